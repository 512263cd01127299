#![doc = include_str!("../README.md")]
#![no_std]
extern crate alloc;

mod bspline;
mod curve;
mod domain;
mod error;
mod error_curve;
mod lag;
mod mls;
#[cfg(feature = "serde")]
mod serialised;
mod series;
mod table;

pub use bspline::BSpline;
pub use curve::Curve;
pub use error::CurveError;
pub use error_curve::{ErrorCurve, Field, Grid};
pub use lag::{SmoothedRate, first_order_lag, first_order_lag_of_ramp};
pub use mls::{MovingLeastSquares, NestedSolutions};
pub use series::{Chebyshev, Fourier, Polynomial};
pub use table::{Interpolation, Table};

#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;
