//! Clocks and deadlines of the control thread.

use std::time::Duration;

use rustix::{
    thread::{ClockId, clock_nanosleep_absolute},
    time::{ClockId as TimeClock, Timespec, clock_gettime},
};

/// Monotonic time since the system was booted.
pub fn monotonic() -> Duration {
    duration(clock_gettime(TimeClock::Monotonic))
}

/// CPU time used by this thread.
pub fn thread_time() -> Duration {
    duration(clock_gettime(TimeClock::ThreadCPUTime))
}

pub(crate) struct Deadlines {
    next: Duration,
    period: Duration,
}

impl Deadlines {
    /// Creates deadlines of which the first is one period from now.
    pub(crate) fn new(period: Duration) -> Self {
        Self { next: monotonic().saturating_add(period), period }
    }

    pub(crate) fn wait(&self) -> Duration {
        // A signal interrupts the sleep, which is then continued.
        while clock_nanosleep_absolute(ClockId::Monotonic, &timespec(self.next)).is_err() {}
        self.next
    }

    /// Advances to the next deadline after `now` and returns the number of skipped periods. Skipping prevents a burst of cycles.
    pub(crate) fn done(&mut self, now: Duration) -> u32 {
        self.next = self.next.saturating_add(self.period);
        if now <= self.next {
            return 0;
        }
        let late = now.saturating_sub(self.next).as_nanos() / self.period.as_nanos().max(1);
        let missed = u32::try_from(late + 1).unwrap_or(u32::MAX);
        self.next = self.next.saturating_add(self.period.saturating_mul(missed));
        missed
    }
}

/// Sleeps to each deadline like a control thread, for the time `during`. Reports time, wake-up latency and number of missed periods, to
/// measure the computer's share of the cycle time.
pub fn tick(period: Duration, during: Duration, report: &mut dyn FnMut(Duration, Duration, u32)) {
    let begun = monotonic();
    let mut deadlines = Deadlines::new(period);
    while monotonic().saturating_sub(begun) < during {
        let deadline = deadlines.wait();
        let woke = monotonic();
        let missed = deadlines.done(woke);
        report(woke, woke.saturating_sub(deadline), missed);
    }
}

fn duration(time: Timespec) -> Duration {
    Duration::new(u64::try_from(time.tv_sec).unwrap_or(0), u32::try_from(time.tv_nsec).unwrap_or(0))
}

fn timespec(time: Duration) -> Timespec {
    Timespec {
        tv_sec: i64::try_from(time.as_secs()).unwrap_or(i64::MAX),
        tv_nsec: i64::from(time.subsec_nanos()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_overrun_skips_to_the_next_period() {
        let ms = Duration::from_millis;
        for (now, expected, skipped) in
            [(10, 12, 0), (12, 12, 0), (13, 16, 1), (16, 20, 2), (31, 32, 5)]
        {
            let mut deadlines = Deadlines { next: ms(8), period: ms(4) };
            assert_eq!(deadlines.done(ms(now)), skipped);
            assert_eq!(deadlines.next, ms(expected));
        }
    }
}
