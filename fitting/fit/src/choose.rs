//! Kinds of curve, and their automatic choice by the leave-one-out errors of candidates.

use std::fmt;

use volcomp_curve::{Chebyshev, MovingLeastSquares, Table};

use crate::between::Band;
use crate::bspline::{self, Problem};
use crate::fit::{Solution, left_out, rms};
use crate::readings::{self, Target};
use crate::{
    Fit, FitError, Noise, fit_bspline, fit_chebyshev, fit_cubic_table, fit_fourier,
    fit_linear_table, fit_mls, fit_polynomial, mls, polynomial,
};

/// A kind of curve with its settings: a candidate of [`choose`](crate::choose).
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "serde", serde(rename_all = "snake_case"))]
#[non_exhaustive]
pub enum Method {
    /// A polynomial in powers of the argument.
    Polynomial {
        /// The highest power.
        order: usize,
    },
    /// A Chebyshev series.
    Chebyshev {
        /// The order of its last term.
        order: usize,
    },
    /// A Fourier series.
    Fourier {
        /// The number of harmonics.
        order: usize,
        /// Period of the first harmonic, in units of the argument.
        period: f64,
    },
    /// A smoothing B-spline, smoothed by generalised cross-validation.
    BSpline,
    /// Moving least squares: a local polynomial about each place.
    MovingLeastSquares {
        /// Order of the local polynomials.
        order: usize,
        /// Half width of the weight as a share of the range.
        support: f64,
        /// Shape of the weight function.
        shape: f64,
    },
    /// Table of the mean reading of each target, with monotone cubic interpolation.
    CubicTable,
    /// Table of the mean reading of each target, with linear interpolation.
    LinearTable,
}

impl Method {
    /// Fits readings `u` at `x` with this method, over the range of `x`. A polynomial of order 0 also accepts readings
    /// at a single target.
    ///
    /// # Errors
    /// The errors of the fit with this method.
    pub fn fit(self, x: &[f64], u: &[f64]) -> Result<Fit, FitError> {
        readings::check(x, u)?;
        let lower = x.iter().copied().fold(f64::INFINITY, f64::min);
        let upper = x.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        let domain = [lower, upper];
        match self {
            Self::Polynomial { order: 0 } if lower == upper => {
                let targets = readings::checked_targets(x, u, 1, "a curve")?;
                let curve = volcomp_curve::Curve::constant(targets[0][1])?;
                Ok(Fit::new(curve, x, u, std::iter::empty()))
            }
            Self::Polynomial { order } => fit_polynomial(x, u, order, domain),
            Self::Chebyshev { order } => fit_chebyshev(x, u, order, domain),
            Self::Fourier { order, period } => {
                // A curve over the full period is valid everywhere, also beyond the last target.
                let gaps = readings::targets(x, u).len().saturating_sub(1).max(1) as f64;
                let range = upper - lower;
                let domain = if range >= period - 1.5 * range / gaps && range < period {
                    [upper - period, lower + period]
                } else {
                    domain
                };
                fit_fourier(x, u, order, period, domain)
            }
            Self::BSpline => fit_bspline(x, u),
            Self::MovingLeastSquares { order, support, shape } => {
                fit_mls(x, u, order, support, shape)
            }
            Self::CubicTable => fit_cubic_table(x, u),
            Self::LinearTable => fit_linear_table(x, u),
        }
    }

    /// Name of the kind of curve, without its settings.
    pub fn kind(self) -> &'static str {
        match self {
            Self::Polynomial { .. } => "polynomial",
            Self::Chebyshev { .. } => "Chebyshev series",
            Self::Fourier { .. } => "Fourier series",
            Self::BSpline => "smoothing B-spline",
            Self::MovingLeastSquares { .. } => "moving least squares",
            Self::CubicTable => "monotone table",
            Self::LinearTable => "linear table",
        }
    }
}

/// Formats the kind of curve with its settings: `polynomial of order 3`.
impl fmt::Display for Method {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Polynomial { order } | Self::Chebyshev { order } => {
                write!(f, "{} of order {order}", self.kind())
            }
            Self::Fourier { order, .. } => write!(f, "{} of {order} harmonics", self.kind()),
            Self::MovingLeastSquares { order, support, .. } => {
                write!(f, "{} of order {order}, support {support:.3}", self.kind())
            }
            Self::BSpline | Self::CubicTable | Self::LinearTable => f.write_str(self.kind()),
        }
    }
}

