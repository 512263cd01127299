//! Motion ranges of the axes in a cycle, separately and by a common factor, and the quantisation of words.

use volcomp_vocabulary::{AxisKind, MAX_AXES, PerChannel};

use crate::{
    AxisLimits, Limits,
    step::{ROUNDING_STEPS, on_grid, whole_below},
};

/// An axis closer to its goal than this number of steps has arrived.
pub(super) const ARRIVED_STEPS: f64 = ROUNDING_STEPS;

pub(super) struct Cycle<'a> {
    pub(super) limits: &'a Limits,
    pub(super) dt_s: f64,
    /// Range of each axis, downwards and upwards, mm or rad.
    pub(super) spans: PerChannel<[f64; 2]>,
    /// Maximum absolute value of each axis, mm or rad: its limit, or its present value if that is
    /// outside a lowered limit.
    pub(super) reach: PerChannel<f64>,
    /// Acceleration of each axis, mm/s² or rad/s²: its limit, or a higher limit that was valid when the motion started.
    pub(super) accel: PerChannel<f64>,
}

/// The motion that a common factor from 0 to 1 scales in a cycle.
pub(super) struct Advance {
    /// Movement of each rotary axis at factor 0 (maximum braking), rad.
    pub(super) least: PerChannel<f64>,
    /// Movement of each rotary axis at factor 1, rad.
    pub(super) most: PerChannel<f64>,
    /// Fraction by which the remaining ramp shrinks at factor 1.
    pub(super) ramp: f64,
}

impl Cycle<'_> {
    /// Indices of the used axes.
    pub(super) fn places(&self) -> impl Iterator<Item = usize> + use<> {
        0..self.limits.count.min(MAX_AXES)
    }

    pub(super) fn of_kind(&self, kind: AxisKind) -> impl Iterator<Item = usize> + use<'_> {
        let places = self.places();
        places.filter(move |i| self.limits.axes[*i].kind == kind)
    }

    /// The smallest step of an axis, mm or rad.
    pub(super) fn step(&self, axis: usize) -> f64 {
        self.limits.axes[axis].resolution
    }

    /// Acceleration over distances that the axes of this kind cover together, 1/s². An axis at its goal, to rounding, imposes no limit.
    pub(super) fn accel_over(&self, ways: &PerChannel<f64>, kind: AxisKind) -> f64 {
        self.of_kind(kind)
            .filter(|i| ways[*i].abs() > ARRIVED_STEPS * self.step(*i))
            .map(|i| self.accel[i] / ways[i].abs())
            .fold(f64::INFINITY, f64::min)
    }

    /// Acceleration over distances that all axes cover together, 1/s².
    pub(super) fn accel_over_all(&self, ways: &PerChannel<f64>) -> f64 {
        self.accel_over(ways, AxisKind::Linear).min(self.accel_over(ways, AxisKind::Rotary))
    }

    /// Fraction of their remaining distances that axes with a common factor cover in this cycle. The fraction is
    /// limited by the ramp and by the need to stop at the ends. It covers at least the braking distance, and at most
    /// the range of each axis.
    pub(super) fn part(
        &self,
        ways: &PerChannel<f64>,
        rates: &PerChannel<f64>,
        ramp: f64,
        accel: f64,
    ) -> f64 {
        let rate = self.going(ways, rates) / self.dt_s;
        let part =
            stopping_part(accel, self.dt_s).min(ramp).max(braking_part(rate, accel, self.dt_s));
        self.places().map(|i| allowed_part(self.spans[i], ways[i])).fold(part, f64::min)
    }

    /// Smallest fraction of its distance that an axis would cover at its present rate; 0 if no axis has a distance.
    pub(super) fn going(&self, ways: &PerChannel<f64>, rates: &PerChannel<f64>) -> f64 {
        let part = self
            .places()
            .filter(|i| ways[*i] != 0.0)
            .map(|i| rates[i] / ways[i])
            .fold(f64::INFINITY, f64::min);
        if part.is_finite() { part * self.dt_s } else { 0.0 }
    }

    /// The permitted advance in this cycle: rotary axes cover up to `part` of their distances, and the ramp advances by
    /// up to `ramp`.
    pub(super) fn advance(&self, ways: &PerChannel<f64>, part: f64, ramp: f64) -> Advance {
        let (mut least, mut most) = (PerChannel::ZERO, PerChannel::ZERO);
        for i in self.of_kind(AxisKind::Rotary) {
            least[i] = within(self.spans[i], 0.0);
            most[i] = within(self.spans[i], part * ways[i]);
        }
        Advance { least, most, ramp }
    }
}

/// Hysteresis of the quantisation, in steps: half a step plus 20 %. The output changes only if the
/// value is farther away.
const HYSTERESIS_STEPS: f64 = 0.6;

