//! The rate of what is sent, in every window of time: whatever made the correction begin anew in between, a word is no
//! further from each one before it than slew and one step allow.

use volcomp_vocabulary::PerChannel;

use crate::{Limits, step::ROUNDING_STEPS};

/// Where the next word of each axis may be: state of the guard.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Corridor {
    lowest: PerChannel<f64>,
    highest: PerChannel<f64>,
}

impl Corridor {
    /// About values (mm, rad) that are applied, and that nothing was sent before.
    pub(crate) fn about(values: &PerChannel<f64>, limits: &Limits) -> Self {
        let step = limits.of_axes(|axis| axis.resolution);
        Self {
            lowest: PerChannel::from_fn(|i| values[i] - step[i]),
            highest: PerChannel::from_fn(|i| values[i] + step[i]),
        }
    }

    /// These values (mm, rad) are applied. Where an axis may have been led there by the words before, these count on; where it
    /// was moved by something else, it begins anew.
    pub(crate) fn begin(&mut self, values: &PerChannel<f64>, limits: &Limits) {
        let before = *self;
        *self = Self::about(values, limits);
        for i in 0..limits.count {
            if before.contains(i, values[i], limits) {
                self.lowest[i] = self.lowest[i].max(before.lowest[i]);
                self.highest[i] = self.highest[i].min(before.highest[i]);
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
        let about = Self::about(words, limits);
        for i in 0..limits.count {
            self.lowest[i] = self.lowest[i].max(about.lowest[i]);
            self.highest[i] = self.highest[i].min(about.highest[i]);
        }
    }
}
