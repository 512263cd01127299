//! First-order lag of a temperature that is known only in some rows, and the error due to interpolation between the
//! rows.

use volcomp_curve::first_order_lag_of_ramp;

/// First-order lag of a signal over time, which starts at the first value of the signal. The signal is linear between
/// rows, and the lag is integrated in closed form. The result has the length of the shorter input.
pub(super) fn lagged(time_s: &[f64], signal: &[f64], lag_s: f64) -> Vec<f64> {
    let mut state: Option<(f64, f64, f64)> = None;
    let step = |(&time, &input): (&f64, &f64)| {
        let (time_before, from, value) = state.unwrap_or((time, input, input));
        let value = first_order_lag_of_ramp(value, from, input, time - time_before, lag_s);
        state = Some((time, input, value));
        value
    };
    time_s.iter().zip(signal).map(step).collect()
}

/// Correction for a signal that is curved between its rows: its lag minus the lag of the linearly interpolated signal,
/// in each row.
///
/// The curvature x″ is the difference of the slopes of two intervals divided by the time between their middles. Of the
/// two values, with the previous and with the next interval, the smaller is used, because the beginning or end of
/// heating curves only one of them. Over an interval h, the signal lies x″·t·(h − t)/2 below the straight line. With p
/// = h/lag and k = exp(−p), the lag of this difference is −x″·h²/2·((1 + k)/p − 2·(1 − k)/p²), which decays by k in
/// each later interval. Without a lag it is 0, because the signal is known in the rows. Changes that begin and end
/// within one interval are invisible in the rows.
pub(super) fn bent(time_s: &[f64], signal: &[f64], lag_s: f64) -> Vec<f64> {
    let rows = time_s.len().min(signal.len());
    let mut found = vec![0.0; rows];
    if lag_s.is_nan() || lag_s <= 0.0 {
        return found;
    }
    // Slope of the interval that ends in a row, and time of the middle of that interval.
    let slope = |row: usize| {
        let step_s = time_s[row] - time_s[row - 1];
        ((signal[row] - signal[row - 1]) / step_s, time_s[row] - 0.5 * step_s)
    };
    for row in 1..rows {
        // Change of slope to a neighbouring interval. The first interval has no predecessor, and the last no successor.
        let against = |beside: usize| {
            let ((own, own_s), (other, other_s)) = (slope(row), slope(beside));
            (own - other) / (own_s - other_s)
        };
        let beside = [row - 1, row + 1].into_iter();
        let beside = beside.filter(|beside| (1..rows).contains(beside));
        let least = beside.map(against).min_by(|a, b| a.abs().total_cmp(&b.abs()));
        let bends = least.unwrap_or(0.0);
        let step_s = time_s[row] - time_s[row - 1];
        let own = -0.5 * bends * step_s * step_s * below_line(step_s / lag_s);
        found[row] = (-step_s / lag_s).exp() * found[row - 1] + own;
    }
    found
}

/// (1 + k)/p − 2·(1 − k)/p² with k = exp(−p). This is the lag of t·(1 − t) at the end of a step from 0 to 1 whose
/// length is `p` time constants.
fn below_line(p: f64) -> f64 {
    // In short steps the two parts cancel. The first terms of the series are exact to 1e-10 there.
    if p < 1e-3 {
        return p / 6.0 - p * p / 12.0;
    }
    (1.0 + (-p).exp()) / p + 2.0 * (-p).exp_m1() / (p * p)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Reference: the lag of a signal, integrated in 20,000 steps per interval by the explicit midpoint rule.
    fn fine(signal: impl Fn(f64) -> f64, time_s: &[f64], lag_s: f64) -> Vec<f64> {
        let mut value = signal(time_s[0]);
        let mut found = vec![value];
        for pair in time_s.windows(2) {
            let step_s = (pair[1] - pair[0]) / 2e4;
            for step in 0..20_000 {
                let middle = signal(pair[0] + (f64::from(step) + 0.5) * step_s);
                let half = value + 0.5 * step_s / lag_s * (middle - value);
                value += step_s / lag_s * (middle - half);
            }
            found.push(value);
        }
        found
    }

    /// For linear signals and rows 10 to 900 s apart, the lag equals that of a fine simulation.
    #[test]
    fn straight_lines_are_integrated_exactly() {
        let time_s = [0.0, 30.0, 90.0, 390.0, 400.0, 1300.0, 1600.0];
        let degc = [20.0, 22.0, 21.0, 25.0, 25.5, 19.0, 23.0];
        let line = |t: f64| {
            let row = time_s.partition_point(|s| *s < t).clamp(1, 6);
            let share = (t - time_s[row - 1]) / (time_s[row] - time_s[row - 1]);
            degc[row - 1] + share * (degc[row] - degc[row - 1])
        };
        for lag_s in [5.0, 120.0, 600.0, 5400.0] {
            let expected = fine(line, &time_s, lag_s);
            for (found, expected) in lagged(&time_s, &degc, lag_s).iter().zip(&expected) {
                assert!((found - expected).abs() < 1e-5, "{lag_s}: {found} {expected}");
            }
        }
        assert_eq!(lagged(&time_s, &degc, 0.0), degc);
    }

    /// A parabola has constant curvature, so its deviation from the straight lines between rows is found exactly.
    #[test]
    fn a_parabola_is_found_from_its_rows() {
        let time_s: Vec<f64> = [0, 300, 600, 650, 1200, 2400].map(f64::from).to_vec();
        let parabola = |t: f64| 20.0 + 1e-2 * t - 3e-6 * t * t;
        let degc: Vec<f64> = time_s.iter().map(|t| parabola(*t)).collect();
        // The first and the last interval have only one neighbour, which suffices for a parabola.
        for lag_s in [60.0, 600.0, 5400.0] {
            let straight = lagged(&time_s, &degc, lag_s);
            let bends = bent(&time_s, &degc, lag_s);
            for ((straight, bends), expected) in
                straight.iter().zip(&bends).zip(fine(parabola, &time_s, lag_s))
            {
                let found = straight + bends;
                assert!((found - expected).abs() < 1e-5, "{lag_s}: {found} {expected}");
            }
            assert!(bends[5] > 0.1, "{bends:?}");
        }
        assert_eq!(bent(&time_s, &degc, 0.0), [0.0; 6]);
        let short = below_line(1e-3 * (1.0 - 1e-12));
        assert!((short - below_line(1e-3)).abs() < 1e-9, "{short}");
    }
}
