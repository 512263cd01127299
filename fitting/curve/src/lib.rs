#![doc = include_str!("../README.md")]
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
mod lag;
mod mls;
mod places;
mod polynomial;
#[cfg(feature = "serde")]
mod serialised;
mod series;
mod table;

pub use bspline::BSpline;
pub use chebyshev::Chebyshev;
pub use curve::Curve;
pub use error::CurveError;
pub use error_curve::{ErrorCurve, Field};
pub use fourier::Fourier;
pub use grid::Grid;
pub use lag::{SmoothedRate, first_order_lag, first_order_lag_of_ramp};
pub use mls::{MovingLeastSquares, NestedSolutions};
pub use polynomial::Polynomial;
pub use table::{Interpolation, Table};

#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;
