//! Tests of the driver with a simulated control, which uses an independent OPC UA library.

#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

mod controller;
mod map;
mod nested;
mod peer;
mod reading;
mod secured;
mod thermometer;

/// Aborts the test on a forbidden allocation.
#[global_allocator]
static ALLOCATOR: assert_no_alloc::AllocDisabler = assert_no_alloc::AllocDisabler;
