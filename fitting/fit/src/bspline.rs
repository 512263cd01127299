//! Fits of cubic smoothing B-splines, by a banded QR factorisation of rows with four adjacent non-zero entries.

use volcomp_curve::BSpline;

use crate::between::{PARTS_OF_GAP, band_of};
use crate::fit::left_out;
use crate::{Fit, FitError, readings};

const DEGREE: usize = 3;
/// Maximum number of segments. It suffices for the pitch error of a long screw. If the readings require fewer segments,
/// the penalty keeps the spline smooth.
const MAX_SEGMENTS: usize = 400;
/// Range of the decimal exponents of the smoothing parameter, for up to `SEGMENTS_OF_RANGE` segments. With more
/// segments the upper end rises, because the penalty on a slow wave falls with the fourth power of the number of
/// segments.
const LOG_LAMBDA: [i32; 2] = [-9, 9];
const SEGMENTS_OF_RANGE: f64 = 40.0;
/// In gaps wider than this multiple of the mean gap, the spline is constrained to the range of the readings
/// (`band_of`), because the neighbouring readings do not determine the spline there. For 500 random sets of targets
/// (`examples/gaps.rs`), a limit of four causes errors up to five times the smallest error; limits of one and two cause
/// none.
const WIDE_GAP: f64 = 2.0;
/// Final step of the search for the smoothing parameter, in decades.
const LOG_RESOLUTION: f64 = 0.01;

/// Fits a smoothing B-spline through the mean reading of each target. The spline is cubic with uniform knots, and has
/// as many segments as gaps between targets, at most 400. The penalty is on second differences of the coefficients
/// (Eilers and Marx, Statistical Science 11, 1996). Its weight is chosen by generalised cross-validation (Craven and
/// Wahba, Numer. Math. 31, 1979).
///
/// If two neighbouring targets are more than two mean gaps apart, the weight minimises the leave-one-out error instead.
/// Only those weights are valid with which the curve stays, in such gaps, within the range of the mean readings
/// extended by a quarter of its height. The reason is that between clustered targets cross-validation cannot detect
/// scatter, and slopes fitted to the scatter would extrapolate far into a gap.
///
/// # Errors
///
/// Unequal lengths, numbers that are not finite, or fewer than 4 different targets.
pub fn fit_bspline(x: &[f64], u: &[f64]) -> Result<Fit, FitError> {
    let targets = readings::checked_targets(x, u, MIN_TARGETS, "a smoothing spline")?;
    let problem = Problem::new(&targets);
    let spline = problem.smoothed(problem.cross_validated()?)?;
    let errors = spline.residuals.iter().zip(&spline.leverages);
    let missed = errors.map(|(&e, &h)| left_out(e, h)).enumerate();
    let curve = BSpline::new(problem.knots, spline.coefficients, DEGREE)?;
    Ok(Fit::new(curve.into(), x, u, missed))
}

pub(crate) const MIN_TARGETS: usize = 4;

/// Least-squares problem of the targets: the four non-zero B-splines at each target, and the triangular factor.
pub(crate) struct Problem {
    knots: Vec<f64>,
    rows: Vec<(usize, [f64; WIDTH])>,
    means: Vec<f64>,
    triangle: Triangle,
    /// B-splines at abscissas in wide gaps between targets, where the spline must stay in `band`.
    in_gaps: Vec<(usize, [f64; WIDTH])>,
    band: [f64; 2],
}

pub(crate) struct Smoothed {
    pub(crate) coefficients: Vec<f64>,
    pub(crate) residuals: Vec<f64>,
    /// Diagonal of the hat matrix.
    pub(crate) leverages: Vec<f64>,
}

