//! Checks whether the readings support the curve between its targets.

use volcomp_curve::Curve;

use crate::fit::rms;
use crate::readings::{self, Target};
use crate::{Fit, Noise};

/// Maximum excursion of a curve between targets, as a fraction of the height of the mean readings: from their range, or
/// from a straight line.
const LEFT_BY: f64 = 0.25;
/// Samples per gap when choosing a curve.
const PIECES: usize = 4;
/// Samples per gap when assessing a curve.
const FINE_PIECES: usize = 64;
/// Maximum number of samples. With many targets there are fewer samples per gap.
const MAX_PIECES: usize = 4000;
/// Targets count as too sparse only if the leave-one-out RMS exceeds this multiple of both the repeatability and the
/// RMS residual. Scatter explains smaller errors.
const MORE_THAN_SCATTER: f64 = 2.0;
/// Targets count as too sparse if the leave-one-out RMS exceeds this multiple of the repeatability. Leaving out a
/// target doubles the gap, so the error of a smooth curve is four times its error within one gap. At this limit the
/// error within one gap is nearly twice the repeatability.
const MORE_THAN_REPEATS: f64 = 7.0;
/// A curve does not follow the readings if the RMS residual of the mean readings exceeds this multiple of their
/// [`unevenness`]. The unevenness estimates the scatter from second differences, and overestimates it where the error
/// bends between targets. Pure scatter exceeds the limit once in a thousand cases. A wave shorter than seven gaps
/// cannot be distinguished from scatter.
const MORE_THAN_UNEVEN: f64 = 3.0;
/// [`MORE_THAN_UNEVEN`] for four, five and six targets. The residuals of a straight line through an arch are at most
/// 1.2, 2.0 and 3.1 times the unevenness of the arch.
const OF_FEW_TARGETS: [f64; 3] = [1.1, 1.8, 2.8];
/// Fraction of the height of the readings that replaces an unknown repeatability.
const OF_HEIGHT: f64 = 0.1;
/// If the leave-one-out errors exceed the scatter, a gap wider than this multiple of the mean gap always counts as too
/// sparse, because leaving out targets elsewhere does not test the curve inside such a gap.
const WIDE_GAP: f64 = 5.0;

/// Positions in a gap, as fractions of its width, at which a spline is constrained.
pub(crate) const PARTS_OF_GAP: [f64; 3] = [0.25, 0.5, 0.75];

/// Range `[low, high]` in which a chosen curve, or a spline in a wide gap, must stay between targets. It is the range
/// of the mean readings, extended by a quarter of its height at both ends.
pub(crate) fn band_of(means: &[f64]) -> [f64; 2] {
    let low = means.iter().copied().fold(f64::INFINITY, f64::min);
    let high = means.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let more = LEFT_BY * (high - low) + 1e-9 * low.abs().max(high.abs());
    [low - more, high + more]
}

pub(crate) struct Band {
    targets: Vec<f64>,
    low: f64,
    high: f64,
}

impl Band {
    pub(crate) fn of(targets: &[Target]) -> Self {
        let means: Vec<f64> = targets.iter().map(|t| t.mean).collect();
        let [low, high] = band_of(&means);
        Self { targets: targets.iter().map(|t| t.x).collect(), low, high }
    }

    /// Whether the curve stays in the range between all targets.
    pub(crate) fn holds(&self, curve: &Curve) -> bool {
        let stays = |gap: &[f64]| {
            self.parts(PIECES).all(|part| {
                let value = curve.value(gap[0] + part * (gap[1] - gap[0]));
                (self.low..=self.high).contains(&value)
            })
        };
        self.targets.windows(2).all(stays)
    }

    /// Neighbouring targets between which the curve departs most from its own chord; `None` if no departure exceeds the
    /// limit. A wave of four gaps departs by a fifth of the height of the readings, a wave of three gaps by a third.
    fn swings(&self, curve: &Curve, scatter: f64) -> Option<[f64; 2]> {
        let limit = (LEFT_BY * self.height()).max(MORE_THAN_REPEATS * scatter);
        let at = |&x: &f64| curve.value(x);
        let values: Vec<f64> = self.targets.iter().map(at).collect();
        let mut worst = None;
        let mut most = 0.0;
        for (gap, ends) in self.targets.windows(2).zip(values.windows(2)) {
            for part in self.parts(FINE_PIECES) {
                let value = curve.value(gap[0] + part * (gap[1] - gap[0]));
                let by = (value - (ends[0] + part * (ends[1] - ends[0]))).abs() - limit;
                // NaN counts as above any limit.
                if by.is_nan() || by > most {
                    most = by;
                    worst = Some([gap[0], gap[1]]);
                }
            }
        }
        worst
    }

