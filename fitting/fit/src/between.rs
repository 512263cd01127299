//! What a curve may do between its targets.

use volcomp_curve::Curve;

use crate::readings::Target;

/// Between targets a curve may leave the band of the mean readings by this share of the band's height, to each side.
const BAND_LEFT_BY: f64 = 0.25;
/// With more targets than this the curve is looked at once between two of them, else three times.
const MANY_TARGETS: usize = 1000;
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

    /// Whether a curve stays inside between all targets.
    pub(crate) fn holds(&self, curve: &Curve) -> bool {
        self.targets.windows(2).all(|gap| {
            let inside = |part: &f64| {
                let value = curve.value(gap[0] + part * (gap[1] - gap[0]));
                (self.low..=self.high).contains(&value)
            };
            self.parts.iter().all(inside)
        })
    }
}
