use std::path::{Path, PathBuf};

use serde_json::{Value, json};
use volcomp_gateway::{interop::quantities::quantities, metrics};

use crate::{
    manual::{Gateway, machine},
    program::token_file,
};

const MACHINE: &str = include_str!("../../../../examples/five-axis.toml");

/// A configuration without a barrier. The given lines are added to `[guard]` and `[[controller]]`.
fn configuration(
    dir: &Path,
    machine: &str,
    address: &str,
    axes: &[&str],
    [guard, controller]: [&str; 2],
) -> PathBuf {
    std::fs::write(dir.join("machine.toml"), machine).expect("writable");
    token_file(dir);
    let text = format!(
        r#"
machine = "machine.toml"
cycle_ms = 4.0
[guard]
slew_um_per_s = 500.0
slew_urad_per_s = 500.0
hold_ms = 200
zero_after_ms = 3000
{guard}
[[controller]]
url = "focas://{address}"
axes = {axes:?}
area = {{ pmc = "R", first = 100, width = 2 }}
heartbeat = {{ pmc = "R", at = 120 }}
{controller}
[dashboard]
token_file = "tokens"
"#
    );
    let config = dir.join("G.toml");
    std::fs::write(&config, text).expect("writable");
    config
}

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
    let guard = "limit_um = 150.0
limit_without_barrier_um = 150.0
limit_urad = 200.0
limit_without_barrier_urad = 2000.0
ramp_s = 0.5
stop_s = 0.1
test_shift_um = 0
test_shift_urad = 0";
    let axes = ["X", "Y", "Z", "B", "C"];
    let keys = [guard, "resolution_urad = 1.0"];
    let config = configuration(dir.path(), MACHINE, "127.0.0.1:1", &axes, keys);
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
