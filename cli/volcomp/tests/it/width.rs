//! On every example no text output of any command is wider than 80 columns.

use std::{fs, process::Command};

use crate::{Folder, root, text, volcomp};

fn machines() -> Vec<String> {
    let entries = fs::read_dir(root().join("examples")).expect("the examples");
    let files = entries.map(|entry| entry.expect("an entry").path());
    let texts = files.filter_map(|path| {
        let text = fs::read_to_string(&path).ok()?;
        text.contains("[axes.X]").then(|| path.display().to_string())
    });
    let mut machines: Vec<String> = texts.collect();
    machines.sort();
    assert!(machines.len() >= 6, "{machines:?}");
    machines
}

fn fits(arguments: &str) {
    let output = volcomp(arguments);
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(0), "{arguments:?}: {said}");
    let shown = String::from_utf8(output.stdout).expect("UTF-8");
    for line in shown.lines().chain(said.lines()) {
        // Long paths and pieces of a machine file may be wider, since they are not wrapped.
        let is_path = line.split_whitespace().any(|word| word.contains('/'));
        let is_toml = line.contains(" = {");
        let wide = line.chars().count();
        assert!(wide <= 80 || is_path || is_toml, "{arguments:?}: {wide} columns\n{line}");
        assert_eq!(line.trim_end(), line, "{arguments:?}: blanks at the end of a line");
    }
}

#[test]
fn every_machine_in_every_command() {
    let folder = Folder::new();
    let place = folder.file("");
    folder.write("points.csv", "X,Y,Z\n1,2,3\n99999,-99999,99999\n-12345.678,0,0\n0,0,-1\n");
    for machine in &machines() {
        for call in [
            "check M",
            "error -m M --at X=1",
            "error -m M --at X=-99999.5,Y=99999.5,Z=-99999.5",
            "error -m M --points $points.csv",
            "correct -m M --at X=1",
            "correct -m M --at X=-99999.5,Y=99999.5,Z=-99999.5",
            "correct -m M --points $points.csv",
            "correct -m M --points $points.csv -o $out.csv",
            "correct -m M --points $out.csv -o $again.csv",
            "diagonals -m M",
            "diagonals -m M --truth M --resolution 0.123",
            "map -m M --grid 3x3x3",
            "map -m M --grid 3x3x3 --compensated",
            "compile M -o $m.blob",
        ] {
            fits(&call.replace('M', machine).replace('$', &place));
        }
    }
}

#[test]
fn every_measurement_in_every_command() {
    let folder = Folder::new();
    let place = folder.file("");
    for call in [
        "demo -o $demo",
        "calibrate $demo/calibration.toml -o $m.toml",
        "calibrate examples/calibration/calibration.toml -o $n.toml",
        "identify examples/identification/observations.toml -o $o.toml",
        "simulate examples/calibration/shop.toml -o $lasers",
        "inspect $demo/exx.rtl",
        "inspect $demo/eay.rta",
        "iso230 $demo/exx.rtl",
        "iso230 $demo/eay.rta",
        "fit-thermal fitting/fit/tests/data/spindle-2min.csv --displacement ch1_um",
        "probe --list",
    ] {
        fits(&call.replace('$', &place));
    }
    for file in ["exx.rtl", "eay.rta"] {
        for method in ["poly", "chebyshev", "mls", "bspline"] {
            // The curve is one line of a machine file, of any length.
            let shown = text(&format!("fit {place}demo/{file} --method {method} --at 0,4000"));
            for line in shown.lines().skip(1) {
                assert!(line.chars().count() <= 80, "{line}");
            }
        }
    }
}

/// A reader that closes the pipe causes no failure. A narrow terminal and missing colours do not change the output.
#[cfg(unix)]
#[test]
fn closed_pipes_and_narrow_terminals() {
    let program = env!("CARGO_BIN_EXE_volcomp");
    let run = |line: &str| {
        Command::new("sh")
            .args(["-c", line])
            .current_dir(root())
            .env("COLUMNS", "40")
            .env("NO_COLOR", "1")
            .output()
            .expect("a shell")
    };
    for call in [
        "check examples/table-tilting.toml",
        "--help",
        "map --help",
        "completions bash",
        "check nowhere.toml",
    ] {
        for reader in ["true", "head -1"] {
            let output = run(&format!("{program} {call} | {reader}"));
            let said = String::from_utf8_lossy(&output.stderr).into_owned();
            assert!(!said.contains("panicked"), "{call} | {reader}: {said}");
        }
        let closed = run(&format!("{program} {call} >&- 2>&-"));
        assert!(matches!(closed.status.code(), Some(0..=2)), "{call}: {closed:?}");
    }
    let narrow = run(&format!("{program} check examples/mill.toml"));
    let wide = volcomp(&["check", "examples/mill.toml"]);
    assert_eq!(narrow.stdout, wide.stdout);
}
