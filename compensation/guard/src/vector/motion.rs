//! How far one axis may go in a cycle, and the words that are written.

use crate::{
    AxisLimits,
    step::{ROUNDING_STEPS, on_grid, whole_below},
};

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

/// How far an axis that stands at `at` and moves at `rate` may go in a cycle, downwards and upwards (mm or rad): within
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
pub(super) fn allowed_part([lowest, highest]: [f64; 2], way: f64) -> f64 {
    let most = if way > 0.0 { highest } else { -lowest };
    if way == 0.0 {
        1.0
    } else {
        (most / way.abs()).clamp(0.0, 1.0)
    }
}

/// Which part of the way that is left may be gone in a cycle so that it can be stopped at its end, `accel` being the
/// acceleration over the whole way, 1/s².
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
