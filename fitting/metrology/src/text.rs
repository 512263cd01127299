//! Text of measurement files: its encoding, its decimal commas and its numbers.
//!
//! The encoding is UTF-8, or else GBK or Latin-1, which is read as Windows-1252. Decimal commas are accepted where
//! numbers are separated by blanks and tabs. Numbers are plain decimal ASCII only.

use std::borrow::Cow;

use volcomp_document::quoted;

use crate::{Finding, MetrologyError};

/// Decodes the text of a file. Also returns a note if the text is not UTF-8.
pub(crate) fn decode(bytes: &[u8], file: &str) -> Result<(String, Option<String>), MetrologyError> {
    let refuse = |at: usize, found: &str| {
        let line = bytes[..at].split(|b| *b == b'\n').count();
        let expected = "text in UTF-8, GBK or Latin-1";
        MetrologyError::Encoding(Place::new(file, line).finding("encoding", found, expected))
    };
    if bytes.starts_with(&[0xFF, 0xFE]) || bytes.starts_with(&[0xFE, 0xFF]) {
        return Err(refuse(0, "UTF-16"));
    }
    if let Some(at) = bytes.iter().position(|b| *b == 0) {
        return Err(refuse(at, "a zero byte (a binary file, or UTF-16)"));
    }
    let bytes = bytes.strip_prefix(&[0xEF, 0xBB, 0xBF]).unwrap_or(bytes);
    if let Ok(text) = std::str::from_utf8(bytes) {
        return Ok((text.to_owned(), None));
    }
    let (encoding, called) = if looks_like_gbk(bytes) {
        (encoding_rs::GBK, "GBK")
    } else {
        (encoding_rs::WINDOWS_1252, "Latin-1")
    };
    let (text, _) = encoding.decode_without_bom_handling(bytes);
    let note = format!("text that is not UTF-8 was read as {called}");
    Ok((text.into_owned(), Some(note)))
}

/// Whether the bytes are Chinese text in GBK. GBK has pairs of high bytes, mostly punctuation (lead bytes A1 to A3) or
/// common characters (lead bytes B0 to D7). In Latin-1, high bytes are isolated between letters.
fn looks_like_gbk(bytes: &[u8]) -> bool {
    let runs = || bytes.split(u8::is_ascii).filter(|run| !run.is_empty());
    let all_pairs =
        runs().all(|run| run.len() % 2 == 0 && run.iter().all(|b| (0xA1..=0xFE).contains(b)));
    let leads: Vec<u8> = runs().flat_map(|run| run.iter().step_by(2).copied()).collect();
    let common = leads.iter().filter(|lead| matches!(lead, 0xA1..=0xA3 | 0xB0..=0xD7)).count();
    all_pairs && 2 * common > leads.len()
}

pub(crate) fn refuse_empty(text: &str, file: &str, expected: &str) -> Result<(), MetrologyError> {
    if text.trim().is_empty() {
        return Err(MetrologyError::Empty { file: file.into(), expected: expected.into() });
    }
    Ok(())
}

/// First line that is not blank, trimmed, and its number from 1.
pub(crate) fn first_line(text: &str) -> Option<(usize, &str)> {
    text.lines()
        .enumerate()
        .map(|(i, line)| (i + 1, line.trim()))
        .find(|(_, line)| !line.is_empty())
}

