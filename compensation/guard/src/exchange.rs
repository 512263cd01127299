//! Inputs and outputs of a guard in one cycle: plain data.

use core::time::Duration;

use volcomp_vocabulary::PerChannel;

use crate::{Reasons, Request, State};

/// The positions, the applied correction and the state that a controller reported in this cycle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Reading {
    /// When the positions held, on the clock of [`Inputs::now`].
    pub taken: Duration,
    /// As reported, mm and rad.
    pub positions: PerChannel<f64>,
    /// The correction that is applied, where the controller can be asked.
    pub applied: Option<PerChannel<f64>>,
    /// Every axis was sent to its reference.
    pub referenced: bool,
    /// An alarm is on.
    pub alarm: bool,
    /// The emergency stop is pressed.
    pub emergency_stop: bool,
}

/// The inputs of a guard in one cycle.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Inputs {
    /// When the cycle began, on a monotonic clock.
    pub now: Duration,
    /// The report of the controller; `None` when it did not answer.
    pub reading: Option<Reading>,
    /// The correction that the model wants, mm and rad; `None`: it has none.
    pub target: Option<PerChannel<f64>>,
    /// The request of a person or a program since the last cycle, if there was one.
    pub request: Option<Request>,
    /// Why arming is forbidden; empty where it is allowed.
    pub forbids: Reasons,
}

/// The decision of a guard in one cycle.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Output {
    /// The correction, multiples of the resolution, mm and rad.
    pub correction: PerChannel<f64>,
    /// Whether it is to be written, and the heartbeat with it.
    pub write: bool,
    /// The state after this cycle.
    pub state: State,
    /// Why the state is what it is.
    pub reasons: Reasons,
    /// Cycles so far in which slew or acceleration held the output back.
    pub held_back: u64,
}
