//! What is too large for the error of a machine, in mm. A machine misses by the more the larger it is, so this depends on how far
//! the rows reach.

use volcomp_kinematics::nalgebra::Vector3;
use volcomp_model::Machine;
use volcomp_vocabulary::{AxisKind, MAX_AXES};

use crate::observations::{Row, Seen};

/// Limits are stated for rows that cover this much, mm: nearly all machine tools.
const USUAL_MM: [f64; 2] = [300.0, 2000.0];
/// What rows cover in a corner of a machine says little of it: limits become smaller down to this share.
const LEAST: f64 = 0.1;

/// How much some rows cover.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Span {
    mm: f64,
}

impl Span {
    /// The diagonal of the box about all places of the linear axes, or of that about all nominal tips in workpiece axes where it is
    /// larger: a tip that stays at a sphere does not move, and axes that stand carry a tip that does.
    pub(crate) fn of<'r>(machine: &Machine, rows: impl Iterator<Item = &'r Row>) -> Self {
        let kinds: Vec<AxisKind> = machine.axes().iter().map(|a| a.name.kind()).collect();
        let mut places = [[f64::INFINITY, f64::NEG_INFINITY]; MAX_AXES];
        let mut tips = [[f64::INFINITY, f64::NEG_INFINITY]; 3];
        let grow = |ends: &mut [f64; 2], at: f64| *ends = [ends[0].min(at), ends[1].max(at)];
        for row in rows {
            let from = match &row.seen {
                Seen::Pair { from, .. } => Some(from),
                _ => None,
            };
            for stand in core::iter::once(&row.stand).chain(from) {
                for ((ends, kind), q) in places.iter_mut().zip(&kinds).zip(&stand.state.q) {
                    if *kind == AxisKind::Linear {
                        grow(ends, *q);
                    }
                }
                let tip: Vector3<f64> = stand.ideal_tip_mm(machine.chain());
                for (ends, at) in tips.iter_mut().zip(tip.iter()) {
                    grow(ends, *at);
                }
            }
        }
        let diagonal = |ends: &[[f64; 2]]| {
            let squares = ends.iter().map(|[low, high]| (high - low).max(0.0).powi(2));
            squares.sum::<f64>().sqrt()
        };
        Self {
            mm: diagonal(&places).max(diagonal(&tips)),
        }
    }

    /// The limit for these rows where it is so many mm for rows of usual machine tools; to two digits, as messages show it. Rows that
    /// cover nothing say nothing of the size.
    pub(crate) fn limit_mm(self, usual_mm: f64) -> f64 {
        let [small, large] = USUAL_MM;
        let times = if self.mm <= 0.0 {
            1.0
        } else if self.mm < small {
            (self.mm / small).max(LEAST)
        } else {
            (self.mm / large).max(1.0)
        };
        let limit = usual_mm * times;
        let digit = 10.0_f64.powf(limit.log10().floor() - 1.0);
        let rounded = (limit / digit).round() * digit;
        // What is left of the way to the digits.
        (rounded * 1e6).round() / 1e6
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn limits_grow_with_what_the_rows_cover() {
        let limit = |mm: f64| Span { mm }.limit_mm(10.0);
        for usual in [0.0, 300.0, 1000.0, 2000.0] {
            assert_eq!(limit(usual), 10.0, "{usual}");
            for other in [1.0, 0.25, 2.0, 5.0] {
                assert_eq!(Span { mm: usual }.limit_mm(other), other, "{usual}");
            }
        }
        assert_eq!(limit(50.0), 1.7);
        assert_eq!(limit(20_000.0), 100.0);
        // A corner of a machine.
        assert_eq!(limit(1e-3), 1.0);
    }
}
