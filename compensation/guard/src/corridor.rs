//! The rate of what is sent, in every window of time: whatever made the correction begin anew in between, a word is no
//! further from each one before it than slew and one step allow.

use volcomp_vocabulary::PerChannel;

use crate::{Limits, step::ROUNDING_STEPS};

/// Where the next word of each axis may be: state of the guard.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Corridor {
    lowest: PerChannel<f64>,
    highest: PerChannel<f64>,
    /// What was sent last.
    sent: PerChannel<f64>,
}

impl Corridor {
    /// About values (mm, rad) that are applied, and that nothing was sent before.
    pub(crate) fn about(values: &PerChannel<f64>, limits: &Limits) -> Self {
        let step = limits.of_axes(|axis| axis.resolution);
        Self {
            lowest: PerChannel::from_fn(|i| values[i] - step[i]),
            highest: PerChannel::from_fn(|i| values[i] + step[i]),
            sent: *values,
        }
    }

    /// The same on another path, each axis of which was at one of these places before; one that was not there is at zero.
    pub(crate) fn on_path(&self, places: &PerChannel<Option<usize>>, limits: &Limits) -> Self {
        let zero = Self::about(&PerChannel::ZERO, limits);
        let carried = |from: &PerChannel<f64>, zero: &PerChannel<f64>| {
            PerChannel::from_fn(|i| places[i].map_or(zero[i], |place| from[place]))
        };
        Self {
            lowest: carried(&self.lowest, &zero.lowest),
            highest: carried(&self.highest, &zero.highest),
            sent: carried(&self.sent, &zero.sent),
        }
    }

    /// These values (mm, rad) are applied. Where an axis may have been led there by the words before, these count on; where it
    /// was moved by something else, it begins anew.
    pub(crate) fn begin(&mut self, values: &PerChannel<f64>, limits: &Limits) {
        let before = *self;
        *self = Self::about(values, limits);
        for i in limits.places() {
            if before.contains(i, values[i], limits) {
                self.lowest[i] = self.lowest[i].max(before.lowest[i]);
                self.highest[i] = self.highest[i].min(before.highest[i]);
                self.sent[i] = before.sent[i];
            }
        }
    }

    /// Nothing else was sent until now. What was sent last stood until now where it is among what may be applied, which
    /// is `between` the lowest and the highest value of each axis.
    pub(crate) fn stay(&mut self, between: &[PerChannel<f64>; 2], limits: &Limits) {
        let [lowest, highest] = between;
        for (i, axis) in limits.axes.iter().enumerate().take(limits.count) {
            let (sent, rounding) = (self.sent[i], ROUNDING_STEPS * axis.resolution);
            if (lowest[i] - rounding..=highest[i] + rounding).contains(&sent) {
                self.lowest[i] = self.lowest[i].max(sent - axis.resolution);
                self.highest[i] = self.highest[i].min(sent + axis.resolution);
            }
        }
    }

    /// Time passes.
    pub(crate) fn widen(&mut self, limits: &Limits, dt_s: f64) {
        for (i, axis) in limits.axes.iter().enumerate().take(limits.count) {
            self.lowest[i] -= axis.slew_per_s * dt_s;
            self.highest[i] += axis.slew_per_s * dt_s;
        }
    }

    /// Whether the word of an axis is in it.
    pub(crate) fn contains(&self, axis: usize, word: f64, limits: &Limits) -> bool {
        let rounding = ROUNDING_STEPS * limits.axes[axis].resolution;
        (self.lowest[axis] - rounding..=self.highest[axis] + rounding).contains(&word)
    }

    /// These words (mm, rad) are sent.
    pub(crate) fn narrow(&mut self, words: &PerChannel<f64>, limits: &Limits) {
        self.sent = *words;
        self.stay(&[*words; 2], limits);
    }
}
