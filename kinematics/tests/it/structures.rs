//! Tests of structural codes and type numbers.

use proptest::prelude::*;
use volcomp_kinematics::{Side, Structure, StructureError};
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