impl Problem {
    /// Builds the problem for at least 4 ascending targets.
    pub(crate) fn new(targets: &[[f64; 2]]) -> Self {
        let (lower, upper) = (targets[0][0], targets[targets.len() - 1][0]);
        let knots = uniform_knots(lower, upper, targets.len() - 1);
        let rows: Vec<_> = targets.iter().map(|t| basis(&knots, t[0])).collect();
        let means: Vec<f64> = targets.iter().map(|t| t[1]).collect();
        let mut triangle = Triangle::new(knots.len() - DEGREE - 1);
        for ((first, row), &mean) in rows.iter().zip(&means) {
            triangle.add(*first, *row, mean);
        }
        let wide = WIDE_GAP * (upper - lower) / (targets.len() - 1) as f64;
        let in_gaps =
            targets.windows(2).filter(|gap| gap[1][0] - gap[0][0] > wide).flat_map(|gap| {
                PARTS_OF_GAP.map(|part| basis(&knots, gap[0][0] + part * (gap[1][0] - gap[0][0])))
            });
        Self { in_gaps: in_gaps.collect(), band: band_of(&means), knots, rows, means, triangle }
    }

    pub(crate) fn curve(&self, coefficients: Vec<f64>) -> Result<BSpline, FitError> {
        Ok(BSpline::new(self.knots.clone(), coefficients, DEGREE)?)
    }

    pub(crate) fn with(&self, means: &[f64]) -> Self {
        let mut triangle = Triangle::new(self.triangle.size());
        for ((first, row), &mean) in self.rows.iter().zip(means) {
            triangle.add(*first, *row, mean);
        }
        Self {
            knots: self.knots.clone(),
            rows: self.rows.clone(),
            means: means.to_vec(),
            triangle,
            in_gaps: self.in_gaps.clone(),
            band: band_of(means),
        }
    }

    /// Decimal exponent of the smoothing parameter with the smallest score. The search tries powers of ten, and then
    /// bisects the step around the best.
    pub(crate) fn cross_validated(&self) -> Result<f64, FitError> {
        let score = |log: f64| Some((self.score(&self.penalised(log)?), log));
        // If every score is infinite, the stiffest spline is kept.
        let better = |a: (f64, f64), b: (f64, f64)| {
            let is_better = b.0 < a.0 || a.0.is_infinite() && b.0.is_infinite() && b.1 > a.1;
            if is_better { b } else { a }
        };
        let [first, last] = LOG_LAMBDA;
        let segments = (self.knots.len() - 2 * DEGREE - 1) as f64;
        let more = (4.0 * (segments / SEGMENTS_OF_RANGE).log10()).max(0.0);
        let last = f64::from(last) + more.ceil();
        let mut best = (first..)
            .map(f64::from)
            .take_while(|log| *log <= last)
            .filter_map(score)
            .reduce(better)
            .ok_or_else(|| self.undetermined())?;
        let mut step = 0.5;
        while step > LOG_RESOLUTION {
            let around = [best.1 - step, best.1 + step].into_iter().filter_map(score);
            best = around.fold(best, better);
            step /= 2.0;
        }
        Ok(best.1)
    }

    pub(crate) fn smoothed(&self, log_lambda: f64) -> Result<Smoothed, FitError> {
        let triangle = self.penalised(log_lambda).ok_or_else(|| self.undetermined())?;
        let coefficients = triangle.solution();
        let rows = self.rows.iter();
        Ok(Smoothed {
            residuals: self.residuals(&coefficients),
            leverages: rows.map(|(first, row)| triangle.leverage(*first, row)).collect(),
            coefficients,
        })
    }

    fn undetermined(&self) -> FitError {
        FitError::Undetermined { coefficients: self.triangle.size() }
    }

    /// Triangular factor of the rows of the readings together with the rows of the penalty; `None` if it is singular.
    fn penalised(&self, log_lambda: f64) -> Option<Triangle> {
        let root = 10_f64.powf(log_lambda / 2.0);
        let size = self.triangle.size();
        let mut triangle = Triangle::new(size);
        for (place, (row, right)) in self.triangle.rows().enumerate() {
            triangle.add(place, *row, right);
            if place + 2 < size {
                triangle.add(place, [root, -2.0 * root, root, 0.0], 0.0);
            }
        }
        triangle.is_regular().then_some(triangle)
    }

    fn residuals(&self, coefficients: &[f64]) -> Vec<f64> {
        let rows = self.rows.iter().zip(&self.means);
        rows.map(|(row, mean)| mean - value(row, coefficients)).collect()
    }

