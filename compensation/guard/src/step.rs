//! Arithmetic of coordinates: whole steps of an axis, whatever rounding they have been through, and whole turns.

/// A rounding, as a part of a step.
pub(crate) const ROUNDING_STEPS: f64 = 1e-6;
/// A number that was converted or multiplied is not missed by its last digits: by this factor it may be larger.
pub const ROUNDING: f64 = 1.0 + 1e-9;
/// Nearer than half a step, and a rounding, two values are the same step.
const SAME_STEPS: f64 = 0.51;
/// Nearer than one step, and a rounding, two values may be one step apart.
const ONE_STEP: f64 = 1.01;

/// Whether two values of an axis are the same step: no further apart than half of one, and a rounding.
pub(crate) fn is_same_step(a: f64, b: f64, step: f64) -> bool {
    (a - b).abs() <= SAME_STEPS * step
}

/// One step of an axis, mm or rad, and a rounding: values that are no further apart differ by at most one step.
#[must_use]
pub fn one_step(step: f64) -> f64 {
    ONE_STEP * step
}

/// Whether a value is a whole number of steps.
pub(crate) fn is_on_grid(value: f64, step: f64) -> bool {
    let steps = value / step;
    (steps - libm::round(steps)).abs() < ROUNDING_STEPS
}

/// A value that is a whole number of steps, or the nearest one to it.
pub(crate) fn on_grid(value: f64, step: f64) -> f64 {
    if is_on_grid(value, step) {
        value
    } else {
        libm::round(value / step) * step
    }
}

/// The whole steps below a number of them, mm or rad: 150 steps of 0.001 below 0.15, not 149 for a rounding.
pub(crate) fn whole_below(value: f64, step: f64) -> f64 {
    libm::floor(value / step + ROUNDING_STEPS) * step
}

/// How far an axis went (mm or rad) whose position changed by `way`: where it begins anew after a `turn` (a rotary axis that
/// rolls over: 2π), by the shorter of the two ways round.
#[must_use]
pub fn shortest_way(way: f64, turn: Option<f64>) -> f64 {
    match turn {
        Some(turn) if turn > 0.0 => way - turn * libm::round(way / turn),
        _ => way,
    }
}
