//! Numbers in measurement files. They are plain decimal ASCII only.

use volcomp_document::quoted;

use crate::{Finding, MetrologyError};

/// Maximum magnitude of a target or deviation. It keeps sums and squares of readings finite.
pub(crate) const LARGEST: f64 = 1e12;

#[derive(Clone, Copy)]
pub(crate) struct Place<'a> {
    pub(crate) file: &'a str,
    pub(crate) line: usize,
}

impl<'a> Place<'a> {
    pub(crate) fn new(file: &'a str, line: usize) -> Self {
        Self { file, line }
    }

    pub(crate) fn finding(
        self,
        what: &str,
        found: impl Into<String>,
        expected: impl Into<String>,
    ) -> Finding {
        Finding {
            file: self.file.into(),
            line: self.line,
            what: what.into(),
            found: found.into(),
            expected: expected.into(),
        }
    }

    pub(crate) fn malformed(
        self,
        what: &str,
        found: impl Into<String>,
        expected: impl Into<String>,
    ) -> MetrologyError {
        MetrologyError::Structure(self.finding(what, found, expected))
    }

    pub(crate) fn not_a_number(
        self,
        what: &str,
        found: impl Into<String>,
        expected: impl Into<String>,
    ) -> MetrologyError {
        MetrologyError::Number(self.finding(what, found, expected))
    }

    pub(crate) fn contradictory(
        self,
        what: &str,
        found: impl Into<String>,
        expected: impl Into<String>,
    ) -> MetrologyError {
        MetrologyError::Contradiction(self.finding(what, found, expected))
    }

    pub(crate) fn truncated(
        self,
        what: &str,
        found: impl Into<String>,
        expected: impl Into<String>,
    ) -> MetrologyError {
        MetrologyError::Truncated(self.finding(what, found, expected))
    }

    /// Error: the content is of another kind than the extension or the caller says.
    pub(crate) fn wrong_kind(self, found: impl Into<String>, expected: &str) -> MetrologyError {
        MetrologyError::Kind(self.finding("kind of file", found, expected))
    }

    /// Parses a finite decimal number. −0 becomes 0, so that equal targets have equal bits.
    pub(crate) fn number(self, what: &str, text: &str) -> Result<f64, MetrologyError> {
        let value = if is_decimal(text) { text.parse::<f64>().ok() } else { None };
        match value {
            Some(value) if value.abs() <= LARGEST => Ok(value + 0.0),
            _ => Err(self.not_a_number(
                what,
                quoted(text),
                if with_point(text).is_some() {
                    "a decimal point: a decimal comma is read where blanks, tabs or semicolons separate the numbers of a file"
                } else {
                    "a finite decimal number such as -12.5, at most 1e12"
                },
            )),
        }
    }

    /// Parses a whole number of at least 1.
    pub(crate) fn count(self, what: &str, text: &str) -> Result<u32, MetrologyError> {
        match text.parse::<u32>() {
            Ok(count) if count >= 1 && text.bytes().all(|b| b.is_ascii_digit()) => Ok(count),
            _ => Err(self.not_a_number(what, quoted(text), "a whole number of at least 1")),
        }
    }
}

/// Replaces the decimal comma of a number by a point; `None` if the text is not a number with a decimal comma.
pub(crate) fn with_point(text: &str) -> Option<String> {
    let (whole, part) = text.split_once(',')?;
    let number = format!("{whole}.{part}");
    (is_decimal(&number) && !whole.contains(['e', 'E'])).then_some(number)
}

pub(crate) fn range(values: impl Iterator<Item = f64>) -> [f64; 2] {
    values.fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], x| [low.min(x), high.max(x)])
}

pub(crate) fn decimals(text: &str) -> usize {
    text.split_once('.').map_or(0, |(_, fraction)| fraction.len())
}

/// Whether the text matches `[+-] digits [. digits] [e [+-] digits]`. A number that ends in a point may be truncated
/// and does not match.
fn is_decimal(text: &str) -> bool {
    let unsigned = text.strip_prefix(['+', '-']).unwrap_or(text);
    let (mantissa, exponent) = match unsigned.split_once(['e', 'E']) {
        Some((mantissa, exponent)) => {
            (mantissa, Some(exponent.strip_prefix(['+', '-']).unwrap_or(exponent)))
        }
        None => (unsigned, None),
    };
    let digits = |t: &str| !t.is_empty() && t.bytes().all(|b| b.is_ascii_digit());
    let mantissa_holds = match mantissa.split_once('.') {
        Some((whole, fraction)) => (whole.is_empty() || digits(whole)) && digits(fraction),
        None => digits(mantissa),
    };
    mantissa_holds && exponent.is_none_or(digits)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_plain_finite_decimals_are_numbers() {
        let place = Place::new("f", 1);
        for (text, value) in
            [("-12.50", -12.5), ("+3", 3.0), (".5", 0.5), ("1e-3", 0.001), ("2.5E+2", 250.0)]
        {
            assert_eq!(place.number("x", text).unwrap(), value);
        }
        for text in [
            "",
            "-",
            "1.",
            "1e",
            "1e+",
            "nan",
            "inf",
            "-Infinity",
            "1e999",
            "1e13",
            "0x10",
            "1,5",
            "1_0",
            "٣",
            " 1",
            "1 ",
        ] {
            assert!(place.number("x", text).is_err(), "{text:?}");
        }
        assert!(place.number("x", "-0.0").unwrap().is_sign_positive());
    }

    #[test]
    fn counts_are_whole_and_positive() {
        let place = Place::new("f", 1);
        assert_eq!(place.count("x", "007").unwrap(), 7);
        for text in ["", "0", "-1", "+1", "1.0", "4294967296", "99999999999999999999999"] {
            assert!(place.count("x", text).is_err(), "{text:?}");
        }
    }
}
