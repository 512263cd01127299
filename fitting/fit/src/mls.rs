use nalgebra::DMatrix;
use volcomp_curve::MovingLeastSquares;

use crate::fit::{Judged, left_out, rms};
use crate::{Fit, FitError, readings};

/// Orders of moving least squares that [`scan_mls`] and [`fit_mls_auto`] try.
pub const MLS_ORDERS: std::ops::RangeInclusive<usize> = 1..=6;
/// Supports tried, in twentieths of the range.
const SUPPORTS: std::ops::RangeInclusive<u32> = 3..=20;
/// The name of the fit in messages about too few targets.
const PURPOSE: &str = "moving least squares";
const OF_ORDER: &str = "a curve of moving least squares of this order";
/// Widest support, as a share of the range: above it every target has nearly the same weight, and the curve is a single polynomial.
const WIDEST: f64 = 1.0;
/// Published order and support for long gantries, tried in addition to the grid.
const PUBLISHED: (usize, f64) = (4, 1.0 / 3.0);
/// Smallest admissible ratio of the smallest to the largest singular value of the weighted design matrix of a candidate.
const MIN_CONDITION: f64 = 1e-10;

/// Fits moving least squares of the order, the support (a share of the range of the targets, above 0 and at most 1) and
/// the shape of the weight, through the mean reading of each target.
///
/// # Errors
/// Unequal lengths, numbers that are not finite, a support above 1, fewer than order + 2 targets, which no such support
/// carries, or parameters that [`MovingLeastSquares::new`] refuses.
pub fn fit_mls(
    x: &[f64],
    u: &[f64],
    order: usize,
    support: f64,
    shape: f64,
) -> Result<Fit, FitError> {
    if support > WIDEST {
        return Err(FitError::Parameter {
            what: "support",
            value: support,
            expected: "a share of the measured range, above 0 and at most 1",
        });
    }
    let needed = order.saturating_add(2);
    let targets = readings::checked_targets(x, u, needed, OF_ORDER)?;
    Ok(Candidate::new(targets, order, support, shape)?.fit(x, u))
}

/// An order and a support that the automatic mode of moving least squares tries, and how well they do.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct MlsTrial {
    /// The order of the local polynomial.
    pub order: usize,
    /// The half width of the weight as a share of the range.
    pub support: f64,
    /// Largest deviation of a target's mean reading from the curve.
    pub max_residual: f64,
    /// Root mean square of the errors with which the curve predicts a target that is left out.
    #[cfg_attr(feature = "serde", serde(with = "crate::serialised"))]
    #[cfg_attr(feature = "schema", schemars(with = "Option<f64>"))]
    pub leave_one_out_rms: f64,
}

/// Settings among which [`fit_mls_auto`] chooses, by ascending order, then by descending support. Settings that the targets cannot carry are omitted.
///
/// # Errors
/// Same as [`fit_mls_auto`].
pub fn scan_mls(x: &[f64], u: &[f64], shape: f64) -> Result<Vec<MlsTrial>, FitError> {
    let targets = scanned(x, u, shape)?;
    let trial = |candidate: Candidate| MlsTrial {
        order: candidate.curve.order(),
        support: candidate.curve.support(),
        max_residual: candidate.max_residual,
        leave_one_out_rms: candidate.leave_one_out_rms,
    };
    let trials: Vec<MlsTrial> = candidates(&targets, shape).map(trial).collect();
    if trials.is_empty() {
        return Err(FitError::NoCandidate {
            targets: targets.len(),
            shape,
        });
    }
    Ok(trials)
}

/// Fits moving least squares in the automatic mode.
///
/// Orders 1 to 6 and supports 0.15 to 1 in steps of 0.05 are tried, and the published pair of order 4 and support 1/3.
/// Candidates are those with at least order + 2 nodes of positive weight everywhere in the range, so that a node
/// left out still leaves order + 1, and with a weighted design matrix in the local basis whose smallest singular value is at
/// least 1e-10 of the largest. Of the candidates that meet the required
/// residual (largest deviation of a target's mean reading) the one with the smallest leave-one-out
/// RMS is taken, ties to the lower order, then to the wider support. When none meets it,
/// [`Fit::meets_required`] is false and the smallest leave-one-out RMS of all decides.
///
/// # Errors
/// Same as [`fit_mls`], a required residual that is not positive, and [`FitError::NoCandidate`] when the targets are
/// too few or too uneven for any candidate.
pub fn fit_mls_auto(
    x: &[f64],
    u: &[f64],
    shape: f64,
    required_residual: Option<f64>,
) -> Result<Fit, FitError> {
    readings::check_required(required_residual)?;
    let targets = scanned(x, u, shape)?;
    let judged = |c: &Candidate| Judged {
        meets: required_residual.is_none_or(|r| c.max_residual <= r),
        leave_one_out_rms: c.leave_one_out_rms,
    };
    let magnitude = readings::magnitude(targets.iter().map(|t| t[1]));
    let mut best: Option<Candidate> = None;
    for candidate in candidates(&targets, shape) {
        let better = judged(&candidate).beats(best.as_ref().map(judged), magnitude);
        if better {
            best = Some(candidate);
        }
    }
    let best = best.ok_or(FitError::NoCandidate {
        targets: targets.len(),
        shape,
    })?;
    let met = required_residual.map(|_| judged(&best).meets);
    Ok(Fit {
        meets_required: met,
        ..best.fit(x, u)
    })
}

