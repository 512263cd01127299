//! Wrong units and overflowing numbers: every command rejects them, and writes nothing.

use std::{fs, path::Path};

use crate::{Folder, contains, one_line, refused, root, volcomp, words};

/// Writes `examples/mill.toml` with `line` in place of the line of the same key (EXX or EC0Y). Returns the path.
fn mill(folder: &Path, name: &str, line: &str) -> String {
    let text = fs::read_to_string(root().join("examples/mill.toml")).expect("the example");
    let key = line.split(' ').next().expect("a key");
    let lines =
        text.lines().map(|old| if old.starts_with(&format!("{key} =")) { line } else { old });
    let path = folder.join(name);
    fs::write(&path, lines.collect::<Vec<_>>().join("\n")).expect("written");
    path.to_str().expect("a path in UTF-8").to_owned()
}

fn said(output: &std::process::Output) -> String {
    String::from_utf8_lossy(&output.stderr).split_whitespace().collect::<Vec<_>>().join(" ")
}

#[test]
fn a_slip_of_units_writes_no_program_and_no_table() {
    let folder = Folder::new();
    let machine = mill(folder.path(), "slip.toml", "EXX = { poly = [0.0, 20] }");
    let result = folder.file("result");
    for (call, limit) in [
        ("nc examples/part.ngc --setup examples/setup.toml --limit-um 2000", 2000),
        ("nc examples/part.mpf --setup examples/setup.toml", 250),
        ("export --format csv", 250),
    ] {
        let output = volcomp(&format!("{call} -m {machine} -o {result}"));
        assert_eq!(output.status.code(), Some(2), "{call}: {output:?}");
        let said = said(&output);
        assert!(
            said.contains(&format!("expected at most {limit} µm"))
                && said.ends_with("or allow more with --limit-um"),
            "{said}"
        );
        assert!(!Path::new(&result).exists(), "{call}");
    }
    let checked = said(&volcomp(&["check", &machine]));
    contains(&checked, "WARNING: the correction of X reaches");
    contains(&checked, "more than the 2000 µm that no command and no gateway applies");
    // The correction of X is between the default limit of 250 µm and the maximum of `--limit-um`, 2000 µm.
    let machine = mill(folder.path(), "large.toml", "EXX = { poly = [0.0, 1] }");
    let checked = said(&volcomp(&["check", &machine]));
    contains(&checked, "more than the 250 µm that nc and export allow");
    let output = volcomp(&format!("export -m {machine} --format csv -o {result} --limit-um 700"));
    assert!(output.status.success(), "{output:?}");
    let checked = said(&volcomp(&["check", "examples/mill.toml"]));
    assert!(!checked.contains("WARNING"), "{checked}");
    // 11.5 µm/(m·K) over 8 m, with a correction of 48 µm at 20 °C.
    let checked = said(&volcomp(&["check", "examples/gantry.toml"]));
    let checked = one_line(&checked);
    contains(
        &checked,
        "the correction of X changes by up to 92.0 µm with each kelvin of the sensors: 2.1 K from 20 °C it may reach the 250 µm that nc and export allow",
    );
    // On a machine whose rotary axes correct, `nc` limits the effect of the correction at the tool.
    let text = "structure = \"w C' A' b X Y Z t\"\n[axes]\nX.travel = [-300.0, 300.0]\nY.travel = [-200.0, 200.0]\nZ.travel = [-150.0, 150.0]\nA.travel = [-110.0, -30.0]\nC.travel = [-180.0, 180.0]\n[errors]\nEXX = { poly = [0.0, 1] }\n";
    let machine = folder.path().join("rotary.toml");
    std::fs::write(&machine, text).expect("written");
    let checked = said(&volcomp(&["check", machine.to_str().expect("UTF-8")]));
    let checked = one_line(&checked);
    contains(&checked, "more than the 250 µm that export allows without --limit-um (nc bounds");
}

#[test]
fn limits_above_the_ceiling_are_refused() {
    for limit in ["0", "-5", "2001", "inf"] {
        let call = words("export -m examples/mill.toml --format csv -o x");
        let message = refused(&[&call[..], &["--limit-um", limit]].concat());
        let expected = format!("--limit-um: found {limit}, expected µm above 0, at most 2000");
        contains(&message, &expected);
    }
}

/// A number that overflows is rejected by every command with its position, in any key.
#[test]
fn numbers_that_overflow_are_refused_by_every_command() {
    let folder = Folder::new();
    for line in ["EC0Y = 1e308", "EXX = { poly = [0.0, 1e308] }", "EXX = { poly = [1e14, 1e14] }"] {
        let machine = mill(folder.path(), "m.toml", line);
        for call in [
            vec!["check", &machine],
            vec!["error", "-m", &machine, "--at", "X=100"],
            vec!["correct", "-m", &machine, "--at", "X=100"],
            vec!["diagonals", "-m", &machine],
            vec!["map", "-m", &machine, "--grid", "3x3x3"],
            vec!["dh", "-m", &machine],
        ] {
            let output = volcomp(&call);
            assert_eq!(output.status.code(), Some(2), "{call:?} {line}: {output:?}");
            assert!(output.stdout.is_empty(), "{call:?} {line}: {output:?}");
            let said = said(&output);
            contains(&said, "m.toml:");
            contains(&said, "expected");
        }
    }
}
