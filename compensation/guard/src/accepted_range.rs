//! Corrections that were sent and may still arrive, and the largest correction that is accepted as a read-back: the
//! limit of the axis, or a larger correction that this guard sent or confirmed before the limit was lowered or the path
//! changed.

use core::time::Duration;

use volcomp_vocabulary::{MAX_AXES, PerChannel};

use crate::{Limits, step::one_step};

/// Maximum time between sending a word and a reading that still shows the word. A barrier accepts only one frame per
/// path delay, because all frames sent while a report is in transit answer the same report. The barrier may therefore
/// still move towards a frame sent one delay before the last frame.
fn longest_visible(limits: &Limits) -> Duration {
    limits.longest_delay().saturating_mul(2)
}

#[derive(Clone, Copy, Debug, Default)]
struct SentRange {
    /// Largest absolute word of each axis, mm or rad.
    largest: PerChannel<f64>,
    /// Highest slew limit of each axis while these corrections were sent, mm/s or rad/s.
    slew_per_s: PerChannel<f64>,
}

/// State of the guard. Call `narrow` or `accept` in each cycle, then `pass`, then `send`: words that expire in a cycle
/// are still included in `narrow` and `accept`.
///
/// Invariants:
/// - `largest` is at least the limit of each axis.
/// - Every word that may still be in transit counts in `recent` or `earlier`.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct AcceptedRange {
    largest: PerChannel<f64>,
    /// Range of the words sent recently.
    recent: SentRange,
    /// Range of the words sent in the interval before `recent`.
    earlier: SentRange,
    /// Readings valid at this time or later show no effect of the `earlier` words.
    earlier_until: Duration,
}

impl AcceptedRange {
    pub(crate) fn within(limits: &Limits) -> Self {
        Self { largest: limits.of_axes(|axis| axis.limit), ..Self::default() }
    }

    pub(crate) fn is_exceeded_by(&self, values: &PerChannel<f64>, limits: &Limits) -> bool {
        let is_beyond =
            |i: usize| values[i].abs() > self.largest[i] + one_step(limits.axes[i].resolution);
        limits.places().any(is_beyond)
    }

    /// Highest slew of an axis among the words that may still arrive, mm/s or rad/s.
    pub(crate) fn slew_per_s(&self, axis: usize) -> f64 {
        self.recent.slew_per_s[axis].max(self.earlier.slew_per_s[axis])
    }

    /// Largest absolute correction that may be applied, now or by words that are still in transit. `present` is the larger of the absolute
    /// output and the absolute confirmed correction.
    fn may_be_applied(&self, axis: usize, present: &PerChannel<f64>) -> f64 {
        let sent = self.recent.largest[axis].max(self.earlier.largest[axis]);
        present[axis].max(sent)
    }

    /// Reduces the largest accepted correction of each axis to the correction that may still be applied, but not below
    /// the limit of the axis. `present`: see `may_be_applied`.
    pub(crate) fn narrow(&mut self, present: &PerChannel<f64>, limits: &Limits) {
        for (i, axis) in limits.axes.iter().enumerate().take(limits.count) {
            let left = self.largest[i].min(self.may_be_applied(i, present));
            self.largest[i] = axis.limit.max(left);
        }
    }

    pub(crate) fn accept(&mut self, present: &PerChannel<f64>, limits: &Limits) {
        for (i, axis) in limits.axes.iter().enumerate().take(limits.count) {
            self.largest[i] = axis.limit.max(self.may_be_applied(i, present));
        }
    }

    /// Removes words sent long before `confirmed`, the time of the last confirmation: they can no
    /// longer arrive.
    pub(crate) fn pass(&mut self, now: Duration, confirmed: Duration, limits: &Limits) {
        if confirmed >= self.earlier_until {
            (self.earlier, self.recent) = (self.recent, SentRange::default());
            self.earlier_until = now.saturating_add(longest_visible(limits));
        }
    }

    /// Records words (mm, rad) as sent.
    pub(crate) fn send(&mut self, words: &PerChannel<f64>, limits: &Limits) {
        let SentRange { largest, slew_per_s } = &mut self.recent;
        for (i, axis) in limits.axes.iter().enumerate().take(limits.count) {
            largest[i] = largest[i].max(words[i].abs());
            slew_per_s[i] = slew_per_s[i].max(axis.slew_per_s);
        }
    }

    /// Switches to another path, which writes from `now` on. `places` is the index of each of its axes on the previous path, whose limits were
    /// `before`; `present_before` bounds the absolute values of output and control there.
    pub(crate) fn take_path(
        &mut self,
        now: Duration,
        places: &PerChannel<Option<usize>>,
        present_before: &PerChannel<f64>,
        before: &Limits,
        limits: &Limits,
    ) {
        let count = before.count.min(MAX_AXES);
        let carried = |of: &dyn Fn(usize) -> f64| {
            PerChannel::from_fn(|i| {
                let place = places[i].filter(|place| *place < count && i < limits.count);
                place.map_or(0.0, of)
            })
        };
        let sent = SentRange {
            largest: carried(&|place| {
                self.largest[place].min(self.may_be_applied(place, present_before))
            }),
            slew_per_s: carried(&|place| self.slew_per_s(place)),
        };
        let most = limits.of_axes(|axis| axis.limit);
        self.largest = PerChannel::from_fn(|i| sent.largest[i].max(most[i]));
        // The last words of the previous path may arrive as late as on that path.
        (self.recent, self.earlier) = (sent, sent);
        self.earlier_until =
            now.saturating_add(longest_visible(before).max(longest_visible(limits)));
    }
}
