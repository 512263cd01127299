//! The configuration and the machine file are reloaded during correction.

use std::time::Duration;

use serde_json::{Value, json};
use volcomp_gateway::request::Operation;

use crate::{
    manual::{Gateway, configuration, machine, says, started},
    program::change,
    standing::with_thermometer,
};

fn reload(gateway: &mut Gateway) -> (u16, Value) {
    gateway.ask(Operation::Reload(None))
}

fn asked(gateway: &mut Gateway) -> Value {
    let (status, asked) = reload(gateway);
    assert_eq!(status, 409, "{asked}");
    asked
}

fn confirm(gateway: &mut Gateway, asked: &Value) {
    let hash = asked["model"].as_str().map(str::to_owned);
    let (status, confirmed) = gateway.ask(Operation::Reload(hash));
    assert_eq!(status, 200, "{confirmed}");
}

fn refused(gateway: &mut Gateway, words: &str) {
    let (status, refused) = reload(gateway);
    assert_eq!(status, 422, "{refused}");
    assert!(refused.to_string().contains(words), "{refused}");
}

fn ramps(gateway: &Gateway) -> usize {
    gateway.audit().matches("\"state\":\"arming\"").count()
}

fn wait_for_y(gateway: &mut Gateway, um: f64) {
    gateway.wait("applied", |state| state["correction_um"]["Y"] == um);
}

/// Waits until arming needs a confirmation, and returns its question. Auto-arm leaves the gateway disarmed.
fn arming_asks(gateway: &mut Gateway) -> Value {
    gateway.wait_until_says("must be confirmed");
    gateway.watch();
    gateway.run(Duration::from_secs(3));
    assert_eq!(gateway.state()["state"], "disarmed");
    let (status, question) = gateway.ask(Operation::Arm(None));
    assert_eq!(status, 409, "{question}");
    question
}