    /// Sampled positions within a gap, as fractions of its width. There are `pieces` parts per gap, and fewer with many
    /// targets.
    fn parts(&self, pieces: usize) -> impl Iterator<Item = f64> {
        let pieces = (MAX_PIECES / self.targets.len().max(1)).clamp(2, pieces);
        (1..pieces).map(move |piece| piece as f64 / pieces as f64)
    }

    fn height(&self) -> f64 {
        (self.high - self.low) / (1.0 + 2.0 * LEFT_BY)
    }
}

/// Range of the mean readings after removing the least-squares line.
fn height_beside_line(targets: &[Target]) -> f64 {
    let count = targets.len() as f64;
    let mean = |of: fn(&Target) -> f64| targets.iter().map(of).sum::<f64>() / count;
    let (x, u) = (mean(|t| t.x), mean(|t| t.mean));
    let (mut square, mut product) = (0.0, 0.0);
    for target in targets {
        square += (target.x - x).powi(2);
        product += (target.x - x) * (target.mean - u);
    }
    let slope = if square > 0.0 { product / square } else { 0.0 };
    let beside = targets.iter().map(|t| t.mean - u - slope * (t.x - x));
    let [low, high] = beside
        .fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], at| [low.min(at), high.max(at)]);
    (high - low).max(0.0)
}

/// Standard deviation of values about a smooth curve, from the deviation of each value from the chord of its two
/// neighbours. `points` are pairs of abscissa and value with ascending abscissas. `None` for fewer than three points.
pub fn unevenness(points: &[(f64, f64)]) -> Option<f64> {
    let beside = points.windows(3).map(|three| {
        let [(x0, v0), (x1, v1), (x2, v2)] = [three[0], three[1], three[2]];
        let share = if x2 == x0 { 0.5 } else { (x1 - x0) / (x2 - x0) };
        let beside = v1 - v0 - share * (v2 - v0);
        // Variance of this deviation relative to the variance of a single value.
        beside * beside / (1.0 + (1.0 - share).powi(2) + share * share)
    });
    let count = beside.len();
    (count > 0).then(|| (beside.sum::<f64>() / count as f64).sqrt())
}

/// Measures of how well the readings support a curve between its targets, in the unit of the readings.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Between {
    /// RMS leave-one-out error of the inner targets; infinite if the curve cannot predict one of these targets.
    pub leave_one_out: f64,
    /// RMS residual of the readings.
    pub residual: f64,
    /// RMS residual of the mean readings of the targets.
    pub residual_of_means: f64,
    /// Standard deviation of a reading, or of a mean if the curve was fitted to means; `None` if unknown.
    pub repeatability: Option<f64>,
    pub targets: usize,
    /// [`unevenness`] of the mean readings from target to target. It is at least the rounding of the readings.
    pub uneven: Option<f64>,
    /// Range of the mean readings (highest minus lowest).
    pub height: f64,
    /// Range of the mean readings after removing the least-squares line.
    pub height_beside_line: f64,
    /// Widest gap between neighbouring targets, relative to the mean gap. It is 0 for fewer than three targets, because
    /// then none can be left out.
    pub widest_gap: f64,
    /// Neighbouring targets between which the curve departs most from its chord; `None` if it departs by at most a
    /// quarter of the height of the readings.
    pub swings: Option<[f64; 2]>,
}

impl Between {
    /// Assesses a fit to readings `u` at `x`. `noise` is the scatter of a reading, or of a mean if `u` are means.
    pub fn of(fit: &Fit, x: &[f64], u: &[f64], noise: Option<Noise>) -> Self {
        let targets = readings::counted(x, u);
        let of_targets = Band::of(&targets);
        let gaps = of_targets.targets.windows(2).map(|gap| gap[1] - gap[0]);
        let points: Vec<(f64, f64)> = targets.iter().map(|t| (t.x, t.mean)).collect();
        // Rounding errors of a fit that follows the readings exactly.
        let rounding = 1e-9 * points.iter().fold(0.0_f64, |most, (_, mean)| most.max(mean.abs()));
        let mean = gaps.clone().sum::<f64>() / targets.len().saturating_sub(1) as f64;
        let (residual, repeatability) = (fit.rms(), noise.map(|noise| noise.deviation));
        Self {
            leave_one_out: fit.inner_rms,
            residual,
            residual_of_means: rms(targets.iter().map(|t| t.mean - fit.curve.value(t.x))),
            repeatability,
            targets: targets.len(),
            uneven: unevenness(&points).map(|uneven| uneven.max(rounding)),
            height: of_targets.height(),
            height_beside_line: height_beside_line(&targets),
            widest_gap: if targets.len() > 2 { gaps.fold(0.0, f64::max) / mean } else { 0.0 },
            swings: of_targets.swings(&fit.curve, repeatability.unwrap_or_default().max(residual)),
        }
    }

