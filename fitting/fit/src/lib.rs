//! From readings to error curves: every function takes targets and readings and returns a [`Fit`],
//! the curve with its residuals and its leave-one-out error.
//!
//! | function | curve |
//! | --- | --- |
//! | [`fit_polynomial`], [`fit_chebyshev`] | least squares, Householder QR on Chebyshev polynomials |
//! | [`fit_fourier`] | least squares, for rotary axes |
//! | [`fit_mls`], [`fit_mls_auto`] | moving least squares; order and support chosen by leave-one-out |
//! | [`fit_bspline`] | cubic smoothing spline, generalised cross-validation |
//! | [`fit_linear_table`], [`fit_cubic_table`] | mean of each target, straight lines or monotone cubics |
//! | [`fit_auto`] | chooses by the number of targets |
//!
//! [`fit_thermal`] finds drift terms from temperatures and a displacement over time.
//!
//! Arguments and readings are in the caller's units. Several runs are simply repeated targets, in
//! any order.
//!
//! ```
//! // Two runs over five targets: mm and µm.
//! let x = [0.0, 100.0, 200.0, 300.0, 400.0, 0.0, 100.0, 200.0, 300.0, 400.0];
//! let u = [0.1, 1.2, 3.9, 9.1, 16.0, -0.1, 0.8, 4.1, 8.9, 16.0];
//! let fit = volcomp_fit::fit_polynomial(&x, &u, 2, [0.0, 400.0])?;
//! assert!((fit.curve.value(250.0) - 6.25).abs() < 0.1);
//! assert!(fit.rms() < fit.leave_one_out_rms);
//! # Ok::<(), volcomp_fit::FitError>(())
//! ```

mod auto;
mod bspline;
mod error;
mod fit;
mod fourier;
mod least_squares;
mod mls;
mod polynomial;
mod readings;
mod table;
mod thermal;

pub use auto::fit_auto;
pub use bspline::fit_bspline;
pub use error::FitError;
pub use fit::Fit;
pub use fourier::fit_fourier;
pub use mls::{fit_mls, fit_mls_auto};
pub use polynomial::{fit_chebyshev, fit_polynomial};
pub use table::{fit_cubic_table, fit_linear_table};
pub use thermal::{
    ThermalChoice, ThermalFit, ThermalOptions, ThermalRecord, ThermalSegment, ThermalTerm,
    fit_thermal, refit_thermal,
};
pub use volcomp_curve as curve;

/// Holds the README's example, so that it is run as a test.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;
