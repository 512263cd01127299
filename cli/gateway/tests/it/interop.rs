//! The published state of the gateway, as other systems read it.
//!
//! Every quantity has a key and a value of its kind, JSON documents match their schemas, and every path to the control
//! is shown: active, standby, and with unknown values.

use std::path::{Path, PathBuf};

use serde_json::{Value, json};
use volcomp_focas::simulator::Simulator;
use volcomp_gateway::{
    config::Config,
    documents::{Status, schemas},
    interop::quantities::{
        self, Kind, Part, Quality, Quantity, Reading, Row, Shape, Unit, quantities,
    },
    metrics,
    plan::Plan,
};
use volcomp_test_support::free_port;
use volcomp_vocabulary::{AxisName, PerChannel};

use crate::{
    check::check,
    manual::{
        Gateway, Served, configuration, control, controlled_configuration, machine,
        served_configuration,
    },
    program::change,
};

/// A state in which all values are known, except for the changes in `changes`.
pub(crate) fn status(changes: &Value) -> Status {
    let times = json!({ "p50_us": 0.0, "p99_us": 0.0, "max_us": 0.0 });
    let mut state = json!({
        "state": "compensating", "reasons": [], "armed": true, "auto_arm": false, "simulated": false,
        "machine": { "name": "m", "hash": "sha256:00", "axes": ["X", "C"] },
        "controller": { "device": "focas://192.0.2.1", "channel": "emzps", "number": 0 },
        "controllers": [{
            "device": "focas://192.0.2.1", "number": 0, "active": true, "scheme": "barrier", "answered_ms": 4.0,
            "positions_ms": 8.0, "confirmed_ms": 12.0, "holds_correction": true, "reasons": [],
        }],
        "proven": { "X": "contained", "C": "not-contained" }, "positions_mm": { "X": 400.25 }, "positions_deg": { "C": -90.0 }, "correction_known": true,
        "correction_um": { "X": -12.5 }, "correction_urad": { "C": 100.0 },
        "sent_um": { "X": -12.5 }, "sent_urad": { "C": 100.0 },
        "wanted_um": { "X": -12.5 }, "wanted_urad": { "C": 100.0 },
        "error_um": [3.0, 4.0, 0.0], "error_urad": [0.0, 0.0, 0.0], "residual_um": [0.0, 0.0, 1.0],
        "error_axis_urad": [0.0, 0.0, 2.0], "residual_axis_urad": [0.0, 0.0, 1.0],
        "temperatures": [
            { "name": "bed plate", "degc": 21.5, "quality": "good", "reason": null },
            { "name": "bed|plate", "degc": 22.0, "quality": "good", "reason": null },
        ],
        "held_back": 0, "faults": 3, "uptime_s": 60.0, "age_ms": 20.0,
        "cycle": {
            "count": 100, "period_us": 4000.0, "p50_us": 0.0, "p99_us": 0.0, "max_us": 0.0, "overruns": 0,
            "own": times, "wake": times, "exchange": times, "histogram_us": [],
        },
    });
    for (key, value) in changes.as_object().expect("an object") {
        state[key] = value.clone();
    }
    serde_json::from_value(state).expect("a state")
}

#[test]
fn every_quantity_has_a_key_and_a_value_of_its_kind() {
    let shape = Shape {
        machine: "m".to_owned(),
        axes: vec![AxisName::X, AxisName::C],
        sensors: vec!["bed plate".to_owned(), "bed|plate".to_owned(), "Bed_plate 2".to_owned()],
        controllers: 1,
    };
    let list = quantities(&shape);
    let mut keys: Vec<&str> = list.iter().map(|own| own.key.as_str()).collect();
    for key in &keys {
        assert!(key.starts_with(|c: char| c.is_ascii_lowercase()), "{key}");
        assert!(
            key.chars().all(|c| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '_'),
            "{key}"
        );
    }
    keys.sort_unstable();
    keys.dedup();
    assert_eq!(keys.len(), list.len());
    let status = status(&json!({}));
    for own in &list {
        let reading = own.read(&status);
        if own.part == Part::Sensor(2) {
            assert_eq!((reading.value, reading.quality), (None, Quality::Unknown));
            continue;
        }
        assert_eq!(reading.quality, Quality::Good, "{}", own.key);
        let fits = match reading.value.expect("it is known") {
            quantities::Value::Number(_) => matches!(own.kind, Kind::Number(_)),
            quantities::Value::Whole(_) => matches!(own.kind, Kind::Whole | Kind::Count),
            quantities::Value::Truth(_) => own.kind == Kind::Truth,
            quantities::Value::Text(_) => own.kind == Kind::Text,
        };
        assert!(fits, "{}", own.key);
    }
}

fn x_position(status: &Status) -> Reading {
    let shape = Shape {
        machine: "m".to_owned(),
        axes: vec![AxisName::X],
        sensors: Vec::new(),
        controllers: 0,
    };
    let is_it = |own: &Quantity| own.key == "x_position";
    let position = quantities(&shape).into_iter().find(is_it);
    position.expect("of every axis").read(status)
}

