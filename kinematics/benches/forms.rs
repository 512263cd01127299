//! One error evaluation in each form, error values given, five axes; against a chain of 4×4 products
//! written by hand in nalgebra. Only ratios within one run mean anything.

use std::hint::black_box;

use criterion::{Criterion, criterion_group, criterion_main};
use volcomp_kinematics::{
    Chain, ErrorMotion, ErrorSource, Form, GivenErrors, JointKind, Side, State,
    nalgebra::{Matrix3, Matrix4, Vector3, Vector4},
    rotation_about_axis, small_rotation, volumetric_error,
};

fn homogeneous(rotation: &Matrix3<f64>, translation: &Vector3<f64>) -> Matrix4<f64> {
    let mut m = Matrix4::identity();
    m.fixed_view_mut::<3, 3>(0, 0).copy_from(rotation);
    m.fixed_view_mut::<3, 1>(0, 3).copy_from(translation);
    m
}

fn about(rotation: &Matrix3<f64>, point: &Vector3<f64>) -> Matrix4<f64> {
    homogeneous(rotation, &(point - rotation * point))
}

/// The `htm` form as one would write it with 4×4 matrices.
fn by_hand(chain: &Chain, errors: &GivenErrors, state: &State) -> [Vector3<f64>; 2] {
    let (mut actual, mut ideal) = (Matrix4::identity(), Matrix4::identity());
    for (i, (joint, &q)) in chain.joints().iter().zip(&state.q).enumerate() {
        let (e, s, location) = (
            errors.error_motion(i, state),
            errors.assembly(i),
            errors.location(i),
        );
        let mut error = about(&small_rotation(&e.angular_rad), &joint.point_mm);
        for k in 0..3 {
            error[(k, 3)] += e.linear_mm[k];
        }
        let assembly = homogeneous(&small_rotation(&s.angular_rad), &s.linear_mm);
        let tilted = joint.direction + location.angular_rad.cross(&joint.direction);
        let (motion, nominal) = match joint.kind {
            JointKind::Linear => (
                Matrix4::new_translation(&(tilted * q)),
                Matrix4::new_translation(&(joint.direction * q)),
            ),
            JointKind::Rotary => (
                about(
                    &rotation_about_axis(&tilted.normalize(), q),
                    &(joint.point_mm + location.linear_mm),
                ),
                about(&rotation_about_axis(&joint.direction, q), &joint.point_mm),
            ),
        };
        actual = match (joint.side, joint.kind) {
            (Side::Tool, JointKind::Linear) => actual * assembly * motion * error,
            (Side::Tool, JointKind::Rotary) => actual * assembly * error * motion,
            (Side::Workpiece, JointKind::Linear) => actual * error * motion * assembly,
            (Side::Workpiece, JointKind::Rotary) => actual * motion * error * assembly,
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

fn forms(c: &mut Criterion) {
    let mut chain = Chain::new("w C' A' X' b Y Z t".parse().expect("a valid structure"));
    for axis in chain.structure().axes().to_vec() {
        chain
            .set_point(axis, [40.0, -30.0, 20.0])
            .expect("an axis of the chain");
    }
    chain
        .set_tool([10.0, 20.0, -150.0], [0.0, 0.0, 1.0])
        .expect("a valid tool");
    let mut errors = GivenErrors::default();
    for (index, set) in errors.motion.iter_mut().take(5).enumerate() {
        let n = index as f64 + 1.0;
        *set = ErrorMotion::from_um_urad([n, -2.0 * n, 3.0, 4.0, 5.0 * n, -6.0]);
        errors.location[index] = ErrorMotion::from_um_urad([0.0, 0.0, 0.0, 3.0, 2.0, n]);
    }
    let state = State::from_coordinates(&[0.7, -0.4, 120.0, -80.0, 60.0]);
    let ours = volumetric_error(&chain, &errors, &state, Form::Htm);
    let [position, _] = by_hand(&chain, &errors, &state);
    assert!(
        (ours.position_mm - position).norm() < 1e-10,
        "the bench compares unlike things"
    );

    let mut group = c.benchmark_group("five_axes");
    for form in [Form::Exact, Form::Htm, Form::Twist] {
        group.bench_function(form.to_string(), |b| {
            b.iter(|| {
                volumetric_error(
                    black_box(&chain),
                    black_box(&errors),
                    black_box(&state),
                    form,
                )
            });
        });
    }
    group.bench_function("nalgebra_4x4_by_hand", |b| {
        b.iter(|| by_hand(black_box(&chain), black_box(&errors), black_box(&state)));
    });
    group.finish();
}

criterion_group!(benches, forms);
criterion_main!(benches);
