//! Error curves over an axis coordinate: value, derivative and range.
//!
//! A [`Curve`] is a function of one coordinate: a constant, a polynomial, a Chebyshev or Fourier
//! series, a table with straight lines or monotone cubics, a B-spline, or moving least squares. A
//! [`Field`] is a curve or a [`Grid`] over two coordinates, an [`ErrorCurve`] adds the two branches
//! of a bidirectional error.
//!
//! Arguments and values are in the caller's units. Outside its range a curve holds its end value
//! and its derivative is 0; `contains` tells. Constructors refuse what cannot be evaluated, so
//! evaluation never fails: it neither allocates nor panics, and NaN gives NaN.
//!
//! ```
//! use volcomp_curve::{Curve, ErrorCurve, Table};
//! use volcomp_vocabulary::Direction;
//!
//! # fn main() -> Result<(), volcomp_curve::CurveError> {
//! // Positioning deviation in µm over the coordinate in mm.
//! let table = Table::cubic(vec![[0.0, 0.0], [400.0, 1.5], [800.0, 2.0]])?;
//! let curve = Curve::Table(table);
//! assert_eq!(curve.value(400.0), 1.5);
//! assert_eq!(curve.value(900.0), 2.0);
//! assert!(!curve.contains(900.0));
//!
//! // The same with a reversal value of 3 µm.
//! let error = ErrorCurve::with_reversal(curve.into(), 3.0)?;
//! assert_eq!(error.value(0, &[400.0], Some(Direction::Positive)), 3.0);
//! assert_eq!(error.value(0, &[400.0], None), 1.5);
//! # Ok(())
//! # }
//! ```
//!
//! # Features
//! The crate is `no_std` and needs `alloc` to build curves. Functions come from `libm` with and
//! without `std`, so a controller and a desk computer get the same digits. `std` (default) only
//! turns on the same feature of the dependencies.

#![no_std]
extern crate alloc;

mod bspline;
mod chebyshev;
mod curve;
mod domain;
mod error;
mod error_curve;
mod fourier;
mod grid;
mod mls;
mod polynomial;
mod table;

pub use bspline::BSpline;
pub use chebyshev::Chebyshev;
pub use curve::Curve;
pub use error::CurveError;
pub use error_curve::{ErrorCurve, Field};
pub use fourier::Fourier;
pub use grid::Grid;
pub use mls::MovingLeastSquares;
pub use polynomial::Polynomial;
pub use table::{Interpolation, Table};

/// Holds the README's example, so that it is run as a test.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;
