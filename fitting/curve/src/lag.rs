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
