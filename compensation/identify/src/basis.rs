//! Curves as sums of modes: a constant, a line, and modes of increasing curvature. A penalty can shrink the modes.

use volcomp_curve::{BSpline, Chebyshev, Curve, CurveError, Fourier};
use volcomp_kinematics::nalgebra::DMatrix;

const DEGREE: usize = 3;

/// Kind of curve of an error.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Basis {
    /// One value, independent of the coordinate.
    Constant,
    /// Legendre polynomials up to this order over the range of the observations.
    Legendre {
        /// Highest polynomial order. The number of coefficients is one more than the order.
        order: usize,
    },
    /// A cubic B-spline on uniform knots over the range of the observations.
    BSpline {
        /// Number of coefficients, 4 or more.
        coefficients: usize,
    },
    /// A Fourier series of period 360°.
    Fourier {
        /// Number of harmonics.
        harmonics: usize,
    },
}

impl Basis {
    pub(crate) fn highest_order(self) -> usize {
        match self {
            Self::Constant => 0,
            Self::Legendre { order } => order,
            Self::BSpline { coefficients } => coefficients.saturating_sub(1),
            Self::Fourier { harmonics } => harmonics,
        }
    }
}

/// Modes φ_m of one curve: value(q) = Σ c_m φ_m(q), q in mm or deg.
#[derive(Clone, Debug)]
pub(crate) struct Modes {
    basis: Basis,
    domain: [f64; 2],
    /// Knots of a B-spline; empty for other bases.
    knots: Vec<f64>,
    /// Spline coefficients of each mode of a B-spline, one column for each mode.
    columns: DMatrix<f64>,
    /// The spline of each mode of a B-spline.
    splines: Vec<BSpline>,
    weights: Vec<f64>,
}

impl Modes {
    /// Creates the modes of a basis over the range of the observations, mm or deg. Fails if no spline can be built over
    /// this range.
    pub(crate) fn new(basis: Basis, domain: [f64; 2]) -> Result<Self, CurveError> {
        let mut modes = Self {
            basis,
            domain,
            knots: Vec::new(),
            columns: DMatrix::zeros(0, 0),
            splines: Vec::new(),
            weights: vec![0.0],
        };
        match basis {
            Basis::Constant => {}
            // k³ is between the power k² of a penalty on slope and the power k⁴ of a penalty on bending.
            Basis::Legendre { order } => {
                let weights = (1..=order).map(|k| (k as f64).powi(3));
                modes.weights.extend(weights);
            }
            Basis::Fourier { harmonics } => {
                for k in 1..=harmonics {
                    modes.weights.extend([(k as f64).powi(3); 2]);
                }
            }
            Basis::BSpline { coefficients } => modes.spline(coefficients.max(DEGREE + 1))?,
        }
        Ok(modes)
    }

