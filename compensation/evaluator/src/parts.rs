//! What a compiled machine is made from.

use alloc::{format, vec, vec::Vec};

use volcomp_kinematics::{Chain, ErrorMotion, nalgebra::Vector3};
use volcomp_vocabulary::{AxisName, Direction, MAX_AXES};

use crate::{
    EvaluatorError,
    patch::Patch,
    table::{LANES, MAX_PIECES, Piece},
};

/// Degree of the Chebyshev interpolant that a piece is judged by, plus 1.
const NODES: usize = 12;

/// How far a compiled curve may be from its source.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tolerance {
    /// Of displacements, mm.
    pub linear_mm: f64,
    /// Of rotations, rad.
    pub angular_rad: f64,
}

impl Default for Tolerance {
    /// 1 nm and 1 nrad.
    fn default() -> Self {
        Self::from_nm(1.0)
    }
}

impl Tolerance {
    /// So many nm and nrad.
    pub fn from_nm(nm: f64) -> Self {
        Self {
            linear_mm: nm * 1e-6,
            angular_rad: nm * 1e-9,
        }
    }

    fn lane(&self, lane: usize) -> f64 {
        if lane < 3 {
            self.linear_mm
        } else {
            self.angular_rad
        }
    }
}

/// The six error motions of an axis as its curves give them: mm and rad at a coordinate in mm or deg.
pub type RawCurve<'a> = dyn Fn(f64, Option<Direction>) -> ErrorMotion + 'a;

/// Whether an axis has different errors in its two directions.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Branches {
    /// The same in both.
    One,
    /// Forward, backward, and their mean where the direction is not known.
    Three,
}

/// The place of a branch among those of [`Branches::Three`]: forward, backward, mean.
#[inline(always)]
pub(crate) fn branch_index(approach: Option<Direction>) -> usize {
    match approach {
        Some(Direction::Positive) => 0,
        Some(Direction::Negative) => 1,
        None => 2,
    }
}

/// One axis of a machine to be compiled. Coordinates are mm or deg.
pub struct AxisParts<'a> {
    /// Its error motions over its own coordinate alone.
    pub errors: &'a RawCurve<'a>,
    /// Whether they depend on the direction.
    pub branches: Branches,
    /// For each component every coordinate at which a derivative may jump, domain ends included, in any
    /// order; outside the first and last of all the errors are held. Empty for constants.
    pub breakpoints: [Vec<f64>; 6],
    /// What its displacements gain for each mm or deg of the coordinate besides, mm, outside the
    /// breakpoints too.
    pub slope_mm: [f64; 3],
    /// Lower and upper end of travel.
    pub travel: [f64; 2],
    /// Period that brings a rotary coordinate into travel.
    pub modulo: Option<f64>,
    /// Errors over two coordinates.
    pub patches: Vec<Patch>,
    /// For each component, where its curve is defined: the axis looked at and its range.
    pub ranges: Vec<(usize, usize, [f64; 2])>,
}

/// A machine to be compiled: axes in chain order.
pub struct MachineParts<'a> {
    /// The ideal chain with its tool, mm and rad.
    pub chain: &'a Chain,
    /// Its axes.
    pub axes: Vec<AxisParts<'a>>,
    /// Location errors, mm and rad.
    pub location: [ErrorMotion; MAX_AXES],
    /// Assembly errors, mm and rad.
    pub assembly: [ErrorMotion; MAX_AXES],
}

/// A function of six components as piecewise cubics, the first and the last of them the held ends.
fn fit(
    function: &dyn Fn(f64) -> [f64; LANES],
    mut points: Vec<f64>,
    tolerance: Tolerance,
) -> Option<Vec<Piece>> {
    points.sort_unstable_by(f64::total_cmp);
    points.dedup();
    let ends = [points.first(), points.last()].map(|end| end.copied().unwrap_or(0.0));
    let mut pieces = vec![Piece::held(ends[0], function(ends[0]))];
    for ends in points.windows(2) {
        let mut pending = vec![(ends[0], ends[1])];
        while let Some((from, to)) = pending.pop() {
            let middle = 0.5 * (from + to);
            let piece = Sampled::over(function, from, to);
            // An interval that cannot be halved any more is taken as it is: one rounding wide.
            if piece.keeps(tolerance) || middle <= from || middle >= to {
                if pieces.len() + 1 >= MAX_PIECES {
                    return None;
                }
                pieces.push(Piece::new(from, to, piece.powers()));
            } else {
                if pending.len() + pieces.len() + 1 >= MAX_PIECES {
                    return None;
                }
                pending.push((middle, to));
                pending.push((from, middle));
            }
        }
    }
    pieces.push(Piece::held(ends[1], function(ends[1])));
    Some(pieces)
}

/// The errors of an axis as its tables want them.
pub(crate) struct ToTable<'a> {
    pub(crate) errors: &'a dyn Fn(f64) -> ErrorMotion,
    pub(crate) breakpoints: &'a [Vec<f64>; LANES],
    /// From the axis's point to the tool tip, mm.
    pub(crate) arm_mm: Vector3<f64>,
    pub(crate) constant: ErrorMotion,
    pub(crate) tolerance: Tolerance,
    pub(crate) axis: AxisName,
}

