//! A control without a barrier whose values can be read back.
//!
//! One reading proves nothing: it may be torn, late, or of another axis. So everything that may be applied is remembered:
//! what was confirmed last, and what was sent since. A reading that is one of these on all axes confirms it, and rules out
//! what was sent before it; anything else may be an old reading, and nothing is sent on it. Another value is believed when
//! nothing was sent for so long that no reading can be from before, and it was then read three times without another one
//! between, the path's delay apart: a message that a driver repeats with each new position is one reading.

use core::time::Duration;

use volcomp_vocabulary::PerChannel;

use super::known::{Confirmed, Known, Landed, are_equal};
use crate::{Limits, Reasons, limits::MOST_READ_BACK_CYCLES};

/// Equal readings that confirm a value that was not written.
const EQUAL_READINGS: u32 = 3;
/// For how long another gateway is reported after it was seen.
const OTHER_REPORTED_FOR: Duration = Duration::from_secs(5);
/// What was confirmed, and a write for each cycle that a reading may be behind.
const MOST: usize = MOST_READ_BACK_CYCLES + 4;

/// A correction that may be applied, and when it was sent first.
#[derive(Clone, Copy, Debug, Default)]
struct Candidate {
    since: Duration,
    values: PerChannel<f64>,
}

/// Equal readings in a row.
#[derive(Clone, Copy, Debug)]
struct Equal {
    values: PerChannel<f64>,
    readings: u32,
    taken: Duration,
}

#[derive(Clone, Debug)]
pub(super) struct Echo {
    /// For how long nothing else may have moved anything before the first write.
    watch: Duration,
    /// What may be applied, the oldest first: what is confirmed, and what was sent since. Equal ones in a row are one.
    candidates: [Candidate; MOST],
    count: usize,
    /// When the last reading held.
    heard: Option<Duration>,
    /// What the last readings were that are all younger than everything that was sent, how many of them count, and when
    /// the last one that counts held.
    equal: Option<Equal>,
    /// When something was sent last, by whatever path.
    sent: Option<Duration>,
    /// Something was sent on what is confirmed.
    has_sent: bool,
    /// Since when nothing but this gateway moved anything.
    alone_since: Option<Duration>,
    other: Option<Duration>,
}

impl Echo {
    pub(super) fn new(watch: Duration) -> Self {
        Self {
            watch,
            candidates: [Candidate::default(); MOST],
            count: 0,
            heard: None,
            equal: None,
            sent: None,
            has_sent: false,
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
    ) -> Landed {
        if !limits.places().all(|i| values[i].is_finite()) {
            known.writable = false;
            self.equal = None;
            return Landed::Unknown;
        }
        if self.heard.replace(taken) == Some(taken) {
            // The same message as before: it says nothing new.
            return Landed::Unknown;
        }
        let found = self.find(values, taken, limits);
        let is_same = self.count_equal(values, taken, limits);
        if found.is_none() && is_same == Some(false) && !self.has_sent {
            // Something else moves the values.
            self.alone_since = Some(now);
        }
        if self
            .equal
            .is_some_and(|equal| equal.readings >= EQUAL_READINGS)
        {
            // Nothing that was sent before counts any more.
            known.changed = found.is_none();
            self.has_sent &= found.is_some();
            self.begin(values, now);
            self.confirm(values, [taken, now], known);
            return Landed::All;
        }
        let Some([oldest, newest]) = found else {
            known.writable = false;
            return Landed::Unknown;
        };
        let landed = match self.candidates[..self.count].get(newest + 1) {
            Some(next) => Landed::Before(next.since),
            None => Landed::All,
        };
        self.candidates.copy_within(oldest..self.count, 0);
        self.count -= oldest;
        self.confirm(values, [taken, now], known);
        landed
    }

    /// Counts equal readings. Whether this one is equal to the one before; `None` where it may be from before the last
    /// write.
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
        let mut equal = same.unwrap_or(Equal {
            values: *values,
            readings: 0,
            taken,
        });
        if same.is_none_or(|before| since(before.taken) >= limits.delay()) {
            equal.readings = equal.readings.saturating_add(1);
            equal.taken = taken;
        }
        self.equal = Some(equal);
        Some(same.is_some())
    }

    /// Nothing but these values may be applied.
    fn begin(&mut self, values: &PerChannel<f64>, now: Duration) {
        self.candidates[0] = Candidate {
            since: now,
            values: *values,
        };
        self.count = 1;
    }

    /// A reading that held at `taken` and is received now confirms these values: as of then, however late it is received.
    fn confirm(
        &mut self,
        values: &PerChannel<f64>,
        [taken, now]: [Duration; 2],
        known: &mut Known,
    ) {
        self.alone_since.get_or_insert(now);
        known.confirmed = Some(Confirmed {
            values: *values,
            at: taken,
        });
        // What does not fit into the memory is not sent.
        known.writable = self.count < MOST;
    }

    /// The oldest and the newest candidate that a reading may be; `None` where it equals no candidate.
    ///
    /// One that something else followed longer ago than the path's delay is one only where that did not land. So it is
    /// the oldest only where no younger one has these values, too.
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
            // Sent although nothing may be sent: nothing is known any more.
            self.count = 0;
            return;
        }
        self.candidates[self.count] = Candidate {
            since: now,
            values: *values,
        };
        self.count += 1;
    }

    /// What was sent by another path until now may be applied, and is not known here.
    pub(super) fn take_over(&mut self, now: Duration, known: &mut Known) {
        self.sent = self.sent.max(Some(now));
        (self.count, self.equal, known.writable) = (0, None, false);
        // What was seen to move while it stood by, this gateway moved.
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

    pub(super) fn see_other(&mut self, now: Duration) {
        self.other = Some(now);
        self.alone_since = Some(now);
    }

    pub(super) fn judge(&self, now: Duration, limits: &Limits, known: &mut Known) {
        let fresh = known
            .confirmed
            .is_some_and(|confirmed| now.saturating_sub(confirmed.at) <= limits.delay());
        let still = self
            .alone_since
            .is_some_and(|since| now.saturating_sub(since) >= self.watch);
        // Before the first write nothing else may have moved anything, and no reading may be of the run before.
        let alone = still || self.has_sent;
        known.writable &= fresh && alone;
        let other = self
            .other
            .is_some_and(|seen| now.saturating_sub(seen) < OTHER_REPORTED_FOR);
        known.reasons = Reasons::WATCHING.when(!alone)
            | Reasons::OTHER_GATEWAY.when(other)
            | Reasons::NO_BARRIER;
    }
}