/// Largest rate from which an axis stops within `distance` at a constant deceleration, for any lengths of later cycles:
/// v²/(2a) + v·dt ≤ distance.
pub(super) fn stopping_rate(distance: f64, accel: f64, dt_s: f64) -> f64 {
    if distance <= 0.0 {
        return 0.0;
    }
    // This form avoids the difference of nearly equal numbers, and the square of a possibly huge number.
    let cycles = 2.0 * distance / (accel * dt_s * dt_s);
    2.0 * distance / dt_s / (libm::sqrt(1.0 + cycles) + 1.0)
}

/// Deceleration with which an axis stops within `distance`. It exceeds the configured acceleration only if a limit or
/// an acceleration was lowered during the motion, and is then at most the previous acceleration, or the deceleration
/// that the new limit requires.
fn needed_to_stop(distance: f64, rate: f64, dt_s: f64) -> f64 {
    if rate <= 0.0 || distance <= 0.0 {
        return 0.0;
    }
    let by_rate = rate * dt_s;
    rate * rate / (libm::sqrt(distance * distance + by_rate * by_rate) + distance)
}

/// Range of an axis at position `at` with `rate` in a cycle, downwards and upwards (mm or rad): within slew and
/// acceleration, and such that the axis never passes its `limit`. Outside the limit the axis can only move inwards.
pub(super) fn span(at: f64, rate: f64, slew: f64, accel: f64, limit: f64, dt_s: f64) -> [f64; 2] {
    let (up, down) = (limit - at, limit + at);
    let accel = accel.max(needed_to_stop(up, rate, dt_s)).max(needed_to_stop(down, -rate, dt_s));
    // Slew takes precedence over acceleration, and the limit over both.
    let within_slew = |rate: f64| rate.max(-slew).min(slew);
    let (least, most) = (within_slew(rate - accel * dt_s), within_slew(rate + accel * dt_s));
    let inwards = (-stopping_rate(down, accel, dt_s), stopping_rate(up, accel, dt_s));
    let lowest = least.max(inwards.0).min(inwards.1);
    let highest = most.min(inwards.1).max(inwards.0);
    [lowest * dt_s, highest * dt_s]
}

pub(super) fn within([lowest, highest]: [f64; 2], value: f64) -> f64 {
    value.max(lowest).min(highest)
}

/// Fraction of `way` that the range of an axis allows.
fn allowed_part([lowest, highest]: [f64; 2], way: f64) -> f64 {
    let most = if way > 0.0 { highest } else { -lowest };
    if way == 0.0 { 1.0 } else { (most / way.abs()).clamp(0.0, 1.0) }
}

/// Fraction of the remaining distance that can be covered in a cycle with a stop at its end; `accel` is the acceleration over the total distance,
/// 1/s².
pub(super) fn stopping_part(accel: f64, dt_s: f64) -> f64 {
    (stopping_rate(1.0, accel, dt_s) * dt_s).min(1.0)
}

/// Fraction of the remaining distance covered in a cycle of braking from `rate`, 1/s, with `accel`, 1/s².
pub(super) fn braking_part(rate: f64, accel: f64, dt_s: f64) -> f64 {
    // An infinite acceleration stops at once.
    ((rate - accel * dt_s) * dt_s).clamp(0.0, 1.0)
}

/// The step within the hysteresis that changes the output least. Over any time, the output therefore changes by at most
/// one step more than the smooth value. An output between two steps is first rounded to the nearest step; the next step
/// is at most one step away from it.
pub(super) fn quantised(output: f64, smooth: f64, step: f64) -> f64 {
    let output = on_grid(output, step);
    let away = (smooth - output) / step;
    if away.abs() <= HYSTERESIS_STEPS {
        return output;
    }
    let steps = smooth / step;
    // A rounding error must not be treated as a step.
    let steps = if away > 0.0 {
        libm::ceil(steps - HYSTERESIS_STEPS - 1e-9)
    } else {
        libm::floor(steps + HYSTERESIS_STEPS + 1e-9)
    };
    steps * step
}

pub(super) fn linear_word(output: f64, smooth: f64, axis: &AxisLimits) -> f64 {
    inside(quantised(output, smooth, axis.resolution), smooth, axis)
}

/// The word of a rotary axis. It is rounded without hysteresis, because the share of the axis is on whole steps.
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

/// Returns `word`; if it exceeds both the limit and the unrounded value `smooth`, returns `smooth` rounded towards zero
/// to a whole step.
fn inside(word: f64, smooth: f64, axis: &AxisLimits) -> f64 {
    let rounding = ROUNDING_STEPS * axis.resolution;
    if word.abs() <= axis.limit + rounding || word.abs() <= smooth.abs() + rounding {
        return word;
    }
    whole_below(smooth.abs(), axis.resolution).copysign(smooth)
}
