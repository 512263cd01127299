//! A line of a program file: its end, its text, its parsed block, and edits to it.
//!
//! The leaders and trailers of a file are those that editors, controls and tape punches write.

use std::ops::Range;

use memchr::memchr;

use crate::{
    NcError,
    block::{Block, Manner, Word},
    control::Dialect,
    number::Number,
};

#[derive(Clone, Copy, Debug)]
pub(crate) struct Line<'a> {
    pub(crate) block: &'a Block,
    pub(crate) text: &'a [u8],
    pub(crate) more: &'static [u8],
    /// Line number, from 1.
    pub(crate) number: usize,
    pub(crate) script: Script,
}

impl<'a> Line<'a> {
    pub(crate) fn word(self, place: Option<usize>) -> Option<&'a Word> {
        self.block.words.get(place?)
    }

    /// Manner of an added word: that of the word at this index of the block, or [`Manner::Modal`] without such a word.
    pub(crate) fn manner(self, place: Option<usize>) -> Manner {
        self.word(place).map_or(Manner::Modal, |word| word.manner)
    }

    /// Direction of an arc, in dialects that write it after the coordinates (with a leading blank).
    pub(crate) fn direction(self) -> &'static [u8] {
        if !self.script.is_heidenhain() {
            return b"";
        }
        let is_clockwise = |word: &Word| word.letter == b'G' && word.value == Some(2.0);
        if self.block.words.iter().any(is_clockwise) { b" DR-" } else { b" DR+" }
    }

    pub(crate) fn motion_code(self) -> Option<Number> {
        let mut codes = (self.block.words.iter()).filter(|word| word.letter == b'G');
        let code = codes.find_map(|word| word.value.filter(|code| (0.0..=3.0).contains(code)));
        Number::nearest(code?, 0)
    }

    pub(crate) fn place_of(self, letter: u8) -> Option<usize> {
        let words = &self.block.words;
        words.iter().position(|word| word.letter == letter)
    }
}

/// Terminator of a line added next to a line with the terminator `end`; a line feed if the last line of a program has
/// none.
pub(crate) fn end_of_more(end: &[u8]) -> &[u8] {
    if end.is_empty() { b"\n" } else { end }
}

