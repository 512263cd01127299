use core::{
    fmt,
    ops::{BitOr, BitOrAssign},
};

/// A set of reasons, stored as a bit mask.
#[derive(Clone, Copy, Default, PartialEq, Eq, Hash)]
pub struct Reasons(u64);

#[derive(Clone, Copy)]
enum Effect {
    Forbids,
    Informs,
}

macro_rules! effect {
    (forbids) => {
        Effect::Forbids
    };
    (informs) => {
        Effect::Informs
    };
}

/// The bit of a reason is its position in the list, so that no two reasons share a bit; a 65th
/// reason would not compile. Reasons are reported in the order of the list: causes of a stop with
/// the required operator action first, then consequences.
macro_rules! reasons {
    ($($(#[$doc:meta])* $name:ident = $effect:ident, $text:literal, $advice:literal;)*) => {
        /// Position of each reason in the list: its bit number.
        #[allow(non_camel_case_types, clippy::upper_case_acronyms)]
        enum Place {
            $($name,)*
        }

        impl Reasons {
            $($(#[$doc])* pub const $name: Self = Self(1 << Place::$name as u64);)*

            const ALL: &'static [(Self, Effect, &'static str)] =
                &[$((Self::$name, effect!($effect), $text)),*];

            /// What the operator can do about each reason, in the order of the list; empty: nothing.
            const ADVICE: &'static [&'static str] = &[$($advice),*];
        }
    };
}

reasons! {
    // Causes of a stop in the machine itself.
    EMERGENCY_STOP = forbids, "emergency stop",
        "Release the emergency stop at the control.";
    CONTROLLER_ALARM = forbids, "controller alarm",
        "Clear the alarm at the control.";
    NOT_REFERENCED = forbids, "axes not referenced",
        "Reference the axes at the control.";
    /// A path on which an interlock was active is silent now.
    INTERLOCK_UNSEEN = forbids, "interlock not seen to clear",
        "Restore the silent path, or make sure that the interlock has ended and acknowledge.";
    // Faults, which the operator must check and acknowledge.
    /// The control applies a correction beyond the limit that this guard did not send.
    BEYOND_LIMIT = forbids, "a correction beyond the limit was found",
        "Find out at the control what set it, then acknowledge: it ramps to zero.";
    /// A written correction is not found when it is read back, several times in a row.
    DOES_NOT_STICK = forbids, "correction does not stick",
        "Check the address and the control's program, then acknowledge.";
    /// Positions contain the correction although the configuration states that they do not, or positions do not contain
    /// it although the configuration states that they do.
    CONTRADICTION = forbids, "positions contradict includes_correction",
        "Correct includes_correction, restart the gateway, acknowledge, arm.";
    /// The gateway was faulted when it ended, and the fault was not acknowledged since.
    FAULTED_BEFORE = forbids, "faulted before the restart: acknowledge it",
        "Find the cause, then acknowledge.";
    /// The correction left in a control without read-back is unknown.
    LEFT_UNKNOWN = forbids, "what the control was left with is unknown",
        "Make sure that the lines of the control are at zero, then acknowledge.";
    // Other causes.
    /// The program is stopping.
    STOPPING = forbids, "stopping",
        "";
    NO_CONTROLLER = forbids, "controller does not answer",
        "Check the cable, the control and its address.";
    /// No controller reports the position of an axis of the machine.
    AXIS_UNKNOWN = forbids, "a machine axis has no position",
        "Check the controller that reports the position of this axis.";
    /// A position is implausibly far outside the travel of its axis.
    OUTSIDE_TRAVEL = forbids, "position outside the travel",
        "Compare units, axes and travels with the control.";
    /// A position cannot have been reached since the last accepted position.
    JUMPED = forbids, "position jumped",
        "Compare the shown position with the control. If it is right, disarm and arm.";
    /// The control's data is not a report of a barrier for this machine and these axes in this order.
    BARRIER_STRANGE = forbids, "no barrier for this machine and these axes",
        "Check the address of the report and that the control's program runs.";
    /// The barrier's limits, rates or times do not fit the limits of the guard, or its scan period is not as
    /// configured.
    BARRIER_UNFIT = forbids, "the control's barrier does not fit the limits",
        "Change the barrier or the limits so that they fit.";
    /// Another gateway corrects this controller.
    OTHER_GATEWAY = forbids, "another gateway",
        "Find the other gateway and stop it.";
    /// A position or a correction is not a finite number.
    NOT_A_NUMBER = forbids, "not a number",
        "Check the machine file and the device.";
    AUDIT = forbids, "audit log cannot be written",
        "Check the disk: full, not writable or not answering.";
    NO_LIMITS = forbids, "limits are not configured",
        "Add the table [guard] to the configuration.";
    /// No other path may take over, because the correction that the silent path still applies is unknown.
    OTHER_CHANNEL_UNKNOWN = informs, "another path may still hold a correction",
        "Restore the silent path.";
    /// A standby path reports a correction that it should not have.
    STANDBY_HOLDS = informs, "a standby path holds a correction",
        "Find out which path is right before you continue.";
    // Decisions of the operator, made or required.
    DISABLED_BY_CENTRE = forbids, "disabled by the centre",
        "Ask the centre to enable the correction.";
    /// The operator disarmed: no auto-arm, not even after a restart.
    DISARMED_BY_PERSON = informs, "disarmed by the operator: the correction stays off until the operator arms",
        "Arm.";
    /// The machine file or the limits differ from the last confirmed machine file and limits.
    MUST_CONFIRM = informs, "machine file or limits must be confirmed",
        "Arm and confirm the change.";
    /// The configuration or the machine file on disk was rejected or needs a confirmation: the previous files are
    /// active.
    NOT_RELOADED = informs, "files on disk not taken over",
        "Fix the files and reload.";
    /// The machine file activated by the centre is unusable: the configured one is active.
    CENTRE_FILE = informs, "machine file of the centre damaged: the configured one holds",
        "See the audit log, and send the machine file again.";
    // Consequences of the causes above.
    /// Positions are so old that the correction ramps to zero.
    POSITIONS_LOST = forbids, "positions lost",
        "Check the cable and the control.";
    /// Positions are older than allowed.
    POSITIONS_STALE = forbids, "positions stale",
        "Check the cable.";
    /// The applied correction has not been confirmed for too long.
    UNCONFIRMED = forbids, "applied correction not confirmed",
        "Check the cable and the control.";
    /// The controller applies another correction than the written correction; the output ramps from the applied
    /// correction.
    READ_BACK = informs, "controller's correction changed",
        "";
    /// A correction is applied while disarmed.
    CORRECTION_LEFT = informs, "a correction is applied",
        "Disarm: it ramps out.";
    // Conditions that end without intervention.
    /// Before the first write the gateway observes whether another gateway writes, and measures the scan period of the
    /// control.
    WATCHING = forbids, "watching the control",
        "Wait for 2 s. If it does not end, something else writes these words.";
    /// Arming waits for standstill.
    WAITING_FOR_STANDSTILL = informs, "waiting for standstill",
        "Stop the axes for a second.";
    // Further information.
    /// A temperature used by the model is missing.
    DEGRADED = informs, "degraded",
        "Check the sensor. If its new value is right, acknowledge.";
    /// A temperature, or its rate of change, is or was shortly before beyond the range for which the thermal terms were
    /// identified. The terms use the temperature at the end of the range, and are reduced to zero with the distance
    /// from it.
    BEYOND_SEEN = informs, "outside what the thermal terms have seen",
        "Test the machine at this temperature and fit the terms again.";
    /// A position is outside the measured range.
    OUTSIDE_RANGE = informs, "outside the measured range",
        "";
    /// The requested correction exceeds the limit.
    LIMITED = informs, "correction limited",
        "Check the machine file and the tool.";
    /// The requested correction exceeds the warning threshold.
    WARN = informs, "correction above the warning",
        "Check the machine file and the tool.";
    /// Slew or acceleration limits the output.
    SLEWING = informs, "rate limited",
        "";
    /// The pose is within about 1° of a singular pose, in which the tool axis cannot be corrected in one direction;
    /// that direction is not corrected.
    SINGULAR = informs, "singular pose",
        "";
    /// The pose is within about 6° of a singular pose: rotary corrections may exceed ten times the error of the tool
    /// axis.
    NEAR_SINGULAR = informs, "near a singular pose",
        "";
    /// Rotary axes have turned two linear axes nearly parallel: linear corrections may exceed ten times the error, or
    /// one of the axes is omitted.
    LINEAR_NEAR_SINGULAR = informs, "linear axes nearly in one direction",
        "";
    /// Positions are so old for the speed of the axes that the correction is reduced or suspended.
    REDUCED_BY_AGE = informs, "correction reduced: positions too old for the speed",
        "Read positions faster, or reduce the feed.";
    /// The test shift did not prove for every axis whether positions contain the correction.
    NOT_PROVEN = informs, "not proven what positions contain",
        "Move each axis, disarm and arm again.";
    /// A controller path other than the first is active.
    FALLBACK = informs, "fallback controller",
        "Restore the first controller.";
    STANDBY_SILENT = informs, "a standby path does not answer",
        "Restore the standby path.";
    /// Cycles exceed their period.
    OVERRUNS = informs, "cycle overruns",
        "Check the computer: cycles take longer than cycle_ms.";
    /// A second gateway could not be detected.
    CANNOT_SEE_OTHERS = informs, "cannot see other gateways",
        "Make sure that no other gateway corrects this control.";
    /// The control does not ramp the correction out when the gateway stops.
    UNWATCHED = informs, "unwatched",
        "";
    /// The control cannot distinguish a late or foreign write from a current one.
    NO_BARRIER = informs, "no barrier",
        "";
}

impl Reasons {
    /// The empty set.
    pub const NONE: Self = Self(0);

    /// The reasons that do not forbid arming.
    pub const DOES_NOT_FORBID: Self = {
        let (mut informing, mut place) = (0, 0);
        while place < Self::ALL.len() {
            let (reason, effect, _) = Self::ALL[place];
            if matches!(effect, Effect::Informs) {
                informing |= reason.0;
            }
            place += 1;
        }
        Self(informing)
    };

    pub fn is_empty(self) -> bool {
        self.0 == 0
    }

    /// Whether the set holds every reason of `other`.
    pub fn contains(self, other: Self) -> bool {
        self.0 & other.0 == other.0
    }

    /// The set if `condition` holds, else the empty set.
    #[must_use]
    pub fn when(self, condition: bool) -> Self {
        if condition { self } else { Self::NONE }
    }

    /// The set without the reasons of `other`.
    #[must_use]
    pub fn without(self, other: Self) -> Self {
        Self(self.0 & !other.0)
    }

    /// The set as a bit mask, for atomics and rings.
    pub fn bits(self) -> u64 {
        self.0
    }

    /// The set of a bit mask returned by [`bits`](Self::bits).
    pub fn from_bits(bits: u64) -> Self {
        Self(bits)
    }

    /// The reason with this text, which `: ` and details may follow; `None` if there is no such reason.
    pub fn with_text(text: &str) -> Option<Self> {
        let mut all = Self::ALL.iter();
        let is = |own: &str| {
            let rest = text.strip_prefix(own);
            rest.is_some_and(|rest| rest.is_empty() || rest.starts_with(": "))
        };
        all.find(|(.., own)| is(own)).map(|(reason, ..)| *reason)
    }

    /// What the operator can do about the first reason of the set; `None` if there is nothing to do.
    pub fn advice(self) -> Option<&'static str> {
        let place = usize::try_from(self.0.trailing_zeros()).ok()?;
        let advice = Self::ADVICE.get(place)?;
        (!advice.is_empty()).then_some(*advice)
    }

    /// The text of each reason of the set, causes first.
    pub fn texts(self) -> impl Iterator<Item = &'static str> {
        Self::ALL.iter().filter(move |(reason, ..)| self.contains(*reason)).map(|(.., text)| *text)
    }
}

