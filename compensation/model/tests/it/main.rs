//! The machine file, its errors and its evaluation, compared with closed forms.

#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

mod absurd;
mod evaluation;
mod inverse;
mod machine_file;
mod thermal;
mod volumetric;

/// Aborts the test on an allocation in a section that forbids it.
#[global_allocator]
static ALLOCATOR: assert_no_alloc::AllocDisabler = assert_no_alloc::AllocDisabler;

/// The example of the file format, with every kind of curve.
pub const EXAMPLE: &str = volcomp_test_support::machines::EVERY_CURVE;