impl ToTable<'_> {
    /// The table, or which curve is too much for it.
    pub(crate) fn fit(&self) -> Result<Vec<Piece>, EvaluatorError> {
        self.pieces(None, self.tolerance)
            .ok_or_else(|| self.too_large())
    }

    /// The pieces of all components or of one of them alone; displacements at the tool tip.
    fn pieces(&self, alone: Option<usize>, tolerance: Tolerance) -> Option<Vec<Piece>> {
        let function = |x: f64| {
            let mut error = (self.errors)(x);
            if let Some(alone) = alone {
                for k in 0..3 {
                    error.linear_mm[k] *= f64::from(u8::from(alone == k));
                    error.angular_rad[k] *= f64::from(u8::from(alone == k + 3));
                }
            }
            let carried = error.angular_rad.cross(&self.arm_mm);
            let linear = error.linear_mm + carried + self.constant.linear_mm;
            let angular = error.angular_rad + self.constant.angular_rad;
            [
                linear.x, linear.y, linear.z, angular.x, angular.y, angular.z,
            ]
        };
        let counted = |lane: usize| alone.is_none_or(|alone| alone == lane);
        let lanes = (0..LANES).filter(|lane| counted(*lane));
        let breakpoints = lanes.flat_map(|lane| self.breakpoints[lane].iter().copied());
        fit(&function, breakpoints.collect(), tolerance)
    }

    /// The first curve that is too large by itself, else the axis, and a tolerance that fits.
    fn too_large(&self) -> EvaluatorError {
        let alone = (0..LANES).find(|lane| self.pieces(Some(*lane), self.tolerance).is_none());
        let tolerance_nm = self.tolerance.linear_mm * 1e6;
        let tried = (1..=9).map(|power| tolerance_nm * libm::pow(10.0, f64::from(power)));
        let fits = |nm: &f64| self.pieces(None, Tolerance::from_nm(*nm)).is_some();
        EvaluatorError::TooLarge {
            curve: match alone {
                Some(lane) => format!(
                    "{}{}",
                    ["EX", "EY", "EZ", "EA", "EB", "EC"][lane],
                    self.axis
                ),
                None => format!("all of axis {}", self.axis),
            },
            tolerance_nm,
            fitting_nm: tried.into_iter().find(fits),
        }
    }
}

/// Six functions over one interval: values at Chebyshev–Lobatto points and their Chebyshev series.
struct Sampled {
    length: f64,
    /// Values at −1, −½, ½, 1 of the interval.
    corners: [[f64; LANES]; 4],
    series: [[f64; LANES]; NODES],
}

impl Sampled {
    fn over(function: &dyn Fn(f64) -> [f64; LANES], from: f64, to: f64) -> Self {
        let length = to - from;
        // From the ends inward, so that the ends are met to the last digit.
        let at = |t: f64| {
            if t <= -1.0 {
                function(from)
            } else if t >= 1.0 {
                function(to)
            } else {
                function(from + 0.5 * (t + 1.0) * length)
            }
        };
        let last = (NODES - 1) as f64;
        let angle = |j: usize| core::f64::consts::PI * j as f64 / last;
        let values: [[f64; LANES]; NODES] = core::array::from_fn(|j| at(libm::cos(angle(j))));
        let mut series = [[0.0; LANES]; NODES];
        for (k, row) in series.iter_mut().enumerate() {
            for (j, value) in values.iter().enumerate() {
                let end = |i: usize| if i == 0 || i == NODES - 1 { 0.5 } else { 1.0 };
                let weight = 2.0 / last * end(j) * end(k) * libm::cos(angle(j) * k as f64);
                for lane in 0..LANES {
                    row[lane] += weight * value[lane];
                }
            }
        }
        Self {
            length,
            corners: [at(-1.0), at(-0.5), at(0.5), at(1.0)],
            series,
        }
    }

    /// The cubic through the corners differs from Σ c_k T_k by 2 Σ_{k ≥ 4} |c_k| at the most: at the
    /// corners T_k coincides with a T of an order below 4. The series is the function itself where that
    /// is a polynomial of an order below [`NODES`]; else its last two coefficients, which must have
    /// died out, are counted ten times for the rest.
    fn keeps(&self, tolerance: Tolerance) -> bool {
        (0..LANES).all(|lane| {
            let size = |k: usize| libm::fabs(self.series[k][lane]);
            let beyond: f64 = (4..NODES).map(size).sum();
            let rest = size(NODES - 1) + size(NODES - 2);
            2.0 * beyond + 10.0 * rest <= tolerance.lane(lane)
        })
    }

    /// In powers of the distance from the start.
    fn powers(&self) -> [[f64; LANES]; 4] {
        let mut powers = [[0.0; LANES]; 4];
        let h = self.length;
        for lane in 0..LANES {
            let [v0, v1, v2, v3] = self.corners.map(|corner| corner[lane]);
            // Through 0, ¼, ¾ and 1 of the length.
            let c1 = (-19.0 * v0 + 24.0 * v1 - 8.0 * v2 + 3.0 * v3) / 3.0;
            let c2 = (32.0 * v0 - 56.0 * v1 + 40.0 * v2 - 16.0 * v3) / 3.0;
            let c3 = (-16.0 * v0 + 32.0 * v1 - 32.0 * v2 + 16.0 * v3) / 3.0;
            powers[0][lane] = v0;
            powers[1][lane] = c1 / h;
            powers[2][lane] = c2 / (h * h);
            powers[3][lane] = c3 / (h * h * h);
        }
        powers
    }
}
