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
    /// Something is wrong that a person must look at; the correction ramps to zero.
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
    /// Not referenced, alarm or emergency stop: nothing is written.
    Interlocked,
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
    /// Positions contain the correction, and should not, or the other way round.
    Contradiction,
}

/// A request of a person or a program to a guard.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Request {
    /// Begin to correct, with the test shift where it is wanted.
    Arm,
    /// Correct in place of another path, in the middle of work: without the test shift.
    TakeOver,
    /// Ramp to zero and stop writing.
    Disarm,
    /// The cause of a fault is mended.
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
    /// The controller has changed the correction that it applies without being told to.
    pub(crate) changed: bool,
    /// Whether something forbids arming.
    pub(crate) forbidden: bool,
    /// The ramp has reached its end.
    pub(crate) ramped: bool,
    /// The output is zero on every axis.
    pub(crate) zero: bool,
    /// The proof at arming is wanted.
    pub(crate) proves: bool,
    /// How the proof at arming went; `None`: not finished.
    pub(crate) proven: Option<bool>,
    /// Several writes in a row did not stick.
    pub(crate) does_not_stick: bool,
    /// The read-back is what was written.
    pub(crate) agrees: bool,
}

impl State {
    /// The name as it stands in JSON and on the dashboard.
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

    /// Whether it corrects or will by itself.
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
            Self::Faulted(Cause::DoesNotStick) => Reasons::DOES_NOT_STICK,
            Self::Faulted(Cause::Contradiction) => Reasons::CONTRADICTION,
            _ => Reasons::NONE,
        }
    }

    /// The state that follows from the facts of a cycle.
    pub(crate) fn next(self, facts: &Facts) -> Self {
        let ramping_in = Self::Arming(Phase::Ramping);
        if self.is_armed() {
            if facts.request == Some(Request::Disarm) {
                return Self::RampingOut(End::Disarmed);
            }
            if facts.does_not_stick {
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
        let may_arm = matches!(facts.request, Some(Request::Arm | Request::TakeOver))
            && !(facts.forbidden || facts.interlocked || facts.stale);
        match self {
            // From zero, or from where it is on its way out.
            Self::Disarmed | Self::RampingOut(End::Disarmed) if may_arm => {
                let proves = facts.proves && facts.request == Some(Request::Arm);
                Self::Arming(if proves {
                    Phase::Proving
                } else {
                    Phase::Ramping
                })
            }
            Self::RampingOut(End::Disarmed) if facts.zero => Self::Disarmed,
            Self::Arming(Phase::Proving) if facts.stale => self,
            Self::Arming(_) | Self::Compensating | Self::Holding(Hold::Interlocked)
                if facts.stale =>
            {
                Self::Holding(Hold::Stale)
            }
            Self::Arming(Phase::Proving) => match facts.proven {
                Some(true) => ramping_in,
                Some(false) => Self::Faulted(Cause::Contradiction),
                None => self,
            },
            Self::Arming(Phase::Ramping) if facts.ramped => Self::Compensating,
            Self::Compensating if facts.changed || facts.request == Some(Request::Switched) => {
                ramping_in
            }
            Self::Holding(Hold::Stale) if facts.lost => Self::RampingOut(End::Lost),
            Self::RampingOut(End::Lost) if facts.stale && facts.zero => Self::Holding(Hold::Lost),
            Self::Holding(_) | Self::RampingOut(End::Lost) if !facts.stale => ramping_in,
            Self::Faulted(_)
                if facts.request == Some(Request::Acknowledge) && facts.zero && facts.agrees =>
            {
                Self::Disarmed
            }
            _ => self,
        }
    }
}
