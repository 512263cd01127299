//! JSON documents match their schemas.

use serde_json::Value;
use volcomp_gateway::documents::schemas;

use crate::{
    manual::{Served, served_configuration},
    online::check,
};

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
