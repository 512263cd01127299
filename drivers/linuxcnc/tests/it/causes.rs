//! The causes that a bridge reports: README.md has their numbers, names and words in one table each, which the driver, the
//! reference barrier and the bridge are held against.

use std::path::Path;

use volcomp_guard::protocol::Refusal;
use volcomp_linuxcnc::Flags;

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

#[test]
fn flags_are_those_of_the_table() {
    let rows = table("flag");
    let own = Flags::ALL
        .map(|flag| [&flag.bit.to_string(), flag.name, flag.set, flag.unset].map(str::to_owned));
    assert_eq!(rows, own);
    assert_eq!(of_component("EMERGENCY_STOP", ""), names(&rows));
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
}
