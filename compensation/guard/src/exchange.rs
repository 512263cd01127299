//! Inputs and outputs of a guard in one cycle: plain data.

use core::time::Duration;

use volcomp_vocabulary::PerChannel;

use crate::{ReadBackStatus, Reasons, Request, RequestedCorrection, State};

/// The positions of this cycle, from the active path.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Reading {
    /// Time at which the oldest of the positions was valid, on the clock of [`Inputs::now`].
    pub taken: Duration,
    /// Positions as reported, mm and rad.
    pub positions: PerChannel<f64>,
}

/// The inputs of a guard in one cycle.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Inputs {
    /// Start of the cycle, on a monotonic clock.
    pub now: Duration,
    /// The positions; `None` if the controller did not answer.
    pub reading: Option<Reading>,
    /// State of the correction that the controller applies.
    pub read_back: ReadBackStatus,
    /// The interlocks of the machine ([`Interlocks::reasons`](crate::Interlocks::reasons)); empty for none.
    pub interlocks: Reasons,
    /// The correction by the model; `None` if the model returns none.
    pub requested: Option<RequestedCorrection>,
    /// Set if positions are old while the machine moves. From an age of `hold` on, the correction then ramps out as
    /// fast as the slew allows, because a held correction would cause a larger error than no correction.
    pub fast_ramp_out: bool,
    /// The request of the operator or a program since the last cycle, if any.
    pub request: Option<Request>,
    /// Reasons that forbid arming; empty if arming is allowed.
    pub forbids: Reasons,
}

/// The decision of a guard in one cycle.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Output {
    /// The correction, multiples of the resolution, mm and rad.
    pub correction: PerChannel<f64>,
    /// Whether the correction is to be sent in this cycle, together with the heartbeat.
    pub write: bool,
    /// The state after this cycle.
    pub state: State,
    /// Reasons for the state.
    pub reasons: Reasons,
    /// Number of cycles so far in which slew or acceleration limited the output.
    pub held_back: u64,
}
