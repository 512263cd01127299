//! Machine structures for tests.

use volcomp_kinematics::Structure;
use volcomp_vocabulary::AxisName;

/// The 4 three-axis and the 12 five-axis structures, the latter with each pair of rotary axes in turn.
pub fn all_types() -> Vec<Structure> {
    let of = |translational, rotary, axes: &[AxisName]| {
        Structure::from_type(translational, rotary, axes).expect("a type of machine")
    };
    let mut types = Vec::new();
    for translational in 0..=3 {
        types.push(of(translational, 0, &[]));
        for rotary in 1..=3 {
            let pair = [
                [AxisName::C, AxisName::A],
                [AxisName::C, AxisName::B],
                [AxisName::A, AxisName::B],
            ][usize::from(rotary + translational) % 3];
            types.push(of(translational, rotary, &pair));
        }
    }
    types
}