/// Replaces decimal commas in the numbers of a text by points. `numbers` is called with each line in order. It returns
/// the byte at which the numbers of the line begin, or `None` for a line without numbers, which stays unchanged.
/// Errors: a file that mixes commas and points, or in which three digits follow every comma, because `1,000` may be a
/// thousand.
pub(crate) fn with_points<'t>(
    text: &'t str,
    name: &str,
    mut numbers: impl FnMut(&str) -> Option<usize>,
) -> Result<Cow<'t, str>, MetrologyError> {
    let (mut comma, mut point) = (None, None);
    let mut is_certain = false;
    let mut written = String::with_capacity(text.len());
    for (index, line) in text.split_inclusive('\n').enumerate() {
        let Some((head, body)) = numbers(line).and_then(|at| line.split_at_checked(at)) else {
            written.push_str(line);
            continue;
        };
        written.push_str(head);
        for token in body.split_inclusive(|c: char| c.is_ascii_whitespace()) {
            let number = token.trim_ascii_end();
            if let Some(read) = with_point(number) {
                comma.get_or_insert((index + 1, number));
                is_certain |= !may_be_thousands(number);
                written.push_str(&read);
                written.push_str(&token[number.len()..]);
                continue;
            }
            let place = Place::new(name, index + 1);
            if number.contains('.') && place.number("", number).is_ok() {
                point.get_or_insert((index + 1, number));
            }
            written.push_str(token);
        }
    }
    let Some((line, found)) = comma else {
        return Ok(Cow::Borrowed(text));
    };
    let wrong = |line, found: &str, expected: String| {
        let place = Place::new(name, line);
        Err(place.not_a_number("decimal comma", quoted(found), expected))
    };
    if let Some((other, point)) = point {
        let expected = format!(
            "decimal commas or decimal points in all numbers: line {other} has {}",
            quoted(point)
        );
        return wrong(line, found, expected);
    }
    if !is_certain {
        let expected = "a decimal point: three digits stand behind each comma of the file, and it may separate thousands";
        return wrong(line, found, expected.to_owned());
    }
    Ok(Cow::Owned(written))
}

/// Whether a comma may separate thousands: true for `1,250`, false for `0,250` and `1,25`.
fn may_be_thousands(number: &str) -> bool {
    let digits = number.trim_start_matches(['+', '-']);
    let parts = digits.split_once(',');
    parts.is_some_and(|(whole, part)| {
        part.len() == 3 && matches!(whole.len(), 1..=3) && !whole.starts_with('0')
    })
}

/// Whether a line begins with a number, with a decimal point or a decimal comma.
pub(crate) fn begins_with_number(line: &str) -> bool {
    let first = line.split_ascii_whitespace().next().unwrap_or_default();
    let place = Place::new("", 0);
    with_point(first).is_some() || place.number("", first).is_ok()
}

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

    fn finding(self, what: &str, found: impl Into<String>, expected: impl Into<String>) -> Finding {
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
fn with_point(text: &str) -> Option<String> {
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
    fn latin_1_and_gbk_are_distinguished() {
        let text_of = |bytes: &[u8]| decode(bytes, "f").unwrap();
        assert_eq!(
            text_of(b"Gr\xF6\xDFe M\xFCller"),
            ("Größe Müller".into(), Some("text that is not UTF-8 was read as Latin-1".into()))
        );
        assert_eq!(
            text_of(b"\xCE\xDE\xCE\xFD: \xBB\xFA\xB4\xB2"),
            ("无锡: 机床".into(), Some("text that is not UTF-8 was read as GBK".into()))
        );
        assert_eq!(text_of(b"\xEF\xBB\xBFa\xC2\xB5"), ("aµ".into(), None));
    }

    #[test]
    fn wide_text_and_binary_are_refused() {
        assert!(decode(b"\xFF\xFEh\0", "f").is_err());
        assert!(decode(b"a\nb\0", "f").unwrap_err().to_string().starts_with("f:2:"));
    }

    fn read(text: &str) -> String {
        let all = |line: &str| begins_with_number(line).then_some(0);
        match with_points(text, "f", all) {
            Ok(text) => text.into_owned(),
            Err(error) => error.to_string(),
        }
    }

    #[test]
    fn commas_are_read_where_they_can_be_nothing_else() {
        for (text, expected) in [
            ("a 1,5\r\n1\t-0,25 2\r\n", "a 1,5\r\n1\t-0.25 2\r\n"),
            ("1,000 0,000\n", "1.000 0.000\n"),
            ("1,5E-03 2", "1.5E-03 2"),
            ("1.5 2\n", "1.5 2\n"),
            // These are no numbers, so the reader of the cell reports them.
            ("1 1,2,3 1,2.3 ,\n", "1 1,2,3 1,2.3 ,\n"),
            (
                "1.5\n2 2,5",
                "f:2: decimal comma: found `2,5`, expected decimal commas or decimal points in all numbers: line 1 has `1.5`",
            ),
            (
                "1,000\n2,500",
                "f:1: decimal comma: found `1,000`, expected a decimal point: three digits stand behind each comma of the file, and it may separate thousands",
            ),
        ] {
            assert_eq!(read(text), expected, "{text:?}");
        }
    }

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
