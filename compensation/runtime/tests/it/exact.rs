//! Corrections and reported errors equal the exact ones of the kinematics.
//!
//! This holds for all axes, and for a control that writes only some. At an end of travel every form of the model has
//! the error of that end, in spite of the conversion to radians and back.

use rand::{RngExt, SeedableRng, seq::SliceRandom};
use rand_chacha::ChaCha8Rng;
use volcomp_kinematics::{CorrectionOptions, Form, State, actual_pose, nalgebra::Vector3};
use volcomp_model::{Fading, Machine, Temperatures};
use volcomp_runtime::{GuardSettings, Model, ToolError};
use volcomp_vocabulary::{AxisName, Displacement, PerAxis};

use crate::rig::{NAMES, Rig, guard, machine, tip_mm};

const PLACES: [[f64; 5]; 4] = [
    [-100.0, 40.0, 200.0, 50.0, 300.0],
    [-400.0, -75.0, 650.0, 300.0, 50.0],
    [0.0, 100.0, 10.0, 190.0, 590.0],
    [-250.0, 0.0, 300.0, 0.0, 300.0],
];

/// Deviation of tip (mm) and tool axis from the commanded pose, by the exact chain, with the axes at a position (mm, deg) plus a
/// correction (mm, rad in machine order).
fn exact(place: [f64; 5], correction: &PerAxis<f64>) -> [Vector3<f64>; 2] {
    let machine = machine();
    let coordinates: Vec<_> = NAMES.into_iter().zip(place).collect();
    let commanded = machine.state(&coordinates).expect("its axes");
    let mut there = commanded;
    for (q, delta) in there.q.iter_mut().zip(correction) {
        *q += delta;
    }
    let temperatures = Temperatures::new();
    let chain = machine.chain();
    let actual = actual_pose(chain, &machine.source(&temperatures), &there);
    let ideal = chain.ideal_pose(&commanded);
    let (tip, axis) = (chain.tool_tip_mm(), chain.tool_axis());
    [
        actual.transform_point(&tip) - ideal.transform_point(&tip),
        (actual.rotation - ideal.rotation) * axis,
    ]
}

/// Checks that an error agrees with the exact chain: tip within 0.02 µm, tool axis within 0.1 µrad.
#[track_caller]
fn assert_exact(place: [f64; 5], correction: &PerAxis<f64>, found: ToolError) {
    let [tip, axis] = exact(place, correction);
    let off = (Vector3::from(found.position_mm) - tip).norm();
    assert!(off < 2e-5, "{place:?}: {found:?} for {tip:?}");
    let off = (Vector3::from(found.axis_rad) - axis).norm();
    assert!(off < 1e-7, "{place:?}: {found:?} for {axis:?}");
}

#[test]
fn without_correction_residual_and_error_agree() {
    for place in PLACES {
        let report = Rig::at(place).run(10);
        assert_eq!(report.correction, PerAxis::ZERO);
        let [error, residual] = [report.error, report.residual].map(|e| e.expect("known"));
        assert_eq!(error.position_mm, residual.position_mm);
        assert_eq!(error.axis_rad, residual.axis_rad);
        assert!(tip_mm(report.error) > 0.005, "there is an error");
        assert_exact(place, &PerAxis::ZERO, error);
    }
}

/// In the middle and at the end of the ramp the reported residual equals the error by the exact chain with the applied
/// correction.
#[test]
fn the_residual_is_that_of_the_chain_at_command_plus_correction() {
    let mut largest = 0.0_f64;
    for place in PLACES {
        let mut rig = Rig::at(place);
        for report in [rig.arm(60), rig.run(600)] {
            assert_exact(place, &report.correction, report.residual.expect("known"));
        }
        let report = rig.run(1);
        assert_eq!(report.state.name(), "compensating");
        let (left, before) = (tip_mm(report.residual), tip_mm(report.error));
        assert!(left < 0.0002 && left < before / 20.0, "{before} to {left}");
        let machine = machine();
        let joints = machine.chain().joints().iter();
        let rotary = joints.zip(&report.correction.0);
        let rotary = rotary.filter(|(joint, _)| joint.name.is_rotary());
        largest = largest.max(rotary.map(|(_, delta)| delta.abs()).sum());
    }
    assert!(largest > 1e-6, "rotary axes are corrected: {largest} rad");
}

/// Checks that the corrections by any choice of axes agree with the exact ones.
fn compare(machine: &Machine, seed: u64) {
    let model = Model::new(machine, Fading::default()).expect("compiles");
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    for _ in 0..300 {
        let mut names = machine.chain().structure().axes().to_vec();
        names.shuffle(&mut rng);
        names.truncate(rng.random_range(1..=names.len()));
        let state = State {
            q: PerAxis::from_fn(|index| {
                machine.axes().get(index).map_or(0.0, |axis| {
                    let [low, high] = axis.travel;
                    let at = rng.random_range(low..=high);
                    Displacement::from_coordinate(axis.name.kind(), at).mm_or_rad()
                })
            }),
            ..State::default()
        };
        // The machine file determines the order of the correcting axes, not the control.
        let correct = machine.chain().structure().axes().iter().copied();
        let correct: Vec<AxisName> = correct.filter(|name| names.contains(name)).collect();
        let options = CorrectionOptions::of(&correct);
        let exact = machine.correction_at(&state, &Temperatures::new(), &options);
        let correctors = model.correctors_among(&names);
        let reported = model.correction_of(&state, &correctors);
        let found = reported.delta;
        let partial = exact.tool_axis_partial && correctors.rotary().len() >= 2;
        assert_eq!((reported.singular, reported.near_singular), (partial, exact.near_singular));
        for (index, axis) in machine.axes().iter().enumerate() {
            let (f, e) = (found[index], exact.delta[index]);
            // Second-order difference: 0.1 µm per 0.1 mm, and likewise for rotary axes.
            let size = exact.delta.iter().fold(0.0_f64, |m, x| m.max(x.abs()));
            let bound = if axis.name.is_rotary() { 1e-8 } else { 2e-5 } + 1e-3 * size;
            assert!((f - e).abs() < bound, "{} of {names:?} at {state:?}: {f} {e}", axis.name);
            assert!(names.contains(&axis.name) || f == 0.0, "an axis that is not written is held");
        }
    }
}

