//! Comparison of two machines over the whole travel.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use volcomp_kinematics::{
    Form, State,
    nalgebra::{DMatrix, DVector, Vector3},
};
use volcomp_model::{Machine, Temperatures};
use volcomp_vocabulary::Displacement;

/// Largest differences over random poses.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Differences {
    pub(crate) position_um: f64,
    pub(crate) rotation_urad: f64,
    /// Difference of the tool axis directions, µrad; a rotation about the tool axis does not count.
    pub(crate) tool_axis_urad: f64,
}

/// Largest differences of the volumetric errors after best-fit rigid-body alignment of the workpiece.
pub(crate) fn compare(one: &Machine, other: &Machine, poses: usize, seed: u64) -> Differences {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let none = Temperatures::new();
    let mut rigid = DMatrix::zeros(3 * poses, 6);
    let mut difference = DVector::zeros(3 * poses);
    let mut turned = Vec::new();
    for pose in 0..poses {
        let mut state = State::default();
        for (place, axis) in one.axes().iter().enumerate() {
            let [low, high] = axis.travel;
            let q = low + (high - low) * random.random::<f64>();
            state.q[place] = Displacement::from_coordinate(axis.name.kind(), q).mm_or_rad();
        }
        let [a, b] = [one, other].map(|machine| machine.error_at(&state, Form::Exact, &none));
        let tip = one.chain().ideal_tip_mm(&state);
        let row = 3 * pose;
        difference.rows_mut(row, 3).copy_from(&(a.position_mm - b.position_mm));
        rigid.view_mut((row, 0), (3, 3)).fill_with_identity();
        rigid.view_mut((row, 3), (3, 3)).copy_from(&(-tip.cross_matrix()));
        let axis = one.chain().ideal_pose(&state).rotation * one.chain().tool_axis();
        turned.push((a.rotation_rad - b.rotation_rad, axis));
    }
    let normal = rigid.transpose() * &rigid;
    let right = rigid.transpose() * &difference;
    let motion = normal.cholesky().expect("poses in space").solve(&right);
    let left = difference - rigid * &motion;
    let turn: Vector3<f64> = motion.fixed_rows::<3>(3).into();
    let largest = |values: &mut dyn Iterator<Item = f64>| values.fold(0.0, f64::max);
    Differences {
        position_um: largest(&mut (0..poses).map(|pose| left.rows(3 * pose, 3).norm() * 1e3)),
        rotation_urad: largest(&mut turned.iter().map(|(by, _)| (by - turn).norm() * 1e6)),
        tool_axis_urad: largest(
            &mut turned.iter().map(|(by, axis)| (by - turn).cross(axis).norm() * 1e6),
        ),
    }
}
