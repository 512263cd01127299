//! Decimal numbers of programs: read without loss of digits, written with a fixed number of decimals.

/// Powers of ten that are exact in an `f64`; their number also limits the decimals that are read.
const POWERS: [f64; 19] = [
    1e0, 1e1, 1e2, 1e3, 1e4, 1e5, 1e6, 1e7, 1e8, 1e9, 1e10, 1e11, 1e12, 1e13, 1e14, 1e15, 1e16,
    1e17, 1e18,
];

/// Integers below this are exact in an `f64`.
const EXACT: u64 = 1 << 53;

pub(crate) const MAX_DECIMALS: u8 = 9;

/// Number of decimal digits that are exact in an `f64`, together with their power of ten.
const EXACT_DIGITS: usize = 15;

/// Fast path for usual numbers: few digits, without blanks. Returns value, decimals and length; `None` means that the number must be read
/// character by character.
#[expect(clippy::cast_possible_truncation, reason = "at most 15 decimals")]
#[inline]
pub(crate) fn plain(text: &[u8], decimal_sign: u8) -> Option<(f64, u8, usize)> {
    let (first, behind) = text.split_first()?;
    let mut rest = if matches!(first, b'-' | b'+') { behind } else { text };
    let mut mantissa = 0_i64;
    let mut digits = |rest: &mut &[u8]| {
        let before = rest.len();
        while let [byte @ b'0'..=b'9', behind @ ..] = *rest {
            mantissa = mantissa.wrapping_mul(10).wrapping_add(i64::from(byte - b'0'));
            *rest = behind;
        }
        before - rest.len()
    };
    let (mut count, mut decimals) = (digits(&mut rest), 0);
    if let [sign, behind @ ..] = rest
        && *sign == decimal_sign
    {
        rest = behind;
        decimals = digits(&mut rest);
        count += decimals;
    }
    if count == 0 || count > EXACT_DIGITS {
        return None;
    }
    if let [b' ' | b'\t', ..] = rest {
        let mut behind = rest.iter().filter(|byte| !matches!(byte, b' ' | b'\t'));
        if let Some(b'0'..=b'9' | b'.') = behind.next() {
            return None;
        }
    }
    let size = mantissa as f64 / POWERS[decimals];
    let value = if *first == b'-' { -size } else { size };
    Some((value, decimals as u8, text.len() - rest.len()))
}

#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Digits {
    mantissa: u64,
    /// Number of digits after the decimal point that are in the mantissa.
    decimals: u8,
    /// Number of digits before the decimal point that did not fit into the mantissa.
    beyond: u8,
    any: bool,
    point: bool,
    negative: bool,
}

impl Digits {
    pub(crate) fn negate(&mut self) {
        self.negative = !self.negative;
    }

    /// Takes the next character; returns false if it does not belong to a number.
    pub(crate) fn take(&mut self, byte: u8) -> bool {
        match byte {
            b'0'..=b'9' => {
                let digit = u64::from(byte - b'0');
                // Digits that do not fit are beyond the resolution of an f64.
                if self.mantissa < u64::MAX / 16 && usize::from(self.decimals) + 1 < POWERS.len() {
                    self.mantissa = self.mantissa * 10 + digit;
                    self.decimals += u8::from(self.point);
                } else if !self.point {
                    self.beyond = self.beyond.saturating_add(1);
                }
                self.any = true;
                true
            }
            b'.' if !self.point => {
                self.point = true;
                true
            }
            _ => false,
        }
    }

    /// Value of the number; `None` without digits.
    pub(crate) fn value(self) -> Option<f64> {
        if !self.any {
            return None;
        }
        let power = POWERS[usize::from(self.decimals)];
        let size = if self.mantissa < EXACT {
            // Mantissa and power are exact, so the quotient is correctly rounded.
            self.mantissa as f64 / power
        } else {
            let digits = self.mantissa / 1000;
            digits as f64 / power * 1000.0
        };
        let size = match self.beyond {
            0 => size,
            beyond => size * 10_f64.powi(i32::from(beyond)),
        };
        Some(if self.negative { -size } else { size })
    }

    pub(crate) fn decimals(self) -> u8 {
        self.decimals
    }
}

/// Numbers of this many steps or more are refused, so that arithmetic on steps is exact in an `f64`.
const MAX_STEPS: f64 = 4e15;