#[test]
fn the_runtime_matches_the_exact_correction() {
    compare(&machine(), 1);
    // U is half a degree off X, V two degrees off Y. U adds no direction, so X and Y correct.
    let text = "structure = \"w C' X' b Y Z U V B t\"
[axes.X]
travel = [0.0, 600.0]
[axes.Y]
travel = [0.0, 500.0]
[axes.Z]
travel = [-400.0, 0.0]
[axes.U]
travel = [0.0, 100.0]
direction = [0.9999619, 0.0087265, 0.0]
[axes.V]
travel = [0.0, 100.0]
direction = [0.0348995, 0.9993908, 0.0]
[axes.B]
travel = [-100.0, 100.0]
point = [0.0, 0.0, 120.0]
[axes.C]
travel = [-360.0, 360.0]
point = [300.0, 250.0, -50.0]
[tool]
tip = [0.0, 0.0, -80.0]
[errors]
EYX = 10.0
EXX = { poly = [0.0, 0.02] }
EAY = { poly = [0.0, 0.03] }
EBC = 12.0
EC0Y = 15.0
EB0C = 8.0
EX0B = 6.0
";
    compare(&Machine::parse(text, "m").expect("valid"), 2);
}

/// A control writes X, Y and Z of a five-axis machine: with the rotary axes held the tip error is below 0.1 µm, and the direction error
/// of the tool remains.
#[test]
fn the_written_axes_correct_the_tip() {
    for place in [
        [-100.0, 40.0, 200.0, 50.0, 300.0],
        [-400.0, -75.0, 650.0, 300.0, 50.0],
        [-250.0, 1.0, 300.0, 0.0, 300.0],
    ] {
        let mut rig = Rig::writing(place, &[AxisName::Z, AxisName::X, AxisName::Y]);
        let report = rig.arm(2000);
        assert_eq!(report.state.name(), "compensating");
        assert!(tip_mm(report.error) > 0.005, "there is an error");
        assert!(tip_mm(report.residual) < 1e-4, "{place:?}");
        let axis = |error: Option<ToolError>| Vector3::from(error.expect("known").axis_rad).norm();
        assert!((axis(report.residual) - axis(report.error)).abs() < 1e-6);
        for name in [AxisName::B, AxisName::C] {
            let index = machine().index_of(name).expect("its axis");
            assert_eq!(report.correction[index], 0.0, "{name} is not written");
        }
    }
}

/// A rotary table with ECC = C/400 µrad, which nearly closes, and a head with EBB = B/10 µrad, each over its whole travel.
fn turntable(turns: [f64; 2], tilts: f64) -> Machine {
    let [low, high] = turns;
    let text = format!(
        "structure = \"w C' b X Y Z B t\"\n[axes]\nX.travel = [0, 500]\nY.travel = [0, 500]\nZ.travel = [0, 500]\n\
         C = {{ travel = [{low:?}, {high:?}], modulo = 360.0 }}\nB.travel = [{0:?}, {tilts:?}]\n\
         [errors]\nECC = {{ poly = [0.0, 0.0025] }}\nEBB = {{ table = [[{0:?}, {1:?}], [{tilts:?}, {2:?}]] }}\n",
        -tilts,
        -tilts / 10.0,
        tilts / 10.0,
    );
    Machine::parse(&text, "end.toml").expect("a machine")
}

#[test]
fn an_end_of_travel_has_the_error_of_its_own_side() {
    let GuardSettings { fading, .. } = guard();
    let warm = Temperatures::new();
    // Includes ends that conversion to radians and back makes larger or smaller, such as 105, 125, 192, 210 and 255.
    for degrees in 1..=359 {
        let high = f64::from(degrees);
        let machine = turntable([high - 360.0, high], high);
        let model = Model::new(&machine, fading).expect("a model");
        let none = PerAxis::default();
        for (end, side) in [(high, 1.0), (high - 360.0, -1.0)] {
            let at = [(AxisName::X, 100.0), (AxisName::B, side * high), (AxisName::C, end)];
            let state = machine.state(&at).expect("a state");
            let exact = machine.error_at(&state, Form::Exact, &warm);
            let [reported, _] = model.errors(&state, &none);
            // To second order ECC of the table turns the tool about Z, and EBB acts about Y.
            for found in [exact.rotation_rad.z, reported.rotation_rad[2]] {
                assert!(
                    (found * 1e6 - end / 400.0).abs() < 0.01,
                    "{end} deg: {} µrad",
                    found * 1e6
                );
            }
            assert_eq!(machine.outside_range(&state), [], "{end} deg");
            assert_eq!(machine.outside_travel(&state), [], "{end} deg");
            assert!(!model.is_outside_range(&state), "{end} deg");
        }
        // A position beyond the end is outside.
        let state = machine.state(&[(AxisName::B, high + 1e-6)]).expect("a state");
        assert_eq!(machine.outside_travel(&state), [AxisName::B]);
        assert!(model.is_outside_range(&state));
    }
}