    /// Score of a smoothing parameter, smaller is better: generalised cross-validation. If the targets have wide gaps,
    /// the score is the sum of the squared leave-one-out errors, or infinity if the spline leaves `band` inside a gap.
    fn score(&self, triangle: &Triangle) -> f64 {
        if self.in_gaps.is_empty() {
            return self.generalised(triangle);
        }
        let coefficients = triangle.solution();
        let [low, high] = self.band;
        let stays = self.in_gaps.iter().all(|at| (low..=high).contains(&value(at, &coefficients)));
        if !stays {
            return f64::INFINITY;
        }
        let errors = self.residuals(&coefficients).into_iter().zip(&self.rows);
        errors
            .map(|(error, (first, row))| left_out(error, triangle.leverage(*first, row)).powi(2))
            .sum()
    }

    /// `n Σe² / (n − tr H)²`, or infinity if the spline has no degrees of freedom left, because only rounding would
    /// determine the value then.
    fn generalised(&self, triangle: &Triangle) -> f64 {
        let count = self.means.len() as f64;
        let freedom = count - triangle.trace_with(&self.triangle);
        if freedom.is_nan() || freedom <= 1e-3 * count {
            return f64::INFINITY;
        }
        let errors = self.residuals(&triangle.solution());
        count * errors.iter().map(|e| e * e).sum::<f64>() / (freedom * freedom)
    }
}

/// Value of a spline at a position, from the B-splines that are not zero there.
fn value((first, row): &(usize, [f64; WIDTH]), coefficients: &[f64]) -> f64 {
    let acting = &coefficients[*first..first + WIDTH];
    row.iter().zip(acting).map(|(b, c)| b * c).sum()
}

fn uniform_knots(lower: f64, upper: f64, gaps: usize) -> Vec<f64> {
    let segments = gaps.min(MAX_SEGMENTS);
    let step = (upper - lower) / segments as f64;
    (0..=segments + 2 * DEGREE)
        .map(|i| match i {
            // The ends of the domain must equal the outer targets exactly.
            _ if i == DEGREE => lower,
            _ if i == DEGREE + segments => upper,
            _ => lower + (i as f64 - DEGREE as f64) * step,
        })
        .collect()
}

/// B-splines that are not zero at `x`: index of the first, and their values (de Boor, J. Approx. Theory 6, 1972). `x`
/// must be in the domain.
fn basis(knots: &[f64], x: f64) -> (usize, [f64; WIDTH]) {
    let inner = &knots[DEGREE..knots.len() - DEGREE];
    let above = inner.partition_point(|&t| t <= x).clamp(1, inner.len() - 1);
    let span = DEGREE + above - 1;
    let mut values = [0.0; WIDTH];
    values[0] = 1.0;
    for degree in 1..=DEGREE {
        let mut saved = 0.0;
        for r in 0..degree {
            let (right, left) = (knots[span + r + 1], knots[span + 1 + r - degree]);
            let part = values[r] / (right - left);
            values[r] = saved + (right - x) * part;
            saved = (x - left) * part;
        }
        values[degree] = saved;
    }
    (span - DEGREE, values)
}

/// Number of non-zero entries of a row.
const WIDTH: usize = 4;

/// Triangular factor R of a QR factorisation with bandwidth 4, and Qᵀ times the right-hand side, built row by row by
/// Givens rotations. Rows must be added by ascending first column, so that each new row meets at most four rows of R.
#[derive(Clone)]
pub(crate) struct Triangle {
    r: Vec<[f64; WIDTH]>,
    y: Vec<f64>,
}

impl Triangle {
    pub(crate) fn new(size: usize) -> Self {
        Self { r: vec![[0.0; WIDTH]; size], y: vec![0.0; size] }
    }

    pub(crate) fn size(&self) -> usize {
        self.r.len()
    }

    /// Rows of R, each from its diagonal entry on, with their right-hand sides.
    pub(crate) fn rows(&self) -> impl Iterator<Item = (&[f64; WIDTH], f64)> {
        self.r.iter().zip(self.y.iter().copied())
    }

