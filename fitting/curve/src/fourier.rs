use alloc::vec::Vec;
use core::f64::consts::TAU;

use crate::{CurveError, domain, series::affine_series};

/// Fourier series `a0 + a1 cos θ + b1 sin θ + a2 cos 2θ + b2 sin 2θ + …` with `θ = 2πx / period`.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Serialize, serde::Deserialize),
    serde(try_from = "crate::serialised::Fourier")
)]
pub struct Fourier {
    coefficients: Vec<f64>,
    period: f64,
    domain: [f64; 2],
}

impl Fourier {
    /// Builds the series from `a0, a1, b1, a2, b2, …` (value units), its period and its domain
    /// (argument units).
    ///
    /// # Errors
    /// No coefficient, an even number of coefficients, a number that is not finite, a period that is not positive, an
    /// empty or reversed domain.
    pub fn new(coefficients: Vec<f64>, period: f64, domain: [f64; 2]) -> Result<Self, CurveError> {
        domain::at_least("Fourier coefficients", coefficients.len(), 1)?;
        if coefficients.len().is_multiple_of(2) {
            return Err(CurveError::UnpairedHarmonic { found: coefficients.len() });
        }
        domain::finite("Fourier coefficient", &coefficients)?;
        domain::positive("period", period)?;
        domain::interval(domain)?;
        Ok(Self { coefficients, period, domain })
    }

    /// Coefficients `a0, a1, b1, a2, b2, …`, in value units.
    pub fn coefficients(&self) -> &[f64] {
        &self.coefficients
    }

    /// Period, in argument units.
    pub fn period(&self) -> f64 {
        self.period
    }

    pub fn domain(&self) -> [f64; 2] {
        self.domain
    }

    /// Value at `x`, in value units. Outside the domain the end value is kept.
    pub fn value(&self, x: f64) -> f64 {
        domain::held(self.domain, x, |x| {
            self.harmonics(x).fold(self.coefficients[0], |sum, h| sum + h.a * h.cos + h.b * h.sin)
        })
    }

    pub fn derivative(&self, x: f64) -> f64 {
        domain::slope(self.domain, x, |x| {
            let per_radian: f64 =
                self.harmonics(x).map(|h| h.order * (h.b * h.cos - h.a * h.sin)).sum();
            per_radian * TAU / self.period
        })
    }

    fn harmonics(&self, x: f64) -> impl Iterator<Item = Harmonic> + '_ {
        let (sin1, cos1) = libm::sincos(TAU * (x / self.period));
        let (mut sin, mut cos) = (0.0, 1.0);
        self.coefficients[1..].chunks_exact(2).zip(1_u32..).map(move |(pair, order)| {
            (sin, cos) = (sin * cos1 + cos * sin1, cos * cos1 - sin * sin1);
            Harmonic { order: f64::from(order), a: pair[0], b: pair[1], cos, sin }
        })
    }

    /// Replaces every value by `scale` times the value plus `c`.
    pub(crate) fn affine(mut self, scale: f64, c: f64) -> Self {
        affine_series(&mut self.coefficients, scale, c);
        self
    }
}

/// One harmonic of the series at one argument: its order, its cosine coefficient `a`, its sine coefficient `b`, and the
/// values of both functions.
struct Harmonic {
    order: f64,
    a: f64,
    b: f64,
    cos: f64,
    sin: f64,
}
