use nalgebra::DMatrix;
use volcomp_curve::MovingLeastSquares;

use crate::fit::{Judged, left_out, rms};
use crate::{Fit, FitError, readings};

/// Orders of moving least squares that [`scan_mls`] and [`fit_mls_auto`] try.
pub const MLS_ORDERS: std::ops::RangeInclusive<usize> = 1..=6;
/// Supports that are tried, in twentieths of the range of the targets.
const SUPPORTS: std::ops::RangeInclusive<u32> = 3..=20;
const PURPOSE: &str = "moving least squares";
const OF_ORDER: &str = "a curve of moving least squares of this order";
/// Widest support, as a fraction of the range. With a wider support every target has nearly the same weight, and the
/// curve is a single polynomial.
const WIDEST: f64 = 1.0;
/// Published order and support for long gantries. This pair is tried in addition to the grid.
const PUBLISHED: (usize, f64) = (4, 1.0 / 3.0);
/// Minimum ratio of the smallest to the largest singular value of a candidate's weighted design matrix.
const MIN_CONDITION: f64 = 1e-10;

/// Fits moving least squares through the mean reading of each target. `support` is a fraction of the range of the
/// targets, above 0 and at most 1, and `shape` is the shape of the weight.
///
/// # Errors
/// Unequal lengths, numbers that are not finite, a support above 1, fewer than order + 2 targets, or parameters that
/// [`MovingLeastSquares::new`] rejects.
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

/// An order and a support of the automatic mode of moving least squares, with its errors.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct MlsTrial {
    /// Order of the local polynomials.
    pub order: usize,
    /// Half width of the weight as a fraction of the range of the targets.
    pub support: f64,
    /// Largest deviation of a target's mean reading from the curve.
    pub max_residual: f64,
    /// Root mean square error of predicting a target that is left out.
    #[cfg_attr(feature = "serde", serde(with = "crate::serialised"))]
    #[cfg_attr(feature = "schema", schemars(with = "Option<f64>"))]
    pub leave_one_out_rms: f64,
}

/// Settings among which [`fit_mls_auto`] chooses, by ascending order, then by descending support. Settings that the
/// targets do not determine are omitted.
///
/// # Errors
///
/// Same as [`fit_mls_auto`].
pub fn scan_mls(x: &[f64], u: &[f64], shape: f64) -> Result<Vec<MlsTrial>, FitError> {
    let targets = scanned(x, u, shape)?;
    let trials: Vec<MlsTrial> = settings(&targets, shape, targets.len())
        .iter()
        .map(|setting| MlsTrial {
            order: setting.order,
            support: setting.support,
            max_residual: setting.max_residual,
            leave_one_out_rms: setting.leave_one_out_rms(),
        })
        .collect();
    if trials.is_empty() {
        return Err(FitError::NoCandidate { targets: targets.len(), shape });
    }
    Ok(trials)
}

/// Fits moving least squares with automatically chosen order and support.
///
/// Orders 1 to 6 with supports 0.15 to 1 in steps of 0.05 are tried, and also the published pair of order 4 and support
/// 1/3. A candidate must meet two conditions. First, at least order + 2 nodes have a positive weight everywhere in the
/// range, so that order + 1 remain if one node is left out. Second, the smallest singular value of the weighted design
/// matrix in the local basis is at least 1e-10 of the largest.
///
/// Of the candidates that meet the required residual (largest deviation of a target's mean reading), the one with the
/// smallest leave-one-out RMS is chosen; of equals, the one with the lower order, then the one with the wider support.
/// If no candidate meets the required residual, [`Fit::meets_required`] is false, and the candidate with the smallest
/// leave-one-out RMS of all is chosen.
///
/// With more than 100 targets, the leave-one-out errors are computed at every second, third, … target, so that there
/// are at most 100. With more than 400 targets, supports are fractions of a range that contains 400 targets.
///
/// # Errors
///
/// The errors of [`fit_mls`]; a required residual that is not positive; [`FitError::NoCandidate`] if the targets are
/// too few or too unevenly spaced for any candidate.
pub fn fit_mls_auto(
    x: &[f64],
    u: &[f64],
    shape: f64,
    required_residual: Option<f64>,
) -> Result<Fit, FitError> {
    readings::check_required(required_residual)?;
    let targets = scanned(x, u, shape)?;
    let magnitude = readings::magnitude(targets.iter().map(|t| t[1]));
    let mut settings = settings(&targets, shape, targets.len());
    loop {
        let mut best: Option<usize> = None;
        let judged = |place: usize| Judged {
            meets: required_residual.is_none_or(|r| settings[place].max_residual <= r),
            leave_one_out_rms: settings[place].leave_one_out_rms(),
        };
        for place in 0..settings.len() {
            if judged(place).beats(best.map(judged), magnitude) {
                best = Some(place);
            }
        }
        let place = best.ok_or(FitError::NoCandidate { targets: targets.len(), shape })?;
        let expected = judged(place).meets;
        let setting = &mut settings[place];
        let made = Candidate::new(targets.clone(), setting.order, setting.support, shape)?;
        let meets = required_residual.is_none_or(|r| made.max_residual <= r);
        // A target that was omitted from the choice may be farther from the curve.
        if expected && !meets {
            setting.max_residual = made.max_residual;
            continue;
        }
        return Ok(Fit { meets_required: required_residual.map(|_| meets), ..made.fit(x, u) });
    }
}

