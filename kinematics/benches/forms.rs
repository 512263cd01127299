//! One error evaluation in each form, with constant errors on five axes, compared with a product of 4×4 matrices
//! written by hand with nalgebra. Only ratios within one run of the benchmark are meaningful.

use std::hint::black_box;

use criterion::{Criterion, criterion_group, criterion_main};
use volcomp_kinematics::{
    Chain, ErrorMotion, Form, GivenErrors, MotionFrame, State, vocabulary::AxisName,
    volumetric_error,
};

mod by_hand;

use by_hand::by_hand;

fn forms(c: &mut Criterion) {
    let mut chain = Chain::new("w C' A' X' b Y Z t".parse().expect("a valid structure"));
    for axis in chain.structure().axes().to_vec() {
        chain.set_point(axis, [40.0, -30.0, 20.0]).expect("an axis of the chain");
    }
    chain.set_tool([10.0, 20.0, -150.0], [0.0, 0.0, 1.0]).expect("a valid tool");
    let mut errors = GivenErrors::default();
    for (index, set) in errors.motion.iter_mut().take(5).enumerate() {
        let n = index as f64 + 1.0;
        *set = ErrorMotion::from_um_urad([n, -2.0 * n, 3.0, 4.0, 5.0 * n, -6.0]);
        errors.location[index] = ErrorMotion::from_um_urad([0.0, 0.0, 0.0, 3.0, 2.0, n]);
    }
    let state = State::new(
        &chain,
        [
            (AxisName::C, 0.7),
            (AxisName::A, -0.4),
            (AxisName::X, 120.0),
            (AxisName::Y, -80.0),
            (AxisName::Z, 60.0),
        ],
    )
    .expect("the axes of the chain");
    let ours = volumetric_error(&chain, &errors, &state, Form::Htm);
    let [position, _] = by_hand(&chain, &errors, &state);
    assert!((ours.position_mm - position).norm() < 1e-10, "the bench compares unlike things");

    let mut group = c.benchmark_group("five_axes");
    for form in [Form::Exact, Form::Htm, Form::Twist] {
        group.bench_function(form.to_string(), |b| {
            b.iter(|| {
                volumetric_error(black_box(&chain), black_box(&errors), black_box(&state), form)
            });
        });
    }
    group.bench_function("nalgebra_4x4_by_hand", |b| {
        b.iter(|| by_hand(black_box(&chain), black_box(&errors), black_box(&state)));
    });
    group.finish();
}

/// All 60 errors of the published five-axis machine: six error motions and six assembly errors for each axis.
fn sixty(c: &mut Criterion) {
    let mut chain = Chain::new("w b X Y Z A B t".parse().expect("a valid structure"));
    for axis in [AxisName::A, AxisName::B] {
        chain.set_motion_frame(axis, MotionFrame::Turning).expect("a rotary axis");
    }
    chain.set_tool([10.0, 20.0, -150.0], [0.0, 0.0, 1.0]).expect("a valid tool");
    let mut errors = GivenErrors::default();
    for index in 0..5 {
        let n = index as f64 + 1.0;
        errors.motion[index] = ErrorMotion::from_um_urad([n, -2.0 * n, 3.0, 4.0, 5.0 * n, -6.0]);
        errors.assembly[index] = ErrorMotion::from_um_urad([-n, 2.0, n, 7.0, -3.0 * n, 2.0]);
    }
    let state = State::new(
        &chain,
        [
            (AxisName::X, 120.0),
            (AxisName::Y, -80.0),
            (AxisName::Z, 60.0),
            (AxisName::A, 0.7),
            (AxisName::B, -0.4),
        ],
    )
    .expect("the axes of the chain");
    let mut group = c.benchmark_group("sixty_errors");
    for form in [Form::Exact, Form::Htm, Form::Twist] {
        group.bench_function(form.to_string(), |b| {
            b.iter(|| {
                volumetric_error(black_box(&chain), black_box(&errors), black_box(&state), form)
            });
        });
    }
    group.finish();
}

criterion_group!(benches, forms, sixty);
criterion_main!(benches);
