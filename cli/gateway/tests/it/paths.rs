//! The published state of every path to the control: active, standby, and unknown values.

use std::path::{Path, PathBuf};

use serde_json::{Value, json};
use volcomp_focas::{PmcAddress, PmcArea, simulator::Simulator};
use volcomp_gateway::{config::Config, plan::Plan};
use volcomp_test_support::free_port;
use volcomp_vocabulary::PerChannel;

use crate::{
    controlled::{configuration, control},
    manual::{Served, says, served_configuration},
    program::{Program, change, path},
};

pub(crate) fn two_ways(dir: &Path, first: &Simulator, second: &str) -> PathBuf {
    let config = configuration(dir, first, "");
    let more = format!(
        "[[controller]]\nurl = \"focas://{second}\"\naxes = [\"X\", \"Y\", \"Z\"]\n[dashboard]"
    );
    change(&config, "[dashboard]", &more);
    change(
        &config,
        "axes = [\"X\", \"Y\", \"Z\"]\n[dash",
        "axes = [\"X\", \"Y\", \"Z\"]\nheartbeat = { pmc = \"R\", at = 120 }\n[dash",
    );
    config
}

pub(crate) fn nobody() -> String {
    format!("127.0.0.1:{}", free_port())
}

fn started(config: &Path) -> Program {
    let dir = config.parent().expect("a folder");
    Program::start(dir, &["--config", path(config)])
}

#[test]
fn a_silent_standby_path_is_reported() {
    let dir = tempfile::tempdir().expect("writable");
    let control = control();
    let program = started(&two_ways(dir.path(), &control, &nobody()));
    let state = program
        .wait(|state| says(state, "a standby path does not answer"))
        .expect("it says so");
    let [first, second] = [0, 1].map(|index| &state["controllers"][index]);
    assert_eq!(first["active"], true);
    assert_eq!(first["scheme"], "plain");
    assert!(first["answered_ms"].as_f64() < Some(1000.0), "{state}");
    assert_eq!(second["active"], false);
    assert_eq!(second["number"], 1);
    for key in ["answered_ms", "positions_ms", "confirmed_ms"] {
        assert_eq!(second[key], Value::Null, "{key} of {second}");
    }
    assert_eq!(second["holds_correction"], Value::Null, "not known");
    let metrics = program.get("/metrics").body;
    for line in [
        "volcomp_path_answered_seconds{path=\"1\"} +Inf",
        "volcomp_path_holds_correction{path=\"1\"} NaN",
        "volcomp_path_holds_correction{path=\"0\"} 0",
        "volcomp_path_barrier{path=\"0\"} 0",
        "volcomp_correction_known 1",
    ] {
        assert!(metrics.contains(line), "{line}: {metrics}");
    }
}

/// 77 µm on a standby path are reported, although the output may move on between two readings.
#[test]
fn a_correction_on_a_standby_path_is_reported() {
    let dir = tempfile::tempdir().expect("writable");
    let (active, standby) = (control(), control());
    let y = PmcAddress {
        area: PmcArea::R,
        at: 102,
    };
    standby.world().set_words(y, &[77]);
    let config = two_ways(dir.path(), &active, &standby.address().to_string());
    let program = started(&config);
    let state = program
        .wait(|state| says(state, "a standby path holds a correction"))
        .expect("it says so");
    let [first, second] = [0, 1].map(|index| &state["controllers"][index]);
    assert_eq!(first["holds_correction"], false, "{state}");
    assert_eq!(second["holds_correction"], true, "{state}");
    let metrics = program.get("/metrics").body;
    let line = "volcomp_path_holds_correction{path=\"1\"} 1";
    assert!(metrics.contains(line), "{metrics}");
}

