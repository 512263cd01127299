//! When frames arrived, from the stamps of the kernel.

use std::time::{Duration, Instant, SystemTime};

/// How far the wall clock, which the stamps of the kernel are of, may go apart from the monotonic one while a queue is
/// emptied. Where it is more, somebody set the clock, and the stamps say nothing.
const CLOCK_WAS_SET: Duration = Duration::from_millis(1);

/// How long reading both clocks may take: so far apart they are at the most.
const BOTH_WITHIN: Duration = Duration::from_micros(100);

/// Both clocks at one instant. A thread that is interrupted between the two reads them again, twice at the most.
pub(crate) fn both_clocks() -> (Instant, SystemTime) {
    let read = || (Instant::now(), SystemTime::now());
    let mut both = read();
    for _ in 0..2 {
        if both.0.elapsed() <= BOTH_WITHIN {
            break;
        }
        both = read();
    }
    both
}

/// The last instant at which no frame waited, by both clocks. What waits later arrived after it.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Arrivals {
    empty: Instant,
    wall: SystemTime,
}

impl Arrivals {
    /// Nothing waits at this instant.
    pub(crate) fn empty_at(empty: Instant, wall: SystemTime) -> Self {
        Self { empty, wall }
    }

    /// When a frame arrived that is read at this instant, never later than it did: by its stamp where it has one and the
    /// clock was not set meanwhile, else the last instant at which no frame waited. So frames that waited while nobody
    /// read are as old as they can be.
    pub(crate) fn of(&self, stamp: Option<SystemTime>, now: Instant, wall: SystemTime) -> Instant {
        let passed = now.saturating_duration_since(self.empty);
        let by_wall = wall.duration_since(self.wall).unwrap_or_default();
        let (Some(stamp), true) = (stamp, passed.abs_diff(by_wall) <= CLOCK_WAS_SET) else {
            return self.empty;
        };
        let age = wall.duration_since(stamp).unwrap_or_default();
        let arrived = now.checked_sub(age).unwrap_or(self.empty);
        arrived.max(self.empty)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: Duration = Duration::from_millis(1);

    #[test]
    fn frames_that_waited_are_old() {
        let (empty, wall) = (Instant::now(), SystemTime::now());
        let arrivals = Arrivals::empty_at(empty, wall);
        let read = |stamp: Option<Duration>, at: Duration, wall_at: Duration| {
            let stamp = stamp.map(|stamp| wall + stamp);
            let arrived = arrivals.of(stamp, empty + at, wall + wall_at);
            arrived.duration_since(empty)
        };
        // Read 300 ms after the queue was empty.
        let at = 300 * MS;
        assert_eq!(read(Some(20 * MS), at, at), 20 * MS);
        assert_eq!(read(Some(at), at, at), at);
        // Without a stamp it may have come right after.
        assert_eq!(read(None, at, at), Duration::ZERO);
        // The clock was set back or ahead meanwhile: the stamp says nothing.
        assert_eq!(read(Some(20 * MS), at, 100 * MS), Duration::ZERO);
        assert_eq!(read(Some(20 * MS), at, 5000 * MS), Duration::ZERO);
        // A stamp of the future or from before the queue was empty is held within.
        assert_eq!(read(Some(301 * MS), at, at), at);
        let before = arrivals.of(Some(wall - 50 * MS), empty + at, wall + at);
        assert_eq!(before, empty);
    }
}
