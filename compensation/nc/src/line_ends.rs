//! Line ends, leaders and trailers of program files, as written by editors, controls and tape punches.

use memchr::memchr;

use crate::NcError;

/// True if a byte continues the line end `end`. A line end is a line feed with carriage returns after it (time for tape punches), carriage
/// returns with a line feed after them, or carriage returns only.
pub(crate) fn goes_on(end: &[u8], byte: u8) -> bool {
    match end {
        [] => matches!(byte, b'\r' | b'\n'),
        [b'\n', ..] => byte == b'\r',
        [.., last] => *last == b'\r' && matches!(byte, b'\r' | b'\n'),
    }
}

pub(crate) fn length_of(text: &[u8]) -> usize {
    let is_end = |byte: &u8| matches!(byte, b'\r' | b'\n');
    let end = text.iter().rev().take_while(|byte| is_end(byte)).count();
    text.len() - end
}

pub(crate) fn split_lines(text: &[u8]) -> Vec<(&[u8], &[u8])> {
    let mut lines = Vec::new();
    let mut rest = text;
    while !rest.is_empty() {
        let length = memchr::memchr2(b'\r', b'\n', rest).unwrap_or(rest.len());
        let (line, behind) = rest.split_at(length);
        let mut of_end = 0;
        while let Some(byte) = behind.get(of_end)
            && goes_on(&behind[..of_end], *byte)
        {
            of_end += 1;
        }
        if lines_of(&behind[..of_end]) > 1 {
            // Carriage returns only: each ends a line.
            of_end = 1;
        }
        let (end, behind) = behind.split_at(of_end);
        lines.push((line, end));
        rest = behind;
    }
    lines
}

/// Number of lines that this line end terminates.
pub(crate) fn lines_of(end: &[u8]) -> usize {
    if end.contains(&b'\n') { 1 } else { end.len().max(1) }
}

/// Line end of a line added after one with this end; `None`: keep the previous one (unusual end, or end of file).
pub(crate) fn end_of_added(end: &[u8]) -> Option<&'static [u8]> {
    match end {
        b"\n" => Some(b"\n"),
        b"\r\n" => Some(b"\r\n"),
        b"\r\r\n" => Some(b"\r\r\n"),
        b"\n\r" => Some(b"\n\r"),
        b"\n\r\r" => Some(b"\n\r\r"),
        [b'\r', ..] if !end.contains(&b'\n') => Some(b"\r"),
        _ => None,
    }
}

#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Ends {
    only_returns: Option<bool>,
}

impl Ends {
    /// Rejects a carriage return without a line feed in a file that has line feeds, and the
    /// reverse: controls interpret it differently.
    pub(crate) fn check(&mut self, line: &[u8], end: &[u8], number: usize) -> Result<(), NcError> {
        if end.is_empty() {
            return Ok(());
        }
        let only_returns = !end.contains(&b'\n');
        if *self.only_returns.get_or_insert(only_returns) == only_returns {
            return Ok(());
        }
        let [found, before] = if only_returns {
            ["a carriage return alone", "line feeds"]
        } else {
            ["a line feed", "carriage returns alone"]
        };
        Err(NcError::not_compensated(
            number,
            format!(
                "column {}: found {found} as the end of the line, expected the same as before it, {before}",
                line.len() + 1
            ),
        ))
    }
}

/// Byte order mark that some editors write.
const BYTE_ORDER_MARK: &[u8] = b"\xef\xbb\xbf";

/// Number of bytes before the program: byte order mark, blank tape leader, and tape reader control characters.
pub(crate) fn leader_of(text: &[u8]) -> usize {
    let mark = if text.starts_with(BYTE_ORDER_MARK) { BYTE_ORDER_MARK.len() } else { 0 };
    mark + (text[mark..].iter()).take_while(|byte| is_of_tape(**byte)).count()
}

/// True if a line consists only of tape control characters, or of the end-of-file mark of CP/M and DOS.
pub(crate) fn is_trailer(line: &[u8]) -> bool {
    !line.is_empty() && (line.iter()).all(|byte| is_of_tape(*byte) || *byte == 0x1a)
}

/// True for a control character of paper tape: NUL, DC1 to DC4.
fn is_of_tape(byte: u8) -> bool {
    matches!(byte, 0 | 0x11..=0x14)
}

/// Maximum line length, bytes; longer lines are rejected.
pub const LONGEST_LINE: usize = 1 << 20;

/// Maximum size, bytes, of the program from its first O-word on, which is held in memory.
pub(crate) const MAX_BYTES_IN_MEMORY: usize = 256 << 20;

/// Rejects lines that no program has: longer than a megabyte, or with a zero byte.
pub(crate) fn check_line(line: &[u8], number: usize) -> Result<(), NcError> {
    check_length(line, number)?;
    match memchr(0, line) {
        Some(column) => Err(NcError::Binary { line: number, column: column + 1 }),
        None => Ok(()),
    }
}

pub(crate) fn check_length(line: &[u8], number: usize) -> Result<(), NcError> {
    if line.len() > LONGEST_LINE {
        return Err(NcError::LongLine { line: number, most: LONGEST_LINE });
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn all_line_ends_are_split() {
        for (text, expected) in [
            ("A\nB\n", &["A|\n", "B|\n"][..]),
            ("A\r\n\r\nB", &["A|\r\n", "|\r\n", "B|"]),
            ("A\r\r\nB\r\r\n", &["A|\r\r\n", "B|\r\r\n"]),
            ("A\n\r\rB\n\r\r", &["A|\n\r\r", "B|\n\r\r"]),
            ("A\r\rB\r", &["A|\r", "|\r", "B|\r"]),
            ("\n\n", &["|\n", "|\n"]),
            ("", &[]),
        ] {
            let found: Vec<String> = (split_lines(text.as_bytes()).iter())
                .map(|(line, end)| {
                    let [line, end] = [line, end].map(|of| String::from_utf8_lossy(of));
                    format!("{line}|{end}")
                })
                .collect();
            assert_eq!(found, expected, "{text:?}");
        }
    }
}
