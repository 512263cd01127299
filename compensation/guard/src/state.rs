//! The states of a guard, and the one function that leads from one to the next.

use crate::Reasons;

/// The state of a guard.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum State {
    /// Nothing is written to the controller.
    #[default]
    Disarmed,
    /// The correction is on its way in.
    Arming(Phase),
    /// The correction follows the model.
    Compensating,
    /// The last correction is held.
    Holding(Hold),
    /// The correction is on its way to zero.
    RampingOut(End),
    /// Something is wrong that the operator must check; the correction ramps to zero.
    Faulted(Cause),
}

/// How far arming is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Phase {
    /// The test shift shows whether positions contain the correction.
    Proving,
    /// The correction ramps in.
    Ramping,
}

/// Why the correction is held.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Hold {
    /// Positions are stale, or there is no correction to be had.
    Stale,
    /// Positions were lost, and the correction has gone to zero.
    Lost,
    /// Not referenced, alarm or emergency stop: nothing new is written.
    Interlocked,
    /// What the control applies has not been confirmed for too long, or what is sent does not land.
    Unconfirmed,
}

/// The state that follows once the correction has reached zero.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum End {
    /// The guard is disarmed.
    Disarmed,
    /// The guard waits for positions, still armed.
    Lost,
}

/// Why a guard is faulted.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Cause {
    /// A correction that was written is not found when it is read back.
    DoesNotStick,
    /// The control applies a correction beyond the limit that was not sent: nothing is written until a person has looked.
    BeyondLimit,
    /// Positions contain the correction, and should not, or the other way round.
    Contradiction,
    /// The barrier has accepted a frame of another gateway.
    OtherGateway,
}

/// A request of a person or a program to a guard.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Request {
    /// Begin to correct, with the test shift where it is wanted.
    Arm,
    /// Correct in place of another path, in the middle of work: without the test shift.
    TakeOver,
    /// Ramp to zero and stop writing, also what was left over before.
    Disarm,
    /// The program ends: ramp to zero, but leave alone what was found and never written here.
    End,
    /// The cause of a fault is fixed.
    Acknowledge,
    /// The model or what it is applied to has changed: ramp to the new one.
    Switched,
}

/// The facts of one cycle on which a transition between states depends.
#[expect(
    clippy::struct_excessive_bools,
    reason = "each is a fact of one cycle, none is kept"
)]
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Facts {
    pub(crate) request: Option<Request>,
    /// Not referenced, alarm, emergency stop.
    pub(crate) interlocked: bool,
    /// Positions or target are older than `hold`.
    pub(crate) stale: bool,
    /// Positions or target are older than `zero_after`.
    pub(crate) lost: bool,
    /// The barrier reports an owner, sequence or epoch that this gateway has not sent.
    pub(crate) other_gateway: bool,
    /// The controller has changed the correction that it applies without a write.
    pub(crate) changed: bool,
    /// Another path writes, and what it applies is seen for the first time, or not yet.
    pub(crate) took_over: bool,
    /// Whether something forbids arming.
    pub(crate) forbidden: bool,
    /// What is applied may be another gateway's, or it is unknown what a control without read-back was left with.
    pub(crate) foreign: bool,
    /// The ramp has reached its end.
    pub(crate) ramped: bool,
    /// The correction is confirmed to be zero on every axis.
    pub(crate) zero: bool,
    /// The proof at arming is wanted.
    pub(crate) proves: bool,
    /// How the proof at arming went; `None`: not finished.
    pub(crate) proven: Option<bool>,
    /// Several writes in a row did not stick.
    pub(crate) does_not_stick: bool,
    /// What the control applies is not confirmed, or what is sent does not land, for longer than `hold`.
    pub(crate) unconfirmed: bool,
    /// What is sent does not land for longer than `zero_after` although the control answers.
    pub(crate) does_not_land: bool,
    /// The control applies more than the limit, and not because the limit was lowered.
    pub(crate) beyond: bool,
}

impl State {
    /// The name in JSON and on the dashboard.
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

    /// Whether it corrects, or will without another request.
    pub fn is_armed(self) -> bool {
        matches!(
            self,
            Self::Arming(_) | Self::Compensating | Self::Holding(_) | Self::RampingOut(End::Lost)
        )
    }

    /// The reason that the state itself is.
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

    /// The state that follows from the facts of a cycle.
    pub(crate) fn next(self, facts: &Facts) -> Self {
        if self.is_armed() {
            // Also with a request to disarm: a correction beyond the limit is not led out without the operator.
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
            // What is not proven is not held on to: arming begins anew.
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
            // Whatever fault it is: a correction beyond the limit is acknowledged by the operator before it is led out.
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
            // Another gateway may be at work with it, or it is unknown.
            Some(Request::Disarm) if facts.foreign => self,
            Some(Request::Arm | Request::TakeOver | Request::Disarm) if facts.beyond => {
                if facts.unconfirmed {
                    self
                } else {
                    Self::Faulted(Cause::BeyondLimit)
                }
            }
            // A correction that was left over is led out.
            Some(Request::Disarm) if !facts.zero => Self::RampingOut(End::Disarmed),
            _ if facts.may_arm() => facts.arming(),
            _ => self,
        }
    }

    /// The states in which it corrects, or will without another request; no interlock, no fault, no request to disarm.
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
            Self::Compensating if facts.begins_anew() => ramping_in,
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
    /// Whether arming is requested and nothing forbids it.
    fn may_arm(&self) -> bool {
        let asked = matches!(self.request, Some(Request::Arm | Request::TakeOver));
        let hindered = self.forbidden || self.interlocked || self.stale;
        asked && !hindered && !self.unconfirmed && !self.beyond
    }

    /// How arming begins: in the middle of work without the proof.
    fn arming(&self) -> State {
        let proves = self.proves && self.request == Some(Request::Arm);
        State::Arming(if proves {
            Phase::Proving
        } else {
            Phase::Ramping
        })
    }

    /// What was compensated until now is ramped to anew.
    pub(crate) fn begins_anew(&self) -> bool {
        self.changed || self.took_over || self.request == Some(Request::Switched)
    }

    /// What follows when the operator acknowledges a fault: what is left of the correction is led out.
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
