//! A state for the tests of the interfaces to other systems, and its quantities.

use serde_json::{Value, json};
use volcomp_gateway::{
    documents::Status,
    interop::quantities::{
        self, Kind, Part, Quality, Quantity, Reading, Row, Shape, Unit, quantities,
    },
    metrics,
};
use volcomp_vocabulary::AxisName;

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
