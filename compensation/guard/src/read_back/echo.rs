//! A control without a barrier whose values can be read back.
//!
//! A single reading does not confirm a value: it may be torn, late, or of another axis. Therefore all values that may
//! be applied are stored: the last confirmed value, and the values sent since. A reading that equals one of them on all
//! axes confirms that value, and excludes the values sent before it. Any other reading may be old, and nothing is sent
//! in response. A foreign value is accepted only after a pause in sending that is longer than the age of any reading,
//! and after three consecutive readings, one path delay apart. A message that a driver repeats with each new position
//! is one reading.

use core::time::Duration;

use volcomp_vocabulary::PerChannel;

use super::status::{Arrival, Confirmed, ReadBackStatus, are_equal};
use crate::{Limits, Reasons, limits::MOST_READ_BACK_CYCLES};

/// Number of consecutive equal readings that confirm a foreign value.
const EQUAL_READINGS: u32 = 3;
const OTHER_REPORTED_FOR: Duration = Duration::from_secs(5);
/// Capacity: more than the confirmed value and one write for each cycle of the maximum read-back lag.
const MOST: usize = MOST_READ_BACK_CYCLES + 4;

/// A correction that may be applied, and when it was first sent.
#[derive(Clone, Copy, Debug, Default)]
struct Candidate {
    since: Duration,
    values: PerChannel<f64>,
}

#[derive(Clone, Copy, Debug)]
struct Equal {
    values: PerChannel<f64>,
    readings: u32,
    taken: Duration,
}

/// The values of one path that may be applied.
///
/// Invariants:
/// - `candidates[..count]` are in the order of sending, and consecutive candidates differ. With a `count` of 0 the
///   applied correction is unknown, and nothing is sent.
/// - After a confirmation the first candidate is the confirmed correction; the later candidates were sent after it.
/// - `equal` counts only readings that are later than every write by more than the maximum age of a reading.
#[derive(Clone, Debug)]
pub(super) struct Echo {
    /// Time before the first write during which the values must not change.
    watch: Duration,
    /// Values that may be applied, oldest first: the confirmed value, and the values sent since. Consecutive equal
    /// values are merged.
    candidates: [Candidate; MOST],
    count: usize,
    last_received: Option<Duration>,
    /// Consecutive equal readings that are later than every write: their value, their number, and the time at which the
    /// last counted reading was valid.
    equal: Option<Equal>,
    /// Time of the last write on any path.
    sent: Option<Duration>,
    /// Whether this path has sent a value since the start, or since a foreign value was last confirmed.
    has_sent: bool,
    /// Time since which only this gateway has changed the values.
    alone_since: Option<Duration>,
    other: Option<Duration>,
}

impl Echo {
    pub(super) fn new(watch: Duration) -> Self {
        Self {
            watch,
            candidates: [Candidate::default(); MOST],
            count: 0,
            last_received: None,
            equal: None,
            sent: None,
            has_sent: false,
            alone_since: None,
            other: None,
        }
    }

    pub(super) fn receive(
        &mut self,
        now: Duration,
        taken: Duration,
        values: &PerChannel<f64>,
        limits: &Limits,
        status: &mut ReadBackStatus,
    ) -> Arrival {
        if !limits.places().all(|i| values[i].is_finite()) {
            status.writable = false;
            self.equal = None;
            return Arrival::Unknown;
        }
        if self.last_received.replace(taken) == Some(taken) {
            // The driver has repeated the previous message, which is ignored.
            return Arrival::Unknown;
        }
        let found = self.find(values, taken, limits);
        let is_same = self.count_equal(values, taken, limits);
        if found.is_none() && is_same == Some(false) && !self.has_sent {
            // Another sender changes the values.
            self.alone_since = Some(now);
        }
        if self.equal.is_some_and(|equal| equal.readings >= EQUAL_READINGS) {
            // All earlier writes are obsolete.
            status.changed = found.is_none();
            self.has_sent &= found.is_some();
            self.begin(values, now);
            self.confirm(values, [taken, now], status);
            return Arrival::All;
        }
        let Some([oldest, newest]) = found else {
            status.writable = false;
            return Arrival::Unknown;
        };
        let landed = match self.candidates[..self.count].get(newest + 1) {
            Some(next) => Arrival::Before(next.since),
            None => Arrival::All,
        };
        self.candidates.copy_within(oldest..self.count, 0);
        self.count -= oldest;
        self.confirm(values, [taken, now], status);
        landed
    }

