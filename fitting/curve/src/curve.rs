use alloc::vec::Vec;

use volcomp_vocabulary::is_within;

use crate::{
    BSpline, Chebyshev, CurveError, Fourier, MovingLeastSquares, Polynomial, Table, domain,
};

/// Function of one coordinate, in the caller's units.
///
/// Outside its domain a curve keeps its end value and has the derivative 0. [`contains`](Self::contains) returns
/// whether an argument is inside. A NaN argument gives NaN. Evaluation neither allocates nor panics.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Serialize, serde::Deserialize),
    serde(rename_all = "snake_case")
)]
pub enum Curve {
    /// Same value everywhere. The domain is unbounded.
    Constant(
        #[cfg_attr(feature = "serde", serde(deserialize_with = "crate::serialised::finite"))] f64,
    ),
    /// Sum of powers of the argument.
    #[cfg_attr(feature = "serde", serde(rename = "poly"))]
    Polynomial(Polynomial),
    /// Series of Chebyshev polynomials.
    Chebyshev(Chebyshev),
    /// Nodes joined by straight lines or monotone cubics.
    Table(Table),
    /// Spline over a knot vector.
    #[cfg_attr(feature = "serde", serde(rename = "bspline"))]
    BSpline(BSpline),
    /// Fourier series, for rotary axes.
    Fourier(Fourier),
    /// Moving least squares over nodes.
    #[cfg_attr(feature = "serde", serde(rename = "mls"))]
    MovingLeastSquares(MovingLeastSquares),
}

impl Curve {
    /// # Errors
    /// The value is not finite.
    pub fn constant(value: f64) -> Result<Self, CurveError> {
        domain::finite("constant", &[value])?;
        Ok(Self::Constant(value))
    }

    /// Value at `x`; NaN if `x` is NaN. Outside the domain the end value is kept.
    pub fn value(&self, x: f64) -> f64 {
        match self {
            Self::Constant(c) => nan_or(x, *c),
            Self::Polynomial(c) => c.value(x),
            Self::Chebyshev(c) => c.value(x),
            Self::Table(c) => c.value(x),
            Self::BSpline(c) => c.value(x),
            Self::Fourier(c) => c.value(x),
            Self::MovingLeastSquares(c) => c.value(x),
        }
    }

    /// Derivative at `x`: at the ends of the domain the one-sided derivative from inside, outside the domain 0.
    pub fn derivative(&self, x: f64) -> f64 {
        match self {
            Self::Constant(_) => nan_or(x, 0.0),
            Self::Polynomial(c) => c.derivative(x),
            Self::Chebyshev(c) => c.derivative(x),
            Self::Table(c) => c.derivative(x),
            Self::BSpline(c) => c.derivative(x),
            Self::Fourier(c) => c.derivative(x),
            Self::MovingLeastSquares(c) => c.derivative(x),
        }
    }

    /// Range of arguments for which the curve was built; `None` for a constant, which is valid everywhere.
    pub fn domain(&self) -> Option<[f64; 2]> {
        match self {
            Self::Constant(_) => None,
            Self::Polynomial(c) => Some(c.domain()),
            Self::Chebyshev(c) => Some(c.domain()),
            Self::Table(c) => Some(c.domain()),
            Self::BSpline(c) => Some(c.domain()),
            Self::Fourier(c) => Some(c.domain()),
            Self::MovingLeastSquares(c) => Some(c.domain()),
        }
    }

    /// Whether `x` is in the domain, including the ends and a tolerance for rounding
    /// ([`COORDINATE_ROUNDING`](volcomp_vocabulary::COORDINATE_ROUNDING)). Returns `false` for NaN.
    pub fn contains(&self, x: f64) -> bool {
        self.domain().map_or(!x.is_nan(), |domain| is_within(domain, x))
    }

    /// Arguments at which a derivative of any order may jump: the ends of the domain, nodes, knots, and the ends of the
    /// supports of moving least-squares weights. They are sorted and without duplicates; empty for a constant.
    pub fn breakpoints(&self) -> Vec<f64> {
        let Some(ends) = self.domain() else {
            return Vec::new();
        };
        let mut points = Vec::from(ends);
        match self {
            Self::Table(table) => points.extend(table.nodes().iter().map(|n| n[0])),
            Self::BSpline(spline) => points.extend(spline.knots()),
            Self::MovingLeastSquares(mls) => {
                let h = mls.half_width();
                points.extend(mls.nodes().iter().flat_map(|n| [n[0] - h, n[0], n[0] + h]));
            }
            Self::Constant(_) | Self::Polynomial(_) | Self::Chebyshev(_) | Self::Fourier(_) => {}
        }
        points.retain(|&x| domain::contains(ends, x));
        points.sort_by(f64::total_cmp);
        points.dedup();
        points
    }

    /// Adds the constant `c` to all values. The kind of curve stays the same.
    #[must_use]
    pub fn offset(self, c: f64) -> Self {
        self.affine(1.0, c)
    }

    /// Multiplies all values by `factor`. The kind of curve stays the same.
    #[must_use]
    pub fn scaled(self, factor: f64) -> Self {
        self.affine(factor, 0.0)
    }

    fn affine(self, scale: f64, c: f64) -> Self {
        match self {
            Self::Constant(value) => Self::Constant(value * scale + c),
            Self::Polynomial(curve) => Self::Polynomial(curve.affine(scale, c)),
            Self::Chebyshev(curve) => Self::Chebyshev(curve.affine(scale, c)),
            Self::Table(curve) => Self::Table(curve.affine(scale, c)),
            Self::BSpline(curve) => Self::BSpline(curve.affine(scale, c)),
            Self::Fourier(curve) => Self::Fourier(curve.affine(scale, c)),
            Self::MovingLeastSquares(curve) => Self::MovingLeastSquares(curve.affine(scale, c)),
        }
    }

    /// Name of the kind of curve, which is its key in a machine file.
    pub fn kind(&self) -> &'static str {
        match self {
            Self::Constant(_) => "constant",
            Self::Polynomial(_) => "poly",
            Self::Chebyshev(_) => "chebyshev",
            Self::Table(_) => "table",
            Self::BSpline(_) => "bspline",
            Self::Fourier(_) => "fourier",
            Self::MovingLeastSquares(_) => "mls",
        }
    }
}

fn nan_or(x: f64, value: f64) -> f64 {
    if x.is_nan() { x } else { value }
}

macro_rules! curve_from {
    ($($kind:ident),*) => {$(
        impl From<$kind> for Curve {
            fn from(curve: $kind) -> Self {
                Self::$kind(curve)
            }
        }
    )*};
}
curve_from!(Polynomial, Chebyshev, Table, BSpline, Fourier, MovingLeastSquares);
