//! Decimal numbers as programs write them: read without loss of a digit, written with a fixed number of decimals.

/// Powers of ten that are exact in an `f64`, and as many decimals as a number is read with.
const POWERS: [f64; 19] = [
    1e0, 1e1, 1e2, 1e3, 1e4, 1e5, 1e6, 1e7, 1e8, 1e9, 1e10, 1e11, 1e12, 1e13, 1e14, 1e15, 1e16,
    1e17, 1e18,
];
/// Below this a whole number is exact in an `f64`.
const EXACT: u64 = 1 << 53;
/// More decimals than this are not written.
pub(crate) const MOST_DECIMALS: u8 = 9;

/// So many digits are exact in an `f64`, together with their power of ten.
const EXACT_DIGITS: usize = 15;

/// A number at the beginning of a text as programs usually have it: few digits without blanks between them. Its value, its decimals and
/// its length; `None`: it is to be read character by character.
pub(crate) fn plain(text: &[u8]) -> Option<(f64, u8, usize)> {
    let first = *text.first()?;
    let begin = usize::from(first == b'-' || first == b'+');
    let mut mantissa = 0_i64;
    let mut at = begin;
    let mut digits = |at: &mut usize| {
        while let Some(digit) = text.get(*at).map(|byte| byte.wrapping_sub(b'0'))
            && digit <= 9
        {
            mantissa = mantissa.wrapping_mul(10).wrapping_add(i64::from(digit));
            *at += 1;
        }
    };
    digits(&mut at);
    let (mut count, mut decimals) = (at - begin, 0);
    if text.get(at) == Some(&b'.') {
        at += 1;
        let point = at;
        digits(&mut at);
        decimals = at - point;
        count += decimals;
    }
    if count == 0 || count > EXACT_DIGITS {
        return None;
    }
    if let Some(b' ' | b'\t') = text.get(at) {
        let mut behind = text[at..]
            .iter()
            .filter(|byte| !matches!(byte, b' ' | b'\t'));
        if let Some(b'0'..=b'9' | b'.') = behind.next() {
            return None;
        }
    }
    let size = mantissa as f64 / POWERS[decimals];
    let value = if first == b'-' { -size } else { size };
    // At most 15.
    Some((value, decimals as u8, at))
}

/// Digits as they are read, one after the other.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Digits {
    mantissa: u64,
    /// Digits behind the decimal point, of those that are in the mantissa.
    decimals: u8,
    /// Digits before the point that did not fit into the mantissa.
    beyond: u8,
    any: bool,
    point: bool,
    negative: bool,
}

impl Digits {
    pub(crate) fn negate(&mut self) {
        self.negative = !self.negative;
    }

    /// Takes the next character; false: it is none of a number.
    pub(crate) fn take(&mut self, byte: u8) -> bool {
        match byte {
            b'0'..=b'9' => {
                let digit = u64::from(byte - b'0');
                // A digit that no longer fits changes nothing that an f64 could hold.
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

    /// The number; `None`: there was no digit.
    pub(crate) fn value(self) -> Option<f64> {
        if !self.any {
            return None;
        }
        let power = POWERS[usize::from(self.decimals)];
        let size = if self.mantissa < EXACT {
            // Both are exact, so that the quotient is the nearest number.
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

    /// Digits behind the decimal point.
    pub(crate) fn decimals(self) -> u8 {
        self.decimals
    }
}

/// A number as so many whole steps of the last decimal; `None` where they are too many to be exact.
#[expect(
    clippy::cast_possible_truncation,
    reason = "the range was looked at before"
)]
pub(crate) fn steps(value: f64, decimals: u8) -> Option<i64> {
    let steps = (value * POWERS[usize::from(decimals.min(MOST_DECIMALS))]).round();
    (steps.abs() < 4e15).then_some(steps as i64)
}

/// What so many steps of the last decimal are.
pub(crate) fn of_steps(steps: i64, decimals: u8) -> f64 {
    steps as f64 / POWERS[usize::from(decimals.min(MOST_DECIMALS))]
}

/// Appends so many steps of the last decimal as a number: without an exponent, with a point where there are decimals.
pub(crate) fn write_steps(to: &mut Vec<u8>, steps: i64, decimals: u8) {
    let mut digits = [b'0'; 24];
    let (mut at, mut rest) = (digits.len(), steps.unsigned_abs());
    let mut put = |byte: u8| {
        at -= 1;
        digits[at] = byte;
    };
    // A remainder of ten is below ten.
    for _ in 0..decimals.min(MOST_DECIMALS) {
        put(b'0' + (rest % 10) as u8);
        rest /= 10;
    }
    if decimals > 0 {
        put(b'.');
    }
    loop {
        put(b'0' + (rest % 10) as u8);
        rest /= 10;
        if rest == 0 {
            break;
        }
    }
    if steps < 0 {
        put(b'-');
    }
    to.extend_from_slice(&digits[at..]);
}