    /// Counts equal readings. Returns whether this reading equals the previous one; `None` if it may be from before the
    /// last write.
    fn count_equal(
        &mut self,
        values: &PerChannel<f64>,
        taken: Duration,
        limits: &Limits,
    ) -> Option<bool> {
        let since = |then: Duration| taken.saturating_sub(then);
        let is_quiet = |sent| since(sent) > limits.oldest_reading();
        let before = self.equal.take();
        if !self.sent.is_none_or(is_quiet) {
            return None;
        }
        let same = before.filter(|before| are_equal(&before.values, values, limits));
        let mut equal = same.unwrap_or(Equal { values: *values, readings: 0, taken });
        if same.is_none_or(|before| since(before.taken) >= limits.delay()) {
            equal.readings = equal.readings.saturating_add(1);
            equal.taken = taken;
        }
        self.equal = Some(equal);
        Some(same.is_some())
    }

    fn begin(&mut self, values: &PerChannel<f64>, now: Duration) {
        self.candidates[0] = Candidate { since: now, values: *values };
        self.count = 1;
    }

    /// Records that a reading received now confirms these values at `taken`.
    fn confirm(
        &mut self,
        values: &PerChannel<f64>,
        [taken, now]: [Duration; 2],
        status: &mut ReadBackStatus,
    ) {
        self.alone_since.get_or_insert(now);
        status.confirmed = Some(Confirmed { values: *values, at: taken });
        // If the list of candidates is full, nothing more may be sent.
        status.writable = self.count < MOST;
    }

    /// The oldest and the newest candidate that a reading may show; `None` if the reading equals no candidate.
    ///
    /// A candidate whose successor was sent longer ago than the path's delay is possible only if the successor did not
    /// arrive. Therefore it is the oldest match only if no later candidate has the same values.
    fn find(
        &self,
        values: &PerChannel<f64>,
        taken: Duration,
        limits: &Limits,
    ) -> Option<[usize; 2]> {
        let candidates = &self.candidates[..self.count];
        let is_it = |place: &usize| are_equal(&candidates[*place].values, values, limits);
        let may_stand = |place: &usize| {
            let next = candidates.get(place + 1);
            next.is_none_or(|next| taken.saturating_sub(next.since) <= limits.longest_delay())
        };
        let newest = (0..self.count).rev().find(is_it)?;
        let oldest = (0..=newest).filter(is_it).find(may_stand);
        Some([oldest.unwrap_or(newest), newest])
    }

    pub(super) fn sent(&mut self, now: Duration, values: &PerChannel<f64>) {
        self.sent = Some(now);
        self.has_sent = true;
        let last = self.count.checked_sub(1).map(|last| self.candidates[last]);
        if last.is_some_and(|last| last.values == *values) {
            return;
        }
        if self.count == MOST {
            // A value was sent although nothing may be sent: the applied correction is unknown.
            self.count = 0;
            return;
        }
        self.candidates[self.count] = Candidate { since: now, values: *values };
        self.count += 1;
    }

    /// Makes this path the active one. The applied correction becomes unknown, because values sent on the previous path may be applied.
    pub(super) fn take_over(&mut self, now: Duration, status: &mut ReadBackStatus) {
        self.sent = self.sent.max(Some(now));
        (self.count, self.equal, status.writable) = (0, None, false);
        // Changes seen during standby were made by this gateway.
        self.alone_since = Some(Duration::ZERO);
    }

    /// The lowest and the highest value of each axis that may be applied.
    pub(super) fn between(&self) -> Option<[PerChannel<f64>; 2]> {
        let (first, others) = self.candidates[..self.count].split_first()?;
        let mut between = [first.values; 2];
        let [lowest, highest] = &mut between;
        for other in others {
            for (i, value) in other.values.iter().enumerate() {
                lowest[i] = lowest[i].min(*value);
                highest[i] = highest[i].max(*value);
            }
        }
        Some(between)
    }

    pub(super) fn report_other_gateway(&mut self, now: Duration) {
        self.other = Some(now);
        self.alone_since = Some(now);
    }

    pub(super) fn judge(&self, now: Duration, limits: &Limits, status: &mut ReadBackStatus) {
        let fresh = status
            .confirmed
            .is_some_and(|confirmed| now.saturating_sub(confirmed.at) <= limits.delay());
        let still = self.alone_since.is_some_and(|since| now.saturating_sub(since) >= self.watch);
        // Before the first write, only this gateway may have changed the values, and no reading may be from the
        // previous run.
        let alone = still || self.has_sent;
        status.writable &= fresh && alone;
        let other = self.other.is_some_and(|seen| now.saturating_sub(seen) < OTHER_REPORTED_FOR);
        status.reasons = Reasons::WATCHING.when(!alone)
            | Reasons::OTHER_GATEWAY.when(other)
            | Reasons::NO_BARRIER;
    }
}
