//! Bounds the rate of the sent correction over every time window: a word differs from each earlier word by at most the
//! slew plus one step, even if the correction was restarted in between.

use volcomp_vocabulary::PerChannel;

use crate::{Limits, step::ROUNDING_STEPS};

/// Range of the next word of each axis; state of the guard.
///
/// Invariants:
/// - The range of an axis is not empty, except for rounding.
/// - Every value in the range differs from each earlier word by at most the slew since that word plus one step, unless
///   a cause outside the guard has moved the axis out of the range.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Corridor {
    lowest: PerChannel<f64>,
    highest: PerChannel<f64>,
    sent: PerChannel<f64>,
}

impl Corridor {
    /// The range around applied values (mm, rad), without earlier words.
    pub(crate) fn about(values: &PerChannel<f64>, limits: &Limits) -> Self {
        let step = limits.of_axes(|axis| axis.resolution);
        Self {
            lowest: PerChannel::from_fn(|i| values[i] - step[i]),
            highest: PerChannel::from_fn(|i| values[i] + step[i]),
            sent: *values,
        }
    }

    /// Converts the range to another path. `places` is the index of each axis of the other path on this path; an axis
    /// that this path lacks starts at zero.
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

    /// Restarts at applied values (mm, rad). The range of an axis is kept if it contains the value; otherwise the range
    /// restarts at the value.
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

    /// Tightens the range to one step around the last sent words, because no other words were sent since. Axes whose
    /// words are outside `between`, the lowest and highest values that may be applied, are unchanged.
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

    pub(crate) fn widen(&mut self, limits: &Limits, dt_s: f64) {
        for (i, axis) in limits.axes.iter().enumerate().take(limits.count) {
            self.lowest[i] -= axis.slew_per_s * dt_s;
            self.highest[i] += axis.slew_per_s * dt_s;
        }
    }

    pub(crate) fn contains(&self, axis: usize, word: f64, limits: &Limits) -> bool {
        let rounding = ROUNDING_STEPS * limits.axes[axis].resolution;
        (self.lowest[axis] - rounding..=self.highest[axis] + rounding).contains(&word)
    }

    /// Tightens the range around the words (mm, rad) being sent.
    pub(crate) fn narrow(&mut self, words: &PerChannel<f64>, limits: &Limits) {
        self.sent = *words;
        self.stay(&[*words; 2], limits);
    }
}
