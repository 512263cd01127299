//! Curves that are series: polynomials, Chebyshev series and Fourier series.

use alloc::vec::Vec;
use core::f64::consts::TAU;

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
fn affine_series(coefficients: &mut [f64], scale: f64, c: f64) {
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
