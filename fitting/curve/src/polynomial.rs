use alloc::vec::Vec;

use crate::{CurveError, domain};

/// A polynomial `c0 + c1 x + c2 x² + …` on a domain.
#[derive(Clone, Debug, PartialEq)]
pub struct Polynomial {
    coefficients: Vec<f64>,
    domain: [f64; 2],
}

impl Polynomial {
    /// Builds the polynomial from its coefficients, constant first (value units over argument
    /// units to the power), and its domain.
    ///
    /// # Errors
    /// No coefficient, a number that is not finite, an empty or reversed domain.
    pub fn new(coefficients: Vec<f64>, domain: [f64; 2]) -> Result<Self, CurveError> {
        domain::at_least("coefficients", coefficients.len(), 1)?;
        domain::finite("coefficient", &coefficients)?;
        domain::interval(domain)?;
        Ok(Self {
            coefficients,
            domain,
        })
    }

    /// The coefficients, constant first.
    pub fn coefficients(&self) -> &[f64] {
        &self.coefficients
    }

    /// The range of arguments.
    pub fn domain(&self) -> [f64; 2] {
        self.domain
    }

    /// The value at `x` (Horner), held outside the domain.
    pub fn value(&self, x: f64) -> f64 {
        domain::held(self.domain, x, |x| {
            self.coefficients
                .iter()
                .rev()
                .fold(0.0, |sum, c| sum * x + c)
        })
    }

    /// The derivative at `x`, 0 outside the domain.
    pub fn derivative(&self, x: f64) -> f64 {
        domain::slope(self.domain, x, |x| {
            let powers = self.coefficients.iter().enumerate().skip(1).rev();
            powers.fold(0.0, |sum, (k, c)| sum * x + k as f64 * c)
        })
    }

    /// Every value times `scale` plus `c`.
    pub(crate) fn affine(mut self, scale: f64, c: f64) -> Self {
        for coefficient in &mut self.coefficients {
            *coefficient *= scale;
        }
        self.coefficients[0] += c;
        self
    }
}
