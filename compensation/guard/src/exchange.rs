//! Inputs and outputs of a guard in one cycle: plain data.

use core::time::Duration;

use volcomp_vocabulary::PerChannel;

use crate::{Known, Reasons, Request, State, Wanted};

/// The positions of this cycle, from the path that corrects.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Reading {
    /// When the oldest of them held, on the clock of [`Inputs::now`].
    pub taken: Duration,
    /// As reported, mm and rad.
    pub positions: PerChannel<f64>,
}

/// The inputs of a guard in one cycle.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Inputs {
    /// When the cycle began, on a monotonic clock.
    pub now: Duration,
    /// The positions; `None` when the controller did not answer.
    pub reading: Option<Reading>,
    /// What is known of the correction that the controller applies.
    pub known: Known,
    /// The interlocks of the machine ([`Interlocks::reasons`](crate::Interlocks::reasons)); empty: none.
    pub interlocks: Reasons,
    /// The correction that the model wants; `None`: it has none.
    pub wanted: Option<Wanted>,
    /// Positions are old and the machine moves: what is held would become worse than nothing, and is to go out as fast as
    /// the slew allows. Counts while positions are stale.
    pub let_go: bool,
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
    /// Whether it is to be sent, and the heartbeat with it.
    pub write: bool,
    /// The state after this cycle.
    pub state: State,
    /// Why the state is what it is.
    pub reasons: Reasons,
    /// Cycles so far in which slew or acceleration held the output back.
    pub held_back: u64,
}
