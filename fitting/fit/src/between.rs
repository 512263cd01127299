//! What a curve does between its targets that readings do not bear out.

use volcomp_curve::Curve;

use crate::readings::{self, Target};
use crate::{Fit, Noise};

/// Between targets a curve may leave the band of the mean readings by this share of the band's height, to each side.
const BAND_LEFT_BY: f64 = 0.25;
/// With more targets than this the curve is looked at once between two of them, else three times.
const MANY_TARGETS: usize = 1000;
/// Targets that are left out are missed by more than so many times what the readings repeat to, and what the curve leaves of them, where the curve
/// misses more than scatter.
const MORE_THAN_SCATTER: f64 = 2.0;
/// A target left out is predicted over twice the mean gap, and a smooth curve misses by the square of it: this share in a mean gap.
const OF_LEFT_OUT: f64 = 0.25;
/// What is missed in a gap counts from so many times what the readings repeat to.
const MORE_THAN_REPEATS: f64 = 1.5;
/// Where nothing tells what readings repeat to, this share of their height counts.
const OF_HEIGHT: f64 = 0.1;

/// Where a curve is looked at between two targets, as shares of the gap.
pub(crate) const PARTS_OF_GAP: [f64; 3] = [0.25, 0.5, 0.75];

/// The band of mean readings that a curve may not leave between targets.
pub(crate) fn band_of(means: &[f64]) -> [f64; 2] {
    let low = means.iter().copied().fold(f64::INFINITY, f64::min);
    let high = means.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let more = BAND_LEFT_BY * (high - low) + 1e-9 * low.abs().max(high.abs());
    [low - more, high + more]
}

/// The targets and the band of their mean readings.
pub(crate) struct Band {
    targets: Vec<f64>,
    parts: &'static [f64],
    low: f64,
    high: f64,
}

impl Band {
    pub(crate) fn of(targets: &[Target]) -> Self {
        let means: Vec<f64> = targets.iter().map(|t| t.mean).collect();
        let [low, high] = band_of(&means);
        Self {
            targets: targets.iter().map(|t| t.x).collect(),
            parts: if targets.len() > MANY_TARGETS {
                &[0.5]
            } else {
                &PARTS_OF_GAP
            },
            low,
            high,
        }
    }

    /// The neighbours between which a curve leaves the band furthest; `None` where it stays inside.
    pub(crate) fn left(&self, curve: &Curve) -> Option<[f64; 2]> {
        let mut furthest = None;
        let mut most = 0.0;
        for gap in self.targets.windows(2) {
            for part in self.parts {
                let value = curve.value(gap[0] + part * (gap[1] - gap[0]));
                let by = (self.low - value).max(value - self.high);
                // A value that is no number leaves it, too.
                if by.is_nan() || by > most {
                    most = by;
                    furthest = Some([gap[0], gap[1]]);
                }
            }
        }
        furthest
    }
}

/// What of a curve between its targets the readings do not bear out, in the unit of the readings.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Between {
    /// What the curve misses of targets that are left out (root mean square); infinite where it cannot predict one.
    pub leave_one_out: f64,
    /// What the curve leaves of the readings (root mean square).
    pub residual: f64,
    /// The standard deviation of a reading, or of the mean that the curve was fitted to; `None` where nothing tells it.
    pub repeatability: Option<f64>,
    /// The highest less the lowest of the mean readings.
    pub height: f64,
    /// The widest gap between neighbouring targets over the mean one; 0 of fewer than three targets, of which none can be left out.
    pub widest_gap: f64,
    /// The neighbouring targets between which the curve leaves the band of the mean readings by more than a quarter of its height,
    /// the furthest. [`choose`](crate::choose) puts such a curve aside; a kind that is stated is warned of.
    pub swings: Option<[f64; 2]>,
}

impl Between {
    /// Of a fit to readings `u` at `x`, with what such a reading scatters.
    pub fn of(fit: &Fit, x: &[f64], u: &[f64], noise: Option<Noise>) -> Self {
        let targets = readings::counted(x, u);
        let of_targets = Band::of(&targets);
        let gaps = of_targets.targets.windows(2).map(|gap| gap[1] - gap[0]);
        let mean = gaps.clone().sum::<f64>() / targets.len().saturating_sub(1) as f64;
        Self {
            leave_one_out: fit.leave_one_out_rms,
            residual: fit.rms(),
            repeatability: noise.map(|noise| noise.deviation),
            height: (of_targets.high - of_targets.low) / (1.0 + 2.0 * BAND_LEFT_BY),
            widest_gap: if targets.len() > 2 {
                gaps.fold(0.0, f64::max) / mean
            } else {
                0.0
            },
            swings: of_targets.left(&fit.curve),
        }
    }

    /// Whether the targets are too sparse for the error: targets left out one at a time are missed by more than twice what the readings repeat to
    /// and what the curve leaves of them, and in the widest gap, as far as the curve is smooth, more than 1.5 times what they repeat to is missed. Where
    /// nothing tells that, of one run, it is a tenth of the height of the readings in the gap.
    pub fn is_too_sparse(&self) -> bool {
        let scatter = self.repeatability.unwrap_or_default().max(self.residual);
        let repeats = self.repeatability.unwrap_or(OF_HEIGHT * self.height);
        let in_gap = OF_LEFT_OUT * self.widest_gap.powi(2) * self.leave_one_out;
        self.leave_one_out > MORE_THAN_SCATTER * scatter && in_gap > MORE_THAN_REPEATS * repeats
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
                "between the targets {from} and {to} {along} the curve leaves the band of the readings by more than a quarter of its height, which no reading bears out. Measure between them, or let the kind of curve be chosen from the readings"
            )
        });
        sparse.into_iter().chain(swings).collect()
    }
}
