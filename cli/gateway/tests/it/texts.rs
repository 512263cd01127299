//! Texts shown in a terminal.

use volcomp_gateway::{check, config::Config, documents::Status, plan::Plan, status};

#[test]
fn status_fits_a_small_terminal() {
    let state = serde_json::json!({
        "state": "compensating",
        "reasons": ["degraded", "rate limited"],
        "armed": true,
        "auto_arm": false,
        "simulated": false,
        "machine": { "name": "five-axis", "hash": "sha256:00", "axes": ["X", "Y", "Z", "B", "C"] },
        "controller": { "device": "focas://192.0.2.10:8193", "channel": "emzps", "number": 0 },
        "controllers": [
            {
                "device": "focas://192.0.2.10:8193", "number": 0, "active": true, "scheme": "barrier",
                "answered_ms": 1.2, "positions_ms": 3.4, "confirmed_ms": 3.4, "holds_correction": true, "reasons": [],
            },
            {
                "device": "can://can0", "number": 1, "active": false, "scheme": "plain", "answered_ms": null,
                "positions_ms": null, "confirmed_ms": null, "holds_correction": null, "reasons": ["no barrier"],
            },
        ],
        "correction_known": true,
        "proven": { "X": "contained", "Y": "contained", "Z": "not-contained", "B": "not-proven", "C": "not-proven" },
        "positions_mm": { "X": 123.456, "Y": -4.5, "Z": 0.0 },
        "positions_deg": { "B": 30.0, "C": -45.25 },
        "correction_um": { "X": -12.0, "Y": 3.0, "Z": 0.0 },
        "correction_urad": { "B": 4.0, "C": 0.0 },
        "wanted_um": { "X": -12.2, "Y": 3.1, "Z": 0.0 },
        "wanted_urad": { "B": 4.4, "C": 0.1 },
        "error_um": [12.0, -3.0, 4.0],
        "error_urad": [1.0, -4.0, 0.0],
        "error_axis_urad": [-4.0, -1.0, 0.0],
        "residual_um": [0.2, 0.1, 0.0],
        "residual_axis_urad": [0.4, 1.0, 0.0],
        "temperatures": [
            { "name": "bed", "degc": 21.46, "quality": "good", "reason": null },
            { "name": "spindle", "degc": null, "quality": "bad", "reason": "jumped" },
        ],
        "held_back": 0,
        "faults": 0,
        "uptime_s": 4.9,
        "age_ms": 1.0,
        "cycle": {
            "count": 1234, "period_us": 4000.0, "p50_us": 38.1, "p99_us": 92.4, "max_us": 120.0, "overruns": 2,
            "own": { "p50_us": 2.0, "p99_us": 3.0, "max_us": 4.0 },
            "wake": { "p50_us": 2.0, "p99_us": 3.0, "max_us": 4.0 },
            "exchange": { "p50_us": 2.0, "p99_us": 3.0, "max_us": 4.0 },
            "histogram_us": [[64.0, 1200], [128.0, 34]],
        },
    });
    let status: Status = serde_json::from_value(state).expect("a state");
    let text = status::text(&status);
    assert!(text.lines().all(|line| line.chars().count() <= 80), "{text}");
    insta::assert_snapshot!(text);
}

#[test]
fn check_says_what_would_be_corrected() {
    let dir = tempfile::tempdir().expect("writable");
    std::fs::write(dir.path().join("machine.toml"), crate::program::MACHINE).expect("writable");
    let config = dir.path().join("G.toml");
    let text = r#"machine = "machine.toml"
[guard]
limit_um = 150.0
limit_without_barrier_um = 150.0
slew_um_per_s = 500.0
hold_ms = 50
zero_after_ms = 500
[[controller]]
url = "can://can0"
axes = ["X"]
fixed = { Y = 50.0, Z = 0.0 }
[[thermometer]]
url = "modbus://192.0.2.20:502?unit=1&profile=PTA8C04"
names = ["bed", "spindle"]
"#;
    std::fs::write(&config, text).expect("writable");
    let config = Config::read(&config).unwrap_or_else(|e| panic!("{e}"));
    let plan = Plan::new(config).unwrap_or_else(|e| panic!("{e}"));
    let folder = dir.path().display().to_string();
    let text = check::text(&plan.document().expect("a plan"), &plan.config);
    let text = text.replace(&folder, "FOLDER");
    insta::assert_snapshot!(text);
}
