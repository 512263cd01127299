use alloc::vec::Vec;

use crate::{CurveError, domain, series::Series};

/// Polynomial `c0 + c1 x + c2 x² + …` on a domain.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Polynomial(Series);

impl Polynomial {
    /// Builds the polynomial from its coefficients and its domain. Coefficient `k`, from 0, is in value units divided
    /// by argument units to the power `k`.
    ///
    /// # Errors
    /// No coefficient, a number that is not finite, an empty or reversed domain.
    pub fn new(coefficients: Vec<f64>, domain: [f64; 2]) -> Result<Self, CurveError> {
        Series::new(coefficients, domain).map(Self)
    }

    /// Coefficients `c0`, `c1`, …. Coefficient `k` is in value units divided by argument units to the power `k`.
    pub fn coefficients(&self) -> &[f64] {
        &self.0.coefficients
    }

    pub fn domain(&self) -> [f64; 2] {
        self.0.domain
    }

    /// Value at `x`, in value units. Outside the domain the end value is kept.
    pub fn value(&self, x: f64) -> f64 {
        domain::held(self.0.domain, x, |x| {
            self.0.coefficients.iter().rev().fold(0.0, |sum, c| sum * x + c)
        })
    }

    pub fn derivative(&self, x: f64) -> f64 {
        domain::slope(self.0.domain, x, |x| {
            let powers = self.0.coefficients.iter().enumerate().skip(1).rev();
            powers.fold(0.0, |sum, (k, c)| sum * x + k as f64 * c)
        })
    }

    /// Replaces every value by `scale` times the value plus `c`.
    pub(crate) fn affine(self, scale: f64, c: f64) -> Self {
        Self(self.0.affine(scale, c))
    }
}