/// Order and support of moving least squares with the smallest leave-one-out error for several sets of readings, such
/// as both directions of a measured line. The settings tried and the handling of the required residual are those of
/// [`fit_mls_auto`].
///
/// One setting is chosen for all sets, by the leave-one-out RMS over all sets, because more readings make the choice
/// less accidental. The first and the last target of each set are not left out. The curve is never evaluated beyond
/// them, and their errors alone would decide against a high order.
///
/// # Errors
///
/// The errors of [`fit_mls_auto`], or no set.
pub fn choose_mls(
    sets: &[(&[f64], &[f64])],
    shape: f64,
    required_residual: Option<f64>,
) -> Result<(usize, f64), FitError> {
    readings::check_required(required_residual)?;
    let targets: Result<Vec<_>, FitError> =
        sets.iter().map(|(x, u)| scanned(x, u, shape)).collect();
    let targets = targets?;
    let most = targets.iter().map(Vec::len).max().unwrap_or_default();
    let magnitude = readings::magnitude(targets.iter().flatten().map(|t| t[1]));
    let mut tried: Option<Vec<Setting>> = None;
    for targets in &targets {
        let own = settings(targets, shape, most);
        tried = Some(match tried {
            None => own,
            Some(before) => {
                let with = |all: Setting| all.with(&own);
                before.into_iter().filter_map(with).collect()
            }
        });
    }
    let mut best: Option<(&Setting, Judged)> = None;
    let tried = tried.unwrap_or_default();
    for setting in &tried {
        let judged = Judged {
            meets: required_residual.is_none_or(|r| setting.max_residual <= r),
            leave_one_out_rms: rms(setting.inner()),
        };
        if judged.beats(best.map(|(_, judged)| judged), magnitude) {
            best = Some((setting, judged));
        }
    }
    let none = FitError::NoCandidate {
        targets: sets.iter().map(|(x, _)| x.len()).min().unwrap_or_default(),
        shape,
    };
    best.map(|(setting, _)| (setting.order, setting.support)).ok_or(none)
}

/// An order and a support, with their errors at the targets of one or more sets.
struct Setting {
    order: usize,
    support: f64,
    /// Largest residual of the checked targets.
    max_residual: f64,
    /// Leave-one-out errors of the targets of each set, including the first and the last target.
    missed: Vec<Vec<f64>>,
}

impl Setting {
    fn leave_one_out_rms(&self) -> f64 {
        rms(self.missed.iter().flatten().copied())
    }

    /// Leave-one-out errors of the inner targets. The curve is never evaluated beyond the end targets, and the error of
    /// a high order there would dominate.
    fn inner(&self) -> impl Iterator<Item = f64> {
        let inner = self.missed.iter().flat_map(|of| {
            let inner = 1..of.len().saturating_sub(1);
            of.get(inner).unwrap_or_default()
        });
        inner.copied()
    }

    /// Combines this setting with the same setting for another set; `None` if the other set lacks the setting.
    fn with(mut self, others: &[Self]) -> Option<Self> {
        let mut others = others.iter();
        let same = others.find(|other| {
            other.order == self.order && (other.support - self.support).abs() < 1e-9
        })?;
        self.max_residual = self.max_residual.max(same.max_residual);
        self.missed.extend(same.missed.iter().cloned());
        Some(self)
    }
}

/// Targets for a scan over orders and supports, after checking the readings.
fn scanned(x: &[f64], u: &[f64], shape: f64) -> Result<Vec<[f64; 2]>, FitError> {
    let targets = readings::checked_targets(x, u, 3, PURPOSE)?;
    // Report an invalid shape here. Otherwise it would be reported as a lack of candidates.
    MovingLeastSquares::new(targets.clone(), 1, 2.0 * targets.len() as f64, shape)?;
    Ok(targets)
}

/// Maximum number of targets at which the errors of a setting are computed.
const MAX_TRIED: usize = 100;
/// Maximum number of targets in the range to which supports refer. The effort for one abscissa grows with the number of
/// targets near it.
const MAX_IN_RANGE: f64 = 400.0;

