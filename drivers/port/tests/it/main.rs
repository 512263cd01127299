//! Tests of traits, simulated machine, injected faults and reconnection.

#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

mod description;
mod faults;
mod simulated;
mod supply;

use std::{sync::Arc, time::Duration};

use volcomp_port::{
    Axis, Clock,
    simulated::{Machine, Move, Warming},
};
use volcomp_vocabulary::{AxisName, Displacement, Mm, PerChannel};

/// Aborts the test if a cycle allocates or frees memory.
#[global_allocator]
static ALLOCATOR: assert_no_alloc::AllocDisabler = assert_no_alloc::AllocDisabler;

fn axis(name: AxisName, includes_correction: bool) -> Axis {
    Axis { name, includes_correction, resolution: Displacement::Length(Mm(0.001)), largest: None }
}

fn place(x: f64, y: f64) -> PerChannel<f64> {
    PerChannel::leading([x, y])
}

/// A machine that moves around a rectangle of 300 × 400 mm. X has an error of 2e-5 of its position plus 1 µm/K.
fn machine(clock: Clock) -> Machine {
    let step = |(x, y, dwell_ms)| Move {
        to: place(x, y),
        feed_per_s: 200.0,
        dwell: Duration::from_millis(dwell_ms),
    };
    Machine {
        axes: vec![axis(AxisName::X, false), axis(AxisName::Y, true)],
        program: [(300.0, 0.0, 0), (300.0, 400.0, 100), (0.0, 0.0, 0)].map(step).to_vec(),
        acceleration_per_s2: 1000.0,
        sensors: vec![Warming {
            name: "scale_x".to_owned(),
            start_degc: 20.0,
            rise_k: 5.0,
            time_constant_s: 100.0,
        }],
        truth: Arc::new(|at, degc| place(2e-5 * at[0] + 0.001 * (degc[0] - 20.0), 0.0)),
        clock,
    }
}
