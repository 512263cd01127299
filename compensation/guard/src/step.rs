//! Arithmetic with positions: whole steps of an axis in the presence of rounding errors, and whole turns.

/// Rounding tolerance, as a fraction of a step.
pub(crate) const ROUNDING_STEPS: f64 = 1e-6;
/// Relative rounding tolerance of a converted or multiplied number.
pub const ROUNDING: f64 = 1.0 + 1e-9;
/// Two values closer than this number of steps are the same step: half a step, plus rounding.
const SAME_STEPS: f64 = 0.51;
/// Two values closer than this number of steps may be one step apart: one step, plus rounding.
const ONE_STEP: f64 = 1.01;

/// Whether two values of an axis are the same step, to half a step plus rounding.
pub(crate) fn is_same_step(a: f64, b: f64, step: f64) -> bool {
    (a - b).abs() <= SAME_STEPS * step
}

/// One step of an axis plus rounding, mm or rad: values no farther apart differ by at most one step.
#[must_use]
pub fn one_step(step: f64) -> f64 {
    ONE_STEP * step
}

pub(crate) fn is_on_grid(value: f64, step: f64) -> bool {
    let steps = value / step;
    (steps - libm::round(steps)).abs() < ROUNDING_STEPS
}

/// The value if it is a whole number of steps, otherwise the nearest whole number of steps.
pub(crate) fn on_grid(value: f64, step: f64) -> f64 {
    if is_on_grid(value, step) { value } else { libm::round(value / step) * step }
}

/// A value rounded down to whole steps, mm or rad, tolerating rounding errors: 0.15 is 150 steps of 0.001, not 149.
pub(crate) fn whole_below(value: f64, step: f64) -> f64 {
    libm::floor(value / step + ROUNDING_STEPS) * step
}

/// Travel of an axis (mm or rad) whose position changed by `way`: if it wraps after a `turn` (a rotary axis: 2π), the shorter of the two
/// directions.
#[must_use]
pub fn shortest_way(way: f64, turn: Option<f64>) -> f64 {
    match turn {
        Some(turn) if turn > 0.0 => way - turn * libm::round(way / turn),
        _ => way,
    }
}
