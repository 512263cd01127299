//! The correction of each axis that is no surprise where it is found: up to its limit, or more where that was lowered, or a
//! path with a lower one writes, and what lies beyond it was sent here or was known before.

use core::time::Duration;

use volcomp_vocabulary::{MAX_AXES, PerChannel};

use crate::{Limits, step::one_step};

/// State of the guard: what is no surprise, and what was sent and may still be on its way.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Allowed {
    /// The largest correction of each axis that is no surprise, without a sign, mm or rad.
    most: PerChannel<f64>,
    /// The largest words of each axis that were sent of late, and in the time before that.
    sent: [PerChannel<f64>; 2],
    /// A reading that held then, or later, shows nothing any more of what was sent in the time before.
    passed: Duration,
}

impl Allowed {
    /// Nothing was sent.
    pub(crate) fn within(limits: &Limits) -> Self {
        Self {
            most: limits.of_axes(|axis| axis.limit),
            ..Self::default()
        }
    }

    /// Whether one of these values is a surprise.
    pub(crate) fn is_exceeded_by(&self, values: &PerChannel<f64>, limits: &Limits) -> bool {
        let is_beyond =
            |i: usize| values[i].abs() > self.most[i] + one_step(limits.axes[i].resolution);
        (0..limits.count).any(is_beyond)
    }

    /// What may be applied, without a sign: where the output and the control stand, and what is on its way there.
    fn largest(&self, axis: usize, stands: &[PerChannel<f64>; 2]) -> f64 {
        let values = stands.iter().chain(&self.sent);
        values.map(|of| of[axis].abs()).fold(0.0, f64::max)
    }

    /// These limits hold, and the output and the control stand there. What was a surprise before is one now, too.
    pub(crate) fn narrow(&mut self, stands: &[PerChannel<f64>; 2], limits: &Limits) {
        for (i, axis) in limits.axes.iter().enumerate().take(limits.count) {
            self.most[i] = axis.limit.max(self.most[i].min(self.largest(i, stands)));
        }
    }

    /// A person has looked: what stands there is no surprise.
    pub(crate) fn accept(&mut self, stands: &[PerChannel<f64>; 2], limits: &Limits) {
        for (i, axis) in limits.axes.iter().enumerate().take(limits.count) {
            self.most[i] = axis.limit.max(self.largest(i, stands));
        }
    }

    /// The control was seen to apply something at `confirmed`: what was sent longer before than the delay of the path is on
    /// its way no more.
    pub(crate) fn pass(&mut self, now: Duration, confirmed: Duration, limits: &Limits) {
        if confirmed >= self.passed {
            self.sent = [PerChannel::ZERO, self.sent[0]];
            self.passed = now.saturating_add(limits.longest_delay());
        }
    }

    /// These words (mm, rad) are sent.
    pub(crate) fn send(&mut self, words: &PerChannel<f64>) {
        for (sent, word) in self.sent[0].iter_mut().zip(words) {
            *sent = sent.max(word.abs());
        }
    }

    /// Another path writes from `now` on. `places` says which place each of its axes had on the path before, of which these
    /// were the limits, and on which output and control stood there.
    pub(crate) fn take_path(
        &mut self,
        now: Duration,
        places: &PerChannel<Option<usize>>,
        stood: &[PerChannel<f64>; 2],
        [before, limits]: [&Limits; 2],
    ) {
        let count = before.count.min(MAX_AXES);
        let known = |place: usize| self.most[place].min(self.largest(place, stood));
        let carried = PerChannel::from_fn(|i| {
            let place = places[i].filter(|place| *place < count && i < limits.count);
            place.map_or(0.0, known)
        });
        let most = limits.of_axes(|axis| axis.limit);
        self.most = PerChannel::from_fn(|i| carried[i].max(most[i]));
        // What the path before has sent last may land as late as it does on that path.
        self.sent = [carried; 2];
        self.passed = now.saturating_add(before.longest_delay().max(limits.longest_delay()));
    }
}
