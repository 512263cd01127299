//! The rehearsal of a configuration on a simulated machine.

use std::{
    fs,
    io::Read,
    path::{Path, PathBuf},
    process::{Command, Output, Stdio},
    time::Duration,
};

use serde_json::Value;
use sha2::{Digest, Sha256};
use volcomp_gateway::{
    config::Config,
    documents::RehearsedFault,
    plan::Plan,
    rehearse::{CATALOGUE, COLUMNS, Rehearsal, text},
};

use volcomp_test_support::Running;

use crate::{interop::validate, program::PATIENCE};

fn examples() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../examples")
}

/// A folder with the shipped machine files, and the shipped configuration changed by `change`.
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
        .env("USER", "anna")
        .output()
        .expect("built")
}

/// Every fault on the shipped configurations. No rule is broken, the table has at most 60 columns, and the document
/// matches its schema.
#[test]
fn shipped_configurations_pass() {
    let (dir, _) = changed(|text| text);
    for file in ["gateway.toml", "gateway-five-axis.toml"] {
        let output = rehearse(dir.path(), &[file]);
        let table = String::from_utf8(output.stdout).expect("UTF-8");
        assert_eq!(output.status.code(), Some(0), "{table}");
        assert!(table.lines().all(|line| line.chars().count() <= 60), "{table}");
        assert!(table.contains("No device was opened and nothing was sent"));
        assert!(table.contains("Not rehearsed:"));
        assert!(table.ends_with("broke no rule\n"));
    }
    let output = rehearse(dir.path(), &["gateway.toml", "--json"]);
    let document: Value = serde_json::from_slice(&output.stdout).expect("one document");
    validate("gateway-rehearsal.json", &document);
    assert_eq!(document["passed"], true);
    // The document has the data that a filed record needs.
    let text = fs::read(dir.path().join("gateway.toml")).expect("written");
    let checksum = Sha256::digest(text)
        .iter()
        .fold("sha256:".to_owned(), |all, byte| format!("{all}{byte:02x}"));
    assert_eq!(document["config_hash"], checksum);
    assert_eq!(document["version"], env!("CARGO_PKG_VERSION"));
    assert_eq!(document["user"], "anna");
    assert!(document["time"].as_str().is_some_and(|time| time.ends_with('Z')));
    assert_eq!(document["selection"], serde_json::json!([]));
    let path = &document["controllers"][0];
    assert_eq!(path["barrier"]["machine"], 1);
    assert_eq!(
        path["limits"][0]["um"],
        serde_json::json!({
            "limit": 150.0, "slew_per_s": 500.0, "accel_per_s2": 20000.0, "step": 1.0, "barrier_per_s": 1000.0
        })
    );
    assert_eq!(document["controllers"][0]["scheme"], "barrier");
    assert_eq!(
        document["controllers"][0]["left_out"],
        serde_json::json!(["sensor_jump", "sensor_corrupt"])
    );
}

#[test]
fn with_a_barrier_no_fault_is_excepted() {
    let (_dir, file) = changed(|text| with_thermometer(&text));
    let plan = Plan::new(Config::read(&file).expect("valid")).expect("valid");
    for seed in 1..4 {
        let found = Rehearsal::of(seed, &[]).expect("all").run(&plan);
        let found = found.expect("limits fit a barrier");
        assert!(found.verdict().is_ok(), "{}", text(&found, COLUMNS));
        let faults = &found.controllers[0].faults;
        // Each fault occurs while compensating and while ramping; faults of sensors are included.
        assert_eq!(faults.len(), 2 * CATALOGUE.len());
        assert!(faults.iter().all(|f| !f.bounded_by_limit && !f.interlock_hidden));
        assert!(faults.iter().all(|f| f.moved_while_held == 0));
        assert!(
            faults[0].axes.iter().any(|axis| axis.excursion().is_some_and(|e| e.furthest > 5.0))
        );
    }
}

/// For any `hold_ms`, reports that repeatedly stay constant for 0.4 s break no rule, and at most four operator actions
/// resume the correction.
#[test]
fn every_hold_passes() {
    for hold_ms in [8, 20, 40, 50, 100, 150, 190, 200] {
        let (_dir, file) = changed(|text| {
            let slower = text.replace("slew_um_per_s = 500.0", "slew_um_per_s = 250.0");
            slower.replace("hold_ms = 200", &format!("hold_ms = {hold_ms}"))
        });
        let plan = Plan::new(Config::read(&file).expect("valid")).expect("valid");
        // Each fault takes long, so only these faults are run.
        let faults = ["constant_100", "constant", "disconnect_50", "all"];
        let names: Vec<String> = match hold_ms {
            40 | 100 => Vec::new(),
            _ => faults.map(str::to_owned).to_vec(),
        };
        let found = Rehearsal::of(1, &names).expect("in the catalogue");
        let found = found.run(&plan).expect("limits fit a barrier");
        assert!(found.verdict().is_ok(), "hold_ms = {hold_ms}\n{}", text(&found, COLUMNS));
        let by_hand = |fault: &RehearsedFault| fault.needed.len();
        let most = found.controllers[0].faults.iter().map(by_hand).max();
        assert!(most <= Some(4), "hold_ms = {hold_ms}\n{}", text(&found, COLUMNS));
    }
}

