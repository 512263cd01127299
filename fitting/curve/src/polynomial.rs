use alloc::vec::Vec;

use crate::{CurveError, domain, series::Series};

/// Polynomial `c0 + c1 x + c2 x² + …` on a domain.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Polynomial(Series);

impl Polynomial {
    /// Builds the polynomial from its coefficients, constant first (value units over argument
    /// units to the power), and its domain.
    ///
    /// # Errors
    /// No coefficient, a number that is not finite, an empty or reversed domain.
    pub fn new(coefficients: Vec<f64>, domain: [f64; 2]) -> Result<Self, CurveError> {
        Series::new(coefficients, domain).map(Self)
    }

    /// Coefficients, the constant first, in value units.
    pub fn coefficients(&self) -> &[f64] {
        &self.0.coefficients
    }

    /// Range of arguments, `[lower, upper]`.
    pub fn domain(&self) -> [f64; 2] {
        self.0.domain
    }

    /// Value at `x` (Horner), constant outside the domain.
    pub fn value(&self, x: f64) -> f64 {
        domain::held(self.0.domain, x, |x| {
            self.0.coefficients.iter().rev().fold(0.0, |sum, c| sum * x + c)
        })
    }

    /// Derivative at `x`, 0 outside the domain.
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
