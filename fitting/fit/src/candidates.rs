//! Candidates of the automatic choice, with their leave-one-out errors.

use volcomp_curve::{Chebyshev, MovingLeastSquares, Table};

use crate::bspline::{self, Problem};
use crate::fit::{left_out, rms};
use crate::least_squares::Solution;
use crate::readings::Target;
use crate::{FitError, FitOptions, Method, fourier, mls, polynomial, readings, table};

const SHAPE: f64 = 3.0;
const MLS_TARGETS: usize = 7;
/// Highest order of a polynomial in powers.
const HIGHEST_POWER: usize = 8;
/// Highest order of a Chebyshev series.
const HIGHEST_ORDER: usize = 15;
/// Highest number of harmonics of a Fourier series.
const HIGHEST_HARMONIC: usize = 20;
/// Orders and supports of moving least squares that are tried: the published pair, and stiffer and looser pairs. The
/// list is deliberately short. Over the whole grid of the automatic mode, the leave-one-out error would select settings
/// that follow the scatter of the readings, which costs the demonstration calibration a third of its accuracy.
const MLS_TRIED: [(usize, f64); 4] = [(4, 1.0 / 3.0), (3, 0.3), (2, 0.25), (4, 0.5)];
/// Further pairs of order and half width, in gaps between targets. They are tried if the half width is less than the
/// smallest support of `MLS_TRIED`.
const MLS_NEAR: [(usize, u32); 2] = [(2, 6), (3, 12)];
/// Maximum number of node evaluations over all targets for one setting of moving least squares. Above this number the
/// setting is skipped, because the spline gives the same result in a fraction of the time.
const MAX_EVALUATIONS: f64 = 400_000.0;
/// Minimum fraction of the period that the targets must cover to determine a Fourier series.
const SHARE_OF_PERIOD: f64 = 0.5;

pub(crate) struct Candidate {
    pub(crate) method: Method,
    /// Number of coefficients, which is the trace of the hat matrix, summed over the sets.
    pub(crate) coefficients: f64,
    /// Leave-one-out errors of the inner targets.
    pub(crate) errors: Vec<f64>,
    pub(crate) largest_residual: f64,
    /// Sum of squared residuals, each weighted by the number of readings.
    pub(crate) squares: f64,
    /// Degrees of freedom of `squares`.
    pub(crate) freedom: f64,
    /// Diagonal of the hat matrix for the targets of the first set.
    pub(crate) leverages: Vec<f64>,
    /// Moving least-squares curve of each set; empty for other methods. The curves are kept, because they are slow to
    /// evaluate and the fit needs them again.
    pub(crate) moving: Vec<mls::Candidate>,
}

impl Candidate {
    pub(crate) fn leave_one_out_rms(&self) -> f64 {
        if self.errors.is_empty() { f64::INFINITY } else { rms(self.errors.iter().copied()) }
    }

    /// Combines this candidate with the candidate of the same method for another set; `None` if the other set lacks the
    /// method.
    pub(crate) fn with(mut self, others: &[Self]) -> Option<Self> {
        let same = others.iter().find(|other| other.method == self.method)?;
        self.coefficients += same.coefficients;
        self.errors.extend(&same.errors);
        self.largest_residual = self.largest_residual.max(same.largest_residual);
        self.squares += same.squares;
        self.freedom += same.freedom;
        self.moving.extend(same.moving.iter().cloned());
        Some(self)
    }

    /// Candidate of a fit whose curve is a linear function of the mean readings.
    fn linear(method: Method, targets: &[Target], residuals: &[f64], leverages: &[f64]) -> Self {
        let errors: Vec<f64> =
            residuals.iter().zip(leverages).map(|(&e, &h)| left_out(e, h)).collect();
        let coefficients: f64 = leverages.iter().sum();
        let squares = residuals.iter().zip(targets).map(|(e, t)| t.count * e * e);
        Self {
            method,
            coefficients,
            squares: squares.sum(),
            freedom: targets.len() as f64 - coefficients,
            leverages: leverages.to_vec(),
            errors: inner(&errors),
            largest_residual: readings::magnitude(residuals.iter().copied()),
            moving: Vec::new(),
        }
    }

