//! Fits curves with piecewise cubics within a tolerance.

use alloc::{format, string::ToString, vec, vec::Vec};

use volcomp_kinematics::{ErrorMotion, nalgebra::Vector3};
use volcomp_vocabulary::{AxisName, Component, ErrorName};

use crate::{
    EvaluatorError, Tolerance,
    table::{LANES, MAX_PIECES, Piece},
};

/// Number of nodes of the Chebyshev interpolant against which a piece is checked: its degree plus 1.
const NODES: usize = 12;

#[derive(Clone, Copy, Debug, PartialEq)]
enum FitFailure {
    TooManyPieces,
    /// A coordinate at or near which the function is not finite.
    NotFinite(f64),
}

/// Fits a function of six components with piecewise cubics; the first and the last piece hold the end values.
fn fit(
    function: &dyn Fn(f64) -> [f64; LANES],
    mut points: Vec<f64>,
    tolerance: Tolerance,
) -> Result<Vec<Piece>, FitFailure> {
    points.sort_unstable_by(f64::total_cmp);
    points.dedup();
    let ends = [points.first(), points.last()].map(|end| end.copied().unwrap_or(0.0));
    for &point in &points {
        if !function(point).iter().all(|value| value.is_finite()) {
            return Err(FitFailure::NotFinite(point));
        }
    }
    let chebyshev = Chebyshev::new();
    let mut pieces = vec![Piece::held(ends[0], function(ends[0]))];
    for ends in points.windows(2) {
        let mut pending = vec![(ends[0], ends[1])];
        while let Some((from, to)) = pending.pop() {
            let middle = 0.5 * (from + to);
            let piece = Sampled::over(function, &chebyshev, from, to);
            if !piece.is_finite() {
                return Err(FitFailure::NotFinite(middle));
            }
            // An interval of one rounding unit cannot be halved further and is accepted.
            if piece.keeps(tolerance) || middle <= from || middle >= to {
                if pieces.len() + 1 >= MAX_PIECES {
                    return Err(FitFailure::TooManyPieces);
                }
                pieces.push(Piece::new(from, to, piece.powers(function)));
            } else {
                if pending.len() + pieces.len() + 1 >= MAX_PIECES {
                    return Err(FitFailure::TooManyPieces);
                }
                pending.push((middle, to));
                pending.push((from, middle));
            }
        }
    }
    pieces.push(Piece::held(ends[1], function(ends[1])));
    Ok(pieces)
}

pub(crate) struct CurveFit<'a> {
    pub(crate) errors: &'a dyn Fn(f64) -> ErrorMotion,
    /// Range of the table, mm or deg, extended by breakpoints outside of it.
    pub(crate) travel: [f64; 2],
    pub(crate) breakpoints: &'a [Vec<f64>; LANES],
    /// Vector from the point of the axis to the tool tip, mm.
    pub(crate) arm_mm: Vector3<f64>,
    pub(crate) constant: ErrorMotion,
    pub(crate) tolerance: Tolerance,
    pub(crate) axis: AxisName,
}

impl CurveFit<'_> {
    pub(crate) fn fit(&self) -> Result<Vec<Piece>, EvaluatorError> {
        self.pieces(None, self.tolerance).map_err(|failure| self.refused(failure))
    }

    /// The pieces of all components, or of the component `alone` with all others set to zero; displacements are those
    /// of the tool tip.
    fn pieces(&self, alone: Option<usize>, tolerance: Tolerance) -> Result<Vec<Piece>, FitFailure> {
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
            [linear.x, linear.y, linear.z, angular.x, angular.y, angular.z]
        };
        let counted = |lane: usize| alone.is_none_or(|alone| alone == lane);
        let lanes = (0..LANES).filter(|lane| counted(*lane));
        let breakpoints = lanes.flat_map(|lane| self.breakpoints[lane].iter().copied());
        let points = self.travel.into_iter().chain(breakpoints);
        fit(&function, points.collect(), tolerance)
    }

    /// The error for a failed fit. It names the first curve that cannot be compiled alone; if each of them can, it
    /// names all curves of the axis.
    fn refused(&self, failure: FitFailure) -> EvaluatorError {
        let alone = (0..LANES).find(|lane| self.pieces(Some(*lane), self.tolerance).is_err());
        let curve = match alone.and_then(|lane| Component::ALL.get(lane)) {
            Some(&component) => ErrorName::motion(component, self.axis).to_string(),
            None => format!("all of axis {}", self.axis),
        };
        if let FitFailure::NotFinite(at) = failure {
            return EvaluatorError::NotFinite { curve, at };
        }
        let tolerance_nm = self.tolerance.linear_mm * 1e6;
        let tried = (1..=9).map(|power| tolerance_nm * libm::pow(10.0, f64::from(power)));
        let fits = |nm: &f64| self.pieces(None, Tolerance::from_nm(*nm)).is_ok();
        EvaluatorError::TooLarge { curve, tolerance_nm, fitting_nm: tried.into_iter().find(fits) }
    }
}

