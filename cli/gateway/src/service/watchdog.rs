//! The watchdog of the service manager: it is fed only while cycles come on time.

use std::time::{Duration, Instant};

use volcomp_runtime::{Pulse, Timing};

/// On time are cycles of which none stayed away for longer than its patience, and of which there were at least a third
/// of what the period asks for.
pub(super) struct Watchdog {
    /// How often it is fed; `None`: nobody waits for it.
    interval: Option<Duration>,
    pulse: Pulse,
    period: Duration,
    /// Since when cycles have been on time.
    since: Instant,
    /// Cycles since then.
    cycles: u64,
}

impl Watchdog {
    /// A watchdog that must hear something within `time`; `None`: there is none.
    pub(super) fn new(
        time: Option<Duration>,
        pulse: Pulse,
        period: Duration,
        now: Instant,
    ) -> Self {
        Self {
            // A stretch that was late costs as long again, and the next one must still be in time.
            interval: time.map(|time| (time / 4).min(Duration::from_secs(1))),
            pulse,
            period,
            since: now,
            cycles: 0,
        }
    }

    /// Counts a cycle.
    pub(super) fn count(&mut self, timing: &Timing, now: Instant) {
        self.cycles += 1;
        if self.period * (timing.missed + 1) > self.pulse.patience() {
            self.begin(now);
        }
    }

    /// Whether it is to be fed now.
    pub(super) fn is_due(&mut self, now: Instant) -> bool {
        let Some(interval) = self.interval else {
            return false;
        };
        if self.pulse.silence().is_some() {
            self.begin(now);
            return false;
        }
        let stretch = now.saturating_duration_since(self.since);
        if stretch < interval {
            return false;
        }
        let expected = stretch.as_secs_f64() / self.period.as_secs_f64();
        let is_on_time = self.cycles as f64 * 3.0 >= expected;
        self.begin(now);
        is_on_time
    }

    fn begin(&mut self, now: Instant) {
        self.since = now;
        self.cycles = 0;
    }
}
