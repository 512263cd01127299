use std::{
    path::{Path, PathBuf},
    time::Duration,
};

use serde_json::{Value, json};
use volcomp_gateway::{interop::quantities::quantities, metrics};
use volcomp_kinematics::{State, actual_pose, nalgebra::Vector3};
use volcomp_model::{Machine, Temperatures};
use volcomp_vocabulary::AxisName;

use crate::{
    manual::{Gateway, machine},
    program::{change, token_file},
    shipped::copied_examples,
};

const MACHINE: &str = include_str!("../../../../examples/five-axis.toml");
/// What an output may be away from what is wanted, µm: half a step and a tenth of one of hysteresis, and behind a barrier half a step more,
/// for each of three axes.
const ROUNDING_UM: f64 = 1.1;
/// From a position to the correction that it leads to, at the axes: it is read once in a cycle of 4 ms, holds until the next frame is taken,
/// and waits for two scans of 2 ms. Twice that, because the speed is that of the 50 ms before, and the axes accelerate.
const CYCLES_ON_THE_WAY: f64 = 2.0 * 3.0;

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

/// A and C are only read and turn with the others: the tip of the simulated machine is off by the rounding of what is written, and by the
/// change of the correction while it is on its way.
#[test]
fn three_written_axes_correct_the_tip_while_two_others_turn() {
    let (_dir, examples) = copied_examples();
    let config = examples.join("gateway-five-axis.toml");
    change(
        &config,
        "axes = [\"X\", \"Y\", \"Z\", \"A\", \"C\"]",
        "axes = [\"X\", \"Y\", \"Z\"]\nreads = [\"A\", \"C\"]",
    );
    change(&config, "resolution_urad", "# resolution_urad");
    let shown = "includes_correction = true";
    change(&config, shown, &format!("test_shift = false\n{shown}"));
    let machine = Machine::read(examples.join("table-tilting.toml")).expect("a machine");
    let (chain, source) = (machine.chain(), machine.source(&Temperatures::new()));
    let axis = |name: AxisName| machine.index_of(name).expect("of the machine");
    let mut gateway = Gateway::start(&config);
    gateway.wait_for("compensating");
    // The ramp that begins a correction is over.
    gateway.run(Duration::from_secs(1));
    let (mut before, mut largest) = (None::<(f64, Vector3<f64>)>, 0.0_f64);
    for _ in 0..2500 {
        gateway.step();
        let state = gateway.state();
        // A state is that of the last cycle where it is new.
        let cycle = state["cycle"]["count"].as_f64().expect("a count");
        if before.is_some_and(|(before, _)| before == cycle) {
            continue;
        }
        assert_eq!(state["state"], "compensating", "{state}");
        let mut at = State::default();
        for (key, is_rotary) in [("positions_mm", false), ("positions_deg", true)] {
            for (name, place) in state[key].as_object().expect("axes") {
                let place = place.as_f64().expect("a number");
                let place = if is_rotary { place.to_radians() } else { place };
                at.q[axis(name.parse().expect("an axis"))] = place;
            }
        }
        let ideal = chain.ideal_pose(&at);
        let tip = chain.tool_tip_mm();
        let off = |at: &State| {
            let actual = actual_pose(chain, &source, at).transform_point(&tip);
            1e3 * (actual - ideal.transform_point(&tip))
        };
        let without = off(&at);
        for (place, name) in [AxisName::X, AxisName::Y, AxisName::Z]
            .into_iter()
            .enumerate()
        {
            at.q[axis(name)] += gateway.shifts()[place];
        }
        // In the directions of X, Y and Z, between which and the workpiece the table turns.
        let now = ideal.rotation.transpose() * without;
        let (since, then) = before.replace((cycle, now)).unwrap_or((cycle, now));
        let speed = (now - then).norm() / (cycle - since).max(1.0);
        largest = largest.max(without.norm());
        let bound = ROUNDING_UM * 3.0_f64.sqrt() + CYCLES_ON_THE_WAY * speed;
        let with = off(&at).norm();
        assert!(
            with <= bound || since == cycle,
            "{with:.2} µm of {:.2} µm, bound {bound:.2} µm",
            without.norm()
        );
    }
    assert!(largest > 30.0, "{largest} µm without correction");
}
