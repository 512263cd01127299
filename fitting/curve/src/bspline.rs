use alloc::vec::Vec;

use crate::{CurveError, domain};

const MAX_DEGREE: usize = 5;

/// Spline `Σ c_i B_i(x)` of B-splines of one degree (1 to 5) over a knot vector.
///
/// Its domain runs from `knots[degree]` to `knots[coefficients.len()]`.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Serialize, serde::Deserialize),
    serde(try_from = "crate::serialised::BSpline")
)]
pub struct BSpline {
    knots: Vec<f64>,
    coefficients: Vec<f64>,
    degree: usize,
}

impl BSpline {
    /// Builds the spline from non-decreasing knots (argument units), its coefficients (value units) and its degree. The
    /// number of knots must be `coefficients.len() + degree + 1`.
    ///
    /// # Errors
    /// A degree outside 1 to 5; too few coefficients; a wrong number of knots; knots that decrease, or are repeated so
    /// often that the spline would jump; a number that is not finite; an empty domain.
    pub fn new(knots: Vec<f64>, coefficients: Vec<f64>, degree: usize) -> Result<Self, CurveError> {
        if !(1..=MAX_DEGREE).contains(&degree) {
            let (lowest, highest) = (1, MAX_DEGREE);
            return Err(CurveError::OutOfRange { what: "degree", found: degree, lowest, highest });
        }
        domain::at_least("coefficients", coefficients.len(), degree + 1)?;
        let expected = coefficients.len() + degree + 1;
        if knots.len() != expected {
            return Err(CurveError::KnotCount {
                found: knots.len(),
                coefficients: coefficients.len(),
                degree,
                expected,
            });
        }
        domain::finite("knot", &knots)?;
        domain::finite("coefficient", &coefficients)?;
        if let Some(i) = knots.windows(2).position(|k| k[1] < k[0]) {
            let (previous, value) = (knots[i], knots[i + 1]);
            return Err(CurveError::KnotsDecrease { index: i + 1, previous, value });
        }
        let spline = Self { knots, coefficients, degree };
        domain::interval(spline.domain())?;
        spline.refuse_jumps()?;
        Ok(spline)
    }

    fn refuse_jumps(&self) -> Result<(), CurveError> {
        let [lower, upper] = self.domain();
        let mut index = 0;
        for same in self.knots.chunk_by(|a, b| a == b) {
            if lower < same[0] && same[0] < upper && same.len() > self.degree {
                let (value, found, degree) = (same[0], same.len(), self.degree);
                return Err(CurveError::KnotRepeated { index, value, found, degree });
            }
            index += same.len();
        }
        Ok(())
    }

    /// Knots, non-decreasing, in argument units.
    pub fn knots(&self) -> &[f64] {
        &self.knots
    }

    /// Coefficients, in value units.
    pub fn coefficients(&self) -> &[f64] {
        &self.coefficients
    }

    pub fn degree(&self) -> usize {
        self.degree
    }

    pub fn domain(&self) -> [f64; 2] {
        [self.knots[self.degree], self.knots[self.coefficients.len()]]
    }

    /// Value at `x`, in value units. Outside the domain the end value is kept. Algorithm: de Boor, J. Approx. Theory
    /// 6, 1972.
    pub fn value(&self, x: f64) -> f64 {
        domain::held(self.domain(), x, |x| {
            let span = self.span(x);
            let mut d = [0.0; MAX_DEGREE + 1];
            let first = span - self.degree;
            d[..=self.degree].copy_from_slice(&self.coefficients[first..=span]);
            de_boor(&self.knots, span, self.degree, &mut d, x)
        })
    }

    /// Derivative at `x`: at a knot the right-hand derivative, outside the domain 0.
    pub fn derivative(&self, x: f64) -> f64 {
        domain::slope(self.domain(), x, |x| {
            let (span, p) = (self.span(x), self.degree);
            let mut d = [0.0; MAX_DEGREE + 1];
            for (j, slope) in d[..p].iter_mut().enumerate() {
                let i = span - p + j;
                let rise = self.coefficients[i + 1] - self.coefficients[i];
                *slope = p as f64 * rise / (self.knots[i + p + 1] - self.knots[i + 1]);
            }
            de_boor(&self.knots[1..], span - 1, p - 1, &mut d, x)
        })
    }

    /// Index `k` with `knots[k] <= x < knots[k + 1]`. At the upper end of the domain, the index of the last non-empty
    /// span. `x` must be in the domain.
    fn span(&self, x: f64) -> usize {
        let inner = &self.knots[self.degree..=self.coefficients.len()];
        let mut above = inner.partition_point(|&t| t <= x);
        if above == inner.len() {
            above = inner.partition_point(|&t| t < x);
        }
        self.degree + above - 1
    }

    /// Replaces every value by `scale` times the value plus `c`. The coefficients are replaced in the same way, because
    /// the basis sums to 1.
    pub(crate) fn affine(mut self, scale: f64, c: f64) -> Self {
        for coefficient in &mut self.coefficients {
            *coefficient = *coefficient * scale + c;
        }
        self
    }
}

/// Value at `x` by de Boor's recurrence. `d` has the `degree + 1` coefficients that act on the span. Every denominator
/// is the width of an interval that contains the non-empty span, so none is 0.
fn de_boor(
    knots: &[f64],
    span: usize,
    degree: usize,
    d: &mut [f64; MAX_DEGREE + 1],
    x: f64,
) -> f64 {
    for level in 1..=degree {
        for j in (level..=degree).rev() {
            let lower = knots[span - degree + j];
            let upper = knots[span + 1 + j - level];
            let alpha = (x - lower) / (upper - lower);
            d[j] = (1.0 - alpha) * d[j - 1] + alpha * d[j];
        }
    }
    d[degree]
}