    /// Adds a row whose first entry is in the column `first`.
    fn add(&mut self, first: usize, mut row: [f64; WIDTH], mut right: f64) {
        for (mine, y) in self.r.iter_mut().zip(&mut self.y).skip(first) {
            if row == [0.0; WIDTH] {
                return;
            }
            if row[0] != 0.0 {
                let length = mine[0].hypot(row[0]);
                let (c, s) = (mine[0] / length, row[0] / length);
                for (a, b) in mine.iter_mut().zip(&mut row) {
                    (*a, *b) = (c * *a + s * *b, c * *b - s * *a);
                }
                (*y, right) = (c * *y + s * right, c * right - s * *y);
            }
            row = [row[1], row[2], row[3], 0.0];
        }
    }

    /// Whether no diagonal entry is numerically zero.
    fn is_regular(&self) -> bool {
        let diagonal = || self.r.iter().map(|row| row[0].abs());
        let largest = diagonal().fold(0.0, f64::max);
        largest.is_finite() && diagonal().all(|d| d > 1e-13 * largest)
    }

    /// Solves R a = y. R must be regular.
    pub(crate) fn solution(&self) -> Vec<f64> {
        let size = self.size();
        let mut a = vec![0.0; size + WIDTH];
        for i in (0..size).rev() {
            let [diagonal, second, third, fourth] = self.r[i];
            let known = second * a[i + 1] + third * a[i + 2] + fourth * a[i + 3];
            a[i] = (self.y[i] - known) / diagonal;
        }
        a.truncate(size);
        a
    }

    /// `bᵀ (RᵀR)⁻¹ b` for a row b that starts in the column `first`. It is the entry of the row on the diagonal of the
    /// hat matrix.
    pub(crate) fn leverage(&self, first: usize, row: &[f64; WIDTH]) -> f64 {
        // Solve Rᵀ z = b from the first non-zero entry of b on.
        let mut pending = *row;
        let mut sum = 0.0;
        for mine in self.r.iter().skip(first) {
            let z = pending[0] / mine[0];
            pending =
                [pending[1] - mine[1] * z, pending[2] - mine[2] * z, pending[3] - mine[3] * z, 0.0];
            sum += z * z;
            // Further terms are below the rounding error of the sum.
            if pending.iter().all(|p| p.abs() < 1e-18 * mine[0].abs()) {
                break;
            }
        }
        sum
    }

    /// Trace of `(RᵀR)⁻¹ SᵀS` for another triangle S of the same size. It needs only the entries of the inverse within
    /// the band. These are computed from the last row to the first (M. F. Hutchinson, F. R. de Hoog, Numer. Math. 47,
    /// 1985).
    fn trace_with(&self, other: &Self) -> f64 {
        let size = self.size();
        // inverse[i][d] = C[i][i + d], with C = (RᵀR)⁻¹. Rows beyond the last row are zero.
        let mut inverse = vec![[0.0; WIDTH]; size + WIDTH];
        for i in (0..size).rev() {
            let r = self.r[i];
            let at = |inverse: &[[f64; WIDTH]], a: usize, b: usize| {
                let (low, high) = if a < b { (a, b) } else { (b, a) };
                inverse[low][high - low]
            };
            for d in (0..WIDTH).rev() {
                let known: f64 = (1..WIDTH).map(|l| r[l] * at(&inverse, i + l, i + d)).sum();
                let unit = if d == 0 { 1.0 / r[0] } else { 0.0 };
                inverse[i][d] = if i + d < size { (unit - known) / r[0] } else { 0.0 };
            }
        }
        let row = |(i, s): (usize, &[f64; WIDTH])| {
            let mut sum = 0.0;
            for a in 0..WIDTH {
                for b in 0..WIDTH {
                    let (low, high) = if a < b { (a, b) } else { (b, a) };
                    let c = inverse.get(i + low).map_or(0.0, |c| c[high - low]);
                    sum += s[a] * s[b] * c;
                }
            }
            sum
        };
        other.r.iter().enumerate().map(row).sum()
    }
}
