//! Interlocks: what forbids moving a correction, seen on any path.

use core::time::Duration;

use crate::{MAX_PATHS, Reasons};

/// The flags of one path, each in the sense that forbids.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Interlock {
    /// An axis was not sent to its reference.
    pub unreferenced: bool,
    /// An alarm is on.
    pub alarm: bool,
    /// The emergency stop is pressed.
    pub emergency_stop: bool,
}

impl Interlock {
    /// The reasons of which each is one of these flags: why a correction stands until a control says otherwise.
    pub const REASONS: [Reasons; 3] = [
        Reasons::NOT_REFERENCED,
        Reasons::CONTROLLER_ALARM,
        Reasons::EMERGENCY_STOP,
    ];

    /// Whether something forbids.
    #[must_use]
    pub fn is_set(self) -> bool {
        self.unreferenced || self.alarm || self.emergency_stop
    }

    /// What is known of the machine from flags of this age: those older than `hold` say nothing any more, so each one that
    /// the control shows (`shown`) counts in the sense that forbids.
    #[must_use]
    pub fn at_age(self, age: Duration, hold: Duration, shown: Self) -> Self {
        let is_old = age > hold;
        Self {
            unreferenced: self.unreferenced || is_old && shown.unreferenced,
            alarm: self.alarm || is_old && shown.alarm,
            emergency_stop: self.emergency_stop || is_old && shown.emergency_stop,
        }
    }

    fn reasons(self) -> Reasons {
        let flags = [self.unreferenced, self.alarm, self.emergency_stop];
        let both = Self::REASONS.into_iter().zip(flags);
        both.fold(Reasons::NONE, |all, (reason, is_set)| {
            all | reason.when(is_set)
        })
    }
}

/// The interlocks of a machine. State: what each path said last. An interlock that was seen on one path holds all of
/// them; that it is no longer seen does not lift it: only the same path saying "clear" does, or a person.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Interlocks {
    said: [Interlock; MAX_PATHS],
    silent: [bool; MAX_PATHS],
}

impl Interlocks {
    /// What the path at this place said in this cycle; `None`: it said nothing.
    pub fn see(&mut self, path: usize, interlock: Option<Interlock>) {
        if let (Some(said), Some(silent)) = (self.said.get_mut(path), self.silent.get_mut(path)) {
            *silent = interlock.is_none();
            *said = interlock.unwrap_or(*said);
        }
    }

    /// A person has made sure that what paths which are silent now said last is no longer so.
    pub fn acknowledge(&mut self) {
        for (said, silent) in self.said.iter_mut().zip(self.silent) {
            if silent {
                *said = Interlock::default();
            }
        }
    }

    /// Why the correction must stand, empty where it may move.
    #[must_use]
    pub fn reasons(&self) -> Reasons {
        (0..MAX_PATHS).fold(Reasons::NONE, |all, path| all | self.said_by(path))
    }

    /// What the path at this place said last, and whether it has been silent since.
    #[must_use]
    pub fn said_by(&self, path: usize) -> Reasons {
        let (Some(said), Some(silent)) = (self.said.get(path), self.silent.get(path)) else {
            return Reasons::NONE;
        };
        said.reasons() | Reasons::INTERLOCK_UNSEEN.when(said.is_set() && *silent)
    }
}