/// A value in whole steps of the last decimal; `None` if it is too large to be exact.
#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "the range was checked before"
)]
#[inline]
pub(crate) fn steps(value: f64, decimals: u8) -> Option<i64> {
    let exact = value * POWERS[usize::from(decimals.min(MAX_DECIMALS))];
    if exact.is_nan() || exact.abs() >= MAX_STEPS {
        return None;
    }
    // Rounds half away from zero without a library call; the remainder is exact.
    let whole = exact as i64;
    let rest = exact - whole as f64;
    let steps = whole + i64::from(rest >= 0.5) - i64::from(rest <= -0.5);
    (steps.unsigned_abs() < MAX_STEPS as u64).then_some(steps)
}

/// Maximum rounding error of a word with this number of decimals, in the unit of the word.
#[inline]
pub(crate) fn half_step(decimals: u8) -> f64 {
    0.5 * of_steps(1, decimals)
}

#[inline]
pub(crate) fn of_steps(steps: i64, decimals: u8) -> f64 {
    steps as f64 / POWERS[usize::from(decimals.min(MAX_DECIMALS))]
}

#[expect(clippy::cast_possible_truncation, reason = "digits")]
const PAIRS: [[u8; 2]; 100] = {
    let mut pairs = [[b'0'; 2]; 100];
    let mut number = 0;
    while number < pairs.len() {
        pairs[number] = [b'0' + (number / 10) as u8, b'0' + (number % 10) as u8];
        number += 1;
    }
    pairs
};

/// Appends a number given in steps of the last decimal: without exponent, with a point if there are decimals.
#[expect(clippy::cast_possible_truncation, reason = "remainders below 100")]
fn write_steps(to: &mut Vec<u8>, steps: i64, decimals: u8) {
    let decimals = decimals.min(MAX_DECIMALS);
    // 19 digits, the point and the sign.
    let mut digits = [0; 21];
    let (mut at, mut rest) = (digits.len(), steps.unsigned_abs());
    let mut left = decimals;
    while left >= 2 {
        at -= 2;
        digits[at..at + 2].copy_from_slice(&PAIRS[(rest % 100) as usize]);
        rest /= 100;
        left -= 2;
    }
    if left == 1 {
        at -= 1;
        digits[at] = b'0' + (rest % 10) as u8;
        rest /= 10;
    }
    if decimals > 0 {
        at -= 1;
        digits[at] = b'.';
    }
    while rest >= 100 {
        at -= 2;
        digits[at..at + 2].copy_from_slice(&PAIRS[(rest % 100) as usize]);
        rest /= 100;
    }
    if rest >= 10 {
        at -= 2;
        digits[at..at + 2].copy_from_slice(&PAIRS[rest as usize]);
    } else {
        at -= 1;
        digits[at] = b'0' + rest as u8;
    }
    if steps < 0 {
        at -= 1;
        digits[at] = b'-';
    }
    to.extend_from_slice(&digits[at..]);
}

/// Number of decimals of coordinates.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Decimals {
    /// Decimals of lengths in mm.
    pub mm: u8,
    /// Decimals of lengths in inches.
    pub inch: u8,
    /// Decimals of angles in deg.
    pub deg: u8,
}

impl Default for Decimals {
    /// Resolution of most controls: 1 µm, 0.0001 inch and 0.001 deg.
    fn default() -> Self {
        Self { mm: 3, inch: 4, deg: 3 }
    }
}