    /// Builds the spline modes: a constant, a line, and then the eigenvectors of the second-difference penalty by
    /// rising penalty.
    fn spline(&mut self, count: usize) -> Result<(), CurveError> {
        let [lower, upper] = self.domain;
        let segments = count - DEGREE;
        let step = (upper - lower) / segments as f64;
        let knot = |i: usize| match i {
            // The knots at the ends of the range equal the ends exactly, without rounding.
            _ if i == DEGREE => lower,
            _ if i == DEGREE + segments => upper,
            _ => lower + (i as f64 - DEGREE as f64) * step,
        };
        self.knots = (0..=segments + 2 * DEGREE).map(knot).collect();
        let mut differences = DMatrix::<f64>::zeros(count - 2, count);
        for row in 0..count - 2 {
            differences[(row, row)] = 1.0;
            differences[(row, row + 1)] = -2.0;
            differences[(row, row + 2)] = 1.0;
        }
        let eigen = (differences.transpose() * &differences).symmetric_eigen();
        let mut order: Vec<usize> = (0..count).collect();
        order.sort_by(|a, b| eigen.eigenvalues[*a].total_cmp(&eigen.eigenvalues[*b]));
        self.columns = DMatrix::zeros(count, count);
        for row in 0..count {
            self.columns[(row, 0)] = 1.0;
            // Linearly rising coefficients give a line; this line is 1 at the upper end of the domain.
            let place = row as f64 - 0.5 * (count - 1) as f64;
            self.columns[(row, 1)] = 2.0 * place / segments as f64;
        }
        let least = eigen.eigenvalues[order[2]];
        self.weights = vec![0.0, 1.0];
        let size = (count as f64).sqrt();
        for (mode, &source) in order.iter().enumerate().skip(2) {
            let column = eigen.eigenvectors.column(source) * size;
            self.columns.set_column(mode, &column);
            // The first bent mode has order 2, hence the weight 2³ = 8 relative to the slope's weight of 1.
            self.weights.push(8.0 * eigen.eigenvalues[source] / least);
        }
        let columns = self.columns.column_iter();
        let spline = |column: Vec<f64>| BSpline::new(self.knots.clone(), column, DEGREE);
        let splines = columns.map(|column| spline(column.iter().copied().collect()));
        self.splines = splines.collect::<Result<_, _>>()?;
        Ok(())
    }

    /// Range of the modes, mm or deg.
    pub(crate) fn domain(&self) -> [f64; 2] {
        self.domain
    }

    pub(crate) fn len(&self) -> usize {
        self.weights.len()
    }

    /// Weight of each mode in the penalty; 0 for the constant.
    pub(crate) fn weights(&self) -> &[f64] {
        &self.weights
    }

    /// Label of a mode. The name of a coefficient is the name of the error and this label.
    pub(crate) fn label(&self, mode: usize) -> String {
        match (self.basis, mode) {
            (_, 0) => "constant".to_owned(),
            (Basis::Constant | Basis::Legendre { .. }, _) => format!("legendre {mode}"),
            (Basis::BSpline { .. }, 1) => "slope".to_owned(),
            (Basis::BSpline { .. }, _) => format!("bspline {mode}"),
            (Basis::Fourier { .. }, _) if mode % 2 == 1 => format!("cos {}", mode.div_ceil(2)),
            (Basis::Fourier { .. }, _) => format!("sin {}", mode / 2),
        }
    }

    /// Order of a mode. If modes of several curves cannot be distinguished, modes of lower order are kept first.
    pub(crate) fn order(&self, mode: usize) -> usize {
        match self.basis {
            Basis::Fourier { .. } => mode.div_ceil(2),
            _ => mode,
        }
    }

    /// Values of all modes at a coordinate, mm or deg; constant outside the range, except for Fourier.
    pub(crate) fn values(&self, at: f64) -> Vec<f64> {
        let [lower, upper] = self.domain;
        let held = at.clamp(lower, upper);
        match self.basis {
            Basis::Constant => vec![1.0],
            Basis::Legendre { order } => {
                legendre((2.0 * held - lower - upper) / (upper - lower), order)
            }
            Basis::Fourier { harmonics } => {
                let mut values = vec![1.0];
                for k in 1..=harmonics {
                    let (sin, cos) = (k as f64 * at.to_radians()).sin_cos();
                    values.extend([cos, sin]);
                }
                values
            }
            Basis::BSpline { .. } => {
                (self.splines.iter()).map(|spline| spline.value(held)).collect()
            }
        }
    }

    pub(crate) fn curve(&self, coefficients: &[f64]) -> Result<Curve, CurveError> {
        let first = coefficients.first().copied().unwrap_or_default();
        Ok(match self.basis {
            Basis::Constant => Curve::constant(first)?,
            Basis::Legendre { order } => {
                let value = |t: f64| {
                    let values = legendre(t, order);
                    values.iter().zip(coefficients).map(|(p, c)| p * c).sum()
                };
                Chebyshev::new(chebyshev_of(value, order), self.domain)?.into()
            }
            Basis::Fourier { .. } => {
                Fourier::new(coefficients.to_vec(), 360.0, self.domain)?.into()
            }
            Basis::BSpline { .. } => {
                let mut found = vec![0.0; self.columns.nrows()];
                for (column, c) in self.columns.column_iter().zip(coefficients) {
                    for (sum, part) in found.iter_mut().zip(&column) {
                        *sum += c * part;
                    }
                }
                BSpline::new(self.knots.clone(), found, DEGREE)?.into()
            }
        })
    }
}

