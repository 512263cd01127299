//! A curve of any kind.

use alloc::vec::Vec;
use core::f64::consts::PI;

use volcomp_vocabulary::is_within;

use crate::{
    BSpline, Chebyshev, CurveError, Fourier, Interpolation, MovingLeastSquares, Polynomial, Table,
    domain,
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

/// Number of sampled arguments for each order of a polynomial, and for half a period of the highest harmonic of a
/// Fourier series. The largest sampled value of a polynomial is then within 2 % of its maximum (1 − cos(π/16): Ehlich
/// and Zeller, Math. Z. 86, 1964).
const POSITIONS_PER_PIECE: usize = 8;
/// Maximum number of sampled arguments along the domain of a curve. Series with very many terms may need more.
const MAX_POSITIONS: usize = 4096;
/// Number of parts into which a cubic piece between two knots or nodes is divided.
const PARTS: u32 = 4;
/// Golden ratio. Its multiples, taken as phases, are spread evenly over a period.
const GOLDEN: f64 = 0.618_033_988_749_894_8;

impl Curve {
    /// Arguments at which to sample the curve in order to find its maximum, or its maximum difference from another
    /// curve. They are the [`breakpoints`](Self::breakpoints), and as many arguments between them as the kind of curve
    /// requires. A Fourier series has 16 for each period of its highest harmonic; a polynomial has 8 for each order,
    /// closer at the ends. They are sorted and without duplicates. If a Fourier series has too many periods, only one
    /// in several periods is sampled, each time at another phase.
    pub fn places(&self) -> Vec<f64> {
        let mut places = self.breakpoints();
        match self {
            Self::Constant(_) => {}
            Self::Polynomial(curve) => {
                places.extend(of_series(curve.domain(), curve.coefficients().len()));
            }
            Self::Chebyshev(curve) => {
                places.extend(of_series(curve.domain(), curve.coefficients().len()));
            }
            Self::Table(table) => places.extend(of_table(table)),
            Self::BSpline(spline) => places.extend(of_spline(spline)),
            Self::Fourier(curve) => places.extend(of_harmonics(curve)),
            Self::MovingLeastSquares(curve) => places.extend(of_weights(curve)),
        }
        if let Some(ends) = self.domain() {
            places.retain(|&x| domain::contains(ends, x));
        }
        places.sort_by(f64::total_cmp);
        places.dedup();
        places
    }
}

fn even([low, high]: [f64; 2], parts: usize) -> impl Iterator<Item = f64> {
    let parts = parts.max(1);
    (0..=parts).map(move |k| low + (high - low) * (k as f64 / parts as f64))
}

/// Extrema of the Chebyshev polynomial whose degree is a multiple of the degree of the series.
fn of_series([low, high]: [f64; 2], coefficients: usize) -> impl Iterator<Item = f64> {
    let parts = (coefficients.saturating_sub(1) * POSITIONS_PER_PIECE)
        .min(MAX_POSITIONS.max(2 * coefficients));
    let [middle, half] = [f64::midpoint(low, high), 0.5 * high - 0.5 * low];
    (0..=parts)
        .filter(move |_| parts > 0)
        .map(move |k| middle - half * libm::cos(PI * (k as f64 / parts as f64)))
}

/// No arguments for straight lines, whose extrema are at the nodes. The extrema of a monotone cubic are at the nodes
/// too, but its difference from another curve may have extrema anywhere.
fn of_table(table: &Table) -> Vec<f64> {
    match table.interpolation() {
        Interpolation::Linear => Vec::new(),
        Interpolation::Cubic => between(table.nodes().iter().map(|node| node[0])),
    }
}

fn of_spline(spline: &BSpline) -> Vec<f64> {
    between(spline.knots().iter().copied())
}

fn between(nodes: impl Iterator<Item = f64> + Clone) -> Vec<f64> {
    let pieces = nodes.clone().zip(nodes.skip(1));
    let inside = |(low, high): (f64, f64)| {
        (1..PARTS).map(move |k| low + (high - low) * (f64::from(k) / f64::from(PARTS)))
    };
    pieces.filter(|(low, high)| low < high).flat_map(inside).collect()
}

fn of_harmonics(curve: &Fourier) -> Vec<f64> {
    let order = curve.coefficients().len() / 2;
    let [low, high] = curve.domain();
    let periods = (high - low) / curve.period();
    if order == 0 {
        return Vec::new();
    }
    let each = 2 * POSITIONS_PER_PIECE * order;
    let most = MAX_POSITIONS.max(4 * each);
    let count = periods * each as f64;
    if count <= most as f64 {
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "positive and at most `most`"
        )]
        let parts = libm::ceil(count) as usize;
        return even([low, high], parts).collect();
    }
    // There are too many periods to sample each. So sample one in several periods, each time at another phase.
    let place = |k: usize| {
        let first = libm::floor(periods * (k as f64 / most as f64));
        let phase = k as f64 * GOLDEN;
        low + (first + (phase - libm::floor(phase))) * curve.period()
    };
    (0..most).map(place).collect()
}

/// Arguments spaced by the width of the weights, within which a local polynomial varies.
fn of_weights(curve: &MovingLeastSquares) -> impl Iterator<Item = f64> {
    let each = (POSITIONS_PER_PIECE * curve.order().max(1)) as f64;
    let count = (each / curve.support()).min(MAX_POSITIONS as f64);
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "positive and at most MAX_POSITIONS"
    )]
    let parts = libm::ceil(count) as usize;
    even(curve.domain(), parts)
}
