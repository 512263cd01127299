//! Selection of the active controller path.

use core::time::Duration;

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
