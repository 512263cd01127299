//! Why the state of a guard is what it is, as a set.

use core::{
    fmt,
    ops::{BitOr, BitOrAssign},
};

/// A set of reasons. Plain bits: cheap to pass between threads.
#[derive(Clone, Copy, Default, PartialEq, Eq, Hash)]
pub struct Reasons(u64);

macro_rules! reasons {
    ($($(#[$doc:meta])* $name:ident = $bit:literal, $text:literal;)*) => {
        impl Reasons {
            $($(#[$doc])* pub const $name: Self = Self(1 << $bit);)*

            const ALL: &'static [(Self, &'static str)] = &[$((Self::$name, $text)),*];
        }
    };
}

reasons! {
    /// The wanted correction is beyond the limit.
    LIMITED = 0, "correction limited";
    /// The wanted correction is beyond the warning.
    WARN = 1, "correction above the warning";
    /// Slew or acceleration holds the output back.
    SLEWING = 2, "rate limited";
    /// Positions are older than allowed.
    POSITIONS_STALE = 3, "positions stale";
    /// Positions are so old that the correction goes to zero.
    POSITIONS_LOST = 4, "positions lost";
    /// The controller does not answer.
    NO_CONTROLLER = 5, "controller does not answer";
    /// Axes are not referenced.
    NOT_REFERENCED = 6, "axes not referenced";
    /// The controller has an alarm.
    CONTROLLER_ALARM = 7, "controller alarm";
    /// The emergency stop is pressed.
    EMERGENCY_STOP = 8, "emergency stop";
    /// A position or a correction is no finite number.
    NOT_A_NUMBER = 9, "not a number";
    /// The correction that the controller has applied is not the one that was written: ramping from there.
    READ_BACK = 10, "controller's correction changed";
    /// A correction that was written is not found when it is read back, several times in a row.
    DOES_NOT_STICK = 11, "correction does not stick";
    /// Positions do not contain the correction as configured.
    CONTRADICTION = 12, "positions contradict includes_correction";
    /// Arming waits until the axes stand still.
    WAITING_FOR_STANDSTILL = 13, "waiting for standstill";
    /// Whether positions contain the correction is not proven for every axis.
    NOT_PROVEN = 14, "not proven what positions contain";
    /// A correction is applied while disarmed.
    CORRECTION_LEFT = 15, "a correction is applied";
    /// A temperature that the model uses is missing.
    DEGRADED = 16, "degraded";
    /// A position is outside the range that was measured.
    OUTSIDE_RANGE = 17, "outside the measured range";
    /// Nobody ramps the correction out when the gateway stops.
    UNWATCHED = 18, "unwatched";
    /// The audit log cannot be written.
    AUDIT = 19, "audit log cannot be written";
    /// An axis of the machine has a position from no controller.
    AXIS_UNKNOWN = 20, "a machine axis has no position";
    /// Another gateway corrects this controller.
    OTHER_GATEWAY = 21, "another gateway";
    /// The limits are not configured.
    NO_LIMITS = 22, "limits are not configured";
    /// Cycles take longer than their time.
    OVERRUNS = 23, "cycle overruns";
    /// Another controller path stands in.
    FALLBACK = 24, "fallback controller";
    /// No other path may take over, since nobody knows what the silent one still applies.
    OTHER_CHANNEL_UNKNOWN = 25, "another path may still hold a correction";
    /// Whether a second gateway is there cannot be seen.
    CANNOT_SEE_OTHERS = 26, "cannot see other gateways";
    /// The program is stopping.
    STOPPING = 27, "stopping";
    /// The pose is within about 1° of one in which the tool axis cannot be corrected in one direction: that direction
    /// is left as it is.
    SINGULAR = 28, "singular pose";
    /// The pose is within about 6° of a singular one: rotary corrections are more than ten times the error of the tool
    /// axis.
    NEAR_SINGULAR = 29, "near a singular pose";
    /// Rotary axes have turned two linear axes nearly into one direction: linear corrections are more than ten times the
    /// error, or one of the axes is left out.
    LINEAR_NEAR_SINGULAR = 55, "linear axes nearly in one direction";
    /// Positions are so old for the speed of the axes that only a part of the correction, or none, is better than nothing.
    LET_GO = 56, "positions too old for the speed: a part of the correction let go";
    /// The configuration or the machine file on disk was refused or waits for a confirmation: the one from before holds.
    NOT_RELOADED = 30, "files on disk not taken over";
    /// The gateway was faulted when it ended, and nobody has acknowledged it since.
    FAULTED_BEFORE = 48, "faulted before the restart: acknowledge it";
    /// A person disarmed it: it does not arm by itself, also after a restart.
    DISARMED_BY_PERSON = 49, "disarmed by a person: it does not arm by itself";
    /// The machine file or the limits are not those that were confirmed last.
    MUST_CONFIRM = 50, "machine file or limits must be confirmed";
    /// Nothing in the control tells a late or foreign write from one that is meant now.
    NO_BARRIER = 31, "no barrier";
    /// The barrier's limits, rates or times do not fit those of the guard, or its scans are not as long as configured.
    BARRIER_UNFIT = 32, "the control's barrier does not fit the limits";
    /// What the control tells is no report of a barrier of this machine and these axes, in this order.
    BARRIER_STRANGE = 40, "no barrier for this machine and these axes";
    /// Whether another gateway writes, or how fast the control scans, is being looked at before the first write.
    WATCHING = 33, "watching the control";
    /// The correction that the control applies has not been confirmed for too long.
    UNCONFIRMED = 34, "applied correction not confirmed";
    /// The control applies a correction beyond the limit, and nothing here has asked for it.
    BEYOND_LIMIT = 35, "a correction beyond the limit was found";
    /// An interlock was seen on a path that says nothing any more.
    INTERLOCK_UNSEEN = 36, "interlock not seen to clear";
    /// What a control that cannot be asked was left with is not known.
    LEFT_UNKNOWN = 37, "what the control was left with is unknown";
    /// Another path shows a correction that it should not have.
    STANDBY_HOLDS = 38, "a standby path holds a correction";
    /// Another path does not answer.
    STANDBY_SILENT = 39, "a standby path does not answer";
}

impl Reasons {
    /// The set without any reason.
    pub const NONE: Self = Self(0);

    /// The reasons that only inform: none of them forbids arming.
    pub const DOES_NOT_FORBID: Self = Self(
        Self::WARN.0
            | Self::LIMITED.0
            | Self::SLEWING.0
            | Self::NOT_PROVEN.0
            | Self::CORRECTION_LEFT.0
            | Self::DEGRADED.0
            | Self::OUTSIDE_RANGE.0
            | Self::UNWATCHED.0
            | Self::OVERRUNS.0
            | Self::FALLBACK.0
            | Self::CANNOT_SEE_OTHERS.0
            | Self::SINGULAR.0
            | Self::NEAR_SINGULAR.0
            | Self::LINEAR_NEAR_SINGULAR.0
            | Self::LET_GO.0
            | Self::NOT_RELOADED.0
            | Self::DISARMED_BY_PERSON.0
            | Self::MUST_CONFIRM.0
            | Self::NO_BARRIER.0
            | Self::STANDBY_HOLDS.0
            | Self::STANDBY_SILENT.0,
    );

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

    /// Each reason of the set in words.
    pub fn texts(self) -> impl Iterator<Item = &'static str> {
        Self::ALL
            .iter()
            .filter(move |(reason, _)| self.contains(*reason))
            .map(|(_, text)| *text)
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