    fn least_squares(method: Method, targets: &[Target], solution: &Solution) -> Self {
        Self::linear(method, targets, &solution.residuals, &solution.leverages)
    }
}

fn inner(errors: &[f64]) -> Vec<f64> {
    let last = errors.len().saturating_sub(1);
    errors.get(1..last).unwrap_or_default().to_vec()
}

/// All candidates that the targets (at least one) can determine, by ascending number of coefficients. Ties are in the
/// order of [`Method`].
pub(crate) fn candidates(
    targets: &[Target],
    options: &FitOptions,
) -> Result<Vec<Candidate>, FitError> {
    let (Some(first), Some(last)) = (targets.first(), targets.last()) else {
        return Err(FitError::TooFewTargets { purpose: "a curve", found: 0, needed: 1 });
    };
    let constant = |targets: f64| Candidate {
        method: Method::Polynomial { order: 0 },
        coefficients: targets,
        errors: Vec::new(),
        largest_residual: 0.0,
        squares: 0.0,
        freedom: 0.0,
        leverages: vec![1.0],
        moving: Vec::new(),
    };
    if targets.len() == 1 {
        return Ok(vec![constant(1.0)]);
    }
    let domain = [first.x, last.x];
    let range = last.x - first.x;
    // If no curve can be built over this range, the fit reports the reason.
    Chebyshev::new(vec![0.0], domain)?;
    let means: Vec<[f64; 2]> = targets.iter().map(|t| [t.x, t.mean]).collect();
    let mut all = Vec::new();
    let count = targets.len();
    let goes_round = options.period.is_some_and(|period| {
        // The gap from the last target to the first target of the next turn counts like the other gaps.
        let gap = range / (count - 1) as f64;
        count > 2 && range + gap >= period * (1.0 - HAIR)
    });
    let of_two = count == 2;
    let order = (4 * count).isqrt().min(HIGHEST_ORDER).min(if of_two { 1 } else { count - 2 });
    let highest = if goes_round { 0 } else { order };
    polynomials(targets, highest, domain, &mut all)?;
    if count == 3 && !goes_round {
        // A single inner target cannot distinguish a constant from a line.
        all.retain(|c| c.coefficients > 1.5);
    }
    if of_two {
        return Ok(all);
    }
    if let Some(period) = options.period
        && range >= SHARE_OF_PERIOD * period
    {
        harmonics(targets, period, &mut all);
    }
    let closed = options
        .period
        .is_some_and(|period| (range - period).abs() <= 1e-9 * period && first.mean == last.mean);
    if !goes_round {
        if count >= bspline::MIN_TARGETS {
            let problem = Problem::new(&means);
            if let Ok(spline) = problem.cross_validated().and_then(|log| problem.smoothed(log)) {
                all.push(Candidate::linear(
                    Method::BSpline,
                    targets,
                    &spline.residuals,
                    &spline.leverages,
                ));
            }
        }
        if count >= MLS_TARGETS {
            moving(targets, &means, &mut all);
        }
    }
    if !goes_round || closed {
        for method in [Method::CubicTable, Method::LinearTable] {
            all.push(through_means(method, &means)?);
        }
    }
    Ok(all)
}

/// Rounding tolerance of targets, as a fraction of the period.
const HAIR: f64 = 1e-9;

fn through_means(method: Method, means: &[[f64; 2]]) -> Result<Candidate, FitError> {
    let build = if method == Method::CubicTable { Table::cubic } else { Table::linear };
    Ok(Candidate {
        method,
        coefficients: means.len() as f64,
        errors: table::left_out(means, build)?,
        largest_residual: 0.0,
        squares: 0.0,
        freedom: 0.0,
        leverages: vec![1.0; means.len()],
        moving: Vec::new(),
    })
}

