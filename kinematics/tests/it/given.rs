//! Tests of errors that are set by name: invalid errors are rejected and change nothing.

use volcomp_kinematics::{
    Chain, ChainError, Form, GivenErrors, InsteadConstant, NoEffect, Side, State, volumetric_error,
};
use volcomp_vocabulary::{AxisName, Component, ErrorName};

use crate::plain;

fn name(text: &str) -> ErrorName {
    text.parse().unwrap()
}

/// A machine with a rotary table and a rotary head, and a pose.
fn five_axes() -> (Chain, State) {
    let mut chain = Chain::new("w C' X' b Y Z B t".parse().unwrap());
    chain.set_tool([10.0, 20.0, -150.0], [0.0, 0.0, 1.0]).unwrap();
    let state = State::new(
        &chain,
        [
            (AxisName::C, 0.5),
            (AxisName::X, 100.0),
            (AxisName::Y, 200.0),
            (AxisName::Z, -50.0),
            (AxisName::B, 0.7),
        ],
    )
    .unwrap();
    (chain, state)
}

#[test]
fn numbers_that_are_none_and_axes_that_are_not_there_are_refused() {
    let chain = Chain::new("w X' b Y Z t".parse().unwrap());
    let mut errors = GivenErrors::default();
    for found in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
        let refused = errors.set(&chain, name("EYX"), found);
        assert!(
            matches!(refused, Err(ChainError::NotFinite { error, .. }) if error == name("EYX"))
        );
    }
    let refused = errors.set(&chain, name("EYX"), f64::NAN).unwrap_err();
    assert_eq!(refused.to_string(), "EYX is NaN, expected a finite number of µm");
    let refused = errors.set(&chain, name("EZB"), 1.0);
    assert!(matches!(refused, Err(ChainError::NoSuchAxis { axis: AxisName::B, .. })));
    assert_eq!(errors, GivenErrors::default());
}

/// A location error is rejected exactly if a chain of plain matrices gives the same pose with and without the error.
#[test]
fn a_location_error_is_refused_where_it_moves_nothing() {
    let (mut chain, state) = five_axes();
    chain.set_direction(AxisName::Y, [0.1, 1.0, 0.0]).unwrap();
    let at_zero = GivenErrors::default();
    for (index, joint) in chain.joints().iter().enumerate() {
        for component in Component::ALL {
            let named = ErrorName::location(component, joint.name);
            let mut set = GivenErrors::default();
            let refused = set.set(&chain, named, 1000.0);
            let mut by_hand = GivenErrors::default();
            let place = component.mcs_index();
            if component.is_angular() {
                by_hand.location[index].angular_rad[place] = 1e-3;
            } else {
                by_hand.location[index].linear_mm[place] = 1.0;
            }
            let [without, with] = [&at_zero, &by_hand]
                .map(|errors| plain::error(&chain, errors, &state, Form::Exact));
            let pairs = without.iter().flatten().zip(with.iter().flatten());
            let moves = pairs.into_iter().any(|(a, b)| (a - b).abs() > 1e-9);
            assert_eq!(refused.is_ok(), moves, "{named}: {refused:?}");
            if moves {
                assert_eq!(set, by_hand);
            } else {
                assert!(matches!(refused, Err(ChainError::NoEffect { .. })));
                assert_eq!(set, at_zero);
            }
        }
    }
    let refused = GivenErrors::default().set(&chain, name("EX0X"), 1.0);
    let Err(ChainError::NoEffect { reason, .. }) = refused else {
        panic!("{refused:?}");
    };
    assert_eq!(
        reason,
        NoEffect::OffsetOfLinearAxis(InsteadConstant { error: name("EXX"), side: Side::Workpiece })
    );
    let mut errors = GivenErrors::default();
    errors.set(&chain, name("EXX"), 5.0).unwrap();
    let error = volumetric_error(&chain, &errors, &State::default(), Form::Exact);
    assert!((error.position_mm.x - 0.005).abs() < 1e-12);
}

/// A displacement of the axis, given as an assembly error, has the same effect as the constant error motion in the
/// message, with the sign in the message.
#[test]
fn the_constant_that_is_named_says_the_same() {
    let (chain, state) = five_axes();
    let mut named = Vec::new();
    for (index, joint) in chain.joints().iter().enumerate() {
        for component in Component::ALL {
            let Some(reason) = joint.no_effect(component) else {
                continue;
            };
            let (NoEffect::OffsetOfLinearAxis(instead)
            | NoEffect::AlongRotaryAxis(instead)
            | NoEffect::AboutLinearAxis(instead)) = reason
            else {
                panic!("{reason:?}");
            };
            // If the table is higher, the tool is lower relative to the workpiece. Assembly errors, in contrast, are
            // those of the chain from the workpiece to the tool.
            let sign = match joint.side {
                Side::Tool => 1.0,
                Side::Workpiece => -1.0,
            };
            let mut misplaced = GivenErrors::default();
            let place = component.mcs_index();
            if component.is_angular() {
                misplaced.assembly[index].angular_rad[place] = sign * 1e-5;
            } else {
                misplaced.assembly[index].linear_mm[place] = sign * 1e-2;
            }
            let mut stated = GivenErrors::default();
            stated.set(&chain, instead.error, sign * 10.0).unwrap();
            let [expected, found] = [&misplaced, &stated]
                .map(|errors| plain::error(&chain, errors, &state, Form::Exact));
            for (expected, found) in expected.iter().flatten().zip(found.iter().flatten()) {
                let error = instead.error;
                assert!((expected - found).abs() < 1e-9, "{error}: {found}, expected {expected}");
            }
            named.push(reason.to_string());
        }
    }
    let told = |key: &str| named.iter().any(|line| line.contains(key));
    assert!(told("into the constant of EZC, with the opposite sign"), "{named:#?}");
    assert!(told("into the constant of EYB, with the same sign"), "{named:#?}");
}
