//! The compiled machine agrees with its source.

use proptest::prelude::*;
use volcomp_kinematics::{CorrectionOptions, ErrorSource, Form, State, correct, volumetric_error};
use volcomp_model::{Machine, Temperatures, Tolerance};
use volcomp_vocabulary::{Direction, PerAxis};

use crate::EXAMPLE;

const TOLERANCE_UM: f64 = 1e-3;

proptest! {
    #[test]
    fn within_the_tolerance_everywhere(
        x in -100.0..8100.0, y in -100.0..4100.0, z in -100.0..2600.0, c in -7.0..7.0,
        approach in 0..3_usize,
    ) {
        let machine = Machine::parse(EXAMPLE, "m").unwrap();
        let compiled = machine.compile(Tolerance::default()).unwrap();
        let none = Temperatures::new();
        let source = machine.source(&none);
        let state = State {
            q: PerAxis::leading([c, x, y, z]),
            approach: [[Some(Direction::Positive), Some(Direction::Negative), None][approach]; 9].into(),
        };
        for axis in 0..5 {
            let difference = source.error_motion(axis, &state).linear_mm
                - compiled.error_motion(axis, &state).linear_mm;
            prop_assert!(difference.amax() * 1e3 <= TOLERANCE_UM * 1.01, "{difference}");
            let difference = source.error_motion(axis, &state).angular_rad
                - compiled.error_motion(axis, &state).angular_rad;
            prop_assert!(difference.amax() * 1e6 <= TOLERANCE_UM * 1.01, "{difference}");
            prop_assert_eq!(source.location(axis), compiled.location(axis));
            prop_assert_eq!(source.assembly(axis), compiled.assembly(axis));
        }
    }
}

#[test]
fn the_slope_bound_holds_and_is_tight() {
    let machine = Machine::parse(EXAMPLE, "m").unwrap();
    let compiled = machine.compile(Tolerance::from_nm(0.1)).unwrap();
    for (name, curve) in machine.errors() {
        let own = machine.index_of(name.axis).unwrap();
        let [low, high] = machine.axis(name.axis).unwrap().travel;
        let mut coordinates = [0.0; 9];
        let steepest = (0..=4000)
            .map(|step| {
                coordinates[own] = low + (high - low) * f64::from(step) / 4000.0;
                curve.derivative(own, &coordinates, None).abs()
            })
            .fold(0.0, f64::max);
        let per_unit = if name.component.is_angular() { 1e6 } else { 1e3 };
        let bound = compiled.slope_bound(name.axis, name.component) * per_unit;
        assert!(bound >= steepest * 0.999 - 1e-6, "{name}: {bound} under {steepest}");
        // EZY is a grid, and its bound also covers the slope along the second axis.
        assert!(
            bound <= steepest * 1.05 + 1e-3 || name.to_string() == "EZY",
            "{name}: {bound} far over {steepest}"
        );
    }
}

#[test]
fn a_tolerance_that_cannot_be_kept_is_refused() {
    let text = EXAMPLE
        .replace("poly = [0.0, 0.0073, -2.1e-7]", "fourier = [0.0, 0.0, 50.0], period = 0.01");
    let message = Machine::parse(&text, "m")
        .unwrap()
        .compile(Tolerance::from_nm(1e-3))
        .unwrap_err()
        .to_string();
    assert!(
        message.contains("curve EXX needs more than 1 MiB for a tolerance of 0.001 nm"),
        "{message}"
    );
}

/// The calls of a real-time cycle (errors of a compiled machine, volumetric error, correction) do not allocate.
#[test]
fn a_cycle_allocates_nothing() {
    let machine = Machine::parse(EXAMPLE, "m").unwrap();
    let compiled = machine.compile(Tolerance::default()).unwrap();
    let options = CorrectionOptions::first_order();
    let mut sum = 0.0;
    for step in 0..100 {
        let q = f64::from(step);
        let state = State {
            q: PerAxis::leading([0.01 * q, 80.0 * q, 40.0 * q, 25.0 * q]),
            ..State::default()
        };
        assert_no_alloc::assert_no_alloc(|| {
            let error = volumetric_error(compiled.chain(), &compiled, &state, Form::Twist);
            let correction = correct(compiled.chain(), &compiled, &state, &options);
            sum += error.position_mm.x + correction.delta[1];
        });
    }
    assert!(sum.is_finite() && sum != 0.0);
}