#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "serde", serde(default))]
pub struct FitOptions {
    /// Largest valid deviation of a mean reading from the curve, in the unit of the readings. It is ignored if no
    /// candidate meets it.
    pub required_residual: Option<f64>,
    /// Scatter of a single reading. `None`: it is estimated from repeated readings of the same target, if there are
    /// any.
    pub noise: Option<Noise>,
    /// Period of the coordinate (360 for a rotary axis in degrees). If the targets cover at least half of the period,
    /// Fourier series are candidates too. If the targets cover the full period, a curve that would jump at its end is
    /// removed.
    pub period: Option<f64>,
}

/// A candidate with its errors.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Score {
    /// Method of the candidate.
    pub method: Method,
    /// Number of coefficients that the readings determine: the trace of the hat matrix, summed over the sets.
    pub coefficients: f64,
    /// Root mean square error of predicting the mean of each inner target after leaving out all its
    /// readings; infinite if a target cannot be predicted.
    #[cfg_attr(feature = "serde", serde(with = "crate::serialised"))]
    #[cfg_attr(feature = "schema", schemars(with = "Option<f64>"))]
    pub leave_one_out_rms: f64,
    /// Largest deviation of a target's mean reading from the curve.
    pub largest_residual: f64,
    /// Whether the required residual is met; true if none is required.
    pub meets_required: bool,
    /// Whether the residuals are explained by the scatter of the readings; true if the scatter is
    /// unknown.
    pub follows: bool,
    /// Whether the candidate was rejected because its curve leaves the band of the readings between
    /// targets. This is checked only for candidates that would otherwise be chosen.
    pub swings: bool,
}

/// Reason for the choice of a candidate.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[cfg_attr(
    feature = "serde",
    derive(serde::Serialize, serde::Deserialize),
    serde(rename_all = "snake_case")
)]
pub enum Reason {
    /// There are too few targets for any other candidate.
    FewTargets,
    /// The candidate has the smallest leave-one-out error.
    Smallest,
    /// The candidate is the simplest whose leave-one-out error is within one standard error of the smallest.
    Simplest,
}

/// Describes the rule, such as `the simplest of those that predict as well as the best`.
impl fmt::Display for Reason {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::FewTargets => "the targets are too few for anything else",
            Self::Smallest => "smallest leave-one-out error",
            Self::Simplest => "simplest of those that predict as well as the best",
        })
    }
}

/// The chosen method, and all candidates.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Choice {
    /// The method chosen.
    pub method: Method,
    /// Rule by which the method was chosen.
    pub reason: Reason,
    /// All candidates, simplest first.
    pub scores: Vec<Score>,
}

impl Choice {
    pub fn chosen(&self) -> Option<&Score> {
        self.scores.iter().find(|score| score.method == self.method)
    }

    /// Message if the residuals of the chosen curve exceed the scatter of the readings; `None` if they do not. `unit`
    /// is the unit of the readings.
    pub fn not_followed(&self, unit: &str) -> Option<String> {
        let score = self.chosen().filter(|score| !score.follows)?;
        Some(format!(
            "the curve chosen, {}, does not follow the readings: it leaves up to {:.1} {unit} of them, more than the runs scatter, and a curve that follows them misses targets that are left out by far more. Look for an error with a period shorter than the spacing of the targets, and for single targets that are wrong; measure more densely, or state the kind of curve",
            score.method, score.largest_residual
        ))
    }

    /// Candidate with the smallest leave-one-out error of each kind, in the order of the candidates.
    pub fn best_of_kinds(&self) -> Vec<Score> {
        let mut best: Vec<Score> = Vec::new();
        for score in &self.scores {
            match best.iter_mut().find(|b| b.method.kind() == score.method.kind()) {
                Some(known) if score.leave_one_out_rms < known.leave_one_out_rms => *known = *score,
                Some(_) => {}
                None => best.push(*score),
            }
        }
        best
    }
}

