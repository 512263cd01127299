//! The first-order lag with which a machine follows a temperature.

/// The output of a first-order lag after a step of `dt`, in which its input stood at `input`:
/// `input + (before − input)·exp(−dt/lag)`, which is exact for an input that holds for the step.
///
/// `before` is the output before the step, in the unit of the input; `dt` and the time constant `lag` are in the same
/// unit of time. Without a lag (0, negative or NaN) the output is the input; a `dt` that is negative or NaN counts as
/// 0. It is the one rule by which a thermal model is fitted and by which it runs.
pub fn first_order_lag(before: f64, input: f64, dt: f64, lag: f64) -> f64 {
    if lag > 0.0 {
        // `max` takes the other number when one is NaN.
        input + (before - input) * libm::exp(-dt.max(0.0) / lag)
    } else {
        input
    }
}
