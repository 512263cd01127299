//! The three forms against plain matrices and against one another.

use volcomp_kinematics::{Form, GivenErrors, letter_direction, volumetric_error};
use volcomp_test_support::structures::all_types;

use crate::{every_error, motion, placed, plain, seeded, state, vector};

#[test]
fn exact_and_htm_are_the_products_in_plain_matrices() {
    let mut rng = seeded(1);
    for structure in all_types() {
        for oblique in [false, true] {
            let mut chain = placed(&structure, &mut rng);
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
    for structure in all_types() {
        let chain = placed(&structure, &mut rng);
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
    println!(
        "largest distance from exact: htm {} um, twist {} um",
        worst[0], worst[1]
    );
    assert!(worst[0] < 0.1 && worst[1] < 0.1, "{worst:?}");
}

/// Scaling the errors by ½ scales the sum of twists by ½ and its distance from the products by ¼:
/// it is their first-order part, location and assembly errors included.
#[test]
fn twist_is_the_first_order_part_of_exact() {
    let mut rng = seeded(3);
    for structure in all_types() {
        let chain = placed(&structure, &mut rng);
        let full = every_error(&chain, &mut rng);
        let state = state(&chain, &mut rng);
        let distance = |factor: f64| {
            let mut errors = full.clone();
            let sets = [
                &mut errors.motion,
                &mut errors.location,
                &mut errors.assembly,
            ];
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
            // The rotation of three linear axes alone is a plain sum up to its second order.
            assert!((3.5..4.5).contains(&ratio), "{structure} {k}: {ratio}");
        }
    }
}
