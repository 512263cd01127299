//! The volumetric error as a product of 4×4 matrices written by hand with nalgebra. It is the speed reference for the
//! forms and for the compiled evaluator.

use volcomp_kinematics::{
    Chain, ErrorSource, Side, State,
    nalgebra::{Matrix3, Matrix4, Vector3, Vector4},
    rotation_about_axis, small_rotation,
};
use volcomp_vocabulary::AxisKind;

fn homogeneous(rotation: &Matrix3<f64>, translation: &Vector3<f64>) -> Matrix4<f64> {
    let mut m = Matrix4::identity();
    m.fixed_view_mut::<3, 3>(0, 0).copy_from(rotation);
    m.fixed_view_mut::<3, 1>(0, 3).copy_from(translation);
    m
}

fn about(rotation: &Matrix3<f64>, point: &Vector3<f64>) -> Matrix4<f64> {
    homogeneous(rotation, &(point - rotation * point))
}

/// The volumetric error of the `htm` form with plain 4×4 matrices: ΔP (mm) and ρ (rad).
pub(crate) fn by_hand<S: ErrorSource>(
    chain: &Chain,
    errors: &S,
    state: &State,
) -> [Vector3<f64>; 2] {
    let (mut actual, mut ideal) = (Matrix4::identity(), Matrix4::identity());
    for (i, (joint, &q)) in chain.joints().iter().zip(&state.q).enumerate() {
        let (e, s, location) =
            (errors.error_motion(i, state), errors.assembly(i), errors.location(i));
        let mut error = about(&small_rotation(&e.angular_rad), &joint.point_mm);
        for k in 0..3 {
            error[(k, 3)] += e.linear_mm[k];
        }
        let assembly = homogeneous(&small_rotation(&s.angular_rad), &s.linear_mm);
        let tilted = joint.direction + location.angular_rad.cross(&joint.direction);
        let (motion, nominal) = match joint.kind {
            AxisKind::Linear => (
                Matrix4::new_translation(&(tilted * q)),
                Matrix4::new_translation(&(joint.direction * q)),
            ),
            AxisKind::Rotary => (
                about(
                    &rotation_about_axis(&tilted.normalize(), q),
                    &(joint.point_mm + location.linear_mm),
                ),
                about(&rotation_about_axis(&joint.direction, q), &joint.point_mm),
            ),
        };
        actual = match (joint.side, joint.errors_on_tool_side()) {
            (Side::Tool, true) => actual * assembly * motion * error,
            (Side::Tool, false) => actual * assembly * error * motion,
            (Side::Workpiece, true) => actual * motion * error * assembly,
            (Side::Workpiece, false) => actual * error * motion * assembly,
        };
        ideal *= nominal;
    }
    let tip = chain.tool_tip_mm();
    let tip = Vector4::new(tip.x, tip.y, tip.z, 1.0);
    let position = (actual * tip - ideal * tip).xyz();
    let rotation = actual.fixed_view::<3, 3>(0, 0) * ideal.fixed_view::<3, 3>(0, 0).transpose();
    let vee = Vector3::new(
        rotation[(2, 1)] - rotation[(1, 2)],
        rotation[(0, 2)] - rotation[(2, 0)],
        rotation[(1, 0)] - rotation[(0, 1)],
    );
    [position, vee * 0.5]
}
