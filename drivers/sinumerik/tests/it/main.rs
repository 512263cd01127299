//! The driver against a simulated control on another OPC UA library.

#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

mod controller;
mod map;
mod peer;
mod reading;
mod secured;
mod thermometer;

/// Ends the run on an allocation where one is forbidden.
#[global_allocator]
static ALLOCATOR: assert_no_alloc::AllocDisabler = assert_no_alloc::AllocDisabler;
