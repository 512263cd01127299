use volcomp_curve::MovingLeastSquares;

use crate::fit::{Judged, left_out, rms};
use crate::{Fit, FitError, readings};

const ORDERS: std::ops::RangeInclusive<usize> = 1..=6;
/// Supports tried, in twentieths of the range.
const SUPPORTS: std::ops::RangeInclusive<u32> = 3..=20;
/// The name of the fit in messages about too few targets.
const PURPOSE: &str = "moving least squares";
/// Points between neighbouring critical points at which the weights are checked.
const SUBDIVISION: u32 = 4;

/// Fits moving least squares of the order, the support (fraction of the range of the targets) and
/// the shape of the weight, through the mean reading of each target.
///
/// # Errors
/// Unequal lengths, numbers that are not finite, too few targets, or parameters that
/// [`MovingLeastSquares::new`] refuses.
pub fn fit_mls(
    x: &[f64],
    u: &[f64],
    order: usize,
    support: f64,
    shape: f64,
) -> Result<Fit, FitError> {
    let needed = order.saturating_add(1).max(2);
    let targets = readings::checked_targets(x, u, needed, PURPOSE)?;
    Ok(Candidate::new(targets, order, support, shape)?.fit(x, u))
}

/// Fits moving least squares in the automatic mode.
///
/// Orders 1 to 6 and supports 0.15 to 1 in steps of 0.05 are tried. Candidates are those with
/// `Σw / max w ≥ order + 2` everywhere in the range. Of the candidates that meet the required
/// residual (largest deviation of a target's mean reading) the one with the smallest leave-one-out
/// RMS is taken, ties to the lower order, then to the wider support. When none meets it,
/// [`Fit::meets_required`] is false and the smallest leave-one-out RMS of all decides.
///
/// # Errors
/// Those of [`fit_mls`], a required residual that is not positive, and
/// [`FitError::NoCandidate`] when the targets are too few or too uneven for any candidate.
pub fn fit_mls_auto(
    x: &[f64],
    u: &[f64],
    shape: f64,
    required_residual: Option<f64>,
) -> Result<Fit, FitError> {
    let targets = readings::checked_targets(x, u, 3, PURPOSE)?;
    readings::check_required(required_residual)?;
    // The shape is refused here, before it is taken for a lack of candidates.
    MovingLeastSquares::new(targets.clone(), 1, 2.0 * targets.len() as f64, shape)?;

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

/// All candidates with enough weight, lower orders first, within an order wider supports first.
fn candidates(targets: &[[f64; 2]], shape: f64) -> impl Iterator<Item = Candidate> {
    let supports: Vec<(f64, f64)> = SUPPORTS
        .rev()
        .map(|twentieths| f64::from(twentieths) / 20.0)
        .map(|support| (support, least_weight(targets, support, shape)))
        .collect();
    ORDERS.flat_map(move |order| {
        let wide = supports
            .clone()
            .into_iter()
            .filter(move |s| s.1 >= (order + 2) as f64);
        wide.filter_map(move |(support, _)| {
            Candidate::new(targets.to_vec(), order, support, shape).ok()
        })
    })
}

struct Candidate {
    curve: MovingLeastSquares,
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
        let residuals: Vec<f64> = curve
            .nodes()
            .iter()
            .map(|&[x, u]| u - curve.value(x))
            .collect();
        let errors = residuals.iter().zip(curve.nodes()).enumerate();
        let leave_one_out_rms =
            rms(errors.map(|(i, (&e, &[x, _]))| left_out(e, curve.influence(x, i))));
        let max_residual = readings::magnitude(residuals.iter().copied());
        Ok(Self {
            curve,
            leave_one_out_rms,
            max_residual,
        })
    }

    fn fit(self, x: &[f64], u: &[f64]) -> Fit {
        Fit::new(self.curve.into(), x, u, self.leave_one_out_rms)
    }
}

/// The smallest `Σw / max w` in the range: at nodes, at the ends of supports, half-way between
/// nodes, and at points between these.
fn least_weight(targets: &[[f64; 2]], support: f64, shape: f64) -> f64 {
    let (lower, upper) = (targets[0][0], targets[targets.len() - 1][0]);
    let h = support * (upper - lower);
    let ends = targets.iter().flat_map(|t| [t[0] - h, t[0], t[0] + h]);
    let middles = targets.windows(2).map(|t| f64::midpoint(t[0][0], t[1][0]));
    let mut critical: Vec<f64> = ends
        .chain(middles)
        .filter(|x| (lower..=upper).contains(x))
        .collect();
    critical.sort_by(f64::total_cmp);
    critical.dedup();
    let between = critical.windows(2).flat_map(|c| {
        let step = (c[1] - c[0]) / f64::from(SUBDIVISION);
        (0..SUBDIVISION).map(move |k| c[0] + f64::from(k) * step)
    });
    between
        .chain([upper])
        .map(|x| relative_weight(targets, x, h, shape))
        .fold(f64::INFINITY, f64::min)
}

fn relative_weight(targets: &[[f64; 2]], x: f64, h: f64, shape: f64) -> f64 {
    let a2 = shape * shape;
    let weights = targets.iter().map(|t| {
        let r2 = ((t[0] - x) / h).powi(2);
        // The weight without its constant denominator, which cancels.
        if r2 < 1.0 {
            -(-a2 * r2).exp() * (-a2 * (1.0 - r2)).exp_m1()
        } else {
            0.0
        }
    });
    let (sum, largest) = weights.fold((0.0, 0.0), |(sum, largest): (f64, f64), w| {
        (sum + w, largest.max(w))
    });
    if largest > 0.0 { sum / largest } else { 0.0 }
}