#[test]
fn a_model_changes_through_the_ramp_and_a_large_change_is_confirmed() {
    let dir = tempfile::tempdir().expect("writable");
    let config = configuration(dir.path(), "auto_arm = true");
    let machine = dir.path().join("machine.toml");
    let mut gateway = Gateway::start(&config);
    gateway.wait_for("compensating");
    wait_for_y(&mut gateway, -20.0);
    // A change of 5 µm at every corner needs no confirmation.
    let before = ramps(&gateway);
    change(&machine, "EYX = 20.0", "EYX = 25.0");
    assert_eq!(reload(&mut gateway).0, 200);
    wait_for_y(&mut gateway, -25.0);
    gateway.wait_for("compensating");
    assert!(ramps(&gateway) > before, "through the ramp");
    // The same files again cause no ramp, and the response says so.
    let before = ramps(&gateway);
    let (status, same) = reload(&mut gateway);
    assert_eq!((status, &same["unchanged"]), (200, &json!(true)), "{same}");
    gateway.run(Duration::from_secs(1));
    assert_eq!(ramps(&gateway), before, "no ramp");
    // A change of 75 µm gets status 409, and is accepted with the hash.
    change(&machine, "EYX = 25.0", "EYX = 100.0");
    let question = asked(&mut gateway);
    assert!((question["worst_corner_um"].as_f64().expect("a number") - 75.0).abs() < 0.1);
    gateway.run(Duration::from_secs(1));
    wait_for_y(&mut gateway, -25.0);
    let other = gateway.ask(Operation::Reload(Some("sha256:00".to_owned())));
    assert_eq!(other.0, 409);
    confirm(&mut gateway, &question);
    wait_for_y(&mut gateway, -100.0);
    // A lower limit needs its own confirmation, because the hash of the machine file does not cover it. Then the
    // correction ramps to the limit.
    change(&config, "limit_um = 150.0", "limit_um = 50.0");
    let question = asked(&mut gateway);
    assert_eq!(question["limits"]["limit_um"], json!([150.0, 50.0]));
    assert_eq!(question["worst_corner_um"], 0.0);
    // No rotary axis is corrected, so the question mentions none.
    assert!(question["worst_corner_urad"].is_null(), "{question}");
    gateway.wait_until_says("must be confirmed");
    let hash = gateway.state()["machine"]["hash"].as_str().map(str::to_owned);
    assert_eq!(gateway.ask(Operation::Reload(hash)).0, 409);
    wait_for_y(&mut gateway, -100.0);
    confirm(&mut gateway, &question);
    let audit = gateway.audit();
    for words in [
        "\"limits\":{\"limit_um\":[150.0,50.0]}",
        // The log lists the reasons in the state's order, not alphabetically.
        "\"reasons\":[\"not proven what positions contain\",",
    ] {
        assert!(audit.contains(words), "{words}: {audit}");
    }
    wait_for_y(&mut gateway, -50.0);
    // A change of a key that is fixed at runtime is reported, and an invalid key is rejected. The correction continues.
    change(&config, "cycle_ms = 4.0", "cycle_ms = 8.0");
    refused(&mut gateway, "cycle_ms");
    change(&machine, "travel = [0.0, 250.0]", "travel = [250.0, 0.0]");
    change(&config, "cycle_ms = 8.0", "cycle_ms = 4.0");
    refused(&mut gateway, "machine.toml");
    gateway.wait_for("compensating");
    // Files on disk that differ from the active ones are reported, also in the response to arming.
    let reported = "files on disk not taken over";
    assert_eq!(gateway.ask(Operation::Disarm).0, 200);
    gateway.wait_for("disarmed");
    assert!(says(&gateway.must_arm(), reported));
    assert!(says(&gateway.wait_for("compensating"), reported));
    change(&machine, "travel = [250.0, 0.0]", "travel = [0.0, 250.0]");
    assert_eq!(reload(&mut gateway).0, 200);
    gateway.wait_until_silent_of(reported);
    // Limits cannot be removed at runtime.
    let text = std::fs::read_to_string(&config).expect("readable");
    let (before, rest) = text.split_once("[guard]").expect("there");
    let (_, after) = rest.split_once("[[controller]]").expect("there");
    std::fs::write(&config, format!("{before}[[controller]]{after}")).expect("writable");
    refused(&mut gateway, "[guard] is missing");
}

/// Two small changes need no confirmation each, but their sum does, because changes are measured from the last
/// confirmed model.
#[test]
fn small_changes_do_not_add_up_without_a_confirmation() {
    let dir = tempfile::tempdir().expect("writable");
    let config = configuration(dir.path(), "auto_arm = true");
    let machine = dir.path().join("machine.toml");
    let mut gateway = Gateway::start(&config);
    gateway.wait_for("compensating");
    let worst_um = |question: &Value| question["worst_corner_um"].as_f64().expect("a number");
    // Arming confirmed a model with 20 µm; `confirm_um` is 10.
    change(&machine, "EYX = 20.0", "EYX = 28.0");
    assert_eq!(reload(&mut gateway).0, 200);
    wait_for_y(&mut gateway, -28.0);
    change(&machine, "EYX = 28.0", "EYX = 36.0");
    let question = asked(&mut gateway);
    assert!((worst_um(&question) - 16.0).abs() < 0.1, "{question}");
    gateway.run(Duration::from_secs(1));
    wait_for_y(&mut gateway, -28.0);
    confirm(&mut gateway, &question);
    wait_for_y(&mut gateway, -36.0);
    // The confirmed change is the new reference.
    change(&machine, "EYX = 36.0", "EYX = 44.0");
    assert_eq!(reload(&mut gateway).0, 200);
    wait_for_y(&mut gateway, -44.0);
    // The distance from the active model counts as well.
    change(&machine, "EYX = 44.0", "EYX = 32.0");
    let question = asked(&mut gateway);
    assert!((worst_um(&question) - 12.0).abs() < 0.1, "{question}");
    // The reference persists over a restart, even with auto-arm.
    change(&machine, "EYX = 32.0", "EYX = 44.0");
    let mut gateway = gateway.killed_and_started(&config);
    wait_for_y(&mut gateway, -44.0);
    change(&machine, "EYX = 44.0", "EYX = 52.0");
    let mut gateway = gateway.killed_and_started(&config);
    gateway.wait_until_says("must be confirmed");
}