/// A position that is missing, not a number, or old does not have the quality `Good`.
#[test]
fn only_current_values_are_good() {
    for (changes, value, quality) in [
        (json!({}), Some(400.25), Quality::Good),
        (json!({ "positions_mm": {} }), None, Quality::Unknown),
        (json!({ "reasons": ["positions stale"] }), Some(400.25), Quality::Stale),
        (json!({ "reasons": ["positions lost"] }), Some(400.25), Quality::Stale),
        (json!({ "reasons": ["no barrier"] }), Some(400.25), Quality::Good),
    ] {
        let reading = x_position(&status(&changes));
        let expected = value.map(quantities::Value::Number);
        assert_eq!((reading.value, reading.quality), (expected, quality), "{changes}");
    }
    let mut state = status(&json!({}));
    state.positions_mm.insert(AxisName::X, f64::NAN);
    assert_eq!(x_position(&state).value, None);
}

/// A quantity added to the table appears in every interface without other changes.
#[test]
fn a_further_row_is_served_to_others() {
    const ROW: Row<usize> = Row("play", Kind::Number(Unit::Um), "Play", |status, place| Reading {
        value: Some(quantities::Value::Number(status.age_ms + place as f64)),
        quality: Quality::Good,
        age_ms: 0.0,
    });
    let row = || ROW.quantity(Part::Controller(2), "2", 2);
    let status = status(&json!({}));
    let text = metrics::text(&status, &[row()]);
    let expected = "# HELP volcomp_path_play_um Play\n# TYPE volcomp_path_play_um gauge\nvolcomp_path_play_um{path=\"2\"} 22\n";
    assert!(text.contains(expected), "{text}");
    assert_eq!(row().folder(), ["Controllers", "2"]);
    assert_eq!(row().name(), "Play");
    #[cfg(feature = "shdr")]
    {
        use volcomp_gateway::interop::shdr::{Items, SentState};
        let items = Items { quantities: vec![row()], conditions: Vec::new() };
        let lines =
            SentState::nothing(&items).changes(&items, &status, std::time::SystemTime::now());
        assert!(lines.contains("|path_2_play|0.022\n"), "{lines}");
    }
}

const FIVE_AXES: &str = include_str!("../../../../examples/five-axis.toml");

/// Keys of rotary axes, and a ramp that is longer than the end.
const OF_FIVE_AXES: &str = "limit_urad = 200.0
slew_urad_per_s = 500.0
limit_without_barrier_urad = 2000.0
test_shift_urad = 0
stop_s = 0.1
ramp_s = 0.5";

fn length(value: &Value) -> f64 {
    let parts = value.as_array().expect("three numbers");
    let squares = parts.iter().map(|x| x.as_f64().expect("a number").powi(2));
    squares.sum::<f64>().sqrt()
}

