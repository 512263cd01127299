//! Proof of life of a machine for the service manager's watchdog. A proof is given only while cycles are on time.

use std::{
    sync::{
        Arc,
        atomic::{AtomicU64, Ordering},
    },
    time::{Duration, Instant},
};

use volcomp_runtime::Timing;

/// Counter of the proofs that cycles are on time.
#[derive(Clone, Debug, Default)]
pub struct Life(Arc<AtomicU64>);

impl Life {
    /// The number of proofs so far.
    pub fn proofs(&self) -> u64 {
        self.0.load(Ordering::Relaxed)
    }

    pub(super) fn prove(&self) {
        self.0.fetch_add(1, Ordering::Relaxed);
    }
}

/// Checks that cycles are on time: no gap is longer than `timeout`, and at least a third of the expected cycles have
/// run.
pub(super) struct Watchdog {
    interval: Duration,
    period: Duration,
    timeout: Duration,
    since: Instant,
    cycles: u64,
}

impl Watchdog {
    /// `time` is the watchdog timeout of the service manager; `timeout` is the longest permitted gap between cycles.
    pub(super) fn new(time: Duration, period: Duration, timeout: Duration, now: Instant) -> Self {
        Self {
            // A missed proof delays the next one by a further interval, and that proof must still be in time.
            interval: (time / 4).min(Duration::from_secs(1)),
            period,
            timeout,
            since: now,
            cycles: 0,
        }
    }

    pub(super) fn count(&mut self, timing: &Timing, now: Instant) {
        self.cycles += 1;
        if self.period.saturating_mul(timing.missed.saturating_add(1)) > self.timeout {
            self.begin(now);
        }
    }

    /// True if a proof is due now. `is_silent`: the control thread has run no cycle for too long.
    pub(super) fn is_due(&mut self, is_silent: bool, now: Instant) -> bool {
        if is_silent {
            self.begin(now);
            return false;
        }
        let passed = now.saturating_duration_since(self.since);
        if passed < self.interval {
            return false;
        }
        let expected = passed.as_secs_f64() / self.period.as_secs_f64();
        let is_on_time = self.cycles as f64 * 3.0 >= expected;
        self.begin(now);
        is_on_time
    }

    fn begin(&mut self, now: Instant) {
        self.since = now;
        self.cycles = 0;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: Duration = Duration::from_millis(1);

    /// Number of proofs within ten seconds. The watchdog timeout is 400 ms. A cycle of 4 ms runs only every `every` ms,
    /// and no cycle runs for `gap_ms` after 5 s.
    fn fed(every: u32, gap_ms: u32) -> u32 {
        let begun = Instant::now();
        let mut dog = Watchdog::new(400 * MS, 4 * MS, 100 * MS, begun);
        let (mut fed, mut last) = (0, 0);
        for ms in 1..10_000_u32 {
            let now = begun + ms * MS;
            let in_gap = ms > 5000 && ms < 5000 + gap_ms;
            if ms.is_multiple_of(every) && !in_gap {
                let missed = (ms - last) / 4 - 1;
                last = ms;
                let timing = Timing { missed, ..Timing::default() };
                dog.count(&timing, now);
            }
            if ms.is_multiple_of(50) {
                fed += u32::from(dog.is_due(ms - last > 100, now));
            }
        }
        fed
    }

    /// At least every third cycle must run.
    #[test]
    fn cycles_must_come_on_time() {
        assert!(fed(4, 0) >= 95, "each cycle");
        assert!(fed(8, 0) >= 95, "a slow control, every other cycle");
        assert_eq!(fed(16, 0), 0, "a quarter of the cycles");
        assert_eq!(fed(1000, 0), 0, "one a second");
        let with_gap = fed(4, 2000);
        assert!((72..=80).contains(&with_gap), "{with_gap}: none for two seconds");
    }
}
