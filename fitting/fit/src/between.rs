//! What a curve does between its targets that readings do not bear out.

use volcomp_curve::Curve;

use crate::fit::rms;
use crate::readings::{self, Target};
use crate::{Fit, Noise};

/// Between targets a curve may leave the band of the mean readings, or a straight line, by this share of the band's height.
const LEFT_BY: f64 = 0.25;
/// Each gap is looked at in so many pieces where a curve is chosen, and so many where it is judged; with many targets in fewer.
const PIECES: usize = 4;
const FINE_PIECES: usize = 64;
const MOST_PIECES: usize = 4000;
/// Targets that are left out are missed by more than so many times what the readings repeat to, and what the curve leaves of them, where the curve
/// misses more than scatter.
const MORE_THAN_SCATTER: f64 = 2.0;
/// A target left out is predicted over two gaps, and is missed by four times what a smooth curve misses within one: of so many times what the readings
/// repeat to, nearly twice is left.
const MORE_THAN_REPEATS: f64 = 7.0;
/// Second differences of mean readings say what these scatter, and more where the error bends between targets: a curve that leaves more than so many
/// times that does not follow them. Scatter alone is held for it once in a thousand; a wave shorter than seven gaps cannot be told from scatter.
const MORE_THAN_UNEVEN: f64 = 3.0;
/// The same of four, five and six targets, of which a straight line leaves no more of an arch than 1.2, 2.0 and 3.1 times their unevenness.
const OF_FEW_TARGETS: [f64; 3] = [1.1, 1.8, 2.8];
/// Where nothing tells what readings repeat to, this share of their height counts.
const OF_HEIGHT: f64 = 0.1;
/// Of what is in a gap of more than so many mean gaps the targets that are left out tell nothing: what is missed of them need be no more than scatter.
const WIDE_GAP: f64 = 5.0;

/// Where a spline is held between two targets, as shares of the gap.
pub(crate) const PARTS_OF_GAP: [f64; 3] = [0.25, 0.5, 0.75];

/// The band of mean readings that a curve that is chosen, or a spline in a wide gap, may not leave between targets.
pub(crate) fn band_of(means: &[f64]) -> [f64; 2] {
    let low = means.iter().copied().fold(f64::INFINITY, f64::min);
    let high = means.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let more = LEFT_BY * (high - low) + 1e-9 * low.abs().max(high.abs());
    [low - more, high + more]
}

/// The targets and the band of their mean readings.
pub(crate) struct Band {
    targets: Vec<f64>,
    low: f64,
    high: f64,
}

impl Band {
    pub(crate) fn of(targets: &[Target]) -> Self {
        let means: Vec<f64> = targets.iter().map(|t| t.mean).collect();
        let [low, high] = band_of(&means);
        Self {
            targets: targets.iter().map(|t| t.x).collect(),
            low,
            high,
        }
    }

    /// Whether a curve stays in the band between targets.
    pub(crate) fn holds(&self, curve: &Curve) -> bool {
        let beyond = |value: f64, _| (self.low - value).max(value - self.high);
        self.furthest(curve, PIECES, beyond).is_none()
    }

    /// The neighbours between which a curve leaves the straight line through its own values at them furthest; `None` where it is nowhere left by more
    /// than it may be. A wave of four gaps leaves it by a fifth of the height of the readings, one of three by a third.
    fn swings(&self, curve: &Curve, scatter: f64) -> Option<[f64; 2]> {
        let most = (LEFT_BY * self.height()).max(MORE_THAN_REPEATS * scatter);
        self.furthest(curve, FINE_PIECES, |value, straight| {
            (value - straight).abs() - most
        })
    }

    fn height(&self) -> f64 {
        (self.high - self.low) / (1.0 + 2.0 * LEFT_BY)
    }

    /// The neighbours between which the value of a curve is furthest beyond what is allowed, from it and that of a straight line between its values at both.
    fn furthest(
        &self,
        curve: &Curve,
        pieces: usize,
        beyond: impl Fn(f64, f64) -> f64,
    ) -> Option<[f64; 2]> {
        let pieces = (MOST_PIECES / self.targets.len().max(1)).clamp(2, pieces);
        let at = |&x: &f64| curve.value(x);
        let values: Vec<f64> = self.targets.iter().map(at).collect();
        let mut furthest = None;
        let mut most = 0.0;
        for (gap, ends) in self.targets.windows(2).zip(values.windows(2)) {
            for part in (1..pieces).map(|piece| piece as f64 / pieces as f64) {
                let value = curve.value(gap[0] + part * (gap[1] - gap[0]));
                let by = beyond(value, ends[0] + part * (ends[1] - ends[0]));
                // A value that is no number is beyond anything.
                if by.is_nan() || by > most {
                    most = by;
                    furthest = Some([gap[0], gap[1]]);
                }
            }
        }
        furthest
    }
}

/// The highest less the lowest mean reading beside the straight line of least squares.
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
    let [low, high] = beside.fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], at| {
        [low.min(at), high.max(at)]
    });
    (high - low).max(0.0)
}