/// All settings that the targets determine, with their errors, by ascending order, then by descending support. `most`
/// is the largest number of targets among the sets that share a setting.
fn settings(targets: &[[f64; 2]], shape: f64, most: usize) -> Vec<Setting> {
    let share = (MAX_IN_RANGE / most as f64).min(1.0);
    let (published_order, published_support) = PUBLISHED;
    let supports = SUPPORTS.map(|step| (MLS_ORDERS, f64::from(step) / 20.0));
    let published = (published_order..=published_order, published_support);
    let mut settings: Vec<Setting> = supports
        .chain([published])
        .flat_map(|(orders, support)| of_support(targets, orders, support * share, shape))
        .collect();
    settings.sort_by(|a, b| {
        let by_support = b.support.total_cmp(&a.support);
        a.order.cmp(&b.order).then(by_support)
    });
    settings
}

/// Settings with this support that the targets determine. Two conditions must hold everywhere in the range. First, at
/// least order + 2 nodes have a positive weight, so that order + 1 remain if one node is left out. Second, the
/// least-squares problem is not nearly singular. Both are checked at the worst abscissas: at the ends, at nodes,
/// half-way between nodes, and where a node enters the support.
fn of_support(
    targets: &[[f64; 2]],
    orders: std::ops::RangeInclusive<usize>,
    support: f64,
    shape: f64,
) -> Vec<Setting> {
    let curve_of = |order: usize| {
        let curve = MovingLeastSquares::new(targets.to_vec(), order, support, shape).ok()?;
        curve.has_nodes_everywhere(order + 2).then_some(curve)
    };
    // Fewer coefficients require fewer nodes. The curve of the highest order contains those of all lower orders.
    let Some(curve) = orders.clone().rev().find_map(curve_of) else {
        return Vec::new();
    };
    let none = |order| Setting { order, support, max_residual: 0.0, missed: vec![Vec::new()] };
    let mut settings: Vec<Setting> = (*orders.start()..=curve.order()).map(none).collect();
    let ([lower, upper], h) = (curve.domain(), curve.half_width());
    let carry = |settings: &mut Vec<Setting>, x: f64| {
        let found = curve.nested(x);
        settings.retain(|setting| {
            found.conditions[setting.order] >= MIN_CONDITION
                || reciprocal_condition(&curve.design(x), setting.order + 1) >= MIN_CONDITION
        });
        found
    };
    let step = targets.len().div_ceil(MAX_TRIED);
    let last = targets.len() - 1;
    let tried = (0..last).step_by(step).chain([last]);
    for place in tried {
        let [x, u] = targets[place];
        let found = carry(&mut settings, x);
        for setting in &mut settings {
            let residual = u - found.values[setting.order];
            setting.max_residual = setting.max_residual.max(residual.abs());
            setting.missed[0].push(left_out(residual, found.influences[setting.order]));
        }
        let middle = targets.get(place + 1).map(|next| f64::midpoint(x, next[0]));
        let places = [x - h, x + h].into_iter().chain(middle);
        for x in places.filter(|x| (lower..=upper).contains(x)) {
            carry(&mut settings, x);
        }
    }
    settings
}

/// Ratio of the smallest to the largest singular value of the first `columns` columns of a matrix, which is given by
/// its rows; 0 if it is singular.
fn reciprocal_condition(rows: &[Vec<f64>], columns: usize) -> f64 {
    if rows.len() < columns || columns == 0 {
        return 0.0;
    }
    let matrix = DMatrix::from_fn(rows.len(), columns, |row, column| rows[row][column]);
    let values = matrix.singular_values();
    // The largest singular value is positive, because in the first column the nearest node has the weight 1, up to a
    // factor.
    values.min() / values.max()
}

#[derive(Clone)]
pub(crate) struct Candidate {
    curve: MovingLeastSquares,
    /// Each target with the value of the curve at it.
    values: Vec<[f64; 2]>,
    pub(crate) residuals: Vec<f64>,
    /// Leverage of each target, which is the derivative of the curve at the target with respect to its mean reading.
    pub(crate) influences: Vec<f64>,
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
        let max_residual = readings::magnitude(residuals.iter().copied());
        Self { curve, values, residuals, influences, max_residual }
    }

    /// Fit of the curve to the single readings `u` at `x`. The curve was fitted to the means of these readings.
    pub(crate) fn fit(self, x: &[f64], u: &[f64]) -> Fit {
        let errors = self.residuals.iter().zip(&self.influences);
        let missed = errors.map(|(&e, &influence)| left_out(e, influence));
        Fit::of_values(self.curve.into(), &self.values, x, u, missed.enumerate())
    }
}
