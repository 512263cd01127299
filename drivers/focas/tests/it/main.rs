//! Tests frames with public captures, client and controller with the simulator, and the simulator with an independent
//! client.

#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

mod abilities;
mod barrier;
mod client;
mod config;
mod connection;
mod controller;
mod frames;
mod parameters;

use std::time::Duration;

use volcomp_focas::{
    FocasConfig, PmcAddress, PmcArea,
    simulator::{Options, Simulator, World},
};
use volcomp_port::Backoff;
use volcomp_vocabulary::AxisName;

#[global_allocator]
static ALLOCATOR: assert_no_alloc::AllocDisabler = assert_no_alloc::AllocDisabler;

/// Timeout of all waits; long enough for a busy computer.
const TIMEOUT: Duration = Duration::from_secs(60);

fn simulator(options: Options) -> Simulator {
    Simulator::start("127.0.0.1:0", options, World::new(&['X', 'Y', 'Z', 'C'])).unwrap()
}

fn at(area: PmcArea, at: u16) -> PmcAddress {
    PmcAddress { area, at }
}

fn config(simulator: &Simulator, axes: &[AxisName]) -> FocasConfig {
    FocasConfig {
        port: simulator.address().port(),
        backoff: Backoff { first: Duration::from_millis(1), most: Duration::from_millis(20) },
        ..FocasConfig::new("127.0.0.1", axes)
    }
}

fn until(what: &str, holds: impl Fn() -> bool) {
    volcomp_test_support::until(what, TIMEOUT, holds);
}
