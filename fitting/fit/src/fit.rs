use volcomp_curve::Curve;

use crate::least_squares::Solution;
use crate::readings;

/// A fitted curve and how well it fits.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Fit {
    /// The curve that was fitted.
    pub curve: Curve,
    /// Reading minus curve, in the order of the readings.
    pub residuals: Vec<f64>,
    /// Root mean square of the errors with which the curve, fitted without a target and all its readings, predicts each of
    /// these. Like the residuals it counts every reading, so that it is never below their root mean square: what the readings
    /// of one target differ by no curve predicts.
    ///
    /// Support, knots and smoothing parameter stay those of the whole fit. A table predicts its inner targets
    /// only. Infinite when a target cannot be predicted from the others.
    #[cfg_attr(feature = "serde", serde(with = "crate::serialised"))]
    pub leave_one_out_rms: f64,
    /// The same of the inner targets alone: the curve is never asked beyond the first and the last, and not every kind can predict them.
    #[cfg_attr(feature = "serde", serde(with = "crate::serialised"))]
    pub inner_rms: f64,
    /// Whether the residual asked for is met; none where nothing was asked for.
    pub meets_required: Option<bool>,
}

impl Fit {
    /// `missed` is what the curve misses of the means of targets that are left out, each with the place of its target; none
    /// where nothing can be left out.
    pub(crate) fn new(
        curve: Curve,
        x: &[f64],
        u: &[f64],
        missed: impl Iterator<Item = (usize, f64)>,
    ) -> Self {
        // Several runs ask for the same places, and moving least squares are slow to answer.
        let mut places = x.to_vec();
        places.sort_by(f64::total_cmp);
        places.dedup();
        let known: Vec<[f64; 2]> = places.into_iter().map(|x| [x, curve.value(x)]).collect();
        Self::of_values(curve, &known, x, u, missed)
    }

    /// As [`new`](Self::new), of a curve of which places and values are known, by ascending place: those of the targets.
    pub(crate) fn of_values(
        curve: Curve,
        known: &[[f64; 2]],
        x: &[f64],
        u: &[f64],
        missed: impl Iterator<Item = (usize, f64)>,
    ) -> Self {
        let at = |x: f64| {
            let place = known.binary_search_by(|[place, _]| place.total_cmp(&x));
            // 0 and −0 are one place.
            place.map_or_else(|_| curve.value(x), |place| known[place][1])
        };
        let residuals = x.iter().zip(u).map(|(&x, &u)| u - at(x));
        let missed: Vec<(usize, f64)> = missed.collect();
        let last = known.len().saturating_sub(1);
        let inner = missed.iter().filter(|(place, _)| (1..last).contains(place));
        Self {
            residuals: residuals.collect(),
            curve,
            inner_rms: over_readings(x, u, inner.copied()),
            leave_one_out_rms: over_readings(x, u, missed.iter().copied()),
            meets_required: None,
        }
    }

    /// The fit of a curve whose coefficients were solved for by least squares.
    pub(crate) fn least_squares(curve: Curve, x: &[f64], u: &[f64], solution: &Solution) -> Self {
        let errors = solution.residuals.iter().zip(&solution.leverages);
        let missed = errors.map(|(&e, &h)| left_out(e, h)).enumerate();
        Self::new(curve, x, u, missed)
    }

    /// The smallest residual, in the unit of the readings.
    pub fn min(&self) -> f64 {
        self.residuals.iter().copied().fold(f64::INFINITY, f64::min)
    }

    /// The largest residual, in the unit of the readings.
    pub fn max(&self) -> f64 {
        self.residuals
            .iter()
            .copied()
            .fold(f64::NEG_INFINITY, f64::max)
    }

    /// The largest magnitude of a residual.
    pub fn max_abs(&self) -> f64 {
        self.min().abs().max(self.max().abs())
    }

    /// The root mean square of the residuals.
    pub fn rms(&self) -> f64 {
        rms(self.residuals.iter().copied())
    }
}

/// Root mean square over the readings of targets, from what is missed of their means; infinite where nothing can be left out.
fn over_readings(x: &[f64], u: &[f64], missed: impl Iterator<Item = (usize, f64)>) -> f64 {
    let targets = readings::counted(x, u);
    let (mut sum, mut count) = (0.0, 0.0);
    for (place, error) in missed {
        if let Some(target) = targets.get(place) {
            sum += target.count * error * error + target.squares;
            count += target.count;
        }
    }
    if count > 0.0 {
        (sum / count).sqrt()
    } else {
        f64::INFINITY
    }
}

pub(crate) fn rms(errors: impl Iterator<Item = f64>) -> f64 {
    let (sum, count) = errors.fold((0.0, 0_u32), |(sum, count), e| (sum + e * e, count + 1));
    (sum / f64::from(count)).sqrt()
}

/// The error of predicting a reading from the others, from its residual `e` and its entry `h` on
/// the diagonal of the hat matrix: `e / (1 − h)` (Allen, Technometrics 16, 1974).
pub(crate) fn left_out(residual: f64, leverage: f64) -> f64 {
    let freedom = 1.0 - leverage;
    if freedom > 1e-9 {
        residual / freedom
    } else {
        f64::INFINITY
    }
}

/// A candidate of an automatic choice: whether it meets the required residual, and its leave-one-out RMS.
#[derive(Clone, Copy)]
pub(crate) struct Judged {
    pub(crate) meets: bool,
    pub(crate) leave_one_out_rms: f64,
}

impl Judged {
    /// Whether this candidate takes the place of the best so far: who meets the required residual comes first, then the
    /// leave-one-out RMS decides where it is better by more than rounding of readings of this magnitude.
    pub(crate) fn beats(self, best: Option<Self>, magnitude: f64) -> bool {
        let Some(best) = best else { return true };
        match (self.meets, best.meets) {
            (true, false) => true,
            (false, true) => false,
            _ => self.leave_one_out_rms < best.leave_one_out_rms - 1e-9 * magnitude,
        }
    }
}