/// Before arming, residual and error are equal. The correction reduces the residual. If a stop leaves a correction, its
/// record names every axis.
#[test]
fn errors_and_remaining_corrections_name_every_axis() {
    let dir = tempfile::tempdir().expect("writable");
    let axes = ["X", "Y", "Z", "B", "C"];
    let config = configuration(dir.path(), "");
    std::fs::write(dir.path().join("machine.toml"), FIVE_AXES).expect("writable");
    change(&config, "ramp_s = 0.1", OF_FIVE_AXES);
    let five = format!("axes = {axes:?}\nresolution_urad = 1.0");
    change(&config, r#"axes = ["X", "Y", "Z"]"#, &five);
    let mut gateway = Gateway::start(&config);
    let state = gateway
        .wait("shown", |state| state["error_um"].is_array() && state["residual_um"].is_array());
    assert_eq!(state["state"], "disarmed");
    assert_eq!(state["error_um"], state["residual_um"]);
    assert_eq!(state["error_axis_urad"], state["residual_axis_urad"]);
    assert!(length(&state["error_um"]) > 5.0, "{state}");
    let rotary = state["positions_deg"].as_object().expect("axes").keys();
    assert!(rotary.eq(["B", "C"]), "{state}");
    assert_eq!(state["machine"]["axes"], json!(axes));
    gateway.must_arm();
    gateway.wait_for("compensating");
    gateway.wait("corrected", |state| {
        length(&state["residual_um"]) < 0.2 * length(&state["error_um"])
    });
    let shape = machine(&config).plan().expect("right").shape();
    let text = metrics::text(&gateway.parts.published.latest(), &quantities(&shape));
    assert!(text.contains("volcomp_correction_urad{axis=\"B\"}"), "{text}");
    gateway.stop();
    let log = std::fs::read_to_string(dir.path().join("audit/audit.log")).expect("a log");
    let last = log.lines().last().and_then(|line| line.split_once(' '));
    let record: Value = serde_json::from_str(last.expect("a record").1).expect("JSON");
    assert_eq!(record["what"], "stopped");
    let left = &record["details"]["what"];
    for (key, names) in [("left_um", &axes[..3]), ("left_urad", &axes[3..])] {
        let found = left[key].as_object().expect("axes");
        assert!(found.keys().eq(names), "{key} in {left}");
    }
    assert_ne!(left["left_urad"]["B"], 0.0, "{left}");
}

pub(crate) fn validate(name: &str, document: &Value) {
    let mut all = schemas().into_iter();
    let (_, schema) = all.find(|(of, _)| *of == name).expect("a document");
    let schema = schema.to_value();
    let validator = jsonschema::validator_for(&schema).unwrap_or_else(|e| panic!("{name}: {e}"));
    let errors: Vec<String> =
        validator.iter_errors(document).map(|e| format!("{}: {e}", e.instance_path())).collect();
    assert!(errors.is_empty(), "{name}: {errors:?} in {document}");
}

/// The JSON documents of a running gateway, its audit log and `check` match their schemas.
#[test]
fn live_documents_fit_their_schemas() {
    let dir = tempfile::tempdir().expect("writable");
    let config = served_configuration(dir.path(), "auto_arm = true");
    let program = Served::start(&config);
    let state = program.wait_for("compensating");
    validate("gateway-state.json", &state);
    validate("gateway-map.json", &program.get("/api/map").json());
    let history = program.get("/api/history").json();
    validate("gateway-history.json", &history);
    let points = history["points"].as_array().expect("a list");
    assert_eq!(history.as_object().map(serde_json::Map::len), Some(2));
    assert!(!points.is_empty() && points[0].get("state").is_none());
    for span_s in [120, 3600, 2_592_000] {
        let history = program.get(&format!("/api/history?span_s={span_s}")).json();
        validate("gateway-history.json", &history);
        let last = history["points"].as_array().and_then(|points| points.last());
        let last = last.expect("a point");
        assert!(last["correction_um"].is_object(), "{last}");
    }
    for wrong in ["0", "2592001", "-1", "x"] {
        let answer = program.get(&format!("/api/history?span_s={wrong}"));
        assert_eq!(answer.status, 400, "{wrong}");
    }
    for (request, body) in [
        ("disarm", ""),
        ("acknowledge", ""),
        ("reload", ""),
        ("arm", "{\"confirm\": \"sha256:00\"}"),
        ("arm", "[]"),
    ] {
        let answer = program.post(&format!("/api/{request}"), body).json();
        validate("gateway-answer.json", &answer);
    }
    let log = program.get("/api/log?count=3").json();
    validate("gateway-log.json", &log);
    assert_eq!(log["events"].as_array().map(Vec::len), Some(3));
    let log = program.get("/api/log").json();
    let texts = |who: &str| {
        let events = log["events"].as_array().expect("a list").iter();
        let own = events.filter(move |event| event["who"] == who);
        own.map(|event| event["text"].to_string()).collect::<Vec<_>>()
    };
    assert!(texts("anna").contains(&"\"Disarm\"".to_owned()), "{log}");
    assert_eq!(program.get("/api/log?count=x").status, 400);
    let disturbed = program.post("/api/disturb", "{\"what\":\"cable\",\"on\":true}");
    assert_eq!(disturbed.status, 404, "no simulation");
    let (plan, ..) = check(&config, &["--json"]);
    let plan: Value = serde_json::from_str(&plan).expect("one document");
    validate("gateway-check.json", &plan);
    assert_eq!(plan["configuration"]["guard"]["limit_um"], 150.0);
    let defaults = plan["defaults"].to_string();
    assert!(!defaults.contains("guard.limit_um"), "{defaults}");
    assert!(defaults.contains("guard.stop_s"), "{defaults}");
    program.stop();
    let log = std::fs::read_to_string(dir.path().join("audit/audit.log")).expect("a log");
    let mut whats = Vec::new();
    for line in log.lines() {
        let (_, record) = line.split_once(' ').expect("a checksum first");
        let record: Value = serde_json::from_str(record).expect("JSON");
        validate("gateway-audit-record.json", &record);
        whats.push(record["what"].as_str().expect("text").to_owned());
    }
    for what in ["started", "state", "disarm", "reload", "stopped"] {
        assert!(whats.iter().any(|w| w == what), "{what} in {whats:?}");
    }
    let output = std::fs::read_to_string(dir.path().join("audit/output.json")).expect("written");
    let output: Value = serde_json::from_str(&output).expect("JSON");
    validate("gateway-last-output.json", &output);
}

pub(crate) fn two_ways(dir: &Path, first: &Simulator, second: &str) -> PathBuf {
    let config = controlled_configuration(dir, first, "");
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
    let status = status(&json!({ "controllers": controllers }));
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
    let text =
        volcomp_gateway::client::status_text(&serde_json::from_value(state).expect("a state"));
    assert!(text.contains("unknown: not confirmed by the control"), "{text}");
    // An old confirmation does not count as a current value.
    let state = program
        .wait(|state| state["controllers"][0]["holds_correction"].is_null())
        .expect("it is not known any more");
    assert!(state["controllers"][0]["confirmed_ms"].as_f64() > Some(2000.0), "{state}");
    let metrics = program.get("/metrics").body;
    let line = "volcomp_path_holds_correction{path=\"0\"} NaN";
    assert!(metrics.contains(line), "{metrics}");
    let text =
        volcomp_gateway::client::status_text(&serde_json::from_value(state).expect("a state"));
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
    let config = controlled_configuration(dir.path(), &control(), "");
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
