//! Tests of curves against closed forms, SciPy and independent second implementations.

#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

mod absurd;
mod closed_forms;
mod every_curve;
mod fields;
mod moving_least_squares;
mod refusals;
mod scipy;
#[cfg(feature = "serde")]
mod serialised;
