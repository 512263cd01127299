//! How far each axis may go in a cycle, alone and with others by one factor, and the words that are written.

use volcomp_vocabulary::{AxisKind, MAX_AXES, PerChannel};

use crate::{
    AxisLimits, Limits,
    step::{ROUNDING_STEPS, on_grid, whole_below},
};

/// An axis that is nearer than this number of steps is at its goal.
pub(super) const ARRIVED_STEPS: f64 = ROUNDING_STEPS;

/// The limits of a cycle.
pub(super) struct Cycle<'a> {
    pub(super) limits: &'a Limits,
    pub(super) dt_s: f64,
    /// How far each axis may go, downwards and upwards, mm or rad.
    pub(super) spans: PerChannel<[f64; 2]>,
    /// How far from zero each axis may be, mm or rad: within its limit, or where a limit that was lowered has left it.
    pub(super) reach: PerChannel<f64>,
    /// The acceleration of each axis, 1/s² of mm or rad: its limit, or a higher one that it began to move with.
    pub(super) accel: PerChannel<f64>,
}

/// What may move in a cycle by one factor from 0 to 1.
pub(super) struct Advance {
    /// How far each rotary axis goes with the factor 0, braking as hard as it can, and with the factor 1, rad.
    pub(super) least: PerChannel<f64>,
    pub(super) most: PerChannel<f64>,
    /// Which part of what is left of the ramp passes with the factor 1.
    pub(super) ramp: f64,
}

impl Cycle<'_> {
    /// The places of the axes that there are.
    pub(super) fn places(&self) -> impl Iterator<Item = usize> + use<> {
        0..self.limits.count.min(MAX_AXES)
    }

    /// The places of the axes of a kind.
    pub(super) fn of_kind(&self, kind: AxisKind) -> impl Iterator<Item = usize> + use<'_> {
        let places = self.places();
        places.filter(move |i| self.limits.axes[*i].kind == kind)
    }

    /// The smallest step of an axis, mm or rad.
    pub(super) fn step(&self, axis: usize) -> f64 {
        self.limits.axes[axis].resolution
    }

    /// The acceleration over ways that the axes of a kind go together, 1/s². An axis that is there but for a rounding sets none.
    pub(super) fn accel_over(&self, ways: &PerChannel<f64>, kind: AxisKind) -> f64 {
        self.of_kind(kind)
            .filter(|i| ways[*i].abs() > ARRIVED_STEPS * self.step(*i))
            .map(|i| self.accel[i] / ways[i].abs())
            .fold(f64::INFINITY, f64::min)
    }

    /// The acceleration over ways that all axes go together, 1/s².
    pub(super) fn accel_over_all(&self, ways: &PerChannel<f64>) -> f64 {
        self.accel_over(ways, AxisKind::Linear)
            .min(self.accel_over(ways, AxisKind::Rotary))
    }

    /// Which part of their ways axes go in this cycle by one factor: what the ramp allows and so that they can stop at
    /// their ends, but no less than braking leaves; no more than the span of each allows.
    pub(super) fn part(
        &self,
        ways: &PerChannel<f64>,
        rates: &PerChannel<f64>,
        ramp: f64,
        accel: f64,
    ) -> f64 {
        let rate = self.going(ways, rates) / self.dt_s;
        let part = stopping_part(accel, self.dt_s)
            .min(ramp)
            .max(braking_part(rate, accel, self.dt_s));
        self.places()
            .map(|i| allowed_part(self.spans[i], ways[i]))
            .fold(part, f64::min)
    }

    /// Which part of their ways axes would go by one factor at their rates, or less; 0 where there is no way.
    pub(super) fn going(&self, ways: &PerChannel<f64>, rates: &PerChannel<f64>) -> f64 {
        let part = self
            .places()
            .filter(|i| ways[*i] != 0.0)
            .map(|i| rates[i] / ways[i])
            .fold(f64::INFINITY, f64::min);
        if part.is_finite() {
            part * self.dt_s
        } else {
            0.0
        }
    }

    /// Rotary axes that may go a part of their ways, and a ramp of which a part may pass.
    pub(super) fn advance(&self, ways: &PerChannel<f64>, part: f64, ramp: f64) -> Advance {
        let (mut least, mut most) = (PerChannel::ZERO, PerChannel::ZERO);
        for i in self.of_kind(AxisKind::Rotary) {
            least[i] = within(self.spans[i], 0.0);
            most[i] = within(self.spans[i], part * ways[i]);
        }
        Advance { least, most, ramp }
    }
}

/// Half a step and 20 %: nearer the quantised output stays.
const HYSTERESIS_STEPS: f64 = 0.6;

