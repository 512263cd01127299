use std::fmt;

use crate::{
    Fit, FitError, fit_bspline, fit_chebyshev, fit_cubic_table, fit_fourier, fit_linear_table,
    fit_mls, fit_polynomial, readings,
};

/// A kind of curve with its settings: a candidate of [`choose`](crate::choose).
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "serde", serde(rename_all = "snake_case"))]
#[non_exhaustive]
pub enum Method {
    /// A polynomial in powers of the argument.
    Polynomial {
        /// The highest power.
        order: usize,
    },
    /// A Chebyshev series.
    Chebyshev {
        /// The order of its last term.
        order: usize,
    },
    /// A Fourier series.
    Fourier {
        /// The number of harmonics.
        order: usize,
        /// Period of the first harmonic, in units of the argument.
        period: f64,
    },
    /// A smoothing B-spline, smoothed by generalised cross-validation.
    BSpline,
    /// Moving least squares: a local polynomial about each place.
    MovingLeastSquares {
        /// Order of the local polynomials.
        order: usize,
        /// Half width of the weight as a share of the range.
        support: f64,
        /// Shape of the weight function.
        shape: f64,
    },
    /// Table of the mean reading of each target, with monotone cubic interpolation.
    CubicTable,
    /// Table of the mean reading of each target, with linear interpolation.
    LinearTable,
}

impl Method {
    /// Fits readings `u` at `x` with this method, over the range of `x`. A polynomial of order 0 also accepts readings
    /// at a single target.
    ///
    /// # Errors
    /// The errors of the fit with this method.
    pub fn fit(self, x: &[f64], u: &[f64]) -> Result<Fit, FitError> {
        readings::check(x, u)?;
        let lower = x.iter().copied().fold(f64::INFINITY, f64::min);
        let upper = x.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        let domain = [lower, upper];
        match self {
            Self::Polynomial { order: 0 } if lower == upper => {
                let targets = readings::checked_targets(x, u, 1, "a curve")?;
                let curve = volcomp_curve::Curve::constant(targets[0][1])?;
                Ok(Fit::new(curve, x, u, std::iter::empty()))
            }
            Self::Polynomial { order } => fit_polynomial(x, u, order, domain),
            Self::Chebyshev { order } => fit_chebyshev(x, u, order, domain),
            Self::Fourier { order, period } => {
                // A curve over the full period is valid everywhere, also beyond the last target.
                let gaps = readings::targets(x, u).len().saturating_sub(1).max(1) as f64;
                let range = upper - lower;
                let domain = if range >= period - 1.5 * range / gaps && range < period {
                    [upper - period, lower + period]
                } else {
                    domain
                };
                fit_fourier(x, u, order, period, domain)
            }
            Self::BSpline => fit_bspline(x, u),
            Self::MovingLeastSquares { order, support, shape } => {
                fit_mls(x, u, order, support, shape)
            }
            Self::CubicTable => fit_cubic_table(x, u),
            Self::LinearTable => fit_linear_table(x, u),
        }
    }

    /// Name of the kind of curve, without its settings.
    pub fn kind(self) -> &'static str {
        match self {
            Self::Polynomial { .. } => "polynomial",
            Self::Chebyshev { .. } => "Chebyshev series",
            Self::Fourier { .. } => "Fourier series",
            Self::BSpline => "smoothing B-spline",
            Self::MovingLeastSquares { .. } => "moving least squares",
            Self::CubicTable => "monotone table",
            Self::LinearTable => "linear table",
        }
    }
}

/// Formats the kind of curve with its settings: `polynomial of order 3`.
impl fmt::Display for Method {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Polynomial { order } | Self::Chebyshev { order } => {
                write!(f, "{} of order {order}", self.kind())
            }
            Self::Fourier { order, .. } => write!(f, "{} of {order} harmonics", self.kind()),
            Self::MovingLeastSquares { order, support, .. } => {
                write!(f, "{} of order {order}, support {support:.3}", self.kind())
            }
            Self::BSpline | Self::CubicTable | Self::LinearTable => f.write_str(self.kind()),
        }
    }
}
