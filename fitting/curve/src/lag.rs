//! The first-order lag with which a machine follows a temperature.

/// The output of a first-order lag after a step of `dt`, in which its input stood at `input`:
/// `input + (before − input)·exp(−dt/lag)`, which is exact for an input that holds for the step.
///
/// `before` is the output before the step, in the unit of the input; `dt` and the time constant `lag` are in the same
/// unit of time. Without a lag (0, negative or NaN) the output is the input; a `dt` that is negative or NaN counts as
/// 0. It is the rule by which a thermal model runs, which is stepped in every cycle; one is fitted from rows that are
/// minutes apart by [`first_order_lag_of_ramp`], which is the same in short steps.
pub fn first_order_lag(before: f64, input: f64, dt: f64, lag: f64) -> f64 {
    if lag > 0.0 {
        // `max` takes the other number when one is NaN.
        input + (before - input) * libm::exp(-dt.max(0.0) / lag)
    } else {
        input
    }
}

/// The output of a first-order lag after a step of `dt`, in which its input went along a straight line from `from` to
/// `to`: what many short steps of [`first_order_lag`] along that line come to.
///
/// With `k = exp(−dt/lag)` and `m = (1 − k)·lag/dt`, the mean of `exp(−t/lag)` over the step, the solution of
/// `lag·y' = x − y` is `k·before + (m − k)·from + (1 − m)·to`. The other rules are those of [`first_order_lag`].
pub fn first_order_lag_of_ramp(before: f64, from: f64, to: f64, dt: f64, lag: f64) -> f64 {
    if lag > 0.0 {
        // `max` takes the other number when one is NaN.
        let steps = dt.max(0.0) / lag;
        let kept = libm::exp(-steps);
        // Of a step of no length, or one so short that the quotient is no number, nothing is forgotten.
        let mean = if steps > 0.0 {
            -libm::expm1(-steps) / steps
        } else {
            1.0
        };
        let mean = if mean.is_finite() { mean } else { 0.0 };
        kept * before + (mean - kept) * from + (1.0 - mean) * to
    } else {
        to
    }
}

/// How fast a signal changes, smoothed: the difference of the signal and its first-order lag over the time constant of
/// [`TIME_S`](Self::TIME_S), which for a steady rise is its rate. What a temperature rises and falls by, in a test and
/// at run time, is measured by this one rule. State: the lagged signal.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SmoothedRate {
    lagged: Option<f64>,
}

impl SmoothedRate {
    /// The time constant, s: ten minutes.
    pub const TIME_S: f64 = 600.0;

    /// Takes the value of the signal after a step of `dt_s`: the rate, for each second. The first value has the rate 0.
    pub fn step(&mut self, value: f64, dt_s: f64) -> f64 {
        let before = self.lagged.unwrap_or(value);
        let lagged = first_order_lag(before, value, dt_s, Self::TIME_S);
        self.lagged = Some(lagged);
        (value - lagged) / Self::TIME_S
    }
}
