//! The protocol, and the driver against a bridge in this process.
#![expect(clippy::unwrap_used, reason = "tests")]

mod bridge;
mod c_bridge;
mod causes;
mod codec;
mod component;
mod controller;
mod frames;
mod fuzz_corpus;
mod ini;
mod key;
mod servo_barrier;
mod settings;

/// Ends the run on an allocation where one is forbidden.
#[global_allocator]
static ALLOCATOR: assert_no_alloc::AllocDisabler = assert_no_alloc::AllocDisabler;
