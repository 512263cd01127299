//! How much readings scatter, and what that explains.

use crate::readings;

/// A standard deviation and how well it is known.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Noise {
    /// Standard deviation of a reading.
    pub deviation: f64,
    /// Degrees of freedom that it was estimated with; infinite where it is known.
    #[cfg_attr(feature = "serde", serde(with = "crate::serialised"))]
    pub freedom: f64,
}

impl Noise {
    /// From the readings of the same targets; `None` where no target has several, or where they do not differ.
    pub(crate) fn pooled(targets: &[readings::Target]) -> Option<Self> {
        let squares: f64 = targets.iter().map(|t| t.squares).sum();
        let freedom: f64 = targets.iter().map(|t| t.count - 1.0).sum();
        let deviation = (squares / freedom).sqrt();
        (deviation > 0.0 && deviation.is_finite()).then_some(Self { deviation, freedom })
    }

    /// Whether a sum of squares of residuals, each with the weight of its readings, with so many degrees of freedom is what this noise makes:
    /// in all but one of a hundred cases it is (E. Paulson, Ann. Math. Stat. 13, 1942: the cube root of F is nearly normal).
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

/// The quantile of the normal distribution that one in a hundred is above.
const ONE_IN_A_HUNDRED: f64 = 2.326_348;
/// With less freedom than this a curve goes through the readings.
const LEAST_FREEDOM: f64 = 0.5;
