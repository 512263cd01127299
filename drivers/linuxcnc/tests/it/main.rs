//! Tests of the protocol, and of the driver with a simulated bridge.
#![expect(clippy::unwrap_used, reason = "tests")]

mod bridge;
mod c_bridge;
mod codec;
mod component;
mod controller;
mod frames;
mod ini;
mod key;
mod servo_barrier;
mod settings;

/// Aborts the test on a forbidden allocation.
#[global_allocator]
static ALLOCATOR: assert_no_alloc::AllocDisabler = assert_no_alloc::AllocDisabler;
