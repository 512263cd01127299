//! The wall clock goes where it wants: only records tell it, nothing is computed from it.

use std::{path::Path, process::Command};

use crate::{
    controlled::{configuration, control},
    program::{Program, path},
};

const FAKETIME: &str = "/usr/lib/x86_64-linux-gnu/faketime/libfaketimeMT.so.1";

#[test]
fn a_wall_clock_that_jumps_changes_nothing_but_the_dates() {
    if !Path::new(FAKETIME).exists() {
        volcomp_test_support::peers::not_run("faketime");
        return;
    }
    let dir = tempfile::tempdir().expect("writable");
    let stamp = dir.path().join("stamp");
    std::fs::write(&stamp, "+0").expect("writable");
    let mut command = Command::new(env!("CARGO_BIN_EXE_volcomp-gateway"));
    command
        .env("LD_PRELOAD", FAKETIME)
        .env("FAKETIME_TIMESTAMP_FILE", &stamp)
        .env("FAKETIME_NO_CACHE", "1")
        .env("FAKETIME_DONT_FAKE_MONOTONIC", "1");
    let control = control();
    let config = configuration(dir.path(), &control, "auto_arm = true");
    let arguments = ["--config", path(&config)];
    let mut program = Program::spawn(command, dir.path(), &arguments);
    program.wait_for("compensating");
    for jump in ["-10d", "+3650d", "+0"] {
        let before = program.state()["cycle"]["count"].as_u64().expect("a count");
        std::fs::write(&stamp, jump).expect("writable");
        // On a busy computer it holds for a moment, whatever the clock does.
        let went_on = program.wait(|state| {
            state["cycle"]["count"].as_u64() > Some(before + 100)
                && state["state"] == "compensating"
        });
        went_on.unwrap_or_else(|state| panic!("{jump}: {state}"));
        // Dates in the log jump, its order does not.
        assert_eq!(program.post("/api/disarm", "").status, 200);
        program.wait_for("disarmed");
        program.must_arm();
        program.wait_for("compensating");
    }
    program.signal("TERM");
    assert_eq!(program.end(), Some(0));
    let text = std::fs::read_to_string(dir.path().join("audit/audit.log")).expect("a log");
    let records: Vec<serde_json::Value> = text
        .lines()
        .filter_map(|line| serde_json::from_str(line.split_once(' ')?.1).ok())
        .collect();
    let years: std::collections::BTreeSet<String> = records
        .iter()
        .filter_map(|r| Some(r["time"].as_str()?.get(..4)?.to_owned()))
        .collect();
    assert!(years.len() >= 2, "the clock did jump: {years:?}");
    let steadily = |pair: &[serde_json::Value]| {
        pair[0]["monotonic_s"].as_f64() <= pair[1]["monotonic_s"].as_f64()
            && pair[0]["seq"].as_u64() < pair[1]["seq"].as_u64()
    };
    assert!(records.windows(2).all(steadily));
}
