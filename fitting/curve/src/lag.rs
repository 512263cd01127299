//! First-order lag, by which a machine follows a temperature.

/// Output of a first-order lag after a step of `dt` with the constant input `input`: `input + (before −
/// input)·exp(−dt/lag)`, which is exact.
///
/// `before` is the output before the step, in the unit of the input. `dt` and the time constant `lag` are in the same
/// unit of time. If `lag` is 0, negative or NaN, the output is the input. If `dt` is negative or NaN, it counts as 0.
/// Thermal models use this function at run time, in steps of one cycle. They are fitted by [`first_order_lag_of_ramp`]
/// to rows that are minutes apart. For short steps both functions agree.
pub fn first_order_lag(before: f64, input: f64, dt: f64, lag: f64) -> f64 {
    if lag > 0.0 {
        // If one argument is NaN, `max` returns the other.
        input + (before - input) * libm::exp(-dt.max(0.0) / lag)
    } else {
        input
    }
}

/// Output of a first-order lag after a step of `dt` in which its input changed linearly from `from` to `to`. It is the
/// limit of many short steps of [`first_order_lag`] along this ramp.
///
/// Let `k = exp(−dt/lag)`, and `m = (1 − k)·lag/dt`, which is the mean of `exp(−t/lag)` over the step. Then the
/// solution of `lag·y' = x − y` is `k·before + (m − k)·from + (1 − m)·to`. Invalid arguments are handled as in
/// [`first_order_lag`].
pub fn first_order_lag_of_ramp(before: f64, from: f64, to: f64, dt: f64, lag: f64) -> f64 {
    if lag > 0.0 {
        // If one argument is NaN, `max` returns the other.
        let steps = dt.max(0.0) / lag;
        let kept = libm::exp(-steps);
        // A step of zero length leaves the output unchanged, and so does a step so short that the quotient underflows.
        let mean = if steps > 0.0 { -libm::expm1(-steps) / steps } else { 1.0 };
        let mean = if mean.is_finite() { mean } else { 0.0 };
        kept * before + (mean - kept) * from + (1.0 - mean) * to
    } else {
        to
    }
}

/// Smoothed rate of change of a signal: the difference between the signal and its first-order lag, divided by the time
/// constant [`TIME_S`](Self::TIME_S). For a steady rise it equals the rate. Used for temperatures in tests and at run
/// time. The state is the lagged signal.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SmoothedRate {
    lagged: Option<f64>,
}

impl SmoothedRate {
    /// Time constant, s.
    pub const TIME_S: f64 = 600.0;

    /// Takes the value of the signal after a step of `dt_s` (s), and returns the rate per second. The first value gives
    /// the rate 0.
    pub fn step(&mut self, value: f64, dt_s: f64) -> f64 {
        let before = self.lagged.unwrap_or(value);
        let lagged = first_order_lag(before, value, dt_s, Self::TIME_S);
        self.lagged = Some(lagged);
        (value - lagged) / Self::TIME_S
    }
}
