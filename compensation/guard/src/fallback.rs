//! Which of several controller paths corrects.

use core::time::Duration;

/// The largest number of paths to one machine.
pub const MAX_PATHS: usize = 4;

/// The condition of one controller path in a cycle; paths are in the order of preference.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct PathHealth {
    /// Its positions are fresh, and every position that its correction depends on is to be had.
    pub usable: bool,
    /// What the axes get is known as soon as it writes: it reports it, or nothing is left of the path before.
    pub ready: bool,
}

/// Which path corrects, and why not another one.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Choice {
    /// The place of the path that corrects.
    pub active: usize,
    /// The place of the path that should correct.
    pub wanted: usize,
    /// Whether it is another one than in the cycle before.
    pub switched: bool,
    /// The next one may not take over, since it is unknown what the path before has left.
    pub blocked: bool,
}

/// Chooses the path, with hysteresis: state are the active path and since when each is usable.
#[derive(Clone, Copy, Debug)]
pub struct Selector {
    active: usize,
    usable_since: [Option<Duration>; MAX_PATHS],
    hand_back: Duration,
}

impl Selector {
    /// The first path is active; a better one takes over again when it was usable for `hand_back`.
    pub fn new(hand_back: Duration) -> Self {
        Self {
            active: 0,
            usable_since: [None; MAX_PATHS],
            hand_back,
        }
    }

    /// The place of the path that corrects.
    pub fn active(&self) -> usize {
        self.active
    }

    /// One cycle: the first [`MAX_PATHS`] of `paths` count.
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
        let wanted = match usable_for(self.active) {
            Some(_) => better,
            None => better.or_else(stands_in),
        };
        let Some(wanted) = wanted.filter(|&wanted| wanted != self.active) else {
            return Choice {
                active: self.active,
                wanted: self.active,
                switched: false,
                blocked: false,
            };
        };
        let blocked = !paths[wanted].ready;
        if !blocked {
            self.active = wanted;
        }
        Choice {
            active: self.active,
            wanted,
            switched: !blocked,
            blocked,
        }
    }
}
