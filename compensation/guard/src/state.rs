//! States of a guard, the causes of their changes, and its inputs and outputs in one cycle, as plain data.

use core::time::Duration;

use volcomp_vocabulary::PerChannel;

use crate::{ReadBackStatus, Reasons, RequestedCorrection};

/// What the guard does with the correction in this cycle.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum State {
    /// Nothing is written to the controller.
    #[default]
    Disarmed,
    /// Armed, but the full correction is not applied yet: test shift or ramp-in.
    Arming(Phase),
    /// The correction follows the model.
    Compensating,
    /// The last correction is held.
    Holding(Hold),
    /// The correction ramps to zero.
    RampingOut(End),
    /// A fault that the operator must check; the correction ramps to zero.
    Faulted(Cause),
}

/// Phase from arming until the full correction is applied.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Phase {
    /// The test shift is testing whether positions contain the correction.
    Proving,
    /// The correction ramps in.
    Ramping,
}

/// Why the correction is held.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Hold {
    /// Positions are stale, or no correction is available.
    Stale,
    /// Positions were lost, and the correction has ramped to zero.
    Lost,
    /// Not referenced, alarm or emergency stop: no new correction is written.
    Interlocked,
    /// The applied correction has not been confirmed for too long, or sent corrections do not arrive.
    Unconfirmed,
}

/// The state that follows once the correction has reached zero.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum End {
    Disarmed,
    /// The guard waits for positions, still armed.
    Lost,
}

/// Why a guard is faulted.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Cause {
    /// A written correction is not found when it is read back.
    DoesNotStick,
    /// The control applies a correction that exceeds the limit and was not sent by this guard; nothing is written until
    /// the operator acknowledges it.
    BeyondLimit,
    /// Positions contain the correction but should not, or the reverse.
    Contradiction,
    /// The barrier has accepted a frame of another gateway.
    OtherGateway,
}

/// A request of the operator or a program to a guard.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Request {
    /// Start compensating, with the test shift if it is configured.
    Arm,
    /// Compensate in place of another path during operation, without the test shift.
    TakeOver,
    /// Ramp to zero and stop writing; also removes a correction that remains from before.
    Disarm,
    /// The program ends: ramp to zero. A correction that was found and never written by this guard
    /// is not changed.
    End,
    /// The cause of a fault is fixed.
    Acknowledge,
    /// The model, the path or the limits have changed: ramp to the new correction.
    Switched,
}

#[expect(clippy::struct_excessive_bools, reason = "each is a fact of one cycle, none is kept")]
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Facts {
    pub(crate) request: Option<Request>,
    /// True during an alarm or emergency stop, or if an axis is not referenced.
    pub(crate) interlocked: bool,
    /// Positions or target are older than `hold`.
    pub(crate) stale: bool,
    /// Positions or target are older than `zero_after`.
    pub(crate) lost: bool,
    /// The barrier reports an owner, sequence or epoch of another sender.
    pub(crate) other_gateway: bool,
    /// The controller has changed its applied correction without a write.
    pub(crate) changed: bool,
    /// The active path has changed, and its applied correction is unknown or is read for the first
    /// time.
    pub(crate) path_changed: bool,
    pub(crate) forbidden: bool,
    /// The applied correction may be that of another gateway, or is unknown in a control without
    /// read-back.
    pub(crate) foreign: bool,
    pub(crate) ramped: bool,
    pub(crate) zero: bool,
    pub(crate) proves: bool,
    /// Result of the proof at arming; `None`: the proof is not complete.
    pub(crate) proven: Option<bool>,
    pub(crate) does_not_stick: bool,
    /// The applied correction was not confirmed, or sent corrections did not arrive, for longer than `hold`.
    pub(crate) unconfirmed: bool,
    /// Sent corrections do not arrive for longer than `zero_after` although the control answers.
    pub(crate) does_not_land: bool,
    /// The applied correction exceeds the limit for another reason than a lowered limit.
    pub(crate) beyond: bool,
}

