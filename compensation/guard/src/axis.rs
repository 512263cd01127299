//! One axis: its correction follows a goal within slew and acceleration, and is quantised last.

use crate::limits::AxisLimits;

/// Half a step and 20 %: nearer the quantised output stays.
const HYSTERESIS_STEPS: f64 = 0.6;

/// The correction of one axis, mm or rad: state of the guard.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Follower {
    /// The correction before the quantiser, mm or rad.
    smooth: f64,
    /// The change of `smooth` in a second.
    rate: f64,
    /// The correction after the quantiser, which is written.
    output: f64,
}

impl Follower {
    /// A follower that stands at what a controller has applied.
    pub fn at(applied: f64) -> Self {
        Self {
            smooth: applied,
            rate: 0.0,
            output: applied,
        }
    }

    /// The correction that is written: a multiple of the step.
    pub fn output(&self) -> f64 {
        self.output
    }

    /// The correction before the quantiser.
    pub fn smooth(&self) -> f64 {
        self.smooth
    }

    /// Stays where it is, since nothing is written.
    pub fn stop(&mut self) {
        self.rate = 0.0;
    }

    /// Goes towards `goal`, which is within the limit, for `dt_s`. Whether slew or acceleration held it back: the
    /// rest is carried to the following cycles.
    ///
    /// The change in a second is the largest from which, at the allowed deceleration, the goal is not
    /// passed whatever the lengths of the cycles to come: v²/(2a) + v·dt ≤ distance. A limit on the correction
    /// so holds on the way, too. Where slew and acceleration disagree, after a reload, slew wins.
    pub fn follow(&mut self, goal: f64, limits: &AxisLimits, dt_s: f64) -> bool {
        if dt_s > 0.0 {
            self.advance(goal, limits, dt_s);
        }
        self.quantise(limits.resolution);
        (goal - self.smooth).abs() > 0.5 * limits.resolution
    }

    fn advance(&mut self, goal: f64, limits: &AxisLimits, dt_s: f64) {
        let distance = goal - self.smooth;
        let wanted = (distance.abs() / dt_s).min(limits.slew_per_s);
        let accel = limits.accel_per_s2;
        if accel.is_finite() {
            let by_cycle = accel * dt_s;
            let braking = libm::sqrt(by_cycle * by_cycle + 2.0 * accel * distance.abs()) - by_cycle;
            let rate = wanted.min(braking).copysign(distance);
            let rate = rate.clamp(self.rate - by_cycle, self.rate + by_cycle);
            self.rate = rate.clamp(-limits.slew_per_s, limits.slew_per_s);
            self.smooth += self.rate * dt_s;
        } else {
            self.rate = wanted.copysign(distance);
            // Exactly there, not a rounding beside it.
            self.smooth = if distance.abs() <= limits.slew_per_s * dt_s {
                goal
            } else {
                self.smooth + self.rate * dt_s
            };
        }
    }

    /// The nearest step within the hysteresis that changes the output least: over any time it then
    /// changes by one step more than the smooth value at the most.
    fn quantise(&mut self, step: f64) {
        let away = (self.smooth - self.output) / step;
        if away.abs() > HYSTERESIS_STEPS {
            let steps = self.smooth / step;
            // A rounding must not count as a step.
            let steps = if away > 0.0 {
                libm::ceil(steps - HYSTERESIS_STEPS - 1e-9)
            } else {
                libm::floor(steps + HYSTERESIS_STEPS + 1e-9)
            };
            self.output = steps * step;
        }
    }
}
