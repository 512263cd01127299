/// A linear scale from values to picture positions.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Scale {
    /// The values at both ends.
    pub values: [f64; 2],
    /// The positions of both ends.
    pub places: [f64; 2],
}

impl Scale {
    /// Creates a scale over all finite `values`, extended at both ends by `margin` (relative to their range). An empty range is widened.
    pub fn over(values: impl IntoIterator<Item = f64>, places: [f64; 2], margin: f64) -> Self {
        /// Maximum magnitude of a drawn value: far beyond measured values, and small enough to subtract without overflow.
        const MOST: f64 = 1e12;
        let finite = values.into_iter().filter(|x| x.abs() <= MOST);
        let (low, high) = finite
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), x| (low.min(x), high.max(x)));
        let (low, high) = if low <= high { (low, high) } else { (0.0, 1.0) };
        let least = 1e-6 * low.abs().max(high.abs()).max(1e-3);
        let range = high - low;
        let (low, high) = if range < least {
            let half = 0.5 * low.abs().max(1.0);
            (low - half, high + half)
        } else {
            (low - margin * range, high + margin * range)
        };
        Self { values: [low, high], places }
    }

    /// The position of a value.
    pub fn at(&self, value: f64) -> f64 {
        let ([low, high], [from, to]) = (self.values, self.places);
        from + (value - low) / (high - low) * (to - from)
    }
}

/// About `count` round values in a range, and the number of decimals with which to format them.
#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "a few decimals, never below 0"
)]
pub fn ticks([low, high]: [f64; 2], count: usize) -> (Vec<f64>, usize) {
    let range = high - low;
    if !(range > 0.0 && range.is_finite()) || count == 0 {
        return (Vec::new(), 0);
    }
    let rough = range / count as f64;
    let power = 10.0_f64.powf(rough.log10().floor());
    let factor = [1.0, 2.0, 2.5, 5.0, 10.0]
        .into_iter()
        .find(|factor| factor * power >= rough * (1.0 - 1e-9))
        .unwrap_or(10.0);
    let step = factor * power;
    let mut decimals = (-step.log10()).ceil().max(0.0) as usize;
    if factor == 2.5 && step < 10.0 {
        decimals = (-power.log10()).ceil().max(0.0) as usize + 1;
    }
    let first = (low / step - 1e-9).ceil();
    let all = (0..=4 * count).map(|index| (first + index as f64) * step);
    let values = all.take_while(|value| *value <= high + 1e-9 * range);
    (values.map(|value| value + 0.0).collect(), decimals.min(9))
}

/// Formats a number for a label with `decimals` decimals, a true minus sign, and no −0.
pub fn short(value: f64, decimals: usize) -> String {
    if !value.is_finite() {
        return "–".to_owned();
    }
    let text = format!("{value:.decimals$}");
    let is_zero = text.chars().all(|sign| matches!(sign, '-' | '0' | '.'));
    match text.strip_prefix('-') {
        Some(rest) if is_zero => rest.to_owned(),
        Some(rest) => format!("−{rest}"),
        None => text,
    }
}

/// Rounds down to 1, 2 or 5 times a power of ten; 1 for a value that is not positive.
pub fn round_below(value: f64) -> f64 {
    let power = 10.0_f64.powf(value.log10().floor());
    if !(power > 0.0 && power.is_finite()) {
        return 1.0;
    }
    let rounds = [5.0, 2.0, 1.0].map(|f| f * power);
    rounds.into_iter().find(|round| *round <= value).unwrap_or(power)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn round_numbers_are_below() {
        assert_eq!([7.0, 23.0, 0.4].map(round_below), [5.0, 20.0, 0.2]);
        assert_eq!([0.0, -3.0, f64::NAN].map(round_below), [1.0; 3]);
    }

    #[test]
    fn ticks_are_round_and_within() {
        assert_eq!(ticks([0.0, 1000.0], 5), (vec![0.0, 200.0, 400.0, 600.0, 800.0, 1000.0], 0));
        let (values, decimals) = ticks([-0.31, 0.42], 4);
        assert_eq!(decimals, 1);
        assert_eq!(values.len(), 4);
        assert!(values.iter().all(|v| (-0.31..=0.42).contains(v)));
        assert_eq!(ticks([0.0, 1.0], 4).1, 2);
        for wrong in [[1.0, 1.0], [2.0, 1.0], [f64::NAN, 1.0], [0.0, f64::INFINITY]] {
            assert!(ticks(wrong, 5).0.is_empty());
        }
    }

    #[test]
    fn a_number_has_a_minus_sign_and_no_negative_zero() {
        assert_eq!(short(-0.001, 2), "0.00");
        assert_eq!(short(-1.5, 1), "−1.5");
        assert_eq!(short(f64::NAN, 1), "–");
    }
}