#[test]
fn an_unknown_correction_is_shown_as_unknown() {
    let dir = tempfile::tempdir().expect("writable");
    let config = served_configuration(dir.path(), "");
    let program = Served::start(&config);
    program.must_arm();
    let state = program.wait_for("compensating");
    assert_eq!(state["correction_known"], true);
    assert_eq!(
        state["proven"],
        json!({ "X": "not-proven", "Y": "not-proven", "Z": "not-proven" }),
        "no test shift is made"
    );
    program.gateway().disconnect();
    let state = program
        .wait(|state| state["correction_known"] == false)
        .expect("it is not known any more");
    assert_eq!(state["residual_um"], Value::Null, "{state}");
    let metrics = program.get("/metrics").body;
    assert!(metrics.contains("volcomp_correction_known 0"), "{metrics}");
    assert!(!metrics.contains("volcomp_correction_um{"), "{metrics}");
    let text = volcomp_gateway::status::text(&serde_json::from_value(state).expect("a state"));
    assert!(
        text.contains("unknown: not confirmed by the control"),
        "{text}"
    );
    // An old confirmation does not count as a current value.
    let state = program
        .wait(|state| state["controllers"][0]["holds_correction"].is_null())
        .expect("it is not known any more");
    assert!(
        state["controllers"][0]["confirmed_ms"].as_f64() > Some(2000.0),
        "{state}"
    );
    let metrics = program.get("/metrics").body;
    let line = "volcomp_path_holds_correction{path=\"0\"} NaN";
    assert!(metrics.contains(line), "{metrics}");
    let text = volcomp_gateway::status::text(&serde_json::from_value(state).expect("a state"));
    for words in [
        "check             the cable and the control",
        "correction unknown, last confirmed",
        "in use, focas://",
    ] {
        assert!(text.contains(words), "{words}: {text}");
    }
}

/// A correction found at the start is not shown as sent. While the machine's position is unknown, no error map is shown.
#[test]
fn unsent_and_unknown_values_are_not_shown() {
    let dir = tempfile::tempdir().expect("writable");
    let program = Served::start(&served_configuration(dir.path(), ""));
    let mut found = PerChannel::ZERO;
    found[1] = 0.021;
    program.gateway().rig.overwrite(&found);
    let state = program
        .wait(|state| state["correction_um"]["Y"] == 21.0)
        .expect("it finds a correction");
    assert_eq!(state["sent_um"], json!({}), "{state}");
    program.gateway().disconnect();
    program
        .wait(|state| state["positions_mm"] == json!({}))
        .expect("positions are lost");
    assert_eq!(program.get("/api/map").json()["error_um"], json!([]));
}

#[test]
fn check_shows_the_addresses_in_the_pmc() {
    let dir = tempfile::tempdir().expect("writable");
    let config = configuration(dir.path(), &control(), "");
    change(
        &config,
        "axes =",
        "area = { pmc = \"D\", first = 200, width = 4, copied = true }\nreferenced = { pmc = \"F\", at = 94 }\naxes =",
    );
    let planned = || Plan::new(Config::read(&config).expect("right")).expect("right");
    let plan = planned();
    let document = serde_json::to_value(plan.document().expect("a plan")).expect("plain data");
    assert_eq!(
        document["controllers"][0]["pmc"],
        json!({
            "shift_words": "D200", "shift_bytes": 4, "copied": true, "frame": null, "report": null,
            "heartbeat": "R120", "referenced": "F94",
        })
    );
    // With a barrier only the ladder writes the shifts.
    change(
        &config,
        "area = { pmc = \"D\", first = 200, width = 4, copied = true }\n",
        "barrier = { machine = 7, scan_ms = 8.0, frame = { pmc = \"R\", at = 300 }, report = { pmc = \"R\", at = 400 } }\n",
    );
    change(&config, "heartbeat = { pmc = \"R\", at = 120 }\n", "");
    change(&config, "referenced = { pmc = \"F\", at = 94 }\n", "");
    let plan = planned();
    let document = serde_json::to_value(plan.document().expect("a plan")).expect("plain data");
    let pmc = &document["controllers"][0]["pmc"];
    assert_eq!(
        (&pmc["frame"], &pmc["report"]),
        (&json!("R300"), &json!("R400"))
    );
    assert_eq!(pmc["shift_words"], Value::Null);
}
