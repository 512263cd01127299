//! Several paths to one control: selection of the active path, and the interlocks of all paths.
//!
//! An interlock is a condition that forbids moving a correction. It applies if any path reports it.

use core::time::Duration;

use crate::Reasons;

/// Maximum number of paths to one machine.
pub const MAX_PATHS: usize = 4;

/// State of one controller path in a cycle. Lists of paths are in order of preference.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct PathHealth {
    /// The controller's positions are fresh, and every position that its correction depends on is available.
    pub usable: bool,
    /// Whether the applied correction will be known once this path writes: the control reports the correction, or no
    /// correction of the previous path remains.
    pub ready: bool,
}

/// The selected path, and whether a change to another path is blocked.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Choice {
    /// Index of the active path.
    pub active: usize,
    /// Index of the path that should be active: the first path before the active one that has been usable for
    /// `hand_back` (see [`Selector::new`]). Without such a path it is the active path or, if the active path is not
    /// usable, the first usable path.
    pub preferred: usize,
    /// Whether the active path changed in this cycle.
    pub switched: bool,
    /// Whether the active path is kept because the preferred path is not [`ready`](PathHealth::ready).
    pub blocked: bool,
}

/// Selects the path, with hysteresis. State: the active path, and the time from which each path is usable.
///
/// Invariants:
/// - `usable_since` of a path is `None` while it is not usable.
/// - `active` changes only to a path that is ready.
#[derive(Clone, Copy, Debug)]
pub struct Selector {
    active: usize,
    usable_since: [Option<Duration>; MAX_PATHS],
    hand_back: Duration,
}

impl Selector {
    /// Starts with the first path. A path of higher preference than the active path takes over once it has been usable
    /// for `hand_back`.
    pub fn new(hand_back: Duration) -> Self {
        Self { active: 0, usable_since: [None; MAX_PATHS], hand_back }
    }

    /// Index of the active path.
    pub fn active(&self) -> usize {
        self.active
    }

    /// Runs one cycle; only the first [`MAX_PATHS`] of `paths` are used.
    pub fn choose(&mut self, now: Duration, paths: &[PathHealth]) -> Choice {
        for (since, path) in self.usable_since.iter_mut().zip(paths) {
            *since = path.usable.then(|| since.unwrap_or(now));
        }
        let usable_for = |index: usize| {
            let since = self.usable_since.get(index).copied().flatten();
            since.map(|since| now.saturating_sub(since))
        };
        let better =
            (0..self.active).find(|&i| usable_for(i).is_some_and(|time| time >= self.hand_back));
        let stands_in = || (0..paths.len().min(MAX_PATHS)).find(|&i| usable_for(i).is_some());
        let preferred = match usable_for(self.active) {
            Some(_) => better,
            None => better.or_else(stands_in),
        };
        let Some(preferred) = preferred.filter(|&preferred| preferred != self.active) else {
            return Choice {
                active: self.active,
                preferred: self.active,
                switched: false,
                blocked: false,
            };
        };
        let blocked = !paths[preferred].ready;
        if !blocked {
            self.active = preferred;
        }
        Choice { active: self.active, preferred, switched: !blocked, blocked }
    }
}

/// The interlock flags of one path; true forbids.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Interlock {
    /// An axis is not referenced.
    pub unreferenced: bool,
    pub alarm: bool,
    pub emergency_stop: bool,
}

impl Interlock {
    /// The reasons that correspond to these flags, which hold a correction until the control clears them.
    pub const REASONS: [Reasons; 3] =
        [Reasons::NOT_REFERENCED, Reasons::CONTROLLER_ALARM, Reasons::EMERGENCY_STOP];

    /// The flags that correspond to these reasons.
    #[must_use]
    pub fn of(reasons: Reasons) -> Self {
        let [unreferenced, alarm, emergency_stop] =
            Self::REASONS.map(|reason| reasons.contains(reason));
        Self { unreferenced, alarm, emergency_stop }
    }

    /// Whether any flag is set.
    #[must_use]
    pub fn is_set(self) -> bool {
        self.unreferenced || self.alarm || self.emergency_stop
    }

    /// The flags that apply at an age: if they are older than `hold`, each flag that the control can report (`shown`)
    /// counts as set.
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
        both.fold(Reasons::NONE, |all, (reason, is_set)| all | reason.when(is_set))
    }
}

/// The interlocks of a machine. State: the last flags of each path. An interlock on one path applies to all paths. It
/// is cleared by a report of the same path or by the operator; silence does not clear it.
///
/// Invariants:
/// - The flags of a path change only by its own report, or by an acknowledgement while the path is silent.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Interlocks {
    flags: [Interlock; MAX_PATHS],
    silent: [bool; MAX_PATHS],
}

impl Interlocks {
    /// Records the flags of the path at this index in this cycle; `None`: the path reported no flags.
    pub fn update(&mut self, path: usize, interlock: Option<Interlock>) {
        if let (Some(flags), Some(silent)) = (self.flags.get_mut(path), self.silent.get_mut(path)) {
            *silent = interlock.is_none();
            *flags = interlock.unwrap_or(*flags);
        }
    }

    /// Restores flags that the path at this index reported before the program ended. The path counts as silent until
    /// its next report.
    pub fn restore(&mut self, path: usize, interlock: Interlock) {
        self.update(path, Some(interlock));
        self.update(path, None);
    }

    /// Clears the interlocks of paths that are silent now. The operator has checked that these interlocks no longer
    /// apply.
    pub fn acknowledge(&mut self) {
        for (flags, silent) in self.flags.iter_mut().zip(self.silent) {
            if silent {
                *flags = Interlock::default();
            }
        }
    }

    /// Why the correction must be held; empty if the correction may move.
    #[must_use]
    pub fn reasons(&self) -> Reasons {
        (0..MAX_PATHS).fold(Reasons::NONE, |all, path| all | self.path_reasons(path))
    }

    /// Reasons from the last flags of the path at this index, with [`Reasons::INTERLOCK_UNSEEN`] if a flag is set and
    /// the path has been silent since.
    #[must_use]
    pub fn path_reasons(&self, path: usize) -> Reasons {
        let (Some(flags), Some(silent)) = (self.flags.get(path), self.silent.get(path)) else {
            return Reasons::NONE;
        };
        flags.reasons() | Reasons::INTERLOCK_UNSEEN.when(flags.is_set() && *silent)
    }
}
