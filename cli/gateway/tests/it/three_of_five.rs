//! A five-axis machine on which X, Y and Z are written and A and C only read: gateway and control together, judged by the simulated
//! machine's tool error.

use std::{
    collections::BTreeMap,
    thread::sleep,
    time::{Duration, Instant},
};

use serde_json::Value;
use volcomp_kinematics::{State, actual_pose};
use volcomp_model::{Machine, Temperatures};
use volcomp_vocabulary::{AxisName, Deg};

use crate::{
    program::{Program, change, path},
    shipped::{Control, copied_examples},
};

/// Maximum deviation of an output from the requested correction, µm per axis: half a step and 10 % hysteresis.
const ROUNDING_UM: f64 = 0.6;
/// Delay from a position to its applied correction, s: one cycle of 4 ms, the wait for the next accepted frame, and two scans of 2 ms.
const DELAY_S: f64 = 0.012;
/// The same delay on a busy computer.
const BUSY_DELAY_S: f64 = 0.040;

/// A gateway and a simulated control with these options; X, Y and Z take corrections.
fn corrected(options: &[&str]) -> (tempfile::TempDir, Control, Program, Machine) {
    let (dir, examples) = copied_examples();
    let machine = examples.join("table-tilting.toml");
    let of_control = ["--truth", path(&machine), "--barrier-axes", "X,Y,Z"];
    let control = Control::start(dir.path(), &[&of_control[..], options].concat());
    let file = examples.join("gateway-five-axis.toml");
    change(&file, "127.0.0.1:8193", &control.address);
    change(
        &file,
        "axes = [\"X\", \"Y\", \"Z\", \"A\", \"C\"]",
        "axes = [\"X\", \"Y\", \"Z\"]\nreads = [\"A\", \"C\"]",
    );
    change(&file, "resolution_urad", "# resolution_urad");
    let gateway = Program::start(dir.path(), &["--config", path(&file)]);
    gateway.wait_for("compensating");
    let machine = Machine::read(&machine).expect("a machine");
    (dir, control, gateway, machine)
}

/// Tip error in a report line, µm, without and with the correction.
fn misses_um(report: &Value) -> [f64; 2] {
    ["error", "residual"].map(|name| {
        let vector: [f64; 3] =
            serde_json::from_value(report[name]["position_um"].clone()).expect("numbers");
        vector.iter().map(|x| x * x).sum::<f64>().sqrt()
    })
}

/// Correction of X, Y and Z that removes the tip's position error, µm, at these axis positions (mm, deg).
fn correction_um(machine: &Machine, places: &BTreeMap<String, f64>) -> [f64; 3] {
    let mut state = State::default();
    for (name, place) in places {
        let name: AxisName = name.parse().expect("an axis");
        let index = machine.index_of(name).expect("of the machine");
        state.q[index] = if name.is_rotary() {
            Deg(*place).to_rad().0
        } else {
            *place
        };
    }
    let chain = machine.chain();
    let ideal = chain.ideal_pose(&state);
    let actual = actual_pose(chain, &machine.source(&Temperatures::new()), &state);
    let tip = chain.tool_tip_mm();
    let error = actual.transform_point(&tip) - ideal.transform_point(&tip);
    // In machine directions: the table's rotation lies between these and the workpiece.
    let error = ideal.rotation.transpose() * error;
    [-error.x * 1e3, -error.y * 1e3, -error.z * 1e3]
}

fn places(report: &Value) -> BTreeMap<String, f64> {
    let of = |key: &str| -> BTreeMap<String, f64> {
        serde_json::from_value(report[key].clone()).expect("numbers")
    };
    let mut places = of("positions_mm");
    places.extend(of("positions_deg"));
    places
}