/// Legendre polynomials P_0 to P_order at t.
pub(crate) fn legendre(t: f64, order: usize) -> Vec<f64> {
    let mut values = vec![1.0];
    let (mut before, mut now) = (1.0, t);
    for k in 1..=order {
        values.push(now);
        let n = k as f64;
        (before, now) = (now, ((2.0 * n + 1.0) * t * now - n * before) / (n + 1.0));
    }
    values
}

/// Chebyshev coefficients of a polynomial of this order on [−1, 1], from its values at the Chebyshev nodes.
fn chebyshev_of(value: impl Fn(f64) -> f64, order: usize) -> Vec<f64> {
    let count = order + 1;
    let angle = |node: usize| core::f64::consts::PI * (node as f64 + 0.5) / count as f64;
    let values: Vec<f64> = (0..count).map(|node| value(angle(node).cos())).collect();
    let coefficient = |k: usize| {
        let terms = values.iter().enumerate();
        let sum: f64 = terms.map(|(node, v)| v * (k as f64 * angle(node)).cos()).sum();
        sum * if k == 0 { 1.0 } else { 2.0 } / count as f64
    };
    (0..count).map(coefficient).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_curve_of_a_machine_file_has_the_values_of_the_modes() {
        for basis in [
            Basis::Constant,
            Basis::Legendre { order: 1 },
            Basis::Legendre { order: 7 },
            Basis::Fourier { harmonics: 3 },
            Basis::BSpline { coefficients: 4 },
            Basis::BSpline { coefficients: 9 },
        ] {
            let modes = Modes::new(basis, [-120.0, 75.0]).expect("a range");
            let c: Vec<f64> = (0..modes.len()).map(|m| 3.0 - 1.7 * m as f64).collect();
            let curve = modes.curve(&c).expect("a curve");
            for at in [-120.0, -60.5, 0.0, 33.3, 75.0] {
                let values = modes.values(at);
                assert_eq!(values.len(), modes.len());
                let expected: f64 = values.iter().zip(&c).map(|(v, c)| v * c).sum();
                let found = curve.value(at);
                assert!((found - expected).abs() < 1e-10, "{basis:?} at {at}: {found} {expected}");
            }
        }
    }

    #[test]
    fn legendre_polynomials_match_the_closed_form() {
        let t: f64 = 0.3;
        let expected = [1.0, t, 1.5 * t * t - 0.5, 2.5 * t.powi(3) - 1.5 * t];
        for (found, expected) in legendre(t, 3).iter().zip(expected) {
            assert!((found - expected).abs() < 1e-15);
        }
    }

    #[test]
    fn constant_and_line_of_a_spline_are_not_bent() {
        let modes = Modes::new(Basis::BSpline { coefficients: 7 }, [0.0, 10.0]).expect("a range");
        for at in [0.0, 2.5, 5.0, 9.0, 10.0] {
            let values = modes.values(at);
            assert!((values[0] - 1.0).abs() < 1e-14);
            assert!((values[1] - (at / 5.0 - 1.0)).abs() < 1e-13, "{at}: {}", values[1]);
        }
    }

    /// A spline over an empty range is rejected, because all its modes would be 0.
    #[test]
    fn a_spline_over_no_range_is_refused() {
        for range in [[3.0, 3.0], [f64::NAN, 1.0], [0.0, f64::INFINITY]] {
            assert!(Modes::new(Basis::BSpline { coefficients: 6 }, range).is_err(), "{range:?}");
        }
    }
}
