use volcomp_curve::BSpline;

use crate::between::{PARTS_OF_GAP, band_of};
use crate::fit::left_out;
use crate::triangle::{Triangle, WIDTH};
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
