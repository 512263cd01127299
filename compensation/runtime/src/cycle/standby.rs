//! What is to be known of the paths that stand by.

use std::time::Duration;

use volcomp_guard::{Confirmed, MAX_PATHS, Reasons};
use volcomp_vocabulary::PerAxis;

use super::{Cycle, STANDBY_EVERY, STANDBY_SILENT};
use crate::path::ControlPath;

/// For so long, and up to twice as long, the output is remembered: longer than three readings of a path that stands by
/// and a write on its way.
const WINDOW: Duration = Duration::from_millis(500);

/// What the paths that stand by are compared with.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Standby {
    /// When the younger of two windows began; the smallest and the largest output of each machine axis in both.
    begun: Duration,
    ranges: [[PerAxis<f64>; 2]; 2],
    /// The paths that told another correction when theirs was confirmed last.
    holds: [bool; MAX_PATHS],
}

impl Standby {
    /// The output of a machine axis.
    fn see(&mut self, axis: usize, output: f64) {
        let [low, high] = &mut self.ranges[0];
        (low[axis], high[axis]) = (low[axis].min(output), high[axis].max(output));
    }

    /// Begins another window when the present one is full.
    fn turn(&mut self, now: Duration, outputs: &PerAxis<f64>) {
        if now.saturating_sub(self.begun) >= WINDOW {
            self.begun = now;
            self.ranges = [[*outputs; 2], self.ranges[0]];
        }
    }

    /// Whether the output of a machine axis went over this value lately.
    fn went_over(&self, axis: usize, value: f64, step: f64) -> bool {
        let low = self.ranges[0][0][axis].min(self.ranges[1][0][axis]);
        let high = self.ranges[0][1][axis].max(self.ranges[1][1][axis]);
        (low - step..=high + step).contains(&value)
    }

    /// Whether a path applies what the output never was: all of them lead to the same axes.
    fn tells_another(&self, path: &ControlPath, confirmed: &Confirmed) -> bool {
        let limits = path.limits();
        (0..limits.count).any(|i| {
            let step = 1.01 * limits.axes[i].resolution;
            !self.went_over(path.machine_axis[i], confirmed.values[i], step)
        })
    }
}

impl Cycle {
    /// What is to be known of the paths that stand by.
    pub(super) fn standby_notes(&mut self, now: Duration) -> Reasons {
        let active = self.selector.active();
        let own = &self.paths[active];
        let mut outputs = PerAxis::ZERO;
        for i in 0..own.count() {
            outputs[own.machine_axis[i]] = self.guard.output()[i];
        }
        self.standby.turn(now, &outputs);
        for (axis, output) in outputs.iter().enumerate() {
            self.standby.see(axis, *output);
        }
        let mut notes = Reasons::NONE;
        for (index, path) in self.paths.iter().enumerate() {
            if index == active || path.asked_at().is_none() {
                continue;
            }
            // What it told long ago is compared with what the output was then, not with that of now.
            if let Some(confirmed) = &path.known().confirmed
                && now.saturating_sub(confirmed.at) <= STANDBY_EVERY * 2
            {
                self.standby.holds[index] = self.standby.tells_another(path, confirmed);
            }
            let report = path.report(now);
            let silent = report.answered.is_none_or(|ago| ago > STANDBY_SILENT);
            notes |= Reasons::STANDBY_SILENT.when(silent && now > STANDBY_SILENT)
                | Reasons::STANDBY_HOLDS.when(report.holds && self.standby.holds[index]);
        }
        notes
    }
}
