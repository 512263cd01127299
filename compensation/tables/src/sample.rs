//! Places over the work space at which a field is looked at.

use volcomp_vocabulary::Direction;

use crate::{Field, GRID_AXES, OUTPUTS};

/// The length of a correction of all outputs together, in the unit of its values.
pub(crate) fn norm(values: &[f64; OUTPUTS]) -> f64 {
    values.iter().map(|v| v * v).sum::<f64>().sqrt()
}

/// Shares 0 to 1 on a lattice of so many places along each of so many axes, ends included; the first axis is the fastest.
pub(crate) fn lattice(axes: usize, most: usize) -> impl Iterator<Item = [f64; GRID_AXES]> {
    // Fewer places where there are many axes.
    let places = if axes > 3 { most.min(5) } else { most };
    let count = (0..axes).fold(1, |count, _| count * places);
    (0..count).map(move |number| {
        let mut shares = [0.0; GRID_AXES];
        let mut rest = number;
        for share in shares.iter_mut().take(axes) {
            *share = (rest % places) as f64 / (places - 1) as f64;
            rest /= places;
        }
        shares
    })
}

/// Every combination of directions along these axes, where the field depends on them.
pub(crate) fn directions_of<F: Field>(
    field: &F,
    axes: usize,
) -> impl Iterator<Item = [Option<Direction>; GRID_AXES]> + use<F> {
    let bidirectional = field.is_bidirectional();
    let count = if bidirectional { 1 << axes } else { 1 };
    (0..count).map(move |number: usize| {
        core::array::from_fn(|axis| {
            (bidirectional && axis < axes).then(|| Direction::BOTH[number >> axis & 1])
        })
    })
}

/// The length of the difference of two corrections, in the unit of their values.
pub(crate) fn distance(one: [f64; OUTPUTS], other: [f64; OUTPUTS]) -> f64 {
    norm(&core::array::from_fn(|output| one[output] - other[output]))
}
