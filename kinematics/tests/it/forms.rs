//! Tests of the three forms: against plain matrices, one another, and published two-axis equations.
//!
//! The equations are those of the error-twist model (Procedia Engineering 24 (2011) 845–849).

use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use volcomp_kinematics::nalgebra::Vector3;
use volcomp_kinematics::{
    Chain, ErrorMotion, Form, GivenErrors, MotionFrame, State, Structure, letter_direction,
    volumetric_error,
};
use volcomp_test_support::structures::all_types;
use volcomp_vocabulary::AxisName;

use crate::{every_error, motion, placed, plain, seeded, state, vector};

fn in_frame(chain: &mut Chain, frame: MotionFrame) {
    for &axis in chain.structure().clone().axes() {
        if axis.is_rotary() {
            chain.set_motion_frame(axis, frame).unwrap();
        }
    }
}

/// Each type of machine, with the error motions of its rotary axes in each of the two frames.
fn both_frames() -> impl Iterator<Item = (Structure, MotionFrame)> {
    let frames = [MotionFrame::Fixed, MotionFrame::Turning];
    all_types()
        .into_iter()
        .flat_map(move |structure| frames.map(|frame| (structure.clone(), frame)))
}

fn placed_in((structure, frame): &(Structure, MotionFrame), rng: &mut ChaCha8Rng) -> Chain {
    let mut chain = placed(structure, rng);
    in_frame(&mut chain, *frame);
    chain
}

