//! Reduction of a correction by the age of the positions: the older they are, the farther the machine may have moved. State: the speeds of
//! the axes, and past corrections.

use std::time::Duration;

use volcomp_guard::{Limits, Reasons, shortest_way};
use volcomp_kinematics::{Correctors, State};
use volcomp_vocabulary::{AxisKind, PerAxis};

use crate::{
    model::{CoupledCorrection, Model},
    positions::MachinePosition,
};

/// Minimum time over which speeds are measured; over a shorter time the resolution of the positions dominates.
const BASE: Duration = Duration::from_millis(20);
/// Time for which a reduction stays reported, because at speed it changes with every position.
const REPORTED_FOR: Duration = Duration::from_secs(2);
const MAX_AHEAD: Duration = Duration::from_secs(10);

/// Interval at which past corrections are stored.
const SPACING: Duration = Duration::from_millis(10);
/// Number of past corrections that are stored.
const REMEMBERED: usize = 3;
/// No prediction is made if the requested correction has changed by at most this fraction over a time as long as the
/// prediction time `ahead`. If the stored corrections cover a longer time, the threshold grows in proportion, up to
/// `MOST_CHANGE`. For a parabolic change, the change ahead is then at most eleven times as large, which is less than
/// half of the correction.
const CALM_CHANGE: f64 = 1.0 / 32.0;
const MOST_CHANGE: f64 = 1.0 / 8.0;

/// Speeds of the axes, and past corrections.
///
/// Invariants:
/// - `wanted` is in descending order of time, entries at least `SPACING` apart, and all from the active model.
/// - `goes_out` is set only while positions are stale.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Lag {
    /// Positions from which the speed was last measured, and the time at which they were valid.
    before: Option<(PerAxis<f64>, Duration)>,
    /// Past corrections requested by the model, and the times of their positions; newest first.
    wanted: [Option<(CoupledCorrection, Duration)>; REMEMBERED],
    /// Speed of each axis, mm/s and rad/s.
    speed: PerAxis<f64>,
    last: Option<Duration>,
    /// Whether the correction ramps out fast until positions are fresh again.
    goes_out: bool,
}

pub(super) struct PredictionInputs<'a> {
    pub(super) model: &'a Model,
    pub(super) correctors: &'a Correctors,
    pub(super) only_thermal: bool,
    pub(super) limits: &'a Limits,
    pub(super) state: &'a State,
    pub(super) wanted: &'a CoupledCorrection,
    /// Applied correction in machine order, mm and rad.
    pub(super) applied: &'a PerAxis<f64>,
    pub(super) way_out: Duration,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Reduction {
    /// Largest factor on the correction, 0 to 1, with which the error is smaller than without
    /// correction.
    pub(super) part: f64,
    /// Whether positions are stale, and the held correction would become worse than no correction.
    pub(super) fast_ramp_out: bool,
    pub(super) notes: Reasons,
}

impl Lag {
    pub(super) fn update(&mut self, place: &MachinePosition, model: &Model) {
        let Some(taken) = place.oldest else { return };
        let Some((before, at)) = self.before else {
            self.before = Some((place.positions, taken));
            return;
        };
        let passed = taken.saturating_sub(at);
        if passed < BASE {
            return;
        }
        self.speed = PerAxis::from_fn(|axis| {
            let way = place.positions[axis] - before[axis];
            shortest_way(way, model.turn_of(axis)) / passed.as_secs_f64()
        });
        self.before = Some((place.positions, taken));
    }

    /// Computes the largest factor with which a correction c reduces the error if positions have this `age`.
    /// Until the correction reaches the axes, the machine continues at its speed, and the required
    /// correction changes by some distance d. If d ≤ c/2, the whole correction is better than none,
    /// in whatever direction it changes. For larger d the factor is 2·(1 − d/c), which is 0 at d =
    /// c.
    pub(super) fn reduction(
        &mut self,
        inputs: &PredictionInputs<'_>,
        age: Duration,
        now: Duration,
    ) -> Reduction {
        let limits = inputs.limits;
        let stale = age > limits.hold;
        let mut ahead = age.saturating_add(limits.delay());
        if stale {
            // A held correction ramps out at its slew, which takes additional time.
            ahead = ahead.saturating_add(inputs.way_out);
        }
        let ahead = ahead.min(MAX_AHEAD);
        let taken = now.saturating_sub(age);
        let moves = self.speed.iter().any(|speed| *speed != 0.0);
        let part = if moves && !self.is_calm(inputs, taken, ahead) {
            inputs.part_ahead(&self.speed, ahead)
        } else {
            1.0
        };
        self.remember(inputs.wanted, taken);
        self.goes_out = stale && (self.goes_out || part < 1.0);
        if part < 1.0 {
            self.last = Some(now);
        }
        let is_reported = self.last.is_some_and(|last| now.saturating_sub(last) <= REPORTED_FOR);
        Reduction {
            part,
            fast_ramp_out: self.goes_out,
            notes: Reasons::REDUCED_BY_AGE.when(is_reported),
        }
    }
}

