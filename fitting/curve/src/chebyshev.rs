use alloc::vec::Vec;

use crate::{CurveError, domain, series::Series};

/// Series `c0 + c1 T1(t) + c2 T2(t) + …` of Chebyshev polynomials of the first kind. `t` is the argument mapped from
/// the domain to [−1, 1]. The series has `c0` itself, without the factor 1/2 of other conventions.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Chebyshev(Series);

impl Chebyshev {
    /// Builds the series from its coefficients (value units) and its domain (argument units).
    ///
    /// # Errors
    /// No coefficient, a number that is not finite, an empty or reversed domain.
    pub fn new(coefficients: Vec<f64>, domain: [f64; 2]) -> Result<Self, CurveError> {
        Series::new(coefficients, domain).map(Self)
    }

    /// Coefficients `c0`, `c1`, …, in value units.
    pub fn coefficients(&self) -> &[f64] {
        &self.0.coefficients
    }

    pub fn domain(&self) -> [f64; 2] {
        self.0.domain
    }

    /// Value at `x`, in value units. Outside the domain the end value is kept. Recurrence of Clenshaw, Math. Comp.
    /// 9, 1955.
    pub fn value(&self, x: f64) -> f64 {
        domain::held(self.0.domain, x, |x| {
            let t = self.mapped(x);
            let (mut b1, mut b2) = (0.0, 0.0);
            for &c in self.0.coefficients[1..].iter().rev() {
                (b1, b2) = (c + 2.0 * t * b1 - b2, b1);
            }
            self.0.coefficients[0] + t * b1 - b2
        })
    }

    /// Derivative at `x`, 0 outside the domain. It is the derivative of Clenshaw's recurrence.
    pub fn derivative(&self, x: f64) -> f64 {
        domain::slope(self.0.domain, x, |x| {
            let t = self.mapped(x);
            let (mut b1, mut b2) = (0.0, 0.0);
            let (mut d1, mut d2) = (0.0, 0.0);
            for &c in self.0.coefficients[1..].iter().rev() {
                (d1, d2) = (2.0 * b1 + 2.0 * t * d1 - d2, d1);
                (b1, b2) = (c + 2.0 * t * b1 - b2, b1);
            }
            let [lower, upper] = self.0.domain;
            (b1 + t * d1 - d2) * 2.0 / (upper - lower)
        })
    }

    fn mapped(&self, x: f64) -> f64 {
        let [lower, upper] = self.0.domain;
        ((x - lower) - (upper - x)) / (upper - lower)
    }

    /// Replaces every value by `scale` times the value plus `c`.
    pub(crate) fn affine(self, scale: f64, c: f64) -> Self {
        Self(self.0.affine(scale, c))
    }
}
