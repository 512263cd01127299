//! Plausibility checks. Limits are stated for usual machine tools and scale with the extent of the rows.

pub(crate) mod input;
pub(crate) mod result;

use volcomp_model::Machine;
use volcomp_vocabulary::{AxisKind, MAX_AXES};

use crate::observations::Row;

/// Minimum and maximum extent of rows to which limits apply without scaling, mm: the extents of nearly all machine
/// tools.
const USUAL_EXTENT_MM: [f64; 2] = [300.0, 2000.0];

/// Minimum scale factor of a limit, for rows that cover only a corner of a machine.
const SMALLEST_FACTOR: f64 = 0.1;

/// The larger of two extents, mm: the diagonal of the box around all coordinates of the linear axes, and the diagonal
/// of the box around all nominal tips in workpiece axes. Both are needed: with the tip on a sphere only the linear axes
/// move, and rotary axes move the tip while the linear axes are at rest.
fn extent_mm<'r>(machine: &Machine, rows: impl Iterator<Item = &'r Row>) -> f64 {
    let is_linear: Vec<bool> =
        (machine.axes().iter()).map(|axis| axis.name.kind() == AxisKind::Linear).collect();
    let mut coordinates = [[f64::INFINITY, f64::NEG_INFINITY]; MAX_AXES];
    let mut tips = [[f64::INFINITY, f64::NEG_INFINITY]; 3];
    let grow = |ends: &mut [f64; 2], at: f64| *ends = [ends[0].min(at), ends[1].max(at)];
    for pose in rows.flat_map(Row::poses) {
        let q = coordinates.iter_mut().zip(&pose.state.q).zip(&is_linear);
        q.filter(|(_, is_linear)| **is_linear).for_each(|((ends, q), _)| grow(ends, *q));
        let tip = pose.ideal_tip_mm(machine.chain());
        tips.iter_mut().zip(tip.iter()).for_each(|(ends, at)| grow(ends, *at));
    }
    let diagonal = |ends: &[[f64; 2]]| {
        let squares = ends.iter().map(|[low, high]| (high - low).max(0.0).powi(2));
        squares.sum::<f64>().sqrt()
    };
    diagonal(&coordinates).max(diagonal(&tips))
}

/// Scales a limit for usual machine tools, mm, to the extent of these rows. The result is rounded to two digits for
/// messages.
pub(crate) fn limit_mm<'r>(
    machine: &Machine,
    rows: impl Iterator<Item = &'r Row>,
    usual_mm: f64,
) -> f64 {
    scaled(usual_mm, extent_mm(machine, rows))
}

fn scaled(usual_mm: f64, extent_mm: f64) -> f64 {
    let [small, large] = USUAL_EXTENT_MM;
    let factor = if extent_mm <= 0.0 {
        // A single pose does not show the size of the machine.
        1.0
    } else if extent_mm < small {
        (extent_mm / small).max(SMALLEST_FACTOR)
    } else {
        (extent_mm / large).max(1.0)
    };
    let limit = usual_mm * factor;
    let digit = 10.0_f64.powf(limit.log10().floor() - 1.0);
    ((limit / digit).round() * digit * 1e6).round() / 1e6
}

pub(crate) fn median(sizes: &[f64]) -> f64 {
    let mut sorted = sizes.to_vec();
    sorted.sort_by(f64::total_cmp);
    sorted.get(sorted.len() / 2).copied().unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::scaled;

    #[test]
    fn limits_grow_with_the_extent_of_the_rows() {
        for usual in [0.0, 300.0, 1000.0, 2000.0] {
            for limit in [10.0, 1.0, 0.25, 2.0, 5.0] {
                assert_eq!(scaled(limit, usual), limit, "{usual}");
            }
        }
        assert_eq!(scaled(10.0, 50.0), 1.7);
        assert_eq!(scaled(10.0, 20_000.0), 100.0);
        // Rows in a corner of the machine get the smallest factor.
        assert_eq!(scaled(10.0, 1e-3), 1.0);
    }
}
