//! Why the state of a guard is what it is, as a set.

use core::{
    fmt,
    ops::{BitOr, BitOrAssign},
};

/// A set of reasons. Plain bits: cheap to pass between threads.
#[derive(Clone, Copy, Default, PartialEq, Eq, Hash)]
pub struct Reasons(u64);

/// What a reason means for arming.
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

/// Each reason takes the bit of its place in the list, so no two share one; a 65th would not compile. In this order they
/// are reported: what caused the stop and what the operator must do comes first, what follows from it later.
macro_rules! reasons {
    ($($(#[$doc:meta])* $name:ident = $effect:ident, $text:literal;)*) => {
        /// The places in the list.
        #[allow(non_camel_case_types, clippy::upper_case_acronyms)]
        enum Place {
            $($name,)*
        }

        impl Reasons {
            $($(#[$doc])* pub const $name: Self = Self(1 << Place::$name as u64);)*

            const ALL: &'static [(Self, Effect, &'static str)] =
                &[$((Self::$name, effect!($effect), $text)),*];
        }
    };
}

reasons! {
    // What stops it: the machine itself.
    /// The emergency stop is pressed.
    EMERGENCY_STOP = forbids, "emergency stop";
    /// The controller has an alarm.
    CONTROLLER_ALARM = forbids, "controller alarm";
    /// Axes are not referenced.
    NOT_REFERENCED = forbids, "axes not referenced";
    /// An interlock was seen on a path that is silent now.
    INTERLOCK_UNSEEN = forbids, "interlock not seen to clear";
    // Faults, which the operator must check and acknowledge.
    /// The control applies a correction beyond the limit that was not sent from here.
    BEYOND_LIMIT = forbids, "a correction beyond the limit was found";
    /// A correction that was written is not found when it is read back, several times in a row.
    DOES_NOT_STICK = forbids, "correction does not stick";
    /// Positions do not contain the correction as configured.
    CONTRADICTION = forbids, "positions contradict includes_correction";
    /// The gateway was faulted when it ended, and was not acknowledged since.
    FAULTED_BEFORE = forbids, "faulted before the restart: acknowledge it";
    /// It is unknown what a control without read-back was left with.
    LEFT_UNKNOWN = forbids, "what the control was left with is unknown";
    // Other causes.
    /// The program is stopping.
    STOPPING = forbids, "stopping";
    /// The controller does not answer.
    NO_CONTROLLER = forbids, "controller does not answer";
    /// An axis of the machine has a position from no controller.
    AXIS_UNKNOWN = forbids, "a machine axis has no position";
    /// A position is farther outside the travel of its axis than an axis can be.
    OUTSIDE_TRAVEL = forbids, "position outside the travel";
    /// A position is where its axis cannot have come to since the last one that was believed.
    JUMPED = forbids, "position jumped";
    /// What the control sends is no report of a barrier of this machine and these axes, in this order.
    BARRIER_STRANGE = forbids, "no barrier for this machine and these axes";
    /// The barrier's limits, rates or times do not fit those of the guard, or its scans are not as long as configured.
    BARRIER_UNFIT = forbids, "the control's barrier does not fit the limits";
    /// Another gateway corrects this controller.
    OTHER_GATEWAY = forbids, "another gateway";
    /// A position or a correction is no finite number.
    NOT_A_NUMBER = forbids, "not a number";
    /// The audit log cannot be written.
    AUDIT = forbids, "audit log cannot be written";
    /// The limits are not configured.
    NO_LIMITS = forbids, "limits are not configured";
    /// No other path may take over, since it is unknown what the silent one still applies.
    OTHER_CHANNEL_UNKNOWN = informs, "another path may still hold a correction";
    /// Another path shows a correction that it should not have.
    STANDBY_HOLDS = informs, "a standby path holds a correction";
    // What a person has decided, or has to.
    /// The centre of the fleet has disabled the correction.
    DISABLED_BY_CENTRE = forbids, "disabled by the centre";
    /// The operator disarmed it: no auto-arm, also after a restart.
    DISARMED_BY_PERSON = informs, "disarmed by a person: it does not arm by itself";
    /// The machine file or the limits are not those that were confirmed last.
    MUST_CONFIRM = informs, "machine file or limits must be confirmed";
    /// The configuration or the machine file on disk was refused or waits for a confirmation: the one from before holds.
    NOT_RELOADED = informs, "files on disk not taken over";
    /// The machine file that the centre has activated cannot be used: the one of the configuration corrects.
    CENTRE_FILE = informs, "machine file of the centre damaged: the configured one holds";
    // What follows from the causes above.
    /// Positions are so old that the correction goes to zero.
    POSITIONS_LOST = forbids, "positions lost";
    /// Positions are older than allowed.
    POSITIONS_STALE = forbids, "positions stale";
    /// The correction that the control applies has not been confirmed for too long.
    UNCONFIRMED = forbids, "applied correction not confirmed";
    /// The correction that the controller has applied is not the one that was written: ramping from there.
    READ_BACK = informs, "controller's correction changed";
    /// A correction is applied while disarmed.
    CORRECTION_LEFT = informs, "a correction is applied";
    // What ends without intervention.
    /// Whether another gateway writes, or how fast the control scans, is being observed before the first write.
    WATCHING = forbids, "watching the control";
    /// Arming waits for standstill.
    WAITING_FOR_STANDSTILL = informs, "waiting for standstill";
    // What else is to be known.
    /// A temperature that the model uses is missing.
    DEGRADED = informs, "degraded";
    /// A temperature, or the rate at which it changes, is beyond what the thermal terms were found from: they hold and fade.
    BEYOND_SEEN = informs, "outside what the thermal terms have seen";
    /// A position is outside the range that was measured.
    OUTSIDE_RANGE = informs, "outside the measured range";
    /// The wanted correction is beyond the limit.
    LIMITED = informs, "correction limited";
    /// The wanted correction is beyond the warning.
    WARN = informs, "correction above the warning";
    /// Slew or acceleration holds the output back.
    SLEWING = informs, "rate limited";
    /// The pose is within about 1° of one in which the tool axis cannot be corrected in one direction: that direction
    /// is left as it is.
    SINGULAR = informs, "singular pose";
    /// The pose is within about 6° of a singular one: rotary corrections are more than ten times the error of the tool
    /// axis.
    NEAR_SINGULAR = informs, "near a singular pose";
    /// Rotary axes have turned two linear axes nearly into one direction: linear corrections are more than ten times the
    /// error, or one of the axes is left out.
    LINEAR_NEAR_SINGULAR = informs, "linear axes nearly in one direction";
    /// Positions are so old for the speed of the axes that only a part of the correction, or none, is better than nothing.
    LET_GO = informs, "positions too old for the speed: a part of the correction let go";
    /// Whether positions contain the correction is not proven for every axis.
    NOT_PROVEN = informs, "not proven what positions contain";
    /// Another controller path than the first corrects.
    FALLBACK = informs, "fallback controller";
    /// Another path does not answer.
    STANDBY_SILENT = informs, "a standby path does not answer";
    /// Cycles take longer than their time.
    OVERRUNS = informs, "cycle overruns";
    /// Whether a second gateway is there cannot be seen.
    CANNOT_SEE_OTHERS = informs, "cannot see other gateways";
    /// The correction is not ramped out when the gateway stops.
    UNWATCHED = informs, "unwatched";
    /// Nothing in the control distinguishes a late or foreign write from one that is meant now.
    NO_BARRIER = informs, "no barrier";
}

impl Reasons {
    /// The set without any reason.
    pub const NONE: Self = Self(0);

    /// The reasons that only inform: none of them forbids arming.
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

    /// Whether the set holds no reason.
    pub fn is_empty(self) -> bool {
        self.0 == 0
    }

    /// Whether the set holds every reason of `other`.
    pub fn contains(self, other: Self) -> bool {
        self.0 & other.0 == other.0
    }

    /// The set where `condition` holds, else the empty set.
    #[must_use]
    pub fn when(self, condition: bool) -> Self {
        if condition { self } else { Self::NONE }
    }

    /// The set without the reasons of `other`.
    #[must_use]
    pub fn without(self, other: Self) -> Self {
        Self(self.0 & !other.0)
    }

    /// The set as a number, for atomics and rings.
    pub fn bits(self) -> u64 {
        self.0
    }

    /// The set of a number that [`bits`](Self::bits) gave.
    pub fn from_bits(bits: u64) -> Self {
        Self(bits)
    }

    /// The reason with a text, after which `: ` and what it is about may follow; `None` if there is no such reason.
    pub fn with_text(text: &str) -> Option<Self> {
        let mut all = Self::ALL.iter();
        let is = |own: &str| {
            let rest = text.strip_prefix(own);
            rest.is_some_and(|rest| rest.is_empty() || rest.starts_with(": "))
        };
        all.find(|(.., own)| is(own)).map(|(reason, ..)| *reason)
    }

    /// Each reason of the set in words, causes first.
    pub fn texts(self) -> impl Iterator<Item = &'static str> {
        Self::ALL
            .iter()
            .filter(move |(reason, ..)| self.contains(*reason))
            .map(|(.., text)| *text)
    }
}

impl fmt::Debug for Reasons {
    /// The reasons in words.
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

    /// The first words are the cause of the stop, not what follows from it.
    #[test]
    fn causes_stand_before_what_follows_from_them() {
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
        assert_eq!(
            Reasons::with_text("emergency stop"),
            Some(Reasons::EMERGENCY_STOP)
        );
        assert_eq!(
            Reasons::with_text("position jumped: X 4000.000 mm"),
            Some(Reasons::JUMPED)
        );
        assert_eq!(Reasons::with_text("position jumped far"), None);
        assert_eq!(Reasons::with_text("no reason"), None);
    }
}
