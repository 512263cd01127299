//! What people read in a terminal.

use serde_json::json;
use volcomp_gateway::{run, status};

#[test]
fn status_fits_a_small_terminal() {
    let state = json!({
        "state": "compensating",
        "reasons": ["degraded", "rate limited"],
        "machine": { "name": "five-axis" },
        "controller": { "device": "focas://192.0.2.10:8193" },
        "positions_mm": { "X": 123.456, "Y": -4.5, "Z": 0.0 },
        "positions_deg": { "B": 30.0, "C": -45.25 },
        "correction_um": { "X": -12.0, "Y": 3.0, "Z": 0.0 },
        "correction_urad": { "B": 4.0, "C": 0.0 },
        "temperatures": [
            { "name": "bed", "degc": 21.46, "quality": "good", "reason": null },
            { "name": "spindle", "degc": null, "quality": "bad", "reason": "jumping" },
        ],
        "cycle": { "count": 1234, "p50_us": 38.1, "p99_us": 92.4, "overruns": 2 },
    });
    let text = status::text(&state);
    assert!(text.lines().all(|line| line.len() <= 80), "{text}");
    insta::assert_snapshot!(text);
}

#[test]
fn check_says_what_would_be_corrected() {
    let dir = tempfile::tempdir().expect("writable");
    std::fs::write(dir.path().join("machine.toml"), crate::program::MACHINE).expect("writable");
    let config = dir.path().join("G.toml");
    let text = "machine = \"machine.toml\"\n[[controller]]\nurl = \"can://can0\"\naxes = [\"X\"]\nfixed = { Y = 50.0 }\n";
    std::fs::write(&config, text).expect("writable");
    insta::assert_snapshot!(
        run::check(&config)
            .unwrap_or_else(|e| panic!("{e}"))
            .join("\n")
    );
}