/// Errors of one method over the targets of one set. The method need not be a candidate of the automatic choice.
pub(crate) fn of_method(method: Method, targets: &[Target]) -> Result<Candidate, FitError> {
    let means: Vec<[f64; 2]> = targets.iter().map(|t| [t.x, t.mean]).collect();
    let (Some(first), Some(last)) = (targets.first(), targets.last()) else {
        return Err(FitError::Undetermined { coefficients: 1 });
    };
    let undetermined = |coefficients| FitError::Undetermined { coefficients };
    let (nested, columns) = match method {
        Method::Polynomial { order } | Method::Chebyshev { order } => {
            let half = if first.x < last.x { 0.0 } else { 1.0 };
            let domain = [first.x - half, last.x + half];
            (polynomial::nested(targets, order, domain), order + 1)
        }
        Method::Fourier { order, period } => {
            (fourier::nested(targets, order, period), 2 * order + 1)
        }
        Method::BSpline => {
            readings::require(&means, bspline::MIN_TARGETS, "a smoothing spline")?;
            let problem = Problem::new(&means);
            let spline = problem.smoothed(problem.cross_validated()?)?;
            let (left, leverages) = (&spline.residuals, &spline.leverages);
            return Ok(Candidate::linear(method, targets, left, leverages));
        }
        Method::MovingLeastSquares { order, support, shape } => {
            let curve = MovingLeastSquares::new(means, order, support, shape)?;
            return Ok(moved(method, targets, curve));
        }
        Method::CubicTable | Method::LinearTable => return through_means(method, &means),
    };
    let solution = nested.solution(columns).ok_or(undetermined(columns))?;
    Ok(Candidate::least_squares(method, targets, &solution))
}

fn moved(method: Method, targets: &[Target], curve: MovingLeastSquares) -> Candidate {
    let moving = mls::Candidate::of(curve);
    Candidate {
        moving: vec![moving.clone()],
        ..Candidate::linear(method, targets, &moving.residuals, &moving.influences)
    }
}

/// Adds polynomials up to `order`, and Chebyshev series, which are the same functions but stay accurate where powers
/// lose digits.
fn polynomials(
    targets: &[Target],
    order: usize,
    domain: [f64; 2],
    all: &mut Vec<Candidate>,
) -> Result<(), FitError> {
    let nested = polynomial::nested(targets, order, domain);
    let magnitude = readings::magnitude(targets.iter().map(|t| t.mean));
    let mut series = Vec::new();
    for order in 0..=order {
        // Higher orders are worse conditioned. The lower orders stay valid.
        let Some(solution) = nested.solution(order + 1) else {
            break;
        };
        let curve = Chebyshev::new(solution.coefficients.clone(), domain)?;
        let candidate = |method| Candidate::least_squares(method, targets, &solution);
        if order <= HIGHEST_POWER && polynomial::in_powers(&curve, magnitude).is_ok() {
            all.push(candidate(Method::Polynomial { order }));
        }
        series.push(candidate(Method::Chebyshev { order }));
    }
    all.extend(series);
    Ok(())
}

fn harmonics(targets: &[Target], period: f64, all: &mut Vec<Candidate>) {
    let highest = ((targets.len() - 3) / 2).min(HIGHEST_HARMONIC);
    let nested = fourier::nested(targets, highest, period);
    for order in 1..=highest {
        let Some(solution) = nested.solution(2 * order + 1) else {
            break;
        };
        let method = Method::Fourier { order, period };
        all.push(Candidate::least_squares(method, targets, &solution));
    }
}

fn moving(targets: &[Target], means: &[[f64; 2]], all: &mut Vec<Candidate>) {
    let count = means.len() as f64;
    let near = MLS_NEAR.map(|(order, gaps)| (order, f64::from(gaps) / (count - 1.0)));
    let least = MLS_TRIED.iter().map(|t| t.1).fold(f64::INFINITY, f64::min);
    let near = near.into_iter().filter(|(_, support)| *support < least);
    for (order, support) in MLS_TRIED.into_iter().chain(near) {
        if count * (2.0 * support).min(1.0) * count > MAX_EVALUATIONS {
            continue;
        }
        // The targets do not determine this setting.
        let Ok(curve) = MovingLeastSquares::new(means.to_vec(), order, support, SHAPE) else {
            continue;
        };
        if !curve.has_nodes_everywhere(order + 2) {
            continue;
        }
        let method = Method::MovingLeastSquares { order, support, shape: SHAPE };
        all.push(moved(method, targets, curve));
    }
}