/// The largest rate from which an axis stops within `distance` at a deceleration, whatever the lengths of the cycles
/// to come: v²/(2a) + v·dt ≤ distance.
pub(super) fn stopping_rate(distance: f64, accel: f64, dt_s: f64) -> f64 {
    if distance <= 0.0 {
        return 0.0;
    }
    // Without the difference of two numbers that are nearly the same, and without the square of one that may be huge.
    let cycles = 2.0 * distance / (accel * dt_s * dt_s);
    2.0 * distance / dt_s / (libm::sqrt(1.0 + cycles) + 1.0)
}

/// The deceleration that an axis needs to stop within `distance`: more than it is allowed only where a limit or an
/// acceleration was lowered in motion, and then no more than it was allowed before, or than the new limit takes.
fn needed_to_stop(distance: f64, rate: f64, dt_s: f64) -> f64 {
    if rate <= 0.0 || distance <= 0.0 {
        return 0.0;
    }
    let by_rate = rate * dt_s;
    rate * rate / (libm::sqrt(distance * distance + by_rate * by_rate) + distance)
}

/// How far an axis that is at `at` and moves at `rate` may go in a cycle, downwards and upwards (mm or rad): within
/// slew and acceleration, and so that it never passes its `limit`. Outside the limit it goes inwards only.
pub(super) fn span(at: f64, rate: f64, slew: f64, accel: f64, limit: f64, dt_s: f64) -> [f64; 2] {
    let (up, down) = (limit - at, limit + at);
    let accel = accel
        .max(needed_to_stop(up, rate, dt_s))
        .max(needed_to_stop(down, -rate, dt_s));
    // Slew comes before acceleration, the limit before both.
    let within_slew = |rate: f64| rate.max(-slew).min(slew);
    let (least, most) = (
        within_slew(rate - accel * dt_s),
        within_slew(rate + accel * dt_s),
    );
    let inwards = (
        -stopping_rate(down, accel, dt_s),
        stopping_rate(up, accel, dt_s),
    );
    let lowest = least.max(inwards.0).min(inwards.1);
    let highest = most.min(inwards.1).max(inwards.0);
    [lowest * dt_s, highest * dt_s]
}

/// A value brought into a span.
pub(super) fn within([lowest, highest]: [f64; 2], value: f64) -> f64 {
    value.max(lowest).min(highest)
}

/// Which part of the `way` of an axis its span allows.
fn allowed_part([lowest, highest]: [f64; 2], way: f64) -> f64 {
    let most = if way > 0.0 { highest } else { -lowest };
    if way == 0.0 {
        1.0
    } else {
        (most / way.abs()).clamp(0.0, 1.0)
    }
}

/// Which part of the way that is left may be gone in a cycle so that it can be stopped at its end, `accel` being the
/// acceleration over the total way, 1/s².
pub(super) fn stopping_part(accel: f64, dt_s: f64) -> f64 {
    (stopping_rate(1.0, accel, dt_s) * dt_s).min(1.0)
}

/// Which part of the way that is left goes by in a cycle of braking from `rate`, 1/s, with `accel`, 1/s².
pub(super) fn braking_part(rate: f64, accel: f64, dt_s: f64) -> f64 {
    // An infinite acceleration stops at once.
    ((rate - accel * dt_s) * dt_s).clamp(0.0, 1.0)
}

/// The nearest step within the hysteresis that changes the output least: over any time it then changes by one step more
/// than the smooth value at the most. An output that stands between two steps goes to the nearest one first: from there
/// the next one is no more than a step away.
pub(super) fn quantised(output: f64, smooth: f64, step: f64) -> f64 {
    let output = on_grid(output, step);
    let away = (smooth - output) / step;
    if away.abs() <= HYSTERESIS_STEPS {
        return output;
    }
    let steps = smooth / step;
    // A rounding must not count as a step.
    let steps = if away > 0.0 {
        libm::ceil(steps - HYSTERESIS_STEPS - 1e-9)
    } else {
        libm::floor(steps + HYSTERESIS_STEPS + 1e-9)
    };
    steps * step
}

/// The word of a linear axis.
pub(super) fn linear_word(output: f64, smooth: f64, axis: &AxisLimits) -> f64 {
    inside(quantised(output, smooth, axis.resolution), smooth, axis)
}

/// The word of a rotary axis: rounded, since the share rests on whole steps.
pub(super) fn rotary_word(output: f64, smooth: f64, axis: &AxisLimits) -> f64 {
    let step = axis.resolution;
    let output = on_grid(output, step);
    let word = if (smooth - output).abs() <= (0.5 + 1e-9) * step {
        output
    } else {
        libm::round(smooth / step) * step
    };
    inside(word, smooth, axis)
}

/// A word that is beyond the limit and beyond the smooth value is rounded towards zero instead.
fn inside(word: f64, smooth: f64, axis: &AxisLimits) -> f64 {
    let rounding = ROUNDING_STEPS * axis.resolution;
    if word.abs() <= axis.limit + rounding || word.abs() <= smooth.abs() + rounding {
        return word;
    }
    whole_below(smooth.abs(), axis.resolution).copysign(smooth)
}
