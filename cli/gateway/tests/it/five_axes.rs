use std::{
    cell::RefCell,
    path::{Path, PathBuf},
    sync::Arc,
    time::Duration,
};

use serde_json::{Value, json};
use volcomp_focas::simulator::{Options, Simulator, World};
use volcomp_gateway::{interop::quantities::quantities, metrics};

use crate::{
    manual::{Gateway, machine},
    program::{Program, path, token_file},
};

const MACHINE: &str = include_str!("../../../../examples/five-axis.toml");

/// A configuration without a barrier, with these lines added to `[guard]` and `[[controller]]`.
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

/// Before arming, residual and error are equal; the correction reduces the residual. If a stop leaves a correction, its record names
/// every axis.
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
    let state = gateway.wait("shown", |state| {
        state["error_um"].is_array() && state["residual_um"].is_array()
    });
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
    assert!(
        text.contains("volcomp_correction_urad{axis=\"B\"}"),
        "{text}"
    );
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

/// C is at rest and the last digit of its position flickers by 0.001°: X moves by at most 1 µm, not by the reversal value of 40 µm.
#[test]
fn a_flickering_last_digit_causes_no_reversal() {
    let dir = tempfile::tempdir().expect("writable");
    let mut world = World::new(&['X', 'Y', 'Z', 'C']);
    world.motion = Arc::new(|t: Duration| {
        let c = if t.as_secs_f64().rem_euclid(0.3) < 0.15 {
            89.9996
        } else {
            90.0004
        };
        let c = if t < Duration::from_secs(1) {
            80.0
        } else {
            c + 0.0003
        };
        vec![200.0, 300.0, -100.0, c]
    });
    let control = Simulator::start("127.0.0.1:0", Options::default(), world).expect("loopback");
    let machine = "name = \"m\"\nstructure = \"w C' X' b Y Z t\"\n[axes.X]\ntravel = [0.0, 800.0]\n[axes.Y]\ntravel = [0.0, 600.0]\n[axes.Z]\ntravel = [-500.0, 0.0]\n[axes.C]\ntravel = [0.0, 360.0]\nmodulo = 360.0\n[tool]\ntip = [0.0, 0.0, -100.0]\naxis = [0.0, 0.0, 1.0]\n[errors]\nEXC = { mean = { poly = [0.0] }, reversal = 40.0 }\n";
    let guard = "limit_um = 30.0\nlimit_urad = 30.0\nramp_s = 0.1";
    let axes = ["X", "Y", "Z", "C"];
    let keys = [guard, "test_shift = false"];
    let address = control.address().to_string();
    let config = configuration(dir.path(), machine, &address, &axes, keys);
    let program = Program::start(dir.path(), &["--config", path(&config)]);
    // Five flickers of the last digit, before arming and while compensating.
    let flickers = || {
        let found = RefCell::new(Vec::new());
        for at_top in [true, false].repeat(5) {
            let there = program.wait(|state| {
                let of = |axis: &str| state["correction_um"][axis].as_f64();
                let both = of("X").zip(of("Y"));
                found.borrow_mut().extend(both.map(|(x, y)| x + y));
                let c = state["positions_deg"]["C"].as_f64();
                c.is_some_and(|c| c > 89.0 && (c > 90.0005) == at_top)
            });
            there.expect("it flickers");
        }
        found.into_inner()
    };
    flickers();
    program.must_arm();
    program.wait_for("compensating");
    let found: Vec<f64> = flickers();
    let [low, high] =
        [f64::min, f64::max].map(|of| found.iter().copied().reduce(of).expect("some"));
    assert!(high - low <= 1.0, "from {low} to {high} µm");
    assert!(
        low.abs() > 15.0,
        "{low} µm: the reversal error is corrected"
    );
}