/// The machine file is replaced by that of another machine between two runs. Arming gets status 409 and needs the hash.
#[test]
fn another_machine_file_needs_confirmation_before_arming() {
    let dir = tempfile::tempdir().expect("writable");
    let config = configuration(dir.path(), "");
    let file = dir.path().join("machine.toml");
    let mut gateway = Gateway::start(&config);
    gateway.must_arm();
    let rig = gateway.stop();
    change(&file, "EYX = 20.0", "EYX = -80.0");
    let mut gateway = Gateway::again(rig, &config);
    gateway.watch();
    let (status, asked) = gateway.ask(Operation::Arm(None));
    assert_eq!(status, 409, "{asked}");
    let hash = asked["model"].as_str().map(str::to_owned);
    assert!(hash.is_some(), "{asked}");
    assert_eq!(gateway.ask(Operation::Arm(hash)).0, 200);
    // With other axes the gateway does not start.
    change(&file, "w X' b Y Z t", "w X' b Y C Z t");
    let axis = "[axes.C]\ntravel = [-180.0, 180.0]\n[errors]";
    change(&file, "[errors]", axis);
    let refused = machine(&config).plan().err().expect("another machine");
    assert_eq!(refused.status(), 2);
    assert!(refused.to_string().contains("axis C"), "{refused}");
}

/// Changed times and thresholds need a confirmation: they determine how long a stale correction remains, and by how
/// much a model may change without a confirmation.
#[test]
fn changed_times_and_thresholds_need_confirmation() {
    let (_dir, config, mut gateway) = started("auto_arm = true");
    gateway.wait_for("compensating");
    for (key, before, line) in [
        ("hold_ms", 200.0, "hold_ms = 200"),
        ("confirm_um", 10.0, "confirm_um = 10.0"),
        ("zero_after_ms", 3000.0, "zero_after_ms = 3000"),
    ] {
        change(&config, line, &format!("{key} = {}", before - 1.0));
        let question = asked(&mut gateway);
        assert_eq!(question["limits"][key], json!([before, before - 1.0]));
        confirm(&mut gateway, &question);
    }
}

/// A file with another name, structure or travel may belong to another machine. A reload, and arming after a restart,
/// ask for confirmation, however little the file changes the correction.
#[test]
fn signs_of_another_machine_need_confirmation() {
    for (from, to, sign) in [
        ("\"small\"", "\"neighbour\"", "“neighbour”"),
        ("w X' b Y Z t", "w X' Y' b Z t", "structure"),
        ("[0.0, 250.0]", "[0.0, 260.0]", "Z travels"),
    ] {
        let dir = tempfile::tempdir().expect("writable");
        let config = configuration(dir.path(), "auto_arm = true");
        let file = dir.path().join("machine.toml");
        let mut gateway = Gateway::start(&config);
        gateway.wait_for("compensating");
        let before = gateway.state()["machine"]["hash"].clone();
        change(&file, from, to);
        let signs = |question: &Value, before: &str| {
            assert!(question["worst_corner_um"].as_f64() < Some(1.0), "{question}");
            let signs = question["differences"].to_string();
            assert!(signs.contains(sign) && signs.contains(before), "{question}");
        };
        let question = asked(&mut gateway);
        signs(&question, "the active model");
        assert_eq!(gateway.state()["machine"]["hash"], before);
        // After a restart auto-arm asks for confirmation.
        let mut gateway = gateway.killed_and_started(&config);
        let question = arming_asks(&mut gateway);
        signs(&question, "the model armed last");
        let hash = question["model"].as_str().map(str::to_owned);
        assert_eq!(gateway.ask(Operation::Arm(hash)).0, 200);
        // The confirmed file is the reference from now on, for a reload and for a restart.
        gateway.wait_for("compensating");
        assert_eq!(reload(&mut gateway).0, 200);
        let mut gateway = gateway.killed_and_started(&config);
        gateway.wait_for("compensating");
        // A reload returns to the first file.
        change(&file, to, from);
        let question = asked(&mut gateway);
        confirm(&mut gateway, &question);
        let mut gateway = gateway.killed_and_started(&config);
        gateway.wait_for("compensating");
        assert_eq!(gateway.state()["machine"]["hash"], before);
    }
}

