//! The rehearsal of a configuration on a simulated machine.

use std::{
    fs,
    path::{Path, PathBuf},
    process::{Command, Output},
};

use serde_json::Value;
use volcomp_gateway::{
    config::Config,
    plan::Plan,
    rehearse::{CATALOGUE, Rehearsal, text},
};

use crate::documents::validate;

fn examples() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../examples")
}

/// A folder with the shipped machine file and configuration, changed.
fn changed(change: impl FnOnce(String) -> String) -> (tempfile::TempDir, PathBuf) {
    let dir = tempfile::tempdir().expect("writable");
    for file in ["mill.toml", "table-tilting.toml", "gateway-five-axis.toml"] {
        fs::copy(examples().join(file), dir.path().join(file)).expect("writable");
    }
    let text = fs::read_to_string(examples().join("gateway.toml")).expect("shipped");
    let file = dir.path().join("gateway.toml");
    fs::write(&file, change(text)).expect("writable");
    (dir, file)
}

/// The shipped configuration, whose control has a barrier, with a thermometer.
fn with_thermometer(text: &str) -> String {
    text.replace(
        "[dashboard]",
        "[[thermometer]]\nurl = \"modbus://192.0.2.50:502?profile=WAGO-750-461\"\n\
         names = [\"bed\", \"column\"]\n\n[dashboard]",
    )
}

/// The shipped configuration with plain values instead of the barrier.
fn without_barrier(text: &str) -> String {
    let is_barrier = |line: &&str| line.starts_with("barrier = ");
    let barrier = text.lines().find(is_barrier).expect("it has a barrier");
    let plain = "area = { pmc = \"R\", first = 100, width = 2 }\n\
                 heartbeat = { pmc = \"R\", at = 120 }";
    text.replace(barrier, plain)
}

fn rehearse(dir: &Path, arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_volcomp-gateway"))
        .current_dir(dir)
        .arg("rehearse")
        .args(arguments)
        .output()
        .expect("built")
}

/// Every fault, on the shipped configurations: no rule is broken, the table fits a terminal, the document its schema.
#[test]
fn shipped_configurations_pass() {
    let (dir, _) = changed(|text| text);
    for file in ["gateway.toml", "gateway-five-axis.toml"] {
        let output = rehearse(dir.path(), &[file]);
        let table = String::from_utf8(output.stdout).expect("UTF-8");
        assert_eq!(output.status.code(), Some(0), "{table}");
        assert!(
            table.lines().all(|line| line.chars().count() <= 60),
            "{table}"
        );
        assert!(table.contains("No device was opened and nothing was sent"));
        assert!(table.contains("Not rehearsed:"));
        assert!(table.ends_with("broke no rule\n"));
    }
    let output = rehearse(dir.path(), &["gateway.toml", "--json"]);
    let document: Value = serde_json::from_slice(&output.stdout).expect("one document");
    validate("gateway-rehearsal.json", &document);
    assert_eq!(document["passed"], true);
    assert_eq!(document["controllers"][0]["scheme"], "barrier");
    assert_eq!(
        document["controllers"][0]["left_out"],
        serde_json::json!(["sensor_jump", "sensor_corrupt"])
    );
}

/// With a barrier no fault is excepted, and several seeds find nothing.
#[test]
fn with_a_barrier_no_fault_is_excepted() {
    let (_dir, file) = changed(|text| with_thermometer(&text));
    let plan = Plan::new(Config::read(&file).expect("valid")).expect("valid");
    for seed in 1..4 {
        let found = Rehearsal::of(seed, &[]).expect("all").run(&plan);
        let found = found.expect("limits fit a barrier");
        assert!(found.verdict().is_ok(), "{}", text(&found));
        let faults = &found.controllers[0].faults;
        // Each while compensating and while ramping, those of sensors too.
        assert_eq!(faults.len(), 2 * CATALOGUE.len());
        assert!(
            faults
                .iter()
                .all(|f| !f.bounded_by_limit && !f.interlock_hidden)
        );
        assert!(faults.iter().all(|f| f.moved_while_held == 0));
        // The machine was corrected at all.
        assert!(
            faults[0]
                .axes
                .iter()
                .any(|axis| axis.excursion().is_some_and(|e| e.furthest > 5.0))
        );
    }
}

/// A barrier that goes faster than it is said to is found out, with exit status 1.
#[test]
fn a_barrier_that_is_faster_than_stated_fails() {
    let (_dir, file) = changed(|text| with_thermometer(&text));
    let plan = Plan::new(Config::read(&file).expect("valid")).expect("valid");
    let lost = ["positions_lost".to_owned()];
    let mut rehearsal = Rehearsal::of(1, &lost).expect("in the catalogue");
    rehearsal.barrier_rate = 4;
    let found = rehearsal.run(&plan).expect("it runs");
    assert!(!found.passed);
    let error = found.verdict().expect_err("a rule was broken");
    assert_eq!(error.status(), 1);
    let table = text(&found);
    assert!(
        table.contains("FAIL") && table.contains("at once, allowed are 2 µm"),
        "{table}"
    );
}

#[test]
fn wrong_calls_and_configurations_end_with_2() {
    let (dir, file) = changed(|text| text);
    let output = rehearse(dir.path(), &["gateway.toml", "--fault", "lightning"]);
    assert_eq!(output.status.code(), Some(2));
    let told = String::from_utf8(output.stderr).expect("UTF-8");
    assert!(told.starts_with("error: --fault: found \"lightning\", expected one of none, delay, "));
    let text = fs::read_to_string(&file).expect("written");
    let (guard, controller) = (text.find("[guard]"), text.find("[[controller]]"));
    let (guard, controller) = (guard.expect("there"), controller.expect("there"));
    fs::write(&file, [&text[..guard], &text[controller..]].concat()).expect("writable");
    let output = rehearse(dir.path(), &["gateway.toml"]);
    assert_eq!(output.status.code(), Some(2));
}

#[test]
fn the_table_is_for_people() {
    let (dir, _) = changed(|text| without_barrier(&text));
    let faults = [
        "none",
        "late_write_50",
        "emergency_stop",
        "garbage",
        "sensor_jump",
    ];
    let named = faults.iter().flat_map(|name| ["--fault", name]);
    let arguments: Vec<&str> = ["gateway.toml"].into_iter().chain(named).collect();
    let output = rehearse(dir.path(), &arguments);
    insta::assert_snapshot!(String::from_utf8(output.stdout).expect("UTF-8"));
}