    /// Whether the targets are too sparse for the error. Three conditions must hold. First, there are enough targets to
    /// judge (`widest_gap` > 0). Second, the leave-one-out RMS of the inner targets exceeds twice the repeatability and
    /// twice the RMS residual. Third, it exceeds seven times the repeatability, or the widest gap exceeds five mean
    /// gaps. An unknown repeatability (one run) counts as zero in the second condition, and as a tenth of the height of
    /// the readings in the third.
    pub fn is_too_sparse(&self) -> bool {
        let scatter = self.repeatability.unwrap_or_default().max(self.residual);
        let repeats = self.repeatability.unwrap_or(OF_HEIGHT * self.height);
        let judged = self.widest_gap > 0.0;
        judged
            && self.leave_one_out > MORE_THAN_SCATTER * scatter
            && (self.leave_one_out > MORE_THAN_REPEATS * repeats || self.widest_gap > WIDE_GAP)
    }

    /// Whether the curve fails to follow the readings. Either the RMS residual exceeds seven times the repeatability,
    /// or the RMS residual of the mean readings exceeds three times their unevenness (less for fewer than seven
    /// targets). In both cases the residual must exceed a tenth of the height of the readings about a straight line,
    /// because a smaller residual is no evidence of a wave. Different offsets of the runs increase the repeatability,
    /// but not the unevenness.
    pub fn is_not_followed(&self) -> bool {
        let few = self.targets.checked_sub(4).and_then(|of| OF_FEW_TARGETS.get(of));
        let times = few.copied().unwrap_or(MORE_THAN_UNEVEN);
        let is_beyond = |left: f64, times: f64, scatter: Option<f64>| {
            scatter.is_some_and(|scatter| left > times * scatter)
        };
        let high = OF_HEIGHT * self.height_beside_line;
        self.residual > high && is_beyond(self.residual, MORE_THAN_REPEATS, self.repeatability)
            || self.residual_of_means > high
                && is_beyond(self.residual_of_means, times, self.uneven)
    }

    /// Message if the curve does not follow the readings; `None` if it does. `unit` is the unit of the readings.
    pub fn not_followed(&self, unit: &str) -> Option<String> {
        if !self.is_not_followed() {
            return None;
        }
        let repeats = |of: f64| format!("repeat to {of:.2} {unit}");
        let uneven =
            |of: f64| format!("scatter by no more than {of:.2} {unit} from target to target");
        let scatter = [self.repeatability.map(repeats), self.uneven.map(uneven)];
        let scatter: Vec<String> = scatter.into_iter().flatten().collect();
        Some(format!(
            "the curve does not follow the readings: it leaves {:.2} {unit} of them (root mean square), which {}: let the kind of curve be chosen from the readings, or state another one",
            self.residual,
            scatter.join(" and ")
        ))
    }

    /// Warnings for the user. `unit` is the unit of the readings, and `along` the unit of the targets.
    pub fn warnings(&self, unit: &str, along: &str) -> Vec<String> {
        let sparse = self.is_too_sparse().then(|| {
            let missed = if self.leave_one_out.is_finite() {
                format!("are missed by {:.2} {unit} (root mean square)", self.leave_one_out)
            } else {
                "cannot all be predicted from the others".to_owned()
            };
            let repeats = self.repeatability.map_or(String::new(), |noise| {
                format!(", which repeat to {noise:.2} {unit}")
            });
            format!(
                "the targets are too sparse: left out one at a time they {missed}, {:.2} {unit} are left of the readings{repeats}, and the widest gap is {:.1} times the mean one. Measure more of them",
                self.residual, self.widest_gap,
            )
        });
        let swings = self.swings.map(|[from, to]| {
            format!(
                "between the targets {from} and {to} {along} the curve swings by more than a quarter of the height of the readings, which no reading bears out. Measure between them, or let the kind of curve be chosen from the readings"
            )
        });
        sparse.into_iter().chain(swings).collect()
    }
}
