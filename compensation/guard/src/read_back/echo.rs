//! A control without a barrier whose values can be read back.
//!
//! One reading proves nothing: it may be torn, late, or of another axis. A value counts as applied when it is, on all
//! axes, one and the same write of the path's delay, or when it was read three times while nothing was written.

use core::time::Duration;

use volcomp_vocabulary::PerChannel;

use super::{Confirmed, Known, are_equal};
use crate::{Limits, Reasons, limits::MOST_READ_BACK_CYCLES};

/// Equal readings that confirm a value that was not written.
const EQUAL_READINGS: u32 = 3;
/// For how long another gateway is reported after it was seen.
const OTHER_TOLD: Duration = Duration::from_secs(5);

#[derive(Clone, Copy, Debug, Default)]
struct Write {
    at: Duration,
    values: PerChannel<f64>,
}

#[derive(Clone, Debug)]
pub(super) struct Echo {
    /// For how long nothing else may have moved anything before the first write.
    watch: Duration,
    /// The last writes; the newest stands before `next`.
    ring: [Write; MOST_READ_BACK_CYCLES],
    next: usize,
    writes: usize,
    /// The last reading that was told apart from the one before, and when it held.
    reading: Option<(PerChannel<f64>, Duration)>,
    equal: u32,
    /// Whether something was sent since the last reading.
    sent: bool,
    /// Since when nobody but this gateway moved anything.
    alone_since: Option<Duration>,
    other: Option<Duration>,
}

impl Echo {
    pub(super) fn new(watch: Duration) -> Self {
        Self {
            watch,
            ring: [Write::default(); MOST_READ_BACK_CYCLES],
            next: 0,
            writes: 0,
            reading: None,
            equal: 0,
            sent: false,
            alone_since: None,
            other: None,
        }
    }

    pub(super) fn hear(
        &mut self,
        now: Duration,
        taken: Duration,
        values: &PerChannel<f64>,
        limits: &Limits,
        known: &mut Known,
    ) {
        if !(0..limits.count).all(|i| values[i].is_finite()) {
            known.writable = false;
            self.equal = 0;
            return;
        }
        let before = self.reading.replace((*values, taken));
        if before.is_some_and(|(_, then)| then == taken) {
            // The same message as before: it says nothing new.
            return;
        }
        let is_same = before.is_some_and(|(before, _)| are_equal(&before, values, limits));
        if is_same && !self.sent {
            self.equal = self.equal.saturating_add(1);
        } else {
            self.equal = 1;
        }
        self.sent = false;
        if let Some(age) = self.find(values, taken, limits) {
            self.confirm(values, now, known);
            known.unlanded_since = (age > 0).then(|| self.write(age - 1).at);
            return;
        }
        let confirmed = known.confirmed.map(|confirmed| confirmed.values);
        if confirmed.is_some_and(|confirmed| are_equal(&confirmed, values, limits)) {
            // What was confirmed before still stands: what was sent since has not landed.
            self.confirm(values, now, known);
            return;
        }
        known.writable = false;
        if !is_same && self.writes == 0 {
            // Something else moves the values.
            self.alone_since = Some(now);
        }
        if self.equal >= EQUAL_READINGS {
            self.confirm(values, now, known);
            known.changed = true;
            // Nothing that was sent before counts any more.
            self.writes = 0;
            known.unlanded_since = None;
        }
    }

    fn confirm(&mut self, values: &PerChannel<f64>, now: Duration, known: &mut Known) {
        self.alone_since.get_or_insert(now);
        known.confirmed = Some(Confirmed {
            values: *values,
            at: now,
        });
        known.writable = true;
    }

    /// A write of the path's delay that is this value, counted back from the newest, which is 0.
    fn find(&self, values: &PerChannel<f64>, taken: Duration, limits: &Limits) -> Option<usize> {
        // A cycle more: the write came after the reading of its cycle.
        let delay = limits.delay() + limits.period * 2;
        (0..self.writes).find(|age| {
            let write = self.write(*age);
            taken.saturating_sub(write.at) <= delay && are_equal(&write.values, values, limits)
        })
    }

    fn write(&self, age: usize) -> &Write {
        &self.ring[(self.next + 2 * MOST_READ_BACK_CYCLES - 1 - age) % MOST_READ_BACK_CYCLES]
    }

    pub(super) fn sent(&mut self, now: Duration, values: &PerChannel<f64>) {
        self.sent = true;
        self.ring[self.next] = Write {
            at: now,
            values: *values,
        };
        self.next = (self.next + 1) % MOST_READ_BACK_CYCLES;
        self.writes = (self.writes + 1).min(MOST_READ_BACK_CYCLES);
    }

    pub(super) fn see_other(&mut self, now: Duration) {
        self.other = Some(now);
        self.alone_since = Some(now);
    }

    pub(super) fn judge(&self, now: Duration, limits: &Limits, known: &mut Known) {
        let fresh = known
            .confirmed
            .is_some_and(|confirmed| now.saturating_sub(confirmed.at) <= limits.delay());
        known.writable &= fresh;
        let still = self
            .alone_since
            .is_some_and(|since| now.saturating_sub(since) >= self.watch);
        let other = self
            .other
            .is_some_and(|seen| now.saturating_sub(seen) < OTHER_TOLD);
        known.reasons = Reasons::WATCHING.when(!still && self.writes == 0)
            | Reasons::OTHER_GATEWAY.when(other)
            | Reasons::NO_BARRIER;
    }
}
