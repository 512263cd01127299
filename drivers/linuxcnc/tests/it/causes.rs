//! The causes that a bridge reports: README.md has their numbers, names and words in one table each, which the driver, the
//! reference barrier and both bridges are held against.

use std::{path::Path, process::Command};

use volcomp_guard::barrier::Refusal;
use volcomp_linuxcnc::Flags;
use volcomp_test_support::peers;

/// The rows below the table's head of this first column: cells without marks.
fn table(first: &str) -> Vec<Vec<String>> {
    let text = std::fs::read_to_string(of("README.md")).unwrap();
    let rows = text
        .lines()
        .skip_while(|line| !line.starts_with(&format!("| {first} |")))
        .skip(2)
        .take_while(|line| line.starts_with('|'));
    let cells = |line: &str| {
        let inner = line.trim_matches('|').split('|');
        inner
            .map(|cell| cell.replace('`', "").trim().to_owned())
            .collect()
    };
    rows.map(cells).collect()
}

fn of(file: &str) -> std::path::PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join(file)
}

/// Number and name of each row.
fn names(rows: &[Vec<String>]) -> Vec<(u16, String)> {
    rows.iter()
        .map(|row| (row[0].parse().unwrap(), row[1].clone()))
        .collect()
}

/// The constants of an enumeration in C whose first one has this name, without what their names begin with.
fn of_component(first: &str, prefix: &str) -> Vec<(u16, String)> {
    let text = std::fs::read_to_string(of("bridge/volcomp.comp")).unwrap();
    let (_, rest) = text
        .split_once(&format!("enum {{ {prefix}{first}"))
        .unwrap();
    let (rest, _) = rest.split_once("};").unwrap();
    let mut next = 0;
    let mut found = Vec::new();
    for constant in format!("{prefix}{first}{rest}").split(',') {
        let (name, value) = match constant.split_once('=') {
            Some((name, value)) => (name, value.trim().parse().unwrap()),
            None => (constant, next),
        };
        next = value + 1;
        let name = name.trim().strip_prefix(prefix).unwrap();
        found.push((value, name.to_owned()));
    }
    found
}

/// The constants of these names in a module of the bridge in user space; `None` where there is no Python.
fn of_python(module: &str, rows: &[Vec<String>]) -> Option<Vec<(u16, String)>> {
    let program = format!(
        "import sys; sys.dont_write_bytecode = True; sys.path.insert(0, sys.argv[1]); import {module}\n\
         for name in sys.argv[2:]: print(getattr({module}, name), name)"
    );
    let output = Command::new(peers::python()?)
        .args(["-c", &program])
        .arg(of("bridge"))
        .args(rows.iter().map(|row| &row[1]))
        .output()
        .unwrap();
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(output.status.success(), "{said}");
    let text = String::from_utf8(output.stdout).unwrap();
    let lines = text.lines().map(|line| line.split_once(' ').unwrap());
    Some(
        lines
            .map(|(number, name)| (number.parse().unwrap(), name.to_owned()))
            .collect(),
    )
}

#[test]
fn flags_are_those_of_the_table() {
    let rows = table("flag");
    let own = Flags::ALL
        .map(|flag| [&flag.bit.to_string(), flag.name, flag.set, flag.unset].map(str::to_owned));
    assert_eq!(rows, own);
    assert_eq!(of_component("EMERGENCY_STOP", ""), names(&rows));
    if let Some(found) = of_python("datagram", &rows) {
        assert_eq!(found, names(&rows));
    }
    assert_eq!(
        Flags(Flags::ENABLED | Flags::LOST).to_string(),
        format!("on, not homed, {}", rows[5][2])
    );
}

#[test]
fn refusals_are_those_of_the_table() {
    let rows = table("refusal");
    let own = [
        Refusal::None,
        Refusal::Checksum,
        Refusal::Epoch,
        Refusal::Tick,
        Refusal::Owner,
        Refusal::Sequence,
        Refusal::Value,
    ];
    let own = own.map(|why| {
        let name = format!("{why:?}").to_uppercase();
        [(why as u16).to_string(), name, why.to_string()]
    });
    assert_eq!(rows, own);
    assert_eq!(of_component("NONE", "REFUSED_"), names(&rows));
    if let Some(found) = of_python("barrier", &rows) {
        assert_eq!(found, names(&rows));
    }
}

/// What both bridges write into the log of LinuxCNC has the same words.
#[test]
fn both_bridges_say_the_same_in_the_log() {
    for file in ["bridge/volcomp.comp", "bridge/volcomp_bridge.py"] {
        let text = std::fs::read_to_string(of(file)).unwrap();
        for words in [
            "the control has lost an offset, or taken it into its position",
            "nothing moves for a second, then the correction is ramped in anew",
            ": the epoch in it is ",
            " or more behind, and cannot be written; frames are refused until it is",
        ] {
            assert!(text.contains(words), "{file}: {words}");
        }
    }
}