#[test]
fn errors_in_the_turning_frame_turn_with_the_axis() {
    for (structure, sign) in [("w b C t", 1.0), ("w C' b t", -1.0)] {
        let mut chain = Chain::new(structure.parse().unwrap());
        let c = chain.structure().axes()[0];
        let mut errors = GivenErrors::default();
        errors.motion[0] = ErrorMotion::from_um_urad([10.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
        let quarter = State::new(&chain, [(c, std::f64::consts::FRAC_PI_2)]).unwrap();
        let moved = |chain: &Chain, form| {
            volumetric_error(chain, &errors, &quarter, form).position_mm * 1e3
        };
        for form in [Form::Exact, Form::Htm, Form::Twist] {
            chain.set_motion_frame(c, MotionFrame::Fixed).unwrap();
            let fixed = moved(&chain, form);
            chain.set_motion_frame(c, MotionFrame::Turning).unwrap();
            let turning = moved(&chain, form);
            // On the tool side, the rotating frame is that of the tool, whose X axis is along Y of the workpiece. On
            // the workpiece side, the rotating frame is that of the workpiece, and the non-rotating frame is rotated
            // relative to it.
            let (along_x, along_y) = if sign > 0.0 { (fixed, turning) } else { (turning, fixed) };
            let off_x = (along_x - Vector3::x() * 10.0).norm();
            let off_y = (along_y - Vector3::y() * 10.0).norm();
            assert!(off_x < 1e-9 && off_y < 1e-9, "{structure} {form}");
        }
    }
    let mut chain = Chain::new("w b X t".parse().unwrap());
    let x = chain.structure().axes()[0];
    let refused = chain.set_motion_frame(x, MotionFrame::Turning).unwrap_err();
    assert!(refused.to_string().contains("axis X is linear"), "{refused}");
}

#[test]
fn exact_and_htm_are_the_products_in_plain_matrices() {
    let mut rng = seeded(1);
    for structure in all_types() {
        for (oblique, frame) in
            [(false, MotionFrame::Fixed), (true, MotionFrame::Fixed), (true, MotionFrame::Turning)]
        {
            let mut chain = placed(&structure, &mut rng);
            in_frame(&mut chain, frame);
            if oblique {
                for &axis in structure.axes() {
                    let u = letter_direction(axis);
                    let tilt = vector(&mut rng, 0.4);
                    chain
                        .set_direction(axis, [u.x + tilt[0], u.y + tilt[1], u.z + tilt[2]])
                        .unwrap();
                }
            }
            for _ in 0..40 {
                let errors = every_error(&chain, &mut rng);
                let state = state(&chain, &mut rng);
                for form in [Form::Exact, Form::Htm] {
                    let ours = volumetric_error(&chain, &errors, &state, form);
                    let [position, rotation] = plain::error(&chain, &errors, &state, form);
                    for k in 0..3 {
                        let um = (ours.position_mm[k] - position[k]).abs() * 1e3;
                        let urad = (ours.rotation_rad[k] - rotation[k]).abs() * 1e6;
                        assert!(
                            um < 1e-6 && urad < 1e-6,
                            "{structure} {form}: {um} um, {urad} urad"
                        );
                    }
                }
            }
        }
    }
}

#[test]
fn all_forms_agree_to_first_order() {
    let mut rng = seeded(2);
    let mut worst = [0.0_f64; 2];
    for structure in both_frames() {
        let chain = placed_in(&structure, &mut rng);
        for _ in 0..200 {
            let mut errors = GivenErrors::default();
            for index in 0..chain.joints().len() {
                errors.motion[index] = motion(&mut rng);
            }
            let state = state(&chain, &mut rng);
            let exact = volumetric_error(&chain, &errors, &state, Form::Exact);
            for (worst, form) in worst.iter_mut().zip([Form::Htm, Form::Twist]) {
                let other = volumetric_error(&chain, &errors, &state, form);
                *worst = worst.max((other.position_mm - exact.position_mm).norm() * 1e3);
            }
        }
    }
    println!("largest distance from exact: htm {} um, twist {} um", worst[0], worst[1]);
    assert!(worst[0] < 0.1 && worst[1] < 0.1, "{worst:?}");
}

/// If all errors are halved, the sum of twists is halved, and its distance from the products becomes a quarter. The sum
/// is thus the first-order part of the products, including location and assembly errors.
#[test]
fn twist_is_the_first_order_part_of_exact() {
    let mut rng = seeded(3);
    for structure in both_frames() {
        let chain = placed_in(&structure, &mut rng);
        let full = every_error(&chain, &mut rng);
        let state = state(&chain, &mut rng);
        let distance = |factor: f64| {
            let mut errors = full.clone();
            let sets = [&mut errors.motion, &mut errors.location, &mut errors.assembly];
            for error in sets.into_iter().flatten() {
                error.linear_mm *= factor;
                error.angular_rad *= factor;
            }
            let exact = volumetric_error(&chain, &errors, &state, Form::Exact);
            let twist = volumetric_error(&chain, &errors, &state, Form::Twist);
            [
                (exact.position_mm - twist.position_mm).norm(),
                (exact.rotation_rad - twist.rotation_rad).norm(),
            ]
        };
        let (large, small) = (distance(64.0), distance(32.0));
        for k in 0..2 {
            let ratio = large[k] / small[k];
            // For three linear axes alone, the rotation is a plain sum up to second order.
            assert!((3.5..4.5).contains(&ratio), "{structure:?} {k}: {ratio}");
        }
    }
}

#[test]
fn twist_gives_the_two_axis_equations() {
    let mut rng = seeded(4);
    let mut chain = Chain::new("w b X Y t".parse().unwrap());
    for _ in 0..1000 {
        let mut random = |size: f64| rng.random_range(-size..=size);
        let (xt, yt, x, y) = (random(300.0), random(300.0), random(800.0), random(800.0));
        chain.set_tool([xt, yt, 0.0], [0.0, 0.0, 1.0]).unwrap();
        let mut errors = GivenErrors::default();
        for index in 0..2 {
            errors.motion[index] = motion(&mut rng);
            errors.assembly[index] = motion(&mut rng);
        }
        let [ex, ey] = [errors.motion[0], errors.motion[1]];
        let [sx, sy] = [errors.assembly[0], errors.assembly[1]];
        let [dx, ax, tx, cx] = [ex.linear_mm, ex.angular_rad, sx.linear_mm, sx.angular_rad];
        let [dy, ay, ty, cy] = [ey.linear_mm, ey.angular_rad, sy.linear_mm, sy.angular_rad];
        let expected = [
            dx.x + tx.x + dy.x + ty.x - (y + yt) * (ax.z + cy.z + cx.z) - yt * ay.z,
            dx.y + tx.y + dy.y + ty.y + xt * (ax.z + cy.z + cx.z + ay.z) + x * cx.z,
            dx.z + tx.z + dy.z + ty.z + (y + yt) * (ax.x + cx.x + cy.x)
                - xt * (ax.y + ay.y + cy.y)
                - (x + xt) * cx.y
                + yt * ay.x,
        ];
        let state = State::new(&chain, [(AxisName::X, x), (AxisName::Y, y)]).unwrap();
        let ours = volumetric_error(&chain, &errors, &state, Form::Twist);
        for (k, expected) in expected.into_iter().enumerate() {
            let um = (ours.position_mm[k] - expected).abs() * 1e3;
            assert!(um < 1e-9, "{k}: {um} um");
        }
        let rotation = ax + cx + cy + ay;
        assert!((ours.rotation_rad - rotation).norm() * 1e6 < 1e-9);
    }
}