/// The simulated machine moves no axis faster than the guard believes, on a travel of 8 m, and on a slow one.
#[test]
fn long_travels_and_slow_axes_pass() {
    for (travel, rapid) in [("8000.0", "100.0"), ("600.0", "2.0")] {
        let (dir, file) =
            changed(|text| text.replace("[guard]", &format!("[guard]\nrapid_m_per_min = {rapid}")));
        let machine = dir.path().join("mill.toml");
        let text_of = fs::read_to_string(&machine).expect("copied");
        let longer =
            text_of.replacen("travel = [0.0, 600.0]", &format!("travel = [0.0, {travel}]"), 1);
        assert!(longer.contains(travel), "{longer}");
        fs::write(&machine, longer).expect("writable");
        let plan = Plan::new(Config::read(&file).expect("valid")).expect("valid");
        let names = ["late_write", "positions_lost"].map(str::to_owned);
        let found = Rehearsal::of(1, &names).expect("in the catalogue").run(&plan);
        let found = found.expect("limits fit a barrier");
        assert!(found.verdict().is_ok(), "{travel} {rapid}\n{}", text(&found, COLUMNS));
    }
}

/// A barrier that is faster than its configuration states is detected, with exit status 1.
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
    let table = text(&found, COLUMNS);
    assert!(table.contains("FAIL") && table.contains("in one step, allowed 2 µm"), "{table}");
}

#[test]
fn wrong_calls_and_configurations_end_with_2() {
    let (dir, file) = changed(|text| text);
    let output = rehearse(dir.path(), &["gateway.toml", "--fault", "lightning"]);
    assert_eq!(output.status.code(), Some(2));
    let reported = String::from_utf8(output.stderr).expect("UTF-8");
    assert!(
        reported.starts_with("error: --fault: found \"lightning\", expected one of none, delay, ")
    );
    let output = rehearse(dir.path(), &["gateway.toml", "--fault", "estop"]);
    let reported = String::from_utf8(output.stderr).expect("UTF-8");
    assert!(reported.contains("did you mean") && reported.contains("emergency_stop"), "{reported}");
    let text = fs::read_to_string(&file).expect("written");
    let (guard, controller) = (text.find("[guard]"), text.find("[[controller]]"));
    let (guard, controller) = (guard.expect("there"), controller.expect("there"));
    fs::write(&file, [&text[..guard], &text[controller..]].concat()).expect("writable");
    let output = rehearse(dir.path(), &["gateway.toml"]);
    assert_eq!(output.status.code(), Some(2));
}

/// Ctrl-C ends it like the other commands.
#[test]
fn an_interrupt_ends_it_with_130() {
    let (dir, _) = changed(|text| text);
    let mut command = Command::new(env!("CARGO_BIN_EXE_volcomp-gateway"));
    command.current_dir(dir.path()).args(["rehearse", "gateway.toml"]);
    let mut running = Running::start(command.stdout(Stdio::null()).stderr(Stdio::piped()));
    // Before the thread exists SIGINT is not handled.
    let tasks = format!("/proc/{}/task", running.id());
    let listens = || {
        let tasks = fs::read_dir(&tasks).into_iter().flatten().flatten();
        let names = tasks.map(|task| fs::read_to_string(task.path().join("comm")));
        names.flatten().any(|name| name == "interrupts\n")
    };
    while !listens() {
        assert!(running.try_wait().expect("a child").is_none(), "it has ended");
        std::thread::sleep(Duration::from_millis(1));
    }
    running.signal("INT");
    let status = running.ended(PATIENCE).expect("it ends");
    let mut reported = String::new();
    let mut stderr = running.stderr.take().expect("piped");
    stderr.read_to_string(&mut reported).expect("UTF-8");
    assert_eq!(status.code(), Some(130), "{reported}");
    assert_eq!(reported, "interrupted\n");
}

#[test]
fn the_table_is_for_people() {
    let (dir, _) = changed(|text| without_barrier(&text));
    let faults = ["none", "late_write_50", "emergency_stop", "garbage", "sensor_jump"];
    let named = faults.iter().flat_map(|name| ["--fault", name]);
    let arguments: Vec<&str> = ["gateway.toml"].into_iter().chain(named).collect();
    let output = rehearse(dir.path(), &arguments);
    let table = String::from_utf8(output.stdout).expect("UTF-8");
    let (head, rest) = table.split_once("machine ").expect("the head of a protocol");
    assert!(head.starts_with("rehearsed     20") && head.contains(" UTC\nby            anna on "));
    insta::assert_snapshot!(rest);
}

/// No line is longer than 40 columns, on a terminal of that width.
#[test]
fn the_table_fits_a_narrow_terminal() {
    let (_dir, file) = changed(|text| without_barrier(&text));
    let plan = Plan::new(Config::read(&file).expect("valid")).expect("valid");
    let faults = ["garbage", "late_write_50", "emergency_stop", "sensor_jump"];
    let found = Rehearsal::of(1, &faults.map(str::to_owned)).expect("in the catalogue");
    let found = found.run(&plan).expect("it runs");
    let table = text(&found, 40);
    // A checksum, path or address cannot be wrapped.
    let is_long = |line: &&str| line.chars().count() > 40 && line.contains(' ');
    let long: Vec<&str> = table.lines().filter(is_long).collect();
    assert!(long.iter().all(|line| line.starts_with("configuration")), "{long:?}");
    assert!(table.contains("\nfaults        a selection: 4 of "), "{table}");
}
