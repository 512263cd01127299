//! Tests that coordinates and corrections are assigned to axes by name.

use volcomp_kinematics::{Chain, CorrectionOptions, ErrorMotion, GivenErrors, State, correct};
use volcomp_test_support::structures::all_types;
use volcomp_vocabulary::AxisName;

/// The tip of an ideal chain of linear axes is at the coordinates of the axes, for any order of the axes in the chain
/// and in the call.
#[test]
fn a_coordinate_goes_to_its_axis() {
    let at = [(AxisName::X, 10.0), (AxisName::Y, 200.0), (AxisName::Z, -3.0)];
    for structure in ["w X' b Y Z t", "w Z' Y' X' b t", "w b Y X Z t"] {
        let chain = Chain::new(structure.parse().unwrap());
        for turn in 0..3 {
            let mut named = at;
            named.rotate_left(turn);
            let state = State::new(&chain, named).unwrap();
            let tip: [f64; 3] = chain.ideal_tip_mm(&state).into();
            assert_eq!(tip, [10.0, 200.0, -3.0], "{structure} {named:?}");
        }
    }
}

/// An error of 4 µm along Y is corrected by Y in each type of five-axis machine with its axes at zero.
#[test]
fn a_correction_is_read_by_name() {
    for structure in all_types() {
        let chain = Chain::new(structure.clone());
        let state = State::new(&chain, structure.axes().iter().map(|&axis| (axis, 0.0))).unwrap();
        let mut errors = GivenErrors::default();
        errors.motion[0] = ErrorMotion::from_um_urad([0.0, 4.0, 0.0, 0.0, 0.0, 0.0]);
        let found = correct(&chain, &errors, &state, &CorrectionOptions::default());
        for &axis in structure.axes() {
            let expected = if axis == AxisName::Y { -4e-3 } else { 0.0 };
            let delta = chain.of_axis(axis, &found.delta).unwrap();
            assert!((delta - expected).abs() < 1e-9, "{structure} {axis}: {delta}");
        }
    }
}

#[test]
fn an_axis_that_is_unknown_missing_or_named_twice_is_refused() {
    let chain = Chain::new("w C' X' b Y t".parse().unwrap());
    let (x, y, c) = ((AxisName::X, 1.0), (AxisName::Y, 2.0), (AxisName::C, 0.1));
    for (coordinates, expected) in [
        (&[x, y, c, (AxisName::Z, 3.0)][..], "the structure `w C' X' b Y t` has no axis Z"),
        (&[c, y], "axis X has no value, expected one for each axis of `w C' X' b Y t`"),
        (&[], "axis C has no value, expected one for each axis of `w C' X' b Y t`"),
        (&[x, y, c, x], "axis X has two values, expected one"),
    ] {
        let refused = State::new(&chain, coordinates.iter().copied()).unwrap_err();
        assert_eq!(refused.to_string(), expected);
    }
    let state = State::new(&chain, [x, y, c]).unwrap();
    assert_eq!(chain.of_axis(AxisName::X, &state.q), Some(1.0));
    assert_eq!(chain.of_axis(AxisName::Z, &state.q), None);
}
