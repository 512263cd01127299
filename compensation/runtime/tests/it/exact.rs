//! Corrections and reported errors, held to the exact ones of kinematics: of all axes, and of a control that writes some only.

use rand::{RngExt, SeedableRng, seq::SliceRandom};
use rand_chacha::ChaCha8Rng;
use volcomp_kinematics::{CorrectionOptions, State, actual_pose, nalgebra::Vector3};
use volcomp_model::{Fading, Machine, Temperatures};
use volcomp_runtime::{Model, guard::Request};
use volcomp_vocabulary::{AxisName, Displacement, PerAxis};

use crate::rig::{NAMES, Rig, machine};

const PLACES: [[f64; 5]; 4] = [
    [-100.0, 40.0, 200.0, 50.0, 300.0],
    [-400.0, -75.0, 650.0, 300.0, 50.0],
    [0.0, 100.0, 10.0, 190.0, 590.0],
    [-250.0, 0.0, 300.0, 0.0, 300.0],
];

/// Tip (mm) and tool axis by the exact chain with the axes at a position (mm, deg) and a correction (mm, rad in
/// machine order), against where the place commands them.
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

#[test]
fn without_correction_residual_and_error_agree() {
    for place in PLACES {
        let report = Rig::at(place).run(10);
        let (error, residual) = (
            report.error.expect("positions are known"),
            report.residual.expect("positions are known"),
        );
        assert_eq!(report.correction, PerAxis::ZERO);
        assert_eq!(error.position_mm, residual.position_mm);
        assert_eq!(error.axis_rad, residual.axis_rad);
        assert!(
            Vector3::from(error.position_mm).norm() > 0.005,
            "there is an error"
        );
        let [tip, axis] = exact(place, &PerAxis::ZERO);
        assert!(
            (Vector3::from(error.position_mm) - tip).norm() < 2e-5,
            "{place:?}"
        );
        assert!(
            (Vector3::from(error.axis_rad) - axis).norm() < 1e-7,
            "{place:?}"
        );
    }
}

/// Half way up the ramp and at its end, by the exact chain.
#[test]
fn the_residual_is_that_of_the_chain_at_command_plus_correction() {
    let mut largest = 0.0_f64;
    for place in PLACES {
        let mut rig = Rig::at(place);
        rig.run(10);
        rig.step(Some(Request::Arm));
        for cycles in [60, 600] {
            let report = rig.run(cycles);
            let residual = report.residual.expect("positions are known");
            let [tip, axis] = exact(place, &report.correction);
            let (found, found_axis) = (
                Vector3::from(residual.position_mm),
                Vector3::from(residual.axis_rad),
            );
            assert!(
                (found - tip).norm() < 2e-5,
                "{place:?}: {found:?} for {tip:?}"
            );
            assert!((found_axis - axis).norm() < 1e-7, "{place:?}");
        }
        let report = rig.run(1);
        assert_eq!(report.state.name(), "compensating");
        let left = Vector3::from(report.residual.expect("known").position_mm).norm();
        let before = Vector3::from(report.error.expect("known").position_mm).norm();
        assert!(
            left < 0.0002 && left < before / 20.0,
            "{before} to {left} mm"
        );
        let machine = machine();
        let turned = report.correction.iter().zip(machine.chain().joints());
        let rotary: f64 = turned
            .filter(|(_, joint)| joint.name.is_rotary())
            .map(|(delta, _)| {
                Displacement::Angle(volcomp_vocabulary::Rad(*delta))
                    .um_or_urad()
                    .abs()
            })
            .sum();
        largest = largest.max(rotary);
    }
    assert!(largest > 1.0, "rotary axes are corrected: {largest} µrad");
}

/// Corrections of any choice of axes agree with the exact ones of the same machine file.
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
        // The order in which axes may move is the machine's, whatever the order of the control's.
        let correct = machine.chain().structure().axes().iter().copied();
        let correct: Vec<AxisName> = correct.filter(|name| names.contains(name)).collect();
        let options = CorrectionOptions::of(&correct);
        let exact = machine.correction_at(&state, &Temperatures::new(), &options);
        let correctors = model.correctors_among(&names);
        let reported = model.correction_of(&state, &correctors);
        let found = reported.delta;
        let partial = exact.tool_axis_partial && correctors.rotary().len() >= 2;
        assert_eq!(
            (reported.singular, reported.near_singular),
            (partial, exact.near_singular)
        );
        for (index, axis) in machine.axes().iter().enumerate() {
            let (f, e) = (found[index], exact.delta[index]);
            // Second order: a hundredth of a µm and of a µrad for each tenth of a millimetre or milliradian.
            let size = exact.delta.iter().fold(0.0_f64, |m, x| m.max(x.abs()));
            let bound = if axis.name.is_rotary() { 1e-8 } else { 2e-5 } + 1e-3 * size;
            assert!(
                (f - e).abs() < bound,
                "{} of {names:?} at {state:?}: {f} {e}",
                axis.name
            );
            assert!(
                names.contains(&axis.name) || f == 0.0,
                "an axis that is not written is held"
            );
        }
    }
}

#[test]
fn the_runtime_matches_the_exact_correction() {
    compare(&machine(), 1);
    // U half a degree off X, V two degrees off Y: U is no new direction, and X and Y correct.
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

/// X, Y and Z of a five-axis machine are written: the tip is corrected with the rotary axes held, the direction of the tool remains. Shares of the
/// full correction used to add an error at the tip.
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
        let (error, residual) = (
            report.error.expect("known"),
            report.residual.expect("known"),
        );
        let tip = |error: [f64; 3]| Vector3::from(error).norm();
        assert!(tip(error.position_mm) > 0.005, "there is an error");
        assert!(tip(residual.position_mm) < 1e-4, "{place:?}: {residual:?}");
        assert!((tip(residual.axis_rad) - tip(error.axis_rad)).abs() < 1e-6);
        for name in [AxisName::B, AxisName::C] {
            let index = machine().index_of(name).expect("its axis");
            assert_eq!(report.correction[index], 0.0, "{name} is not written");
        }
    }
}
