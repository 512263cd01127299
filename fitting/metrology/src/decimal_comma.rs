//! Decimal commas in files whose numbers are separated by blanks and tabs, so that a comma is no separator.

use std::borrow::Cow;

use volcomp_document::quoted;

use crate::MetrologyError;
use crate::number::{Place, with_point};

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

#[cfg(test)]
mod tests {
    use super::*;

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
}