impl State {
    /// Name in JSON and in the web interface.
    pub fn name(self) -> &'static str {
        match self {
            Self::Disarmed => "disarmed",
            Self::Arming(_) => "arming",
            Self::Compensating => "compensating",
            Self::Holding(_) => "holding",
            Self::RampingOut(_) => "ramping-out",
            Self::Faulted(_) => "faulted",
        }
    }

    /// Whether the guard compensates now, or will compensate without another request.
    pub fn is_armed(self) -> bool {
        matches!(
            self,
            Self::Arming(_) | Self::Compensating | Self::Holding(_) | Self::RampingOut(End::Lost)
        )
    }

    /// The reason implied by the state itself.
    pub fn reason(self) -> Reasons {
        match self {
            Self::Holding(Hold::Lost) | Self::RampingOut(End::Lost) => Reasons::POSITIONS_LOST,
            Self::Holding(Hold::Unconfirmed) => Reasons::UNCONFIRMED,
            Self::Faulted(Cause::DoesNotStick) => Reasons::DOES_NOT_STICK,
            Self::Faulted(Cause::BeyondLimit) => Reasons::BEYOND_LIMIT,
            Self::Faulted(Cause::Contradiction) => Reasons::CONTRADICTION,
            Self::Faulted(Cause::OtherGateway) => Reasons::OTHER_GATEWAY,
            _ => Reasons::NONE,
        }
    }

    pub(crate) fn next(self, facts: &Facts) -> Self {
        if self.is_armed() {
            // A fault takes precedence over a request to disarm: only the operator permits removing a correction beyond
            // the limit.
            if facts.beyond {
                return Self::Faulted(Cause::BeyondLimit);
            }
            if facts.other_gateway {
                return Self::Faulted(Cause::OtherGateway);
            }
            if matches!(facts.request, Some(Request::Disarm | Request::End)) {
                return Self::RampingOut(End::Disarmed);
            }
            if facts.does_not_stick || facts.does_not_land {
                return Self::Faulted(Cause::DoesNotStick);
            }
            // An interrupted proof is not resumed: the guard disarms, and arming must be requested again.
            if self == Self::Arming(Phase::Proving) && (facts.interlocked || facts.lost) {
                return Self::RampingOut(End::Disarmed);
            }
            if facts.interlocked {
                return Self::Holding(Hold::Interlocked);
            }
        }
        match self {
            Self::Disarmed => self.disarmed(facts),
            Self::RampingOut(End::Disarmed) if facts.may_arm() => facts.arming(),
            Self::RampingOut(End::Disarmed) if facts.beyond => Self::Faulted(Cause::BeyondLimit),
            Self::RampingOut(End::Disarmed) if facts.other_gateway => {
                Self::Faulted(Cause::OtherGateway)
            }
            Self::RampingOut(End::Disarmed) if facts.does_not_land => {
                Self::Faulted(Cause::DoesNotStick)
            }
            Self::RampingOut(End::Disarmed) if facts.zero => Self::Disarmed,
            // In any fault, a correction beyond the limit must be acknowledged by the operator before it is removed.
            Self::Faulted(cause) if facts.beyond && cause != Cause::BeyondLimit => {
                Self::Faulted(Cause::BeyondLimit)
            }
            Self::Faulted(_) if facts.request == Some(Request::Acknowledge) => {
                facts.acknowledged(self)
            }
            Self::RampingOut(End::Disarmed) | Self::Faulted(_) => self,
            _ => self.armed(facts),
        }
    }

    fn disarmed(self, facts: &Facts) -> Self {
        match facts.request {
            // Another gateway may be using the correction, or the correction is unknown.
            Some(Request::Disarm) if facts.foreign => self,
            Some(Request::Arm | Request::TakeOver | Request::Disarm) if facts.beyond => {
                if facts.unconfirmed { self } else { Self::Faulted(Cause::BeyondLimit) }
            }
            // A remaining correction is removed.
            Some(Request::Disarm) if !facts.zero => Self::RampingOut(End::Disarmed),
            _ if facts.may_arm() => facts.arming(),
            _ => self,
        }
    }

    /// Transitions of the armed states, without interlock, fault or request to disarm.
    fn armed(self, facts: &Facts) -> Self {
        let ramping_in = Self::Arming(Phase::Ramping);
        match self {
            Self::Arming(Phase::Proving) if facts.stale || facts.unconfirmed => self,
            Self::Arming(_) | Self::Compensating | Self::Holding(Hold::Interlocked)
                if facts.stale =>
            {
                Self::Holding(Hold::Stale)
            }
            Self::Arming(_) | Self::Compensating | Self::Holding(Hold::Interlocked)
                if facts.unconfirmed =>
            {
                Self::Holding(Hold::Unconfirmed)
            }
            Self::Arming(Phase::Proving) => match facts.proven {
                Some(true) => ramping_in,
                Some(false) => Self::Faulted(Cause::Contradiction),
                None => self,
            },
            Self::Arming(Phase::Ramping) if facts.ramped => Self::Compensating,
            Self::Compensating if facts.needs_ramp() => ramping_in,
            Self::Holding(Hold::Stale | Hold::Unconfirmed) if facts.lost => {
                Self::RampingOut(End::Lost)
            }
            Self::RampingOut(End::Lost) if facts.stale && facts.zero => Self::Holding(Hold::Lost),
            Self::Holding(Hold::Stale) if !facts.stale && facts.unconfirmed => {
                Self::Holding(Hold::Unconfirmed)
            }
            Self::Holding(Hold::Unconfirmed) if facts.stale && !facts.unconfirmed => {
                Self::Holding(Hold::Stale)
            }
            Self::Holding(_) | Self::RampingOut(End::Lost)
                if !facts.stale && !facts.unconfirmed =>
            {
                ramping_in
            }
            _ => self,
        }
    }
}

impl Facts {
    fn may_arm(&self) -> bool {
        let is_requested = matches!(self.request, Some(Request::Arm | Request::TakeOver));
        let is_prevented = self.forbidden || self.interlocked || self.stale;
        is_requested && !is_prevented && !self.unconfirmed && !self.beyond
    }

    /// The first phase of arming. A take-over during operation skips the proof.
    fn arming(&self) -> State {
        let proves = self.proves && self.request == Some(Request::Arm);
        State::Arming(if proves { Phase::Proving } else { Phase::Ramping })
    }

    pub(crate) fn needs_ramp(&self) -> bool {
        self.changed || self.path_changed || self.request == Some(Request::Switched)
    }

    fn acknowledged(&self, fault: State) -> State {
        if self.interlocked || self.unconfirmed || self.other_gateway {
            fault
        } else if self.zero {
            State::Disarmed
        } else {
            State::RampingOut(End::Disarmed)
        }
    }
}

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