/// Order and support with which moving least squares follow several sets of readings best, such as both directions of a measured line. The settings
/// tried and the treatment of the required residual are those of [`fit_mls_auto`].
///
/// One setting is chosen for all sets, by the leave-one-out RMS over all of them: more readings make the choice less accidental. The first and the
/// last target of each set are not left out: the curve is never evaluated beyond them, and they alone would decide against a high order that misses
/// them.
///
/// # Errors
/// Same as [`fit_mls_auto`]; no set.
pub fn choose_mls(
    sets: &[(&[f64], &[f64])],
    shape: f64,
    required_residual: Option<f64>,
) -> Result<(usize, f64), FitError> {
    readings::check_required(required_residual)?;
    let mut tried: Option<Vec<PooledErrors>> = None;
    let mut magnitude = 0.0_f64;
    for (x, u) in sets {
        let targets = scanned(x, u, shape)?;
        magnitude = magnitude.max(readings::magnitude(targets.iter().map(|t| t[1])));
        let own = candidates(&targets, shape).map(|candidate| PooledErrors::of(&candidate));
        tried = Some(match tried {
            None => own.collect(),
            Some(before) => {
                let own: Vec<PooledErrors> = own.collect();
                let with = |all: PooledErrors| all.with(&own);
                before.into_iter().filter_map(with).collect()
            }
        });
    }
    let mut best: Option<(PooledErrors, Judged)> = None;
    for trial in tried.unwrap_or_default() {
        let judged = Judged {
            meets: required_residual.is_none_or(|r| trial.max_residual <= r),
            leave_one_out_rms: (trial.squares / trial.targets).sqrt(),
        };
        if judged.beats(best.map(|(_, judged)| judged), magnitude) {
            best = Some((trial, judged));
        }
    }
    let none = FitError::NoCandidate {
        targets: sets.iter().map(|(x, _)| x.len()).min().unwrap_or_default(),
        shape,
    };
    best.map(|(trial, _)| (trial.order, trial.support))
        .ok_or(none)
}

/// Setting with its errors over several sets of readings.
#[derive(Clone, Copy)]
struct PooledErrors {
    order: usize,
    support: f64,
    max_residual: f64,
    /// Sum of squared leave-one-out errors, and the number of targets left out.
    squares: f64,
    targets: f64,
}

impl PooledErrors {
    /// Targets at the ends are not left out: the curve is never evaluated beyond them, and the error of a high order there would dominate.
    fn of(candidate: &Candidate) -> Self {
        let curve = &candidate.curve;
        let inner = 1..curve.nodes().len().saturating_sub(1);
        let missed = inner
            .clone()
            .map(|i| left_out(candidate.residuals[i], candidate.influences[i]));
        Self {
            order: curve.order(),
            support: curve.support(),
            max_residual: candidate.max_residual,
            squares: missed.map(|missed| missed * missed).sum(),
            targets: inner.len() as f64,
        }
    }

    /// Combines this setting with the same one for another set; `None` if that set has none.
    fn with(self, others: &[Self]) -> Option<Self> {
        let mut others = others.iter();
        let same = others.find(|other| {
            other.order == self.order && (other.support - self.support).abs() < 1e-9
        })?;
        Some(Self {
            max_residual: self.max_residual.max(same.max_residual),
            squares: self.squares + same.squares,
            targets: self.targets + same.targets,
            ..self
        })
    }
}

/// Checked targets of a scan over orders and supports.
fn scanned(x: &[f64], u: &[f64], shape: f64) -> Result<Vec<[f64; 2]>, FitError> {
    let targets = readings::checked_targets(x, u, 3, PURPOSE)?;
    // Report an invalid shape here, before it is mistaken for a lack of candidates.
    MovingLeastSquares::new(targets.clone(), 1, 2.0 * targets.len() as f64, shape)?;
    Ok(targets)
}

