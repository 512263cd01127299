//! The paths that stand by: who asks them, what they said, and what is to be known of them.

use std::time::Duration;

use volcomp_guard::{Confirmed, MAX_PATHS, Reasons, Scheme, one_step};
use volcomp_vocabulary::PerAxis;

use super::Cycle;
use crate::{attendant::STANDBY_EVERY, path::ControlPath};

/// A path that stands by and has not answered for so long is reported.
const STANDBY_SILENT: Duration = Duration::from_secs(2);

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
    /// The path that takes over once the cycle has its controller.
    pub(super) wanted: Option<usize>,
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
            let step = one_step(limits.axes[i].resolution);
            !self.went_over(path.seen.machine_axis[i], confirmed.values[i], step)
        })
    }
}

impl Cycle {
    /// Takes what the paths that stand by have answered to the threads that ask them.
    pub(super) fn hear_standbys(&mut self, now: Duration) {
        let active = self.selector.active();
        for (index, path) in self.paths.iter_mut().enumerate() {
            let mut answered = None;
            while let Some(heard) = path.device.heard() {
                // What was asked before the path became the active one is heard, and left.
                let told = (index != active).then(|| path.listen(&heard, self.start));
                if let Some(is_good) = told.flatten() {
                    self.report.faults += u64::from(!is_good);
                    answered = Some(is_good);
                }
            }
            path.device.take_back();
            if index != active && (answered.is_some() || path.falls_silent(now)) {
                self.interlocks.see(index, path.interlock());
            }
        }
    }

    /// Leaves the paths that stand by to the threads that ask them; where there are none, asks one of them here, after
    /// the path that corrects has been written: they must not hold it up.
    pub(super) fn leave_standbys(&mut self, now: Duration) {
        let (active, wanted) = (self.selector.active(), self.standby.wanted);
        for (index, path) in self.paths.iter_mut().enumerate() {
            if index != active && wanted != Some(index) {
                path.device.hand_over(path.patience());
            }
        }
        let here = self.paths.iter().enumerate();
        let here = here.filter(|(index, path)| *index != active && !path.device.is_attended());
        let next = here.min_by_key(|(_, path)| path.asked_at());
        let Some((next, asked)) = next.map(|(index, path)| (index, path.asked_at())) else {
            return;
        };
        if asked.is_none_or(|at| now.saturating_sub(at) >= STANDBY_EVERY) {
            let deadline = self.instant() + self.period.mul_f64(0.5);
            self.read(next, deadline, now);
        }
    }

    /// What is to be known of the paths that stand by. `outputs`: the correction that the axes have, in machine order.
    pub(super) fn standby_notes(&mut self, now: Duration, outputs: &PerAxis<f64>) -> Reasons {
        let active = self.selector.active();
        self.standby.turn(now, outputs);
        for (axis, output) in outputs.iter().enumerate() {
            self.standby.see(axis, *output);
        }
        let mut notes = Reasons::NONE;
        for (index, path) in self.paths.iter().enumerate() {
            if index == active {
                continue;
            }
            // What it told long ago is compared with what the output was then, not with that of now.
            if let Some(confirmed) = &path.known().confirmed
                && now.saturating_sub(confirmed.at) <= STANDBY_EVERY * 2
            {
                self.standby.holds[index] = self.standby.tells_another(path, confirmed);
            }
            let report = path.report(now);
            // What lines were left with the control keeps beside what another path writes, unless it lets go by itself.
            let keeps = report.scheme == Scheme::NoReadBack
                && path.read_back.zero_by_itself(&path.limits()).is_none();
            let silent = report.answered.is_none_or(|ago| ago > STANDBY_SILENT);
            notes |= Reasons::STANDBY_SILENT.when(silent && now > STANDBY_SILENT)
                | Reasons::STANDBY_HOLDS.when(report.holds && (keeps || self.standby.holds[index]));
        }
        notes
    }
}
