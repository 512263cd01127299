//! The compiled machine compared with the exact form on curve objects, closed forms and a second implementation.

#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

mod blob;
mod builder;
mod chord;
mod differential;
mod machines;

/// Aborts the test on an allocation in a section that forbids it.
#[global_allocator]
static ALLOCATOR: assert_no_alloc::AllocDisabler = assert_no_alloc::AllocDisabler;

/// A machine file with every kind of curve in it.
pub const EXAMPLE: &str = volcomp_test_support::machines::EVERY_CURVE;