impl Decimals {
    #[inline]
    pub(crate) fn of(self, axis: usize, unit_mm: f64) -> u8 {
        match axis {
            3..6 => self.deg,
            _ if unit_mm == 1.0 => self.mm,
            _ => self.inch,
        }
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Number {
    steps: i64,
    decimals: u8,
    form: Form,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Form {
    /// A decimal point is written only if there are decimals.
    Plain,
    /// A decimal point is always written.
    Point,
    /// As a number of least increments, without a point.
    Increments,
}

impl Number {
    /// The nearest number with this number of decimals; `None` if it is too large to be exact.
    #[inline]
    pub(crate) fn nearest(value: f64, decimals: u8) -> Option<Self> {
        Some(Self { steps: steps(value, decimals)?, decimals, form: Form::Plain })
    }

    /// The nearest number with at most `most` decimals, without trailing zeros; `None` if it is too large to be exact.
    pub(crate) fn shortest(value: f64, most: u8) -> Option<Self> {
        Self::shortest_of(value, 0, most)
    }

    /// The nearest number with `least` to `most` decimals, without trailing zeros beyond `least`; `None` if it is too large to be exact.
    pub(crate) fn shortest_of(value: f64, least: u8, most: u8) -> Option<Self> {
        let mut number = Self::nearest(value, most)?;
        while number.decimals > least && number.steps % 10 == 0 {
            number.steps /= 10;
            number.decimals -= 1;
        }
        Some(number)
    }

    pub(crate) fn form(self, form: Form) -> Self {
        Self { form, ..self }
    }

    /// This angular position (deg) moved by whole turns into 0 to less than 360; `None` if it has too many decimals.
    pub(crate) fn in_one_turn(self) -> Option<Self> {
        let turn = steps(360.0, self.decimals)?;
        Some(Self { steps: self.steps.rem_euclid(turn), ..self })
    }

    pub(crate) fn is_negative(self) -> bool {
        self.steps < 0
    }

    pub(crate) fn value(self) -> f64 {
        of_steps(self.steps, self.decimals)
    }

    pub(crate) fn write(self, to: &mut Vec<u8>) {
        let decimals = match self.form {
            Form::Increments => 0,
            Form::Plain | Form::Point => self.decimals,
        };
        write_steps(to, self.steps, decimals);
        if self.form == Form::Point && decimals == 0 {
            to.push(b'.');
        }
    }
}

#[derive(Clone, Copy, Debug)]
pub(crate) struct Numerals {
    pub(crate) decimals: u8,
    pub(crate) form: Form,
}

impl Numerals {
    /// The nearest number with at least `least` decimals; `None` if it is too large to be exact.
    #[inline]
    pub(crate) fn nearest(self, value: f64, least: u8) -> Option<Number> {
        Some(Number::nearest(value, self.decimals.max(least))?.form(self.form))
    }
}

#[cfg(test)]
mod tests {
    use rand::{RngExt as _, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    use super::*;

    /// Compared with the standard library.
    #[expect(clippy::cast_possible_truncation, reason = "the range is checked")]
    #[test]
    fn steps_are_the_nearest() {
        let mut draw = ChaCha8Rng::seed_from_u64(6);
        let mut values = vec![0.0, -0.0, 0.5, -0.5, 1.5, 2.5, -2.5, f64::NAN, f64::INFINITY];
        values.extend([
            0.49999999999999994,
            3999999999999999.5,
            3999999999999999.4,
            4e15,
            -4e15,
            1e300,
        ]);
        for _ in 0..100_000 {
            let size = 10_f64.powi(draw.random_range(-3..16));
            let value: f64 = draw.random_range(-size..size);
            values.extend([value, (2.0 * value).round() / 2.0]);
        }
        for value in values {
            for decimals in [0, 3, 4] {
                let expected = (value * POWERS[usize::from(decimals)]).round();
                let expected = (expected.abs() < 4e15).then_some(expected as i64);
                assert_eq!(steps(value, decimals), expected, "{value:e} {decimals}");
            }
        }
    }

    /// Compared with the digits of the number as an integer, with the decimal point inserted.
    #[test]
    fn steps_are_written_with_their_decimals() {
        let mut draw = ChaCha8Rng::seed_from_u64(5);
        let mut steps = vec![0, 1, -1, 9, 10, -10, 99, 100, 101, 999, 1000, -1000];
        steps.extend([4_000_000_000_000_000, i64::MAX, i64::MIN, i64::MIN + 1]);
        for _ in 0..20_000 {
            let size = draw.random_range(0..62_u32);
            steps.push(draw.random_range(-(1_i64 << size)..=1 << size));
        }
        for steps in steps {
            for decimals in 0..=MAX_DECIMALS {
                let mut found = Vec::new();
                write_steps(&mut found, steps, decimals);
                let width = usize::from(decimals) + 1;
                let mut expected = format!("{:0width$}", steps.unsigned_abs());
                if decimals > 0 {
                    expected.insert(expected.len() + 1 - width, '.');
                }
                if steps < 0 {
                    expected.insert(0, '-');
                }
                assert_eq!(found, expected.as_bytes(), "{steps} {decimals}");
            }
        }
    }
}
