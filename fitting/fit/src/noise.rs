//! Scatter of readings, and tests against it.

use crate::readings;

/// Standard deviation with its degrees of freedom.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Noise {
    /// Standard deviation of a reading.
    pub deviation: f64,
    /// Degrees of freedom of the estimate; infinite if the deviation is known.
    #[cfg_attr(feature = "serde", serde(with = "crate::serialised"))]
    pub freedom: f64,
}

impl Noise {
    /// Pooled standard deviation of repeated readings; `None` if no target has several, or if they do not differ.
    pub(crate) fn pooled(targets: &[readings::Target]) -> Option<Self> {
        let squares: f64 = targets.iter().map(|t| t.squares).sum();
        let freedom: f64 = targets.iter().map(|t| t.count - 1.0).sum();
        let deviation = (squares / freedom).sqrt();
        (deviation > 0.0 && deviation.is_finite()).then_some(Self { deviation, freedom })
    }

    /// Whether this noise explains a sum of squared residuals, each weighted by its number of readings, with these degrees of freedom: a test at the
    /// 1 % level (E. Paulson, Ann. Math. Stat. 13, 1942: the cube root of F is nearly normal).
    pub(crate) fn explains(&self, squares: f64, freedom: f64) -> bool {
        if freedom < LEAST_FREEDOM {
            return true;
        }
        let root = (squares / freedom / self.deviation.powi(2)).cbrt();
        let (above, below) = (2.0 / (9.0 * freedom), 2.0 / (9.0 * self.freedom));
        let score = ((1.0 - below) * root - (1.0 - above)) / (below * root * root + above).sqrt();
        score <= ONE_IN_A_HUNDRED
    }
}

/// 99 % quantile of the standard normal distribution.
const ONE_IN_A_HUNDRED: f64 = 2.326_348;
/// Minimum degrees of freedom of the test: with fewer the curve interpolates the readings.
const LEAST_FREEDOM: f64 = 0.5;