#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct AutoFit {
    pub fit: Fit,
    pub choice: Choice,
}

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
    largest_residual: f64,
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
        errors: polynomial::left_out(means, build)?,
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
            (polynomial::nested_chebyshev(targets, order, domain), order + 1)
        }
        Method::Fourier { order, period } => {
            (polynomial::nested_fourier(targets, order, period), 2 * order + 1)
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
    let nested = polynomial::nested_chebyshev(targets, order, domain);
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
    let nested = polynomial::nested_fourier(targets, highest, period);
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

/// Candidates whose leave-one-out RMS exceeds this multiple of the smallest RMS are rejected. Such a candidate may
/// follow the readings better at the targets, but is far worse between them.
const FAR: f64 = 2.0;
/// A simpler candidate replaces the best candidate only if its leave-one-out RMS is at most this multiple of the best
/// RMS. With few targets the rule of one standard error alone would be too generous. Of the values 1.0 to 1.25, this
/// value comes closest to the true curves of `examples/automatic.rs`.
const AT_MOST: f64 = 1.1;

/// Chooses a curve for readings `u` at `x` by [`choose`], and fits it.
///
/// # Errors
/// Same as [`choose`].
pub fn fit_auto(x: &[f64], u: &[f64], options: &FitOptions) -> Result<AutoFit, FitError> {
    let (choice, mut fits) = choose_and_fit(&[(x, u)], options)?;
    // There is one set, and so one fit.
    let fit = fits.pop().ok_or(FitError::Undetermined { coefficients: 1 })?;
    Ok(AutoFit { fit, choice })
}

/// Chooses one method for several sets of readings, such as both directions of a measured line. The choice is by
/// leave-one-out errors: each target is left out with all its readings, and predicted from the other targets.
///
/// Candidates are:
///
/// - Polynomials in powers up to order 8, and Chebyshev series up to order 15. The order is also at most twice the
///   square root of the number of targets, because beyond this order a polynomial through evenly spaced targets
///   oscillates at its ends, and at most the number of targets less 2.
/// - The two tables, which need 3 targets, the smoothing B-spline, which needs 4, and moving least squares of shape 3
///   in a few settings, which need 7.
/// - With a period, Fourier series if the targets cover at least half of the period.
///
/// If any candidates meet the required residual, only these are considered. The rules are:
///
/// 1. Candidates whose leave-one-out RMS is more than twice the smallest are rejected. Then candidates whose residuals
///    exceed the scatter are rejected, unless none would remain. This is a statistical test, which one in a hundred
///    true curves fails. The scatter is from repeated readings of the same target or from the options; if it is
///    unknown, all candidates remain. Leave-one-out errors cannot separate scatter from a real error at a single
///    target, but several runs can.
/// 2. The best candidate has the smallest leave-one-out RMS over the inner targets. The first and the last target of a
///    set are not left out, because the curve is never evaluated beyond them, and some kinds of curve cannot predict
///    them.
/// 3. A candidate counts as good as the best under two conditions. First, its squared leave-one-out errors, compared
///    target by target, exceed those of the best by at most one standard error on average. Second, its leave-one-out
///    RMS is at most 1.1 times that of the best. The simplest such candidate is chosen, which is the one with the
///    fewest coefficients (trace of the hat matrix).
/// 4. If the curve of the chosen candidate leaves the range of the mean readings between targets by more than a quarter
///    of its height, the candidate is rejected, and the rules are applied again to the others.
///
/// One target gives a constant, two targets give a line. Three targets give a line, or a table if the residuals of the
/// line exceed the scatter of the readings. With a period and targets that cover the full period, the only candidates
/// are a constant, Fourier series and, if the last reading equals the first, tables, because no other kind is periodic.
///
/// # Errors
/// Unequal lengths, numbers that are not finite, no set, a set without a reading, or a required residual or period that
/// is not positive.
pub fn choose(sets: &[(&[f64], &[f64])], options: &FitOptions) -> Result<Choice, FitError> {
    choose_and_fit(sets, options).map(|(choice, _)| choice)
}

/// Chooses one method for several sets of readings by [`choose`]. Also returns the fit of each set, which was computed
/// for the choice.
///
/// # Errors
///
/// Same as [`choose`].
pub fn choose_and_fit(
    sets: &[(&[f64], &[f64])],
    options: &FitOptions,
) -> Result<(Choice, Vec<Fit>), FitError> {
    readings::check_required(options.required_residual)?;
    if let Some(value) = options.period.filter(|p| !(*p > 0.0 && p.is_finite())) {
        return Err(FitError::Parameter {
            what: "period",
            value,
            expected: "a positive finite number",
        });
    }
    let mut together: Option<Vec<Candidate>> = None;
    let mut magnitude = 0.0_f64;
    let (mut bands, mut all_targets) = (Vec::new(), Vec::new());
    for (x, u) in sets {
        readings::check(x, u)?;
        let targets = readings::counted(x, u);
        magnitude = magnitude.max(readings::magnitude(targets.iter().map(|t| t.mean)));
        let own = candidates(&targets, options)?;
        together = Some(match together {
            None => own,
            Some(before) => {
                before.into_iter().filter_map(|candidate| candidate.with(&own)).collect()
            }
        });
        bands.push(Band::of(&targets));
        all_targets.extend(targets);
    }
    let noise = options.noise.or_else(|| Noise::pooled(&all_targets));
    let mut candidates = together.unwrap_or_default();
    candidates.sort_by(|a, b| {
        let rounded = |c: &Candidate| (c.coefficients * 1e6).round();
        rounded(a).total_cmp(&rounded(b))
    });
    let meets = |c: &Candidate| options.required_residual.is_none_or(|r| c.largest_residual <= r);
    let follows = |c: &Candidate| noise.is_none_or(|n| n.explains(c.squares, c.freedom));
    let mut swings = vec![false; candidates.len()];
    let mut refusal = FitError::TooFewTargets { purpose: "a curve", found: 0, needed: 1 };
    loop {
        let left: Vec<&Candidate> = candidates
            .iter()
            .zip(&swings)
            .filter_map(|(candidate, swings)| (!swings).then_some(candidate))
            .collect();
        let any = left.iter().any(|c| meets(c));
        let left: Vec<&Candidate> = left.into_iter().filter(|c| !any || meets(c)).collect();
        let Some((taken, reason)) = simplest(&left, &follows, magnitude) else {
            return Err(refusal);
        };
        let method = taken.method;
        let place = candidates.iter().position(|c| c.method == method);
        let mut made = taken.moving.iter();
        let fit = |(x, u): &(&[f64], &[f64])| match made.next() {
            Some(moving) => Ok(moving.clone().fit(x, u)),
            None => method.fit(x, u),
        };
        let fits: Result<Vec<Fit>, FitError> = sets.iter().map(fit).collect();
        let stays = match fits {
            Ok(mut fits) => {
                let mut pairs = fits.iter().zip(&bands);
                let holds = pairs.all(|(fit, band)| band.holds(&fit.curve));
                // The last candidate is kept even if it leaves the range.
                if holds || left.len() == 1 {
                    for fit in &mut fits {
                        fit.meets_required = options.required_residual.map(|_| any);
                    }
                    Some(fits)
                } else {
                    None
                }
            }
            Err(error) => {
                refusal = error;
                None
            }
        };
        if let Some(fits) = stays {
            let scores = candidates.iter().zip(&swings).map(|(c, &swings)| Score {
                method: c.method,
                coefficients: c.coefficients,
                leave_one_out_rms: c.leave_one_out_rms(),
                largest_residual: c.largest_residual,
                meets_required: meets(c),
                follows: follows(c),
                swings,
            });
            let choice = Choice { method, reason, scores: scores.collect() };
            return Ok((choice, fits));
        }
        // The method is from the candidates, so the index exists.
        swings[place.unwrap_or_default()] = true;
    }
}

/// Applies rules 1 to 3 of [`choose`] to candidates that are sorted by their number of coefficients.
fn simplest<'a>(
    candidates: &[&'a Candidate],
    follows: &dyn Fn(&Candidate) -> bool,
    magnitude: f64,
) -> Option<(&'a Candidate, Reason)> {
    let rounding = 1e-9 * magnitude;
    let first = *candidates.first()?;
    // Without an inner target there are no errors to compare. One target gives the constant, two give the line.
    if first.errors.is_empty() {
        let most = candidates
            .iter()
            .copied()
            .reduce(|most, c| if c.coefficients > most.coefficients + 0.5 { c } else { most });
        return Some((most?, Reason::FewTargets));
    }
    let least = |of: &mut dyn Iterator<Item = &&'a Candidate>| {
        of.map(|c| c.leave_one_out_rms()).fold(f64::INFINITY, f64::min)
    };
    let smallest = least(&mut candidates.iter());
    let near = |c: &&Candidate| c.leave_one_out_rms() <= FAR * smallest + rounding;
    let near: Vec<&Candidate> = candidates.iter().copied().filter(near).collect();
    let following = near.iter().copied().filter(|c| follows(c));
    let following: Vec<&Candidate> = following.collect();
    let candidates = if following.is_empty() { &near } else { &following };
    let smallest = least(&mut candidates.iter());
    let best = *candidates.iter().find(|c| c.leave_one_out_rms() <= smallest + rounding)?;
    let as_good = |c: &&&Candidate| {
        c.method == best.method
            || c.leave_one_out_rms() <= AT_MOST * smallest + rounding && within_one_error(c, best)
    };
    let taken = *candidates.iter().find(as_good)?;
    let reason = if taken.method == best.method { Reason::Smallest } else { Reason::Simplest };
    Some((taken, reason))
}

/// Whether the squared errors of a candidate exceed those of the best on average by at most one standard error of the
/// mean.
fn within_one_error(candidate: &Candidate, best: &Candidate) -> bool {
    let pairs = candidate.errors.iter().zip(&best.errors);
    let differences: Vec<f64> = pairs.map(|(own, best)| own * own - best * best).collect();
    let count = differences.len() as f64;
    let mean = differences.iter().sum::<f64>() / count;
    let squares: f64 = differences.iter().map(|d| (d - mean).powi(2)).sum();
    let error = if count > 1.0 { (squares / (count - 1.0) / count).sqrt() } else { 0.0 };
    mean <= error
}
