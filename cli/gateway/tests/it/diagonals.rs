//! Body diagonals over the network: the simulated control measures the residuals of its true errors at its targets.

use std::{
    fs,
    io::{BufRead, Write},
    process::{Command, Stdio},
};

use serde_json::Value;
use volcomp_test_support::Running;

use crate::{
    first_hour::simulator,
    program::{Program, path},
};

/// A machine of 400 × 300 × 200 mm with scale errors of 150 to 250 µm/m and a squareness error of 80 µrad.
const MACHINE: &str = r#"name = "small"
structure = "w X' b Y Z t"
axes = { X.travel = [0, 400], Y.travel = [0, 300], Z.travel = [0, 200] }
errors = { EXX = { poly = [0, 0.2] }, EYY = { poly = [0, 0.15] }, EZZ = { poly = [0, 0.25] }, EC0Y = 80 }
"#;
const GATEWAY: &str = r#"machine = "machine.toml"
cycle_ms = 4.0
auto_arm = true
[guard]
limit_um = 150.0
slew_um_per_s = 500.0
hold_ms = 200
zero_after_ms = 2000
ramp_s = 0.1
test_shift_um = 0
[[controller]]
url = "focas://ADDRESS"
axes = ["X", "Y", "Z"]
includes_correction = true
barrier = { frame = { pmc = "R", at = 200 }, report = { pmc = "R", at = 240 }, machine = 1, scan_ms = 8.0 }
[audit]
dir = "audit"
"#;

fn diagonals() -> String {
    let row = |name: &str, share: f64| {
        let at = |(sense, length): (char, f64)| {
            let share = if sense == 'P' { share } else { 1.0 - share };
            (share * length).to_string()
        };
        let at: Vec<String> = name.chars().zip([400.0, 300.0, 200.0]).map(at).collect();
        format!("{name},{},60000", at.join(","))
    };
    let mut rows = vec!["line,X,Y,Z,feed".to_owned(), ",200,150,100,60000".to_owned()];
    for name in ["PPP", "NPP", "PNP", "PPN"] {
        rows.extend([0.0, 0.25, 0.5, 0.75, 1.0].map(|share| row(name, share)));
    }
    rows.join("\n")
}

/// With the correct model each range falls by 90 %. The remaining tip error is the rounding of the correction words.
#[test]
fn ranges_fall_by_nine_tenths() {
    let dir = tempfile::tempdir().expect("writable");
    let file = |name: &str, text: &str| {
        fs::write(dir.path().join(name), text).expect("writable");
    };
    file("machine.toml", MACHINE);
    file("diagonals.csv", &diagonals());
    // The settling time is long enough for a busy computer.
    let arguments = "--listen 127.0.0.1:0 --truth machine.toml --program diagonals.csv --acceleration-mm-s2 5000 \
        --report targets.csv --wait --report-s 0 --settle-s 0.4 --scan-ms 8 --json";
    let (mut control, line, mut output) = Running::start_and_hear(
        Command::new(simulator())
            .args(arguments.split_whitespace())
            .current_dir(dir.path())
            .stdin(Stdio::piped()),
    );
    let address = line.strip_prefix("listening on ").expect("an address");
    file("gateway.toml", &GATEWAY.replace("ADDRESS", address));
    let config = dir.path().join("gateway.toml");
    let gateway = Program::start(dir.path(), &["--config", path(&config)]);
    gateway.wait_for("compensating");
    writeln!(control.stdin.as_mut().expect("piped"), "run").expect("it listens");
    let mut line = String::new();
    output.read_line(&mut line).expect("text");
    let pass: Value = serde_json::from_str(&line).expect("JSON");
    assert_eq!(pass["not_settled"], 0, "{pass}");
    let lines = pass["lines"].as_array().expect("lines");
    assert_eq!(lines.len(), 4, "{pass}");
    for line in lines {
        assert_eq!(line["targets"], 5);
        let [without, with] =
            ["range_without_um", "range_um"].map(|name| line[name].as_f64().expect("a number"));
        assert!(without > 30.0, "{without} µm");
        assert!(with <= 0.1 * without, "{without} → {with} µm");
    }
    let text = fs::read_to_string(dir.path().join("targets.csv")).expect("written");
    let mut rows = text.lines().map(|row| row.split(','));
    let head: Vec<&str> = rows.next().expect("a head").collect();
    let residuals: Vec<f64> = rows
        .flat_map(|row| head.iter().zip(row))
        .filter(|(name, _)| name.starts_with("residual_") && name.ends_with("_um"))
        .map(|(_, cell)| cell.parse().expect("a number"))
        .collect();
    assert_eq!(residuals.len(), 20 * 3, "{text}");
    // Half a count, a tenth of a count of hysteresis, and 0.02 µm because the error is that of the corrected position.
    assert!(residuals.iter().all(|um| um.abs() <= 0.62), "{text}");
}
