//! What a curve does between its targets that readings do not bear out.

use volcomp_curve::Curve;

use crate::readings::{self, Target};
use crate::{Fit, Noise};

/// Between targets a curve may leave the band of the mean readings by this share of the band's height, to each side.
const BAND_LEFT_BY: f64 = 0.25;
/// With more targets than this the curve is looked at once between two of them, else three times.
const MANY_TARGETS: usize = 1000;
/// Targets are too sparse where the leave-one-out error is more than so many times what the readings repeat to, and
const OF_REPEATABILITY: f64 = 3.0;
/// more than so many times what the curve leaves of them.
const OF_RESIDUAL: f64 = 2.0;

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
    /// The neighbouring targets between which the curve leaves the band of the mean readings by more than a quarter of its height,
    /// the furthest. [`choose`](crate::choose) puts such a curve aside; a kind that is stated is warned of.
    pub swings: Option<[f64; 2]>,
}

impl Between {
    /// Of a fit to readings `u` at `x`, with what such a reading scatters.
    pub fn of(fit: &Fit, x: &[f64], u: &[f64], noise: Option<Noise>) -> Self {
        let is_read = readings::check(x, u).is_ok();
        Self {
            leave_one_out: fit.leave_one_out_rms,
            residual: fit.rms(),
            repeatability: noise.map(|noise| noise.deviation),
            swings: is_read
                .then(|| Band::of(&readings::counted(x, u)).left(&fit.curve))
                .flatten(),
        }
    }

    /// Whether the targets are too sparse for the error: left out one at a time they are missed by more than three times what the
    /// readings repeat to, and by more than twice what the curve leaves of them. Of one run nothing tells.
    pub fn is_too_sparse(&self) -> bool {
        self.repeatability.is_some_and(|noise| {
            let least = (OF_REPEATABILITY * noise).max(OF_RESIDUAL * self.residual);
            self.leave_one_out.is_finite() && self.leave_one_out > least
        })
    }

    /// What a person should read of it; `unit` is that of the readings, `along` that of the targets.
    pub fn warnings(&self, unit: &str, along: &str) -> Vec<String> {
        let sparse = self.is_too_sparse().then(|| {
            format!(
                "the targets are too sparse: left out one at a time they are missed by {:.2} {unit} (root mean square), {:.2} {unit} are left of the readings, which repeat to {:.2} {unit}; between targets the curve may be wrong by as much. Measure at half the spacing",
                self.leave_one_out,
                self.residual,
                self.repeatability.unwrap_or_default(),
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
