//! The published state of every path to the control: active, standby, and unknown values.

use std::path::{Path, PathBuf};

use serde_json::{Value, json};
use volcomp_focas::simulator::Simulator;
use volcomp_gateway::{
    config::Config,
    interop::quantities::{Shape, quantities},
    metrics,
    plan::Plan,
};
use volcomp_test_support::free_port;
use volcomp_vocabulary::PerChannel;

use crate::{
    controlled::{configuration, control},
    interop,
    manual::{Served, served_configuration},
    program::change,
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

pub(crate) fn closed_address() -> String {
    format!("127.0.0.1:{}", free_port())
}

/// Metrics of a standby path that has never answered, and of a path that holds a correction.
#[test]
fn the_metrics_show_what_is_not_known_of_a_standby_path() {
    let path = |number: u8, known: bool| {
        let ms = known.then_some(4.0);
        json!({
            "device": "focas://192.0.2.1", "number": number, "active": number == 0, "scheme": "plain", "answered_ms": ms,
            "positions_ms": ms, "confirmed_ms": ms, "holds_correction": known.then_some(number == 2), "reasons": [],
        })
    };
    let controllers = json!([path(0, true), path(1, false), path(2, true)]);
    let status = interop::status(&json!({ "controllers": controllers }));
    let shape =
        Shape { machine: "m".to_owned(), axes: Vec::new(), sensors: Vec::new(), controllers: 3 };
    let metrics = metrics::text(&status, &quantities(&shape));
    for line in [
        "volcomp_path_answered_seconds{path=\"1\"} +Inf",
        "volcomp_path_holds_correction{path=\"1\"} NaN",
        "volcomp_path_holds_correction{path=\"0\"} 0",
        "volcomp_path_holds_correction{path=\"2\"} 1",
        "volcomp_path_barrier{path=\"0\"} 0",
    ] {
        assert!(metrics.contains(line), "{line}: {metrics}");
    }
}

/// When the control stops responding, the applied correction is shown as unknown everywhere.
#[test]
fn an_unknown_correction_is_shown_as_unknown() {
    let dir = tempfile::tempdir().expect("writable");
    let config = served_configuration(dir.path(), "");
    let program = Served::start(&config);
    program.must_arm();
    let state = program.wait_for("compensating");
    assert_eq!(state["correction_known"], true);
    let metrics = program.get("/metrics").body;
    assert!(metrics.contains("volcomp_correction_known 1"), "{metrics}");
    assert_eq!(
        state["proven"],
        json!({ "X": "not-proven", "Y": "not-proven", "Z": "not-proven" }),
        "no test shift is made"
    );
    program.gateway().disconnect();
    let state =
        program.wait(|state| state["correction_known"] == false).expect("it is not known any more");
    assert_eq!(state["residual_um"], Value::Null, "{state}");
    let metrics = program.get("/metrics").body;
    assert!(metrics.contains("volcomp_correction_known 0"), "{metrics}");
    assert!(!metrics.contains("volcomp_correction_um{"), "{metrics}");
    let text = volcomp_gateway::status::text(&serde_json::from_value(state).expect("a state"));
    assert!(text.contains("unknown: not confirmed by the control"), "{text}");
    // An old confirmation does not count as a current value.
    let state = program
        .wait(|state| state["controllers"][0]["holds_correction"].is_null())
        .expect("it is not known any more");
    assert!(state["controllers"][0]["confirmed_ms"].as_f64() > Some(2000.0), "{state}");
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
    let state =
        program.wait(|state| state["correction_um"]["Y"] == 21.0).expect("it finds a correction");
    assert_eq!(state["sent_um"], json!({}), "{state}");
    program.gateway().disconnect();
    program.wait(|state| state["positions_mm"] == json!({})).expect("positions are lost");
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
    assert_eq!((&pmc["frame"], &pmc["report"]), (&json!("R300"), &json!("R400")));
    assert_eq!(pmc["shift_words"], Value::Null);
}