/// Chebyshev–Lobatto points, descending from 1 to −1, and the weights that convert values at these points to the
/// coefficients of the Chebyshev series.
struct Chebyshev {
    points: [f64; NODES],
    weights: [[f64; NODES]; NODES],
}

impl Chebyshev {
    fn new() -> Self {
        let last = (NODES - 1) as f64;
        let angle = |j: usize| core::f64::consts::PI * j as f64 / last;
        let end = |i: usize| if i == 0 || i == NODES - 1 { 0.5 } else { 1.0 };
        let weight =
            |k: usize, j: usize| 2.0 / last * end(j) * end(k) * libm::cos(angle(j) * k as f64);
        Self {
            points: core::array::from_fn(|j| libm::cos(angle(j))),
            weights: core::array::from_fn(|k| core::array::from_fn(|j| weight(k, j))),
        }
    }
}

/// Six functions over one interval: their values at its ends, and their Chebyshev series.
struct Sampled {
    from: f64,
    length: f64,
    ends: [[f64; LANES]; 2],
    series: [[f64; LANES]; NODES],
}

impl Sampled {
    fn over(
        function: &dyn Fn(f64) -> [f64; LANES],
        chebyshev: &Chebyshev,
        from: f64,
        to: f64,
    ) -> Self {
        let length = to - from;
        // At the ends the function is evaluated at exactly `from` and `to`, without rounding.
        let at = |t: f64| {
            if t <= -1.0 {
                function(from)
            } else if t >= 1.0 {
                function(to)
            } else {
                function(from + 0.5 * (t + 1.0) * length)
            }
        };
        let values = chebyshev.points.map(at);
        let mut series = [[0.0; LANES]; NODES];
        for (row, weights) in series.iter_mut().zip(&chebyshev.weights) {
            for (value, weight) in values.iter().zip(weights) {
                for lane in 0..LANES {
                    row[lane] += weight * value[lane];
                }
            }
        }
        Self {
            from,
            length,
            // The first and the last point are the ends, in descending order.
            ends: [values[NODES - 1], values[0]],
            series,
        }
    }

    fn is_finite(&self) -> bool {
        self.series.iter().flatten().all(|value| value.is_finite())
    }

    /// Whether the cubic is within the tolerance. The cubic through the corners differs from Σ c_k T_k by at most 2
    /// Σ_{k ≥ 4} |c_k|, because at the corners each T_k equals a T of an order below 4. The series is exact for a
    /// polynomial of an order below [`NODES`]. For other functions the remainder is estimated as ten times the last two
    /// coefficients.
    fn keeps(&self, tolerance: Tolerance) -> bool {
        (0..LANES).all(|lane| {
            let size = |k: usize| libm::fabs(self.series[k][lane]);
            let beyond: f64 = (4..NODES).map(size).sum();
            let rest = size(NODES - 1) + size(NODES - 2);
            2.0 * beyond + 10.0 * rest <= tolerance.lane(lane)
        })
    }

    /// Powers of the cubic through the values at −1, −½, ½, 1 of the interval.
    fn powers(&self, function: &dyn Fn(f64) -> [f64; LANES]) -> [[f64; LANES]; 4] {
        let mut powers = [[0.0; LANES]; 4];
        let h = self.length;
        let inner = [-0.5, 0.5].map(|t| function(self.from + 0.5 * (t + 1.0) * h));
        let corners = [self.ends[0], inner[0], inner[1], self.ends[1]];
        for lane in 0..LANES {
            let [v0, v1, v2, v3] = corners.map(|corner| corner[lane]);
            // Through the points at 0, ¼, ¾ and 1 of the length.
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
