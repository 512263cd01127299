//! Arrival times of frames, from kernel timestamps.

use std::time::{Duration, Instant, SystemTime};

/// Maximum divergence, while a queue is emptied, between the wall clock (used by kernel timestamps) and the monotonic
/// clock. A larger divergence means that the wall clock was set, and the timestamps are ignored.
const MAX_CLOCK_DRIFT: Duration = Duration::from_millis(1);

/// The two clocks count as read together if both readings take at most this time.
const MAX_CLOCK_READ_TIME: Duration = Duration::from_micros(100);

/// Reads both clocks together. If the thread is interrupted between the two readings, both are repeated, at most twice.
pub(crate) fn both_clocks() -> (Instant, SystemTime) {
    let read = || (Instant::now(), SystemTime::now());
    let mut both = read();
    for _ in 0..2 {
        if both.0.elapsed() <= MAX_CLOCK_READ_TIME {
            break;
        }
        both = read();
    }
    both
}

/// The last time at which no frame was waiting, by both clocks. Every frame read later arrived after this time.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Arrivals {
    empty: Instant,
    wall: SystemTime,
}

impl Arrivals {
    /// Records that no frame is waiting at this time.
    pub(crate) fn empty_at(empty: Instant, wall: SystemTime) -> Self {
        Self { empty, wall }
    }

    /// Arrival time of a frame that is read at `now`, never later than the true arrival. It is the kernel timestamp if
    /// the kernel gave one and the wall clock was not set since `empty`. Otherwise it is `empty`, so that the frame
    /// gets its maximum age.
    pub(crate) fn of(&self, stamp: Option<SystemTime>, now: Instant, wall: SystemTime) -> Instant {
        let passed = now.saturating_duration_since(self.empty);
        let by_wall = wall.duration_since(self.wall).unwrap_or_default();
        let (Some(stamp), true) = (stamp, passed.abs_diff(by_wall) <= MAX_CLOCK_DRIFT) else {
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
    fn a_queued_frame_gets_its_maximum_age() {
        let (empty, wall) = (Instant::now(), SystemTime::now());
        let arrivals = Arrivals::empty_at(empty, wall);
        let read = |stamp: Option<Duration>, at: Duration, wall_at: Duration| {
            let stamp = stamp.map(|stamp| wall + stamp);
            let arrived = arrivals.of(stamp, empty + at, wall + wall_at);
            arrived.duration_since(empty)
        };
        // Frames are read 300 ms after the queue was empty.
        let at = 300 * MS;
        assert_eq!(read(Some(20 * MS), at, at), 20 * MS);
        assert_eq!(read(Some(at), at, at), at);
        // A frame without a timestamp may have arrived just after the queue was empty.
        assert_eq!(read(None, at, at), Duration::ZERO);
        // The wall clock was set meanwhile, so the timestamp is ignored.
        assert_eq!(read(Some(20 * MS), at, 100 * MS), Duration::ZERO);
        assert_eq!(read(Some(20 * MS), at, 5000 * MS), Duration::ZERO);
        // A timestamp after now, or before the queue was empty, is clamped.
        assert_eq!(read(Some(301 * MS), at, at), at);
        let before = arrivals.of(Some(wall - 50 * MS), empty + at, wall + at);
        assert_eq!(before, empty);
    }
}