/// A restart changes the axes that a controller writes, their held positions, its address or its time. Auto-arm waits
/// for the operator.
#[test]
fn a_changed_controller_needs_confirmation() {
    let axes = |letters: &str| format!("controller[0].axes = [{letters}]");
    for (from, to, limits) in [
        (
            "axes = [\"X\", \"Y\", \"Z\"]",
            "axes = [\"Y\", \"X\", \"Z\"]",
            json!({ axes("\"X\",\"Y\",\"Z\""): [1.0, null], axes("\"Y\",\"X\",\"Z\""): [null, 1.0] }),
        ),
        (
            "axes = [\"X\", \"Y\", \"Z\"]",
            "axes = [\"X\", \"Y\"]\nfixed = { Z = 12.5 }",
            json!({
                axes("\"X\",\"Y\",\"Z\""): [1.0, null],
                axes("\"X\",\"Y\""): [null, 1.0],
                "controller[0].fixed.Z": [null, 12.5],
            }),
        ),
        (
            "heartbeat",
            "hold_ms = 100\nheartbeat",
            json!({ "controller[0].hold_ms": [null, 100.0] }),
        ),
    ] {
        let dir = tempfile::tempdir().expect("writable");
        let config = configuration(dir.path(), "auto_arm = true");
        let mut gateway = Gateway::start(&config);
        gateway.wait_for("compensating");
        drop(gateway);
        change(&config, from, to);
        let mut gateway = Gateway::start(&config);
        let question = arming_asks(&mut gateway);
        assert_eq!(question["limits"], limits);
        let hash = question["model"].as_str().map(str::to_owned);
        assert_eq!(gateway.ask(Operation::Arm(hash)).0, 200);
        gateway.wait_for("compensating");
        drop(gateway);
        Gateway::start(&config).wait_for("compensating");
    }
}

/// A restart changes a controller from thermal terms only to all terms, and back. Arming asks for confirmation and
/// states the size of the change.
#[test]
fn changed_terms_need_confirmation() {
    let dir = tempfile::tempdir().expect("writable");
    let config = with_thermometer(dir.path());
    let [all, thermal] = ["heartbeat = ", "terms = [\"thermal\"]\nheartbeat = "];
    change(&config, all, thermal);
    let mut gateway = Gateway::start(&config);
    gateway.wait_for("compensating");
    wait_for_y(&mut gateway, 0.0);
    for (from, to, terms, um) in
        [(thermal, all, json!([1.0, null]), -20.0), (all, thermal, json!([null, 1.0]), 0.0)]
    {
        change(&config, from, to);
        // A rig keeps the terms of its first start, so start a new one.
        drop(gateway);
        gateway = Gateway::start(&config);
        let question = arming_asks(&mut gateway);
        assert_eq!(question["limits"], json!({ "controller[0].terms = [\"thermal\"]": terms }));
        let worst_um = question["worst_corner_um"].as_f64().expect("a number");
        // The change is `EXX` at the end of X.
        assert!((worst_um - 40.0).abs() < 0.1, "{question}");
        let hash = question["model"].as_str().map(str::to_owned);
        assert_eq!(gateway.ask(Operation::Arm(hash)).0, 200);
        wait_for_y(&mut gateway, um);
        // The terms are confirmed, so the next restart asks no question.
        gateway = gateway.killed_and_started(&config);
        gateway.wait_for("compensating");
        wait_for_y(&mut gateway, um);
    }
}