/// The standard deviation of values about a smooth course, of points in the order of their places: from what each value is beside the straight line through
/// its two neighbours. `None` of fewer than three points.
pub fn unevenness(points: &[(f64, f64)]) -> Option<f64> {
    let beside = points.windows(3).map(|three| {
        let [(x0, v0), (x1, v1), (x2, v2)] = [three[0], three[1], three[2]];
        let share = if x2 == x0 { 0.5 } else { (x1 - x0) / (x2 - x0) };
        let beside = v1 - v0 - share * (v2 - v0);
        // The variance of the difference is so many times that of a value.
        beside * beside / (1.0 + (1.0 - share).powi(2) + share * share)
    });
    let count = beside.len();
    (count > 0).then(|| (beside.sum::<f64>() / count as f64).sqrt())
}

/// What of a curve between its targets the readings do not bear out, in the unit of the readings.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Between {
    /// What the curve misses of inner targets that are left out (root mean square); infinite where it cannot predict one.
    pub leave_one_out: f64,
    /// What the curve leaves of the readings (root mean square).
    pub residual: f64,
    /// What it leaves of the mean readings of the targets (root mean square).
    pub residual_of_means: f64,
    /// The standard deviation of a reading, or of the mean that the curve was fitted to; `None` where nothing tells it.
    pub repeatability: Option<f64>,
    /// The number of targets.
    pub targets: usize,
    /// The [`unevenness`] of the mean readings from target to target, and no less than their rounding.
    pub uneven: Option<f64>,
    /// The highest less the lowest of the mean readings.
    pub height: f64,
    /// The same beside the straight line through them (least squares).
    pub height_beside_line: f64,
    /// The widest gap between neighbouring targets over the mean one; 0 of fewer than three targets, of which none can be left out.
    pub widest_gap: f64,
    /// The neighbouring targets between which the curve leaves the straight line between its values there by more than a quarter of the height of
    /// the readings, the furthest.
    pub swings: Option<[f64; 2]>,
}

impl Between {
    /// Of a fit to readings `u` at `x`, with what such a reading scatters.
    pub fn of(fit: &Fit, x: &[f64], u: &[f64], noise: Option<Noise>) -> Self {
        let targets = readings::counted(x, u);
        let of_targets = Band::of(&targets);
        let gaps = of_targets.targets.windows(2).map(|gap| gap[1] - gap[0]);
        let points: Vec<(f64, f64)> = targets.iter().map(|t| (t.x, t.mean)).collect();
        // What a fit leaves of readings that it follows exactly.
        let rounding = 1e-9
            * points
                .iter()
                .fold(0.0_f64, |most, (_, mean)| most.max(mean.abs()));
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
            widest_gap: if targets.len() > 2 {
                gaps.fold(0.0, f64::max) / mean
            } else {
                0.0
            },
            swings: of_targets.swings(&fit.curve, repeatability.unwrap_or_default().max(residual)),
        }
    }

    /// Whether the targets are too sparse for the error: inner targets left out one at a time are missed by more than twice what the readings repeat to
    /// and what the curve leaves of them, and by more than seven times what they repeat to, or the widest gap is of more than five mean gaps. Where nothing tells
    /// what readings repeat to, of one run, it is a tenth of their height in the second rule, and nothing in the first.
    pub fn is_too_sparse(&self) -> bool {
        let scatter = self.repeatability.unwrap_or_default().max(self.residual);
        let repeats = self.repeatability.unwrap_or(OF_HEIGHT * self.height);
        let judged = self.widest_gap > 0.0;
        judged
            && self.leave_one_out > MORE_THAN_SCATTER * scatter
            && (self.leave_one_out > MORE_THAN_REPEATS * repeats || self.widest_gap > WIDE_GAP)
    }

    /// Whether the curve does not follow the readings: it leaves more than seven times what they repeat to, or of their means more than three times
    /// the unevenness (less of fewer than seven targets), and more than a tenth of their height beside a straight line, which says nothing of a wave. What
    /// runs differ by in their zero makes them repeat badly, and not uneven.
    pub fn is_not_followed(&self) -> bool {
        let few = self
            .targets
            .checked_sub(4)
            .and_then(|of| OF_FEW_TARGETS.get(of));
        let times = few.copied().unwrap_or(MORE_THAN_UNEVEN);
        let is_beyond = |left: f64, times: f64, scatter: Option<f64>| {
            scatter.is_some_and(|scatter| left > times * scatter)
        };
        let high = OF_HEIGHT * self.height_beside_line;
        self.residual > high && is_beyond(self.residual, MORE_THAN_REPEATS, self.repeatability)
            || self.residual_of_means > high
                && is_beyond(self.residual_of_means, times, self.uneven)
    }

    /// Says that the curve does not follow the readings, whose `unit` that is.
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

    /// What a person should read of it; `unit` is that of the readings, `along` that of the targets.
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
