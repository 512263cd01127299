//! Files of another kind, and slips in machine files: the message names what was found and what was meant.

use std::fs;

use crate::{refused, root};

const FIRST: &str = "examples/first.toml";

#[test]
fn a_file_of_another_kind_is_named() {
    let folder = tempfile::tempdir().expect("a folder");
    let blob = folder.path().join("m.blob").display().to_string();
    crate::json(&["compile", FIRST, "-o", &blob]);
    let program = env!("CARGO_BIN_EXE_volcomp");
    let calibration = "examples/calibration/calibration.toml";
    for (call, expected) in [
        (
            ["check", calibration],
            "found a calibration file (it has the key `measurement`), expected a machine file",
        ),
        (
            ["check", "examples/gateway.toml"],
            "found a configuration of the gateway",
        ),
        (
            ["check", "examples/calibration/shop.toml"],
            "found a shop file",
        ),
        (
            ["check", "examples/temperature-module.toml"],
            "found a profile of a Modbus module",
        ),
        (
            ["check", "examples/calibration/exx.csv"],
            "expected TOML: `key = value` or `[table]`",
        ),
        (
            ["check", &blob],
            "found a compiled machine (volcomp compile)",
        ),
        (["check", program], "is not UTF-8"),
        (["check", "examples"], "examples: cannot be read"),
    ] {
        let message = refused(&call);
        assert!(message.contains(expected), "{call:?}: {message}");
    }
    for (command, file, expected) in [
        (
            "calibrate",
            FIRST,
            "found a machine file (it has the key `structure`), expected a calibration file",
        ),
        ("simulate", FIRST, "expected a shop file"),
        ("identify", FIRST, "expected a file of observations"),
        (
            "calibrate",
            "examples/calibration/shop.toml",
            "found a shop file",
        ),
    ] {
        let out = folder.path().join("out").display().to_string();
        let message = refused(&[command, file, "-o", &out]);
        assert!(message.contains(expected), "{command} {file}: {message}");
    }
}

#[test]
fn a_file_that_is_read_is_not_written_over() {
    let folder = tempfile::tempdir().expect("a folder");
    let machine = folder.path().join("machine.toml");
    let file = machine.display().to_string();
    let good = fs::read_to_string(root().join(FIRST)).expect("read");
    fs::write(&machine, &good).expect("written");
    for call in [
        &["compile", &file, "-o", &file][..],
        &["correct", "-m", &file, "--at", "X=1", "-o", &file],
    ] {
        let message = refused(call);
        assert!(
            message.contains("expected another one to write"),
            "{message}"
        );
        assert_eq!(fs::read_to_string(&machine).expect("read"), good);
    }
    let points = folder.path().join("points.csv").display().to_string();
    fs::write(&points, "X\n1\n").expect("written");
    let message = refused(&["correct", "-m", &file, "--points", &points, "-o", &points]);
    assert!(
        message.contains("this is the file of --points, expected another one to write"),
        "{message}"
    );
    assert_eq!(fs::read_to_string(&points).expect("read"), "X\n1\n");
}

/// A text in another encoding has one message, whichever command reads it.
#[test]
fn bytes_that_are_not_utf_8_are_told_with_their_place() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("latin.csv");
    fs::write(&path, b"time_s,spindle_degc,z_um\n0,20,\xb5\n").expect("written");
    let file = path.display().to_string();
    for call in [
        &["fit-thermal", &file][..],
        &["error", "-m", FIRST, "--points", &file],
        &["check", &file],
    ] {
        let message = refused(call);
        let expected = format!("{file}: byte 30 is not UTF-8, expected a text file in UTF-8");
        assert!(message.contains(&expected), "{call:?}: {message}");
    }
}

#[test]
fn slips_in_a_machine_file_are_told_with_what_was_meant() {
    let folder = tempfile::tempdir().expect("a folder");
    let good = fs::read_to_string(root().join(FIRST)).expect("read");
    let path = folder.path().join("machine.toml");
    let file = path.display().to_string();
    for (from, to, expected) in [
        (
            "EC0Y = 12.0",
            "EC0Y = oops",
            "found `oops`, expected a number (12.5)",
        ),
        (
            "EC0Y = 12.0",
            "EC0Y = 12,5",
            "found `12,5`, expected a decimal point: 12.5",
        ),
        (
            "EC0Y = 12.0",
            "EC0Y = -0,5 # µrad",
            "found `-0,5`, expected a decimal point: -0.5",
        ),
        (
            "EC0Y = 12.0",
            "EC0Y = 12 µrad",
            "found `12 µrad`, expected a number",
        ),
        (
            "EC0Y = 12.0",
            "EC0Y =",
            "found nothing behind `=`, expected a value",
        ),
        (
            "EC0Y = 12.0",
            "EC0Y = \"12\"",
            "errors.EC0Y: found the text \"12\", expected a finite number",
        ),
        (
            "EC0Y = 12.0",
            "ec0y = 12.0",
            "found `ec0y`, expected upper-case letters: `EC0Y`",
        ),
        (
            "[axes.X]",
            "[axes.x]",
            "found `x`, expected an upper-case letter: `X`",
        ),
        (
            "travel = [0.0, 1000.0]",
            "travl = [0.0, 1000.0]",
            "did you mean `travel`?",
        ),
        (
            "travel = [0.0, 1000.0]",
            "travel = [0,0, 1000,0]",
            "found an array of 4, expected an array of 2 numbers; a number has a decimal point",
        ),
        (
            "EXX = { poly",
            "EXX = { ploy",
            "found no curve in `ploy`, expected one of: poly",
        ),
        ("EXX = { poly", "EXX = { ploy", "did you mean `poly`?"),
        ("name =", "nmae =", "did you mean `name`?"),
    ] {
        let broken = good.replacen(from, to, 1);
        assert_ne!(broken, good, "{from}");
        fs::write(&path, &broken).expect("written");
        let message = refused(&["check", &file]);
        assert!(message.contains(expected), "{to}: {message}");
        let line = 1 + broken
            .lines()
            .position(|line| line.contains(to.split(' ').next().unwrap_or(to)))
            .expect("the line");
        assert!(
            message.contains(&format!("machine.toml:{line}: ")),
            "{to}, line {line}: {message}"
        );
    }
    let message = refused(&["check", FIRST, "--tool", "T1"]);
    assert!(
        message.contains("has no tool `T1`, and its file states none in [tools]"),
        "{message}"
    );
}