impl fmt::Debug for Reasons {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_set().entries(self.texts()).finish()
    }
}

impl BitOr for Reasons {
    type Output = Self;

    fn bitor(self, other: Self) -> Self {
        Self(self.0 | other.0)
    }
}

impl BitOrAssign for Reasons {
    fn bitor_assign(&mut self, other: Self) {
        self.0 |= other.0;
    }
}

#[cfg(test)]
mod tests {
    use super::Reasons;

    #[test]
    fn causes_come_before_their_consequences() {
        let causes = [
            Reasons::EMERGENCY_STOP,
            Reasons::CONTROLLER_ALARM,
            Reasons::NOT_REFERENCED,
            Reasons::BEYOND_LIMIT,
            Reasons::DOES_NOT_STICK,
            Reasons::CONTRADICTION,
            Reasons::FAULTED_BEFORE,
            Reasons::NO_CONTROLLER,
            Reasons::OTHER_GATEWAY,
            Reasons::NOT_RELOADED,
            Reasons::MUST_CONFIRM,
        ];
        let consequences = [
            (Reasons::POSITIONS_STALE, "positions stale"),
            (Reasons::POSITIONS_LOST, "positions lost"),
            (Reasons::UNCONFIRMED, "applied correction not confirmed"),
            (Reasons::WAITING_FOR_STANDSTILL, "waiting for standstill"),
            (Reasons::OVERRUNS, "cycle overruns"),
            (Reasons::NO_BARRIER, "no barrier"),
        ];
        for cause in causes {
            for (consequence, text) in consequences {
                let mut texts = (consequence | cause).texts();
                assert!(texts.next().is_some_and(|first| first != text));
                assert_eq!(texts.next(), Some(text), "after {cause:?}");
            }
        }
        let all = [
            Reasons::UNCONFIRMED,
            Reasons::NOT_RELOADED,
            Reasons::INTERLOCK_UNSEEN,
            Reasons::NO_CONTROLLER,
            Reasons::POSITIONS_STALE,
            Reasons::EMERGENCY_STOP,
        ];
        let all = all.into_iter().fold(Reasons::NONE, |all, one| all | one);
        let expected = [
            "emergency stop",
            "interlock not seen to clear",
            "controller does not answer",
            "files on disk not taken over",
            "positions stale",
            "applied correction not confirmed",
        ];
        assert!(all.texts().eq(expected), "{all:?}");
        assert_eq!(Reasons::with_text("emergency stop"), Some(Reasons::EMERGENCY_STOP));
        assert_eq!(Reasons::with_text("position jumped: X 4000.000 mm"), Some(Reasons::JUMPED));
        assert_eq!(Reasons::with_text("position jumped far"), None);
        assert_eq!(Reasons::with_text("no reason"), None);
    }

    #[test]
    fn advice_is_that_of_the_first_reason() {
        let cable = "Check the cable.";
        assert_eq!(Reasons::POSITIONS_STALE.advice(), Some(cable));
        let both = Reasons::POSITIONS_STALE | Reasons::EMERGENCY_STOP;
        let first = "Release the emergency stop at the control.";
        assert_eq!(both.advice(), Some(first));
        assert_eq!(Reasons::SLEWING.advice(), None);
        assert_eq!(Reasons::NONE.advice(), None);
        // Every reason that forbids arming names an action. The end of the gateway is the only exception.
        let silent = Reasons::ALL.iter().filter(|(reason, ..)| {
            !Reasons::DOES_NOT_FORBID.contains(*reason) && reason.advice().is_none()
        });
        assert!(silent.map(|(reason, ..)| *reason).eq([Reasons::STOPPING]));
    }
}
