//! Sensitivities and formulas against the model itself, singular values and published counts.

#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]
