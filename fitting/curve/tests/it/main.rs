//! Tests of curves against closed forms, SciPy and independent second implementations.

#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

mod closed_forms;
mod every_curve;
mod refusals;
#[cfg(feature = "serde")]
mod serialised;