/// All candidates that the targets can carry, by ascending order, then by descending support.
fn candidates(targets: &[[f64; 2]], shape: f64) -> impl Iterator<Item = Candidate> {
    MLS_ORDERS.flat_map(move |order| {
        let supports = SUPPORTS.rev().map(|step| f64::from(step) / 20.0);
        let mut supports: Vec<f64> = supports.collect();
        let (published_order, published_support) = PUBLISHED;
        if order == published_order {
            supports.push(published_support);
            supports.sort_by(|a, b| b.total_cmp(a));
        }
        supports.into_iter().filter_map(move |support| {
            let curve = MovingLeastSquares::new(targets.to_vec(), order, support, shape).ok()?;
            carries(&curve).then(|| Candidate::of(curve))
        })
    })
}

#[derive(Clone)]
pub(crate) struct Candidate {
    curve: MovingLeastSquares,
    /// Each target with the value of the curve there.
    values: Vec<[f64; 2]>,
    /// Residual of each target, and its leverage: the weight of the reading in the curve there.
    pub(crate) residuals: Vec<f64>,
    pub(crate) influences: Vec<f64>,
    leave_one_out_rms: f64,
    /// Largest deviation of a target's mean reading from the curve.
    max_residual: f64,
}

impl Candidate {
    fn new(
        targets: Vec<[f64; 2]>,
        order: usize,
        support: f64,
        shape: f64,
    ) -> Result<Self, FitError> {
        let curve = MovingLeastSquares::new(targets, order, support, shape)?;
        Ok(Self::of(curve))
    }

    pub(crate) fn of(curve: MovingLeastSquares) -> Self {
        let nodes = curve.nodes().iter().enumerate();
        let found = nodes.map(|(i, &[x, _])| {
            let (value, influence) = curve.value_and_influence(x, i);
            ([x, value], influence)
        });
        let (values, influences): (Vec<[f64; 2]>, Vec<f64>) = found.unzip();
        let read = curve.nodes().iter().zip(&values);
        let residuals: Vec<f64> = read.map(|([_, u], [_, value])| u - value).collect();
        let errors = residuals.iter().zip(&influences);
        let leave_one_out_rms = rms(errors.map(|(&e, &influence)| left_out(e, influence)));
        let max_residual = readings::magnitude(residuals.iter().copied());
        Self {
            curve,
            values,
            residuals,
            influences,
            leave_one_out_rms,
            max_residual,
        }
    }

    /// Fit to the readings that the targets were averaged from.
    pub(crate) fn fit(self, x: &[f64], u: &[f64]) -> Fit {
        let errors = self.residuals.iter().zip(&self.influences);
        let missed = errors.map(|(&e, &influence)| left_out(e, influence));
        Fit::of_values(self.curve.into(), &self.values, x, u, missed.enumerate())
    }
}

/// Whether the targets can carry the curve. Everywhere in the range there must be enough nodes with a positive weight that one more than the number
/// of coefficients remains when one is left out, and the least-squares problem must not be nearly singular. It is checked in the worst places: at the
/// ends, at nodes, half-way between them, and where a node enters the support.
fn carries(curve: &MovingLeastSquares) -> bool {
    if !curve.has_nodes_everywhere(curve.order() + 2) {
        return false;
    }
    let ([lower, upper], h) = (curve.domain(), curve.half_width());
    let nodes = curve.nodes();
    let middles = nodes.windows(2).map(|n| f64::midpoint(n[0][0], n[1][0]));
    let mut places = [lower, upper]
        .into_iter()
        .chain(nodes.iter().flat_map(|n| [n[0], n[0] - h, n[0] + h]))
        .chain(middles)
        .filter(|x| (lower..=upper).contains(x));
    places.all(|x| reciprocal_condition(&curve.design(x)) >= MIN_CONDITION)
}

/// Ratio of the smallest to the largest singular value of a matrix given by rows; 0 if it is singular.
fn reciprocal_condition(rows: &[Vec<f64>]) -> f64 {
    let columns = rows.first().map_or(0, Vec::len);
    let matrix = DMatrix::from_fn(rows.len(), columns, |row, column| rows[row][column]);
    if matrix.nrows() < columns || columns == 0 {
        return 0.0;
    }
    let values = matrix.singular_values();
    // The largest is positive: the nearest node has the weight 1 in the first column, up to a factor.
    values.min() / values.max()
}
