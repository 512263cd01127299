//! Functions common to series and node lists: checks, scaling and shifting of values.

use alloc::vec::Vec;

use crate::{CurveError, domain};

/// Coefficients of a series on a domain. The first coefficient is the constant.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Serialize, serde::Deserialize),
    serde(try_from = "crate::serialised::Series")
)]
pub(crate) struct Series {
    pub(crate) coefficients: Vec<f64>,
    pub(crate) domain: [f64; 2],
}

impl Series {
    /// Rejects a series without a coefficient, numbers that are not finite, an empty or reversed domain.
    pub(crate) fn new(coefficients: Vec<f64>, domain: [f64; 2]) -> Result<Self, CurveError> {
        domain::at_least("coefficients", coefficients.len(), 1)?;
        domain::finite("coefficient", &coefficients)?;
        domain::interval(domain)?;
        Ok(Self { coefficients, domain })
    }

    /// Replaces every value by `scale` times the value plus `c`.
    pub(crate) fn affine(mut self, scale: f64, c: f64) -> Self {
        affine_series(&mut self.coefficients, scale, c);
        self
    }
}

/// Changes the coefficients so that every value of the series is multiplied by `scale` and shifted by `c`. The first
/// coefficient is the constant.
pub(crate) fn affine_series(coefficients: &mut [f64], scale: f64, c: f64) {
    for (place, coefficient) in coefficients.iter_mut().enumerate() {
        *coefficient *= scale;
        if place == 0 {
            *coefficient += c;
        }
    }
}

/// Multiplies every value of the nodes `[argument, value]` by `scale` and shifts it by `c`.
pub(crate) fn affine_nodes(nodes: &mut [[f64; 2]], scale: f64, c: f64) {
    for [_, value] in nodes {
        *value = *value * scale + c;
    }
}
