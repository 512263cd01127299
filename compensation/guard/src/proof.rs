//! At arming: do reported positions contain the correction, as the configuration says?

use volcomp_vocabulary::{MAX_AXES, PerChannel};

use crate::Limits;

/// Readings in a row, and time, for which the axes must stand before and after the shift.
const STILL_READINGS: f64 = 5.0;
const STILL_S: f64 = 0.1;

/// The test shift: state of the guard.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Proof {
    positions: PerChannel<f64>,
    still: u32,
    /// Positions before the shift, once it is on its way.
    before: Option<PerChannel<f64>>,
}

impl Proof {
    /// The correction (mm, rad) to move to during the proof: at first the one where it began, then one test shift
    /// away from it, on an axis with a positive correction downwards, else upwards.
    pub(crate) fn goal(&self, from: &PerChannel<f64>, limits: &Limits) -> PerChannel<f64> {
        if self.before.is_none() {
            return *from;
        }
        PerChannel::from_fn(|i| {
            let shift = shift(limits, i);
            if from[i] > 0.0 {
                from[i] - shift
            } else {
                from[i] + shift
            }
        })
    }

    /// A reading, and what the correction is and was when the proof began: whether the positions are as
    /// configured, once that is known.
    pub(crate) fn read(
        &mut self,
        positions: &PerChannel<f64>,
        output: &PerChannel<f64>,
        from: &PerChannel<f64>,
        limits: &Limits,
    ) -> Option<bool> {
        let same = (0..limits.count).all(|i| {
            (positions[i] - self.positions[i]).abs()
                < 0.1 * shift(limits, i).max(limits.axes[i].resolution)
        });
        self.positions = *positions;
        let goal = self.goal(from, limits);
        let there =
            (0..limits.count).all(|i| (output[i] - goal[i]).abs() < limits.axes[i].resolution);
        self.still = if same && there { self.still + 1 } else { 0 };
        let needed = STILL_READINGS.max(STILL_S / limits.period.as_secs_f64());
        if f64::from(self.still) < needed {
            return None;
        }
        let Some(before) = self.before else {
            (self.before, self.still) = (Some(*positions), 0);
            return None;
        };
        let verdict = judge(positions, &before, &goal, from, limits);
        if verdict.is_none() {
            // Moved by something else: once more.
            *self = Self::default();
        }
        verdict
    }
}

fn shift(limits: &Limits, axis: usize) -> f64 {
    let step = limits.axes[axis].resolution;
    libm::round(limits.test_shift[axis] / step) * step
}

/// Whether every axis moved by its shift or not at all, as configured; `None`: something between.
fn judge(
    positions: &PerChannel<f64>,
    before: &PerChannel<f64>,
    goal: &PerChannel<f64>,
    from: &PerChannel<f64>,
    limits: &Limits,
) -> Option<bool> {
    let mut as_configured = true;
    for i in 0..limits.count.min(MAX_AXES) {
        let shifted = goal[i] - from[i];
        if shifted == 0.0 {
            continue;
        }
        let share = (positions[i] - before[i]) / shifted;
        let contains = if share.abs() <= 0.25 {
            false
        } else if (share - 1.0).abs() <= 0.25 {
            true
        } else {
            return None;
        };
        as_configured &= contains == limits.axes[i].includes_correction;
    }
    Some(as_configured)
}
