//! What a cycle tells: plain data of fixed size, copied out without a lock.

use std::time::Duration;

use volcomp_guard::{Reasons, State};
use volcomp_vocabulary::PerAxis;

/// Temperatures at the most.
pub const MAX_SENSORS: usize = 64;

/// One temperature as the cycle sees it.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SensorReport {
    /// degC; `None` when it is left out.
    pub degc: Option<f64>,
    /// Why it is left out; an index of [`SENSOR_TEXTS`], 0: good.
    pub flaw: u8,
}

/// What may be wrong with a temperature.
pub const SENSOR_TEXTS: [&str; 5] = ["", "broken or silent", "stale", "out of range", "jumping"];

/// One cycle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Report {
    /// Cycles so far.
    pub cycle: u64,
    /// Since the start.
    pub now: Duration,
    /// The state of the active path.
    pub state: State,
    /// Why.
    pub reasons: Reasons,
    /// Which path corrects.
    pub active: usize,
    /// Positions without correction in the machine's order, mm and rad; whether they are known.
    pub positions: PerAxis<f64>,
    /// As bits.
    pub known: u16,
    /// What the model wants, machine's order, mm and rad.
    pub wanted: PerAxis<f64>,
    /// What is written, machine's order.
    pub correction: PerAxis<f64>,
    /// The error of the model at the positions, um and urad.
    pub error: [f64; 6],
    /// Cycles in which slew or acceleration held the output back.
    pub held_back: u64,
    /// Exchanges that failed, of every path.
    pub faults: u64,
    /// Periods that were missed.
    pub overruns: u64,
    /// Temperatures in the order of the configuration.
    pub sensors: [SensorReport; MAX_SENSORS],
}

impl Default for Report {
    fn default() -> Self {
        Self {
            cycle: 0,
            now: Duration::ZERO,
            state: State::Disarmed,
            reasons: Reasons::NONE,
            active: 0,
            positions: PerAxis::ZERO,
            known: 0,
            wanted: PerAxis::ZERO,
            correction: PerAxis::ZERO,
            error: [0.0; 6],
            held_back: 0,
            faults: 0,
            overruns: 0,
            sensors: [SensorReport::default(); MAX_SENSORS],
        }
    }
}

/// How long a cycle took, ns.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Timing {
    /// From the deadline to the first instruction.
    pub wake_ns: u64,
    /// Everything, exchanges included.
    pub whole_ns: u64,
    /// Exchanges with controllers.
    pub exchange_ns: u64,
    /// Own work by the thread's CPU clock, without exchanges.
    pub own_ns: u64,
    /// Periods that were missed after this cycle.
    pub missed: u32,
}