/// Writes a line as a comment in parentheses, which every RS-274 control accepts.
pub(crate) fn write_comment(line: &[u8], out: &mut Vec<u8>) {
    out.push(b'(');
    out.extend(line.iter().filter(|byte| !b"()".contains(byte)));
    out.push(b')');
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Script {
    pub(crate) dialect: Dialect,
    pub(crate) comma: bool,
    pub(crate) says_each: bool,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Shape {
    Straight,
    /// Unchanged: the line keeps its polar coordinates.
    AsItIs,
    Centre,
    Radius,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct NewWord {
    pub(crate) letter: u8,
    pub(crate) manner: Manner,
    pub(crate) number: Number,
}

impl NewWord {
    pub(crate) fn plain((letter, number): (u8, Number)) -> Self {
        Self { letter, manner: Manner::Modal, number }
    }
}

impl Script {
    /// True if the arc centre has a separate block before the arc and each motion has a keyword: HEIDENHAIN.
    pub(crate) fn is_heidenhain(self) -> bool {
        self.dialect == Dialect::Heidenhain
    }

    /// Keyword of a motion in an added line; empty where the motion is modal.
    pub(crate) fn keyword(self, shape: Shape) -> &'static [u8] {
        match shape {
            _ if !self.is_heidenhain() => b"",
            Shape::Straight | Shape::AsItIs => b"L",
            Shape::Centre => b"C",
            Shape::Radius => b"CR",
        }
    }

    /// Appends a word, with a blank before it unless it begins a line.
    pub(crate) fn write_word(self, word: &NewWord, out: &mut Vec<u8>) {
        if !matches!(out.last(), None | Some(b'\r' | b'\n' | b'/')) {
            out.push(b' ');
        }
        let opens: &[u8] = match (self.dialect, word.manner) {
            (Dialect::Siemens, Manner::Absolute) => b"=AC(",
            (Dialect::Siemens, Manner::Incremental) => b"=IC(",
            (Dialect::Siemens, Manner::Shortest) => b"=DC(",
            (Dialect::Heidenhain, Manner::Incremental) => {
                out.push(b'I');
                b""
            }
            _ => b"",
        };
        match (self.dialect, word.letter) {
            (Dialect::Siemens, b'R') => out.extend_from_slice(b"CR="),
            (_, letter) => out.push(letter),
        }
        out.extend_from_slice(opens);
        self.write_number(word.number, true, out);
        if !opens.is_empty() {
            out.push(b')');
        }
    }

    /// Writes a number in place of the number text `before`, with the same decimal sign. A positive number gets a sign
    /// only if `before` has one.
    #[inline]
    pub(crate) fn write_like(self, before: &[u8], number: Number, out: &mut Vec<u8>) {
        if !self.is_heidenhain() {
            return number.write(out);
        }
        let sign = before.iter().find(|byte| matches!(byte, b',' | b'.'));
        let script = Self { comma: sign.map_or(self.comma, |sign| *sign == b','), ..self };
        let has_sign = !before.first().is_some_and(u8::is_ascii_digit);
        script.write_number(number, has_sign, out);
    }

    /// Writes a number; with `has_sign` also the sign of positive numbers, if the dialect writes one.
    fn write_number(self, number: Number, has_sign: bool, out: &mut Vec<u8>) {
        if !self.is_heidenhain() {
            return number.write(out);
        }
        if has_sign && !number.is_negative() {
            out.push(b'+');
        }
        let from = out.len();
        number.write(out);
        if self.comma {
            for byte in &mut out[from..] {
                if *byte == b'.' {
                    *byte = b',';
                }
            }
        }
    }
}

#[derive(Clone, Debug, Default)]
pub(crate) struct Edits {
    pub(crate) replaced: Vec<(usize, Number)>,
    pub(crate) removed: Vec<usize>,
    pub(crate) added: Vec<(u8, Number)>,
    /// Replaced byte ranges of the line, each with the new number; `None` deletes the range.
    pub(crate) ranges: Vec<(Range<usize>, Option<Number>)>,
}

impl Edits {
    pub(crate) fn clear(&mut self) {
        self.replaced.clear();
        self.removed.clear();
        self.added.clear();
        self.ranges.clear();
    }

    pub(crate) fn is_empty(&self) -> bool {
        self.replaced.is_empty()
            && self.removed.is_empty()
            && self.added.is_empty()
            && self.ranges.is_empty()
    }

    pub(crate) fn set(&mut self, letter: u8, place: Option<usize>, number: Number) {
        match place {
            Some(place) => self.replaced.push((place, number)),
            None => self.added.push((letter, number)),
        }
    }

    pub(crate) fn write(&self, line: Line<'_>, out: &mut Vec<u8>) {
        let (text, block) = (line.text, line.block);
        let (mut at, mut added) = (0, false);
        // Inserts the added words after the last word of the block.
        let add = |at: &mut usize, out: &mut Vec<u8>| {
            out.extend_from_slice(&text[*at..block.end]);
            *at = block.end;
            for word in &self.added {
                line.script.write_word(&NewWord::plain(*word), out);
            }
        };
        let mut put = |range: &Range<usize>, number: Option<Number>, out: &mut Vec<u8>| {
            if !added && range.start >= block.end {
                add(&mut at, out);
                added = true;
            }
            out.extend_from_slice(&text[at..range.start]);
            if let Some(number) = number {
                line.script.write_like(&text[range.clone()], number, out);
            }
            at = range.end;
        };
        let of_words = (block.words.iter().enumerate())
            .filter_map(|(place, word)| self.of_word(place, word, text));
        if self.ranges.is_empty() {
            of_words.for_each(|(range, number)| put(&range, number, out));
        } else {
            let mut edits: Vec<_> = of_words.chain(self.ranges.iter().cloned()).collect();
            edits.sort_by_key(|(range, _)| range.start);
            for (range, number) in &edits {
                put(range, *number, out);
            }
        }
        if !added {
            add(&mut at, out);
        }
        out.extend_from_slice(&text[at..]);
    }

    fn of_word(
        &self,
        place: usize,
        word: &Word,
        text: &[u8],
    ) -> Option<(Range<usize>, Option<Number>)> {
        if self.removed.contains(&place) {
            // Removed with the blanks before it, unless it begins the line.
            let kept = text[..word.at].trim_ascii_end().len();
            let from = if kept == 0 { word.at } else { kept };
            return Some((from..word.text.end, None));
        }
        let replaced = self.replaced.iter().rev().find(|(of, _)| *of == place);
        replaced.map(|(_, number)| (word.text.clone(), Some(*number)))
    }
}

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