fn reports(control: &Control, within: Duration) -> Vec<Value> {
    let mut reports: Vec<Value> = Vec::new();
    let end = Instant::now() + within;
    while Instant::now() < end {
        if let Some(report) = control.report()
            && reports.last() != Some(&report)
        {
            reports.push(report);
        }
        sleep(Duration::from_millis(20));
    }
    reports
}

/// With A and C at rest the remaining tip error is at most the rounding of the outputs.
#[test]
fn what_stands_is_corrected_to_the_rounding() {
    let bound = ROUNDING_UM * 3.0_f64.sqrt();
    for place in [
        "X=300,Y=250,Z=-250,A=-30,C=0",
        "X=80,Y=60,Z=-120,A=-75,C=-140",
        "X=520,Y=440,Z=-180,A=-60,C=200",
    ] {
        let (_dir, control, gateway, _) = corrected(&["--at", place]);
        let reached = gateway.wait(|_| {
            control
                .report()
                .is_some_and(|report| misses_um(&report)[1] <= bound)
        });
        assert!(reached.is_ok(), "{place}: {:?}", control.report());
        let seen = reports(&control, Duration::from_secs(1));
        for report in &seen {
            let [without, with] = misses_um(report);
            assert!(without > 4.0, "{place}: {without} µm");
            assert!(
                with <= bound,
                "{place}: {with:.2} µm, {without:.2} µm without correction; {ROUNDING_UM} µm for each of three axes are {bound:.2} µm"
            );
        }
        assert!(seen.len() >= 5);
    }
}

/// A and C move uncorrected, the table at 33 rpm: the residual is at most the rounding plus the change of the correction during its
/// delay.
#[test]
fn what_moves_is_corrected_to_the_rounding_and_the_lag() {
    let moves = "A,C,feed\n-20,0,12000\n-40,200,12000\n-75,350,12000\n-40,150,12000\n";
    let dir = tempfile::tempdir().expect("writable");
    let file = dir.path().join("moves.csv");
    std::fs::write(&file, moves).expect("writable");
    let options = ["--program", path(&file), "--at", "X=480,Y=120,Z=-200"];
    let (_dir, control, gateway, machine) = corrected(&options);
    // Wait until the initial ramp is complete.
    sleep(Duration::from_millis(1500));
    let seen = reports(&control, Duration::from_secs(8));
    assert_eq!(gateway.state()["state"], "compensating");
    let rounding = ROUNDING_UM * 3.0_f64.sqrt();
    let (mut within, mut reported) = (0, Vec::new());
    for pair in seen.windows(2) {
        let [before, after] = [&pair[0], &pair[1]];
        let time = |report: &Value| report["time_s"].as_f64().expect("a number");
        let between_s = time(after) - time(before);
        if between_s > 0.15 {
            continue;
        }
        // Rate of the requested correction: speed times slope of the errors.
        let [from, to] = [before, after].map(|report| correction_um(&machine, &places(report)));
        let moved = from
            .iter()
            .zip(&to)
            .map(|(a, b)| (a - b).powi(2))
            .sum::<f64>()
            .sqrt();
        let speed_um_per_s = moved / between_s;
        let [without, with] = misses_um(after);
        let [lag, busy] = [DELAY_S, BUSY_DELAY_S].map(|delay| delay * speed_um_per_s);
        let text = format!(
            "{with:.2} µm, {without:.2} µm without correction; the rounding is {rounding:.2} µm, the lag {lag:.2} µm at {speed_um_per_s:.0} µm/s ({busy:.2} µm on a busy computer)"
        );
        assert!(with <= rounding + busy, "{text}");
        within += usize::from(with <= rounding + lag);
        reported.push(text);
    }
    assert!(reported.len() >= 20, "{} lines", reported.len());
    assert!(
        10 * within >= 9 * reported.len(),
        "{within} of {}: {reported:#?}",
        reported.len()
    );
    let most = seen
        .iter()
        .map(|report| misses_um(report)[0])
        .fold(0.0, f64::max);
    assert!(most > 30.0, "{most} µm without correction");
}
