//! A five-axis machine behind the simulated control: what is told of its rotary axes.

use std::{cell::RefCell, path::Path, sync::Arc, time::Duration};

use serde_json::Value;
use volcomp_focas::simulator::{Options, Simulator, World};

use crate::program::{Program, path, token_file};

const MACHINE: &str = include_str!("../../../../examples/five-axis.toml");

/// A control that stands at one place (mm, deg) of a five-axis machine.
fn control() -> Simulator {
    let mut world = World::new(&['X', 'Y', 'Z', 'B', 'C']);
    world.motion = Arc::new(|_| vec![200.0, 300.0, -100.0, 40.0, 50.0]);
    Simulator::start("127.0.0.1:0", Options::default(), world).expect("loopback")
}

/// A gateway on a control without a barrier: its machine file, the axes of the control, and what its configuration says besides
/// in `[guard]` and `[[controller]]`.
fn gateway(
    dir: &Path,
    machine: &str,
    control: &Simulator,
    axes: &[&str],
    [guard, controller]: [&str; 2],
) -> Program {
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
url = "focas://{}"
axes = {axes:?}
area = {{ pmc = "R", first = 100, width = 2 }}
heartbeat = {{ pmc = "R", at = 120 }}
{controller}
[dashboard]
token_file = "tokens"
"#,
        control.address()
    );
    let config = dir.join("G.toml");
    std::fs::write(&config, text).expect("writable");
    Program::start(dir, &["--config", path(&config)])
}

fn length(value: &Value) -> f64 {
    let parts = value.as_array().expect("three numbers");
    let squares = parts.iter().map(|x| x.as_f64().expect("a number").powi(2));
    squares.sum::<f64>().sqrt()
}

/// With nothing applied the error with correction is that without; what is applied makes it smaller; and the record of
/// a stop that left a correction names every axis.
#[test]
fn errors_and_what_is_left_are_told_of_every_axis() {
    let dir = tempfile::tempdir().expect("writable");
    let control = control();
    let guard = "limit_um = 150.0
limit_without_barrier_um = 150.0
limit_urad = 200.0
limit_without_barrier_urad = 2000.0
ramp_s = 0.5
stop_s = 0
test_shift_um = 0
test_shift_urad = 0";
    let axes = ["X", "Y", "Z", "B", "C"];
    let says = [guard, "resolution_urad = 1.0"];
    let mut program = gateway(dir.path(), MACHINE, &control, &axes, says);
    let state = program
        .wait(|state| state["error_um"].is_array() && state["residual_um"].is_array())
        .expect("it sees the machine");
    assert_eq!(state["state"], "disarmed");
    assert_eq!(state["error_um"], state["residual_um"]);
    assert_eq!(state["error_axis_urad"], state["residual_axis_urad"]);
    assert!(length(&state["error_um"]) > 5.0, "{state}");
    let axes: Vec<&String> = state["positions_deg"]
        .as_object()
        .expect("axes")
        .keys()
        .collect();
    assert_eq!(axes, ["B", "C"]);
    assert_eq!(
        state["machine"]["axes"],
        serde_json::json!(["X", "Y", "Z", "B", "C"])
    );
    program.must_arm();
    let armed = program.wait_for("compensating");
    assert!(
        length(&armed["residual_um"]) < 0.2 * length(&armed["error_um"]),
        "{armed}"
    );
    let metrics = program.get("/metrics").body;
    assert!(
        metrics.contains("volcomp_correction_urad{axis=\"B\"}"),
        "{metrics}"
    );
    program.signal("TERM");
    assert_eq!(program.end(), Some(0));
    let log = std::fs::read_to_string(dir.path().join("audit/audit.log")).expect("a log");
    let (_, record) = log
        .lines()
        .last()
        .and_then(|line| line.split_once(' '))
        .expect("a record");
    let record: Value = serde_json::from_str(record).expect("JSON");
    assert_eq!(record["what"], "stopped");
    let left = &record["details"]["what"];
    for (key, name) in [
        ("left_um", "X"),
        ("left_um", "Y"),
        ("left_um", "Z"),
        ("left_urad", "B"),
        ("left_urad", "C"),
    ] {
        assert!(left[key][name].is_number(), "{key} {name} in {left}");
    }
    assert!(
        left["left_urad"]["B"]
            .as_f64()
            .is_some_and(|urad| urad != 0.0),
        "{left}"
    );
}

/// The table C stands, and the last digit of its position goes to and fro: 0.001°, twice what turned the direction of
/// travel. X was moved by 40 µm at every flicker.
#[test]
fn the_last_digit_of_a_table_that_stands_turns_nothing() {
    let dir = tempfile::tempdir().expect("writable");
    let mut world = World::new(&['X', 'Y', 'Z', 'C']);
    world.motion = Arc::new(|t: Duration| {
        let c = if t.as_secs_f64().rem_euclid(1.0) < 0.5 {
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
    let says = [guard, "test_shift = false"];
    let program = gateway(dir.path(), machine, &control, &axes, says);
    // Three times its last digit is seen to go to and fro, before it is armed and while it compensates.
    let flickers = || {
        let found = RefCell::new(Vec::new());
        for at_top in [true, false].repeat(3) {
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
