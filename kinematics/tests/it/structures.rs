//! Tests of structural codes and type numbers, and of values that are assigned to axes by name.

use proptest::prelude::*;
use volcomp_kinematics::{
    Chain, CorrectionOptions, ErrorMotion, GivenErrors, Side, State, Structure, StructureError,
    correct,
};
use volcomp_test_support::structures::all_types;
use volcomp_vocabulary::AxisName;

#[test]
fn codes_of_the_published_types() {
    for (translational, rotary, axes, code) in [
        (0, 0, &[][..], "w b X Y Z t"),
        (1, 0, &[], "w X' b Y Z t"),
        (2, 0, &[], "w X' Y' b Z t"),
        (3, 0, &[], "w X' Y' Z' b t"),
        (1, 1, &[AxisName::C, AxisName::A], "w C' A' X' b Y Z t"),
        (1, 2, &[AxisName::C, AxisName::A], "w X' b Y Z C A t"),
        (1, 3, &[AxisName::C, AxisName::B], "w C' X' b Y Z B t"),
    ] {
        let structure = Structure::from_type(translational, rotary, axes).unwrap();
        assert_eq!(structure.to_string(), code);
        let numbers = structure.type_numbers().unwrap();
        assert_eq!((numbers.translational, numbers.rotary), (translational, rotary));
        assert_eq!(&numbers.rotary_axes[..], axes);
    }
    assert_eq!(all_types().len(), 16);
}

#[test]
fn other_chains_primes_and_blanks_are_free() {
    for (read, printed) in [
        ("wXbYZt", "w X' b Y Z t"),
        ("w  Z Y' b X t", "w Z' Y' b X t"),
        ("w C’ b X U Y V Z W A t", "w C' b X U Y V Z W A t"),
        ("w X b t", "w X' b t"),
    ] {
        let structure: Structure = read.parse().unwrap();
        assert_eq!(structure.to_string(), printed);
        assert_eq!(structure.side(0), Side::Workpiece);
    }
    for outside_the_types in ["w Y' b X Z t", "w C' b X Y Z t", "w b U V W t"] {
        let structure: Structure = outside_the_types.parse().unwrap();
        assert_eq!(structure.type_numbers(), None);
    }
}

#[test]
fn wrong_codes_are_refused_for_what_is_wrong_with_them() {
    let refusal = |code: &str| code.parse::<Structure>().unwrap_err();
    assert_eq!(refusal("w X' b Y' t"), StructureError::PrimeOnToolSide { axis: AxisName::Y });
    assert_eq!(refusal("w X Y b X t"), StructureError::RepeatedAxis { axis: AxisName::X });
    assert_eq!(refusal("w ' X b t"), StructureError::StrayPrime { position: 3 });
    assert_eq!(refusal("w b t"), StructureError::NoAxes);
    assert_eq!(refusal("w b X"), StructureError::Missing { missing: 't' });
    assert_eq!(refusal("X b Y t"), StructureError::Missing { missing: 'w' });
    assert_eq!(refusal("w b X w t"), StructureError::OutOfPlace { found: 'w', position: 7 });
    assert_eq!(refusal(""), StructureError::Missing { missing: 'w' });
    assert_eq!(refusal("w X Y t"), StructureError::Missing { missing: 'b' });
    assert_eq!(refusal("w b Q t"), StructureError::UnknownCharacter { found: 'Q', position: 5 });
    assert!(Structure::from_type(4, 0, &[]).is_err());
    assert!(Structure::from_type(1, 2, &[AxisName::C, AxisName::C]).is_err());
    assert!(Structure::from_type(1, 0, &[AxisName::C]).is_err());
}

proptest! {
    #[test]
    fn what_is_printed_reads_back(order in Just(AxisName::ALL.to_vec()).prop_shuffle(), count in 1..=9_usize, bed in 0..=9_usize) {
        let axes = &order[..count];
        let (workpiece, tool) = axes.split_at(bed.min(count));
        let structure = Structure::new(workpiece, tool).unwrap();
        prop_assert_eq!(structure.to_string().parse::<Structure>().unwrap(), structure);
    }

    #[test]
    fn no_text_makes_the_parser_panic(code in ".{0,40}") {
        let _ = code.parse::<Structure>();
    }
}

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
