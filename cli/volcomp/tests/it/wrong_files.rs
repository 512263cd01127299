//! Files of another kind, and mistakes in machine files: the message names the content found and the likely intention.

use std::fs;

use crate::{Folder, json, refuse_each, refused, refuses, root};

const FIRST: &str = "examples/first.toml";

#[test]
fn a_file_of_another_kind_is_named() {
    let folder = Folder::new();
    let blob = folder.file("m.blob");
    json(&["compile", FIRST, "-o", &blob]);
    let calls = "
check examples/calibration/calibration.toml => found a calibration file (it has the key `measurement`), expected a machine file
check examples/gateway.toml => found a configuration of the gateway
check examples/calibration/shop.toml => found a shop file
check examples/temperature-module.toml => found a profile of a Modbus module
check examples/calibration/exx.csv => expected TOML: `key = value` or `[table]`
check $blob => found a compiled machine (volcomp compile)
check $program => is not UTF-8
check examples => examples: cannot be read
calibrate $first -o $out => found a machine file (it has the key `structure`), expected a calibration file
simulate $first -o $out => expected a shop file
identify $first -o $out => expected a file of observations
calibrate examples/calibration/shop.toml -o $out => found a shop file
";
    refuse_each(
        calls,
        &[
            ("$blob", &blob),
            ("$program", env!("CARGO_BIN_EXE_volcomp")),
            ("$first", FIRST),
            ("$out", &folder.file("out")),
        ],
    );
}

#[test]
fn a_file_that_is_read_is_not_written_over() {
    let folder = Folder::new();
    let machine = folder.path().join("machine.toml");
    let file = machine.display().to_string();
    let good = fs::read_to_string(root().join(FIRST)).expect("read");
    fs::write(&machine, &good).expect("written");
    for call in [
        &["compile", &file, "-o", &file][..],
        &["correct", "-m", &file, "--at", "X=1", "-o", &file],
    ] {
        refuses(call, "expected another one to write");
        assert_eq!(fs::read_to_string(&machine).expect("read"), good);
    }
    let points = folder.write("points.csv", "X\n1\n");
    refuses(
        &["correct", "-m", &file, "--points", &points, "-o", &points],
        "this is the file of --points, expected another one to write",
    );
    assert_eq!(fs::read_to_string(&points).expect("read"), "X\n1\n");
}

/// Bytes that are not UTF-8 give the same message in every command, with file and position of the byte.
#[test]
fn bytes_that_are_not_utf_8_are_told_with_their_place() {
    let folder = Folder::new();
    let path = folder.path().join("latin.csv");
    fs::write(&path, b"time_s,spindle_degc,z_um\n0,20,\xb5\n").expect("written");
    let file = path.display().to_string();
    for call in
        [&["fit-thermal", &file][..], &["error", "-m", FIRST, "--points", &file], &["check", &file]]
    {
        let message = refused(call);
        let expected = format!("{file}: byte 30 is not UTF-8, expected a text file in UTF-8");
        assert!(message.contains(&expected), "{call:?}: {message}");
    }
}

/// Mistakes that the message table of volcomp-model does not cover.
#[test]
fn slips_in_a_machine_file_are_told_with_what_was_meant() {
    let folder = Folder::new();
    let good = fs::read_to_string(root().join(FIRST)).expect("read");
    for (from, to, expected) in [
        ("EC0Y = 12.0", "ec0y = 12.0", "found `ec0y`, expected upper-case letters: `EC0Y`"),
        ("[axes.X]", "[axes.x]", "found `x`, expected an upper-case letter: `X`"),
        (
            "travel = [0.0, 1000.0]",
            "travel = [0,0, 1000,0]",
            "found an array of 4, expected an array of 2 numbers; a number has a decimal point",
        ),
    ] {
        let file = folder.write("machine.toml", good.replacen(from, to, 1));
        refuses(&format!("check {file}"), expected);
    }
    refuses(
        &format!("check {FIRST} --tool T1"),
        "has no tool `T1`, and its file states none in [tools]",
    );
}