impl Lag {
    /// Whether the correction changed so little before the time `taken` of the positions that a prediction
    /// would not reduce it. A prediction costs as much as the rest of the cycle.
    fn is_calm(&self, inputs: &PredictionInputs<'_>, taken: Duration, ahead: Duration) -> bool {
        let Some((_, begun)) = self.wanted[REMEMBERED - 1] else {
            return false;
        };
        let stretch = taken.saturating_sub(begun);
        // Near a singular pose corrections start and end abruptly, and a curve may bend at a node, so the past does not predict the change.
        let may_bend = |(axis, (at, speed)): (usize, (&f64, &f64))| {
            let [from, to] = [-stretch.as_secs_f64(), ahead.as_secs_f64()].map(|s| at + speed * s);
            from != to && inputs.model.may_bend_between(axis, from, to)
        };
        let mut axes = inputs.state.q.iter().zip(&self.speed).enumerate();
        let wanted = inputs.wanted;
        if ahead > stretch
            || stretch.is_zero()
            || wanted.near_singular
            || wanted.linear_near_singular
            || axes.any(may_bend)
        {
            return false;
        }
        let part = ahead.as_secs_f64() / stretch.as_secs_f64();
        let most = (CALM_CHANGE / part).min(MOST_CHANGE);
        let mut past = self.wanted.iter().flatten();
        past.all(|(then, _)| inputs.compare(then).iter().all(|compare| compare.is_within(most)))
    }

    fn remember(&mut self, wanted: &CoupledCorrection, taken: Duration) {
        let is_due = |(_, last): (_, Duration)| taken.saturating_sub(last) >= SPACING;
        if self.wanted[0].is_none_or(is_due) {
            self.wanted.rotate_right(1);
            self.wanted[0] = Some((*wanted, taken));
        }
    }

    /// Discards the past corrections, which belong to the replaced model.
    pub(super) fn forget(&mut self) {
        self.wanted = [None; REMEMBERED];
    }
}

impl PredictionInputs<'_> {
    /// The smaller of two factors with which the correction is better than no correction: half-way through the time
    /// `ahead`, and at its end.
    fn part_ahead(&self, speed: &PerAxis<f64>, ahead: Duration) -> f64 {
        // A periodic error may have the same value at the end as now, so half-way is checked too.
        let half = self.part_after(speed, ahead / 2);
        half.min(self.part_after(speed, ahead))
    }

    fn part_after(&self, speed: &PerAxis<f64>, time: Duration) -> f64 {
        let mut ahead_state = *self.state;
        for (q, speed) in ahead_state.q.iter_mut().zip(speed) {
            *q += speed * time.as_secs_f64();
        }
        let model = self.model;
        let then = model.wanted_by(self.only_thermal, &ahead_state, self.correctors, self.applied);
        let [linear, rotary] = self.compare(&then).map(|compare| compare.part());
        linear.min(rotary)
    }

    /// Compares the present correction with `then`, the correction required ahead: first the linear
    /// axes, then the rotary axes.
    fn compare(&self, then: &CoupledCorrection) -> [Comparison; 2] {
        let now = self.wanted;
        // Effect of the present linear corrections at the pose ahead, where the lever arms of the
        // rotary corrections differ.
        let mut does = now.position;
        let rows = now.follow.iter().zip(&then.follow).zip(&now.rotary);
        for ((now, then), share) in rows.filter(|(_, share)| **share != 0.0) {
            for ((does, now), then) in does.iter_mut().zip(now).zip(then) {
                *does += (now - then) * share;
            }
        }
        [
            Comparison::new(&does, &then.position, self.step(AxisKind::Linear)),
            Comparison::new(&now.rotary, &then.rotary, self.step(AxisKind::Rotary)),
        ]
    }

    fn step(&self, kind: AxisKind) -> f64 {
        let axes = self.limits.axes.iter().take(self.limits.count);
        let of_kind = axes.filter(|axis| axis.kind == kind);
        of_kind.map(|axis| axis.resolution).fold(0.0, f64::max)
    }
}

/// Size of a correction, and its distance from the required one, mm or rad; a distance of up to one step is
/// treated as zero.
struct Comparison {
    size: f64,
    differs: f64,
    step: f64,
}

impl Comparison {
    fn new(does: &PerAxis<f64>, needed: &PerAxis<f64>, step: f64) -> Self {
        let norm = |values: &PerAxis<f64>| values.iter().map(|x| x * x).sum::<f64>().sqrt();
        Self { size: norm(does), differs: norm(&PerAxis::from_fn(|i| does[i] - needed[i])), step }
    }

    fn part(&self) -> f64 {
        let differs = self.differs - self.step;
        if differs <= 0.5 * self.size { 1.0 } else { (2.0 * (1.0 - differs / self.size)).max(0.0) }
    }

    /// Whether the distance is at most `part` times the sum of the correction and two steps. Above 0.5 times the
    /// correction, the correction is reduced.
    fn is_within(&self, part: f64) -> bool {
        self.differs <= part * (self.size + 2.0 * self.step)
    }
}

#[cfg(test)]
mod tests;
