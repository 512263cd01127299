//! Nothing that people read is wider than 80 columns: every command on every example.

use std::{fs, process::Command};

use crate::{root, volcomp};

/// The machine files of `examples/`.
fn machines() -> Vec<String> {
    let entries = fs::read_dir(root().join("examples")).expect("the examples");
    let files = entries.map(|entry| entry.expect("an entry").path());
    let texts = files.filter_map(|path| {
        let text = fs::read_to_string(&path).ok()?;
        text.contains("[axes.X]")
            .then(|| path.display().to_string())
    });
    let mut machines: Vec<String> = texts.collect();
    machines.sort();
    assert!(machines.len() >= 6, "{machines:?}");
    machines
}

/// Standard output and notes of a call, judged line by line.
fn fits(arguments: &[&str]) {
    let output = volcomp(arguments);
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(0), "{arguments:?}: {said}");
    let shown = String::from_utf8(output.stdout).expect("UTF-8");
    for line in shown.lines().chain(said.lines()) {
        // A path is as long as it is, and a piece of a machine file stays one line.
        let is_path = line.split_whitespace().any(|word| word.contains('/'));
        let is_toml = line.contains(" = {");
        let wide = line.chars().count();
        assert!(
            wide <= 80 || is_path || is_toml,
            "{arguments:?}: {wide} columns\n{line}"
        );
        assert_eq!(
            line.trim_end(),
            line,
            "{arguments:?}: blanks at the end of a line"
        );
    }
}

#[test]
fn every_machine_in_every_command() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = |name: &str| folder.path().join(name).display().to_string();
    let points = path("points.csv");
    fs::write(
        &points,
        "X,Y,Z\n1,2,3\n99999,-99999,99999\n-12345.678,0,0\n0,0,-1\n",
    )
    .expect("written");
    let far = "X=-99999.5,Y=99999.5,Z=-99999.5";
    for machine in &machines() {
        let machine = machine.as_str();
        fits(&["check", machine]);
        for command in ["error", "correct"] {
            for at in ["X=1", far] {
                fits(&[command, "-m", machine, "--at", at]);
            }
            fits(&[command, "-m", machine, "--points", &points]);
        }
        fits(&[
            "correct",
            "-m",
            machine,
            "--points",
            &points,
            "-o",
            &path("out.csv"),
        ]);
        fits(&[
            "correct",
            "-m",
            machine,
            "--points",
            &path("out.csv"),
            "-o",
            &path("again.csv"),
        ]);
        fits(&["diagonals", "-m", machine]);
        fits(&[
            "diagonals",
            "-m",
            machine,
            "--truth",
            machine,
            "--resolution",
            "0.123",
        ]);
        fits(&["map", "-m", machine, "--grid", "3x3x3"]);
        fits(&["map", "-m", machine, "--grid", "3x3x3", "--compensated"]);
        fits(&["compile", machine, "-o", &path("m.blob")]);
    }
}

#[test]
fn every_measurement_in_every_command() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = |name: &str| folder.path().join(name).display().to_string();
    let demo = path("demo");
    fits(&["demo", "-o", &demo]);
    fits(&[
        "calibrate",
        &format!("{demo}/calibration.toml"),
        "-o",
        &path("m.toml"),
    ]);
    fits(&[
        "calibrate",
        "examples/calibration/calibration.toml",
        "-o",
        &path("n.toml"),
    ]);
    fits(&[
        "identify",
        "examples/identification/observations.toml",
        "-o",
        &path("o.toml"),
    ]);
    fits(&[
        "simulate",
        "examples/calibration/shop.toml",
        "-o",
        &path("lasers"),
    ]);
    for file in ["exx.rtl", "eay.rta"] {
        let file = format!("{demo}/{file}");
        fits(&["inspect", &file]);
        fits(&["iso230", &file]);
        for method in ["poly", "chebyshev", "mls", "bspline"] {
            // The curve itself is one line of a machine file, however long.
            let output = volcomp(&["fit", &file, "--method", method, "--at", "0,4000"]);
            let shown = String::from_utf8_lossy(&output.stdout).into_owned();
            for line in shown.lines().skip(1) {
                assert!(line.chars().count() <= 80, "{line}");
            }
        }
    }
    fits(&[
        "fit-thermal",
        "fitting/fit/tests/data/spindle-2min.csv",
        "--displacement",
        "ch1_um",
    ]);
    fits(&["probe", "--list"]);
}

/// A reader that goes away is no failure, a narrow terminal and no colours change nothing.
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
        assert!(
            matches!(closed.status.code(), Some(0..=2)),
            "{call}: {closed:?}"
        );
    }
    let narrow = run(&format!("{program} check examples/mill.toml"));
    let wide = volcomp(&["check", "examples/mill.toml"]);
    assert_eq!(narrow.stdout, wide.stdout);
}
