//! What was sent and may be on its way, and the correction of each axis that is expected where it is found: up to its limit,
//! or more where that was lowered, or a path with a lower one writes, and what lies beyond it was sent here or was known before.

use core::time::Duration;

use volcomp_vocabulary::{MAX_AXES, PerChannel};

use crate::{Limits, step::one_step};

/// How long after a word was sent a reading may still show it. The frames that are sent while a report is on its way answer
/// the same one, so a barrier takes one of them in each delay of the path: it goes to one that was sent a delay before the last.
fn longest_shown(limits: &Limits) -> Duration {
    limits.longest_delay().saturating_mul(2)
}

/// Words that were sent in some time.
#[derive(Clone, Copy, Debug, Default)]
struct Sent {
    /// The largest one of each axis, without a sign, mm or rad.
    largest: PerChannel<f64>,
    /// The highest rate of each axis with which they were sent, mm/s or rad/s.
    slew_per_s: PerChannel<f64>,
}

/// State of the guard. In a cycle `narrow` or `accept` comes first, then `pass`, then `send`: what is forgotten in a cycle has
/// counted in it.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Allowed {
    /// The largest correction of each axis that is expected, without a sign, mm or rad.
    largest: PerChannel<f64>,
    /// What was sent of late, and in the time before that.
    lately: Sent,
    earlier: Sent,
    /// A reading that held at this time, or later, shows nothing any more of what was sent earlier.
    earlier_until: Duration,
}

impl Allowed {
    /// Nothing was sent.
    pub(crate) fn within(limits: &Limits) -> Self {
        Self {
            largest: limits.of_axes(|axis| axis.limit),
            ..Self::default()
        }
    }

    /// Whether one of these values is larger than what is expected.
    pub(crate) fn is_exceeded_by(&self, values: &PerChannel<f64>, limits: &Limits) -> bool {
        let is_beyond =
            |i: usize| values[i].abs() > self.largest[i] + one_step(limits.axes[i].resolution);
        limits.places().any(is_beyond)
    }

    /// The highest rate of an axis with which something was sent that may be on its way, mm/s or rad/s.
    pub(crate) fn slew_per_s(&self, axis: usize) -> f64 {
        self.lately.slew_per_s[axis].max(self.earlier.slew_per_s[axis])
    }

    /// The largest correction that may be applied, without a sign: `stands`, where output and control stand, or what is on
    /// its way there.
    fn may_be_applied(&self, axis: usize, stands: &PerChannel<f64>) -> f64 {
        let sent = self.lately.largest[axis].max(self.earlier.largest[axis]);
        stands[axis].max(sent)
    }

    /// These limits hold, and output and control stand no further than `stands` from zero. What was not expected before is not
    /// expected now either.
    pub(crate) fn narrow(&mut self, stands: &PerChannel<f64>, limits: &Limits) {
        for (i, axis) in limits.axes.iter().enumerate().take(limits.count) {
            let left = self.largest[i].min(self.may_be_applied(i, stands));
            self.largest[i] = axis.limit.max(left);
        }
    }

    /// The operator has acknowledged: what is there is expected.
    pub(crate) fn accept(&mut self, stands: &PerChannel<f64>, limits: &Limits) {
        for (i, axis) in limits.axes.iter().enumerate().take(limits.count) {
            self.largest[i] = axis.limit.max(self.may_be_applied(i, stands));
        }
    }

    /// The control was seen to apply something at `confirmed`: what was sent long before that is on its way no
    /// more.
    pub(crate) fn pass(&mut self, now: Duration, confirmed: Duration, limits: &Limits) {
        if confirmed >= self.earlier_until {
            (self.earlier, self.lately) = (self.lately, Sent::default());
            self.earlier_until = now.saturating_add(longest_shown(limits));
        }
    }

    /// These words (mm, rad) are sent.
    pub(crate) fn send(&mut self, words: &PerChannel<f64>, limits: &Limits) {
        let Sent {
            largest,
            slew_per_s,
        } = &mut self.lately;
        for (i, axis) in limits.axes.iter().enumerate().take(limits.count) {
            largest[i] = largest[i].max(words[i].abs());
            slew_per_s[i] = slew_per_s[i].max(axis.slew_per_s);
        }
    }

    /// Another path writes from `now` on. `places` says which place each of its axes had on the path before, of which these
    /// were the limits, and on which output and control stood no further than `stood` from zero.
    pub(crate) fn take_path(
        &mut self,
        now: Duration,
        places: &PerChannel<Option<usize>>,
        stood: &PerChannel<f64>,
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
        let sent = Sent {
            largest: carried(&|place| self.largest[place].min(self.may_be_applied(place, stood))),
            slew_per_s: carried(&|place| self.slew_per_s(place)),
        };
        let most = limits.of_axes(|axis| axis.limit);
        self.largest = PerChannel::from_fn(|i| sent.largest[i].max(most[i]));
        // What the path before has sent last may land as late as it does on that path.
        (self.lately, self.earlier) = (sent, sent);
        self.earlier_until = now.saturating_add(longest_shown(before).max(longest_shown(limits)));
    }
}
