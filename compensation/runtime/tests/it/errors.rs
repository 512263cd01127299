//! What a report says of the error of the tool, held to the exact chain of kinematics.

use volcomp_kinematics::{actual_pose, nalgebra::Vector3};
use volcomp_model::Temperatures;
use volcomp_runtime::guard::Request;
use volcomp_vocabulary::{Displacement, PerAxis};

use crate::rig::{NAMES, Rig, machine};

const PLACES: [[f64; 5]; 4] = [
    [-100.0, 40.0, 200.0, 50.0, 300.0],
    [-400.0, -75.0, 650.0, 300.0, 50.0],
    [0.0, 100.0, 10.0, 190.0, 590.0],
    [-250.0, 0.0, 300.0, 0.0, 300.0],
];

/// Tip (mm) and tool axis by the exact chain when the axes stand at a place (mm, deg) with a correction (mm, rad in
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

/// With nothing applied the error with correction is the error without.
#[test]
fn nothing_applied_changes_nothing() {
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

/// Half way up the ramp and at its end the residual is that of the exact chain at command plus correction.
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
