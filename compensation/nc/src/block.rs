//! One parsed line of a program: its words with their byte positions, so that unchanged text stays as it is.

use std::ops::Range;

use crate::{
    error::{Column, Fault},
    number::{Digits, plain},
    parameters::Value,
};

#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Word {
    /// Capital letter, one of `@`, `^` and `$`, or a pseudo-letter: `OTHER` or `LAST`.
    pub(crate) letter: u8,
    /// Byte offset of the letter in the line.
    pub(crate) at: usize,
    /// Byte range of the value in the line.
    pub(crate) text: Range<usize>,
    pub(crate) value: Value,
    /// Decimals of a plain number; `None` for a computed value.
    pub(crate) decimals: Option<u8>,
    pub(crate) manner: Manner,
    pub(crate) in_increments: bool,
}

/// How the coordinate of a word is to be interpreted.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) enum Manner {
    /// According to the active mode (G90 or G91).
    #[default]
    Modal,
    /// Absolute position: `AC(..)`.
    Absolute,
    /// Incremental: `IC(..)`, `IX`.
    Incremental,
    /// Absolute position of a rotary axis, approached by the shorter way: `DC(..)`.
    Shortest,
}

/// Pseudo-letter of words that do not affect coordinates but belong to their motion, such as coolant on.
pub(crate) const OTHER: u8 = b'!';

/// Pseudo-letter of words executed at the end of the motion, such as a stop. When a motion is split, they are written
/// with its last part.
pub(crate) const LAST: u8 = b'&';

/// Letters of polar coordinates: distance from the pole, and angle.
pub(crate) const POLAR: [u8; 2] = *b"@^";

/// A parameter. It is assigned after the other words of its block are read.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Parameter {
    Numbered(u32),
    Named(String),
}

#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Assignment {
    pub(crate) parameter: Parameter,
    pub(crate) value: Value,
    /// Byte range of the assignment.
    pub(crate) all: Range<usize>,
    /// Byte range of the assigned value.
    pub(crate) text: Range<usize>,
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) enum BlockStart {
    #[default]
    Nothing,
    /// Block delete (`/`): the operator may have the line skipped.
    Slash,
    /// Percent sign: start or end of the program.
    Percent,
}

#[derive(Clone, Debug, Default)]
pub(crate) struct Block {
    pub(crate) words: Vec<Word>,
    pub(crate) assignments: Vec<Assignment>,
    /// Commands of the dialect that have no RS-274 code.
    pub(crate) commands: Vec<Command>,
    pub(crate) begins: BlockStart,
    /// Block number and its byte range, in dialects that number their blocks consecutively (HEIDENHAIN).
    pub(crate) number: Option<(Range<usize>, u64)>,
    /// Byte range of the motion keyword; added lines need one as well.
    pub(crate) keyword: Range<usize>,
    /// True if numbers have decimal commas; `None` if the block has no decimals.
    pub(crate) comma: Option<bool>,
    /// Whether the last coordinate of the program was in least increments; `None` if there was no coordinate yet, or if
    /// the control does not count in increments.
    pub(crate) last_in_increments: Option<bool>,
    /// Byte range of the block-delete mark.
    pub(crate) skip: Range<usize>,
    /// Byte offset for added words: after the last word.
    pub(crate) end: usize,
}

impl Block {
    pub(crate) fn push(
        &mut self,
        letter: u8,
        at: usize,
        text: Range<usize>,
        value: Value,
        manner: Manner,
        decimals: Option<u8>,
    ) {
        self.words.push(Word { letter, at, text, value, decimals, manner, in_increments: false });
    }
}

#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Command {
    /// Shifts the coordinates by the words of the block: replaces the programmed frame (TRANS), or adds to it (ATRANS).
    Shift {
        adds: bool,
    },
    /// Rotates the coordinates by an angle, deg, about the axis normal to X and Y (ROT, AROT).
    Rotation {
        adds: bool,
        angle_deg: Value,
    },
    /// From now on coordinates are those of the tool centre point (true) or of the axes (false).
    CentrePoint(bool),
    WorkOffset(usize),
    /// CYCL DEF 247: the preset number follows in one of the next lines.
    AwaitsPreset,
    Preset(Value),
    InMachine,
    /// Cutting edge whose tool length is active from now on; 0: none.
    Edge(Value),
    ChangeTool,
    NamedTool,
    /// The rest of the line moves axes in a dialect-specific way and is copied unchanged.
    Cycle(Cycle),
    /// Makes a cycle modal, so that it is executed after each motion (`Some`), or cancels the modal cycle (`None`).
    EachMotion(Option<Cycle>),
    /// A copied command that may move axes; their positions are unknown afterwards.
    MayMove(String),
    /// A printer homes (G28), which clears the G92 shift.
    Homes {
        all: bool,
    },
    /// E words are relative (M83) or absolute (M82) from now on.
    Extrudes {
        relative: bool,
    },
    Ends,
    /// Sets the pole, the centre of arcs and polar coordinates, to the words of the block (CC).
    Pole,
    /// Sets the datum shift along the axes of the block's words; the other axes keep theirs (cycle 7).
    Datum,
    /// From now on rotary axes take the shorter way (true, M126), or not (M127).
    Shorter(bool),
    GoesOn,
    /// Defines the cycle for later calls; `CallsDefined` calls it.
    Defines(Cycle),
    CallsDefined,
    /// Calls the tool with this number and a length allowance, in the unit of the program.
    CallsTool {
        tool: Value,
        longer: Value,
    },
    /// Defines a tool length, in the unit of the program.
    DefinesTool {
        tool: Value,
        length: Value,
    },
}

#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Cycle {
    pub(crate) name: String,
    /// End position (RTP) of a cycle that only moves along the tool axis, in the unit of the program.
    pub(crate) drills_to: Option<Value>,
}

/// Cursor over a line, read from the left. Positions are byte offsets.
#[derive(Clone, Debug)]
pub(crate) struct Scanner<'a> {
    bytes: &'a [u8],
    at: usize,
}

impl<'a> Scanner<'a> {
    pub(crate) fn new(bytes: &'a [u8]) -> Self {
        Self { bytes, at: 0 }
    }

    pub(crate) fn at(&self) -> usize {
        self.at
    }

    pub(crate) fn bytes(&self) -> &'a [u8] {
        self.bytes
    }

    pub(crate) fn rest(&self) -> &'a [u8] {
        self.bytes.get(self.at..).unwrap_or_default()
    }

    /// True if the text continues with this word, in upper or lower case; blanks are not skipped.
    pub(crate) fn is_next(&self, word: &str) -> bool {
        let next = self.rest().get(..word.len());
        next.is_some_and(|next| next.eq_ignore_ascii_case(word.as_bytes()))
    }

    pub(crate) fn go_to(&mut self, at: usize) {
        self.at = at.min(self.bytes.len());
    }

    pub(crate) fn column(&self) -> Column {
        Column(self.at + 1)
    }

    /// Returns the next character in upper case without consuming it; skips blanks.
    #[inline]
    pub(crate) fn peek(&mut self) -> Option<u8> {
        while let Some(byte) = self.bytes.get(self.at) {
            if !matches!(byte, b' ' | b'\t') {
                return Some(byte.to_ascii_uppercase());
            }
            self.at += 1;
        }
        None
    }

    #[inline]
    pub(crate) fn next(&mut self) -> Option<u8> {
        let byte = self.peek()?;
        self.at += 1;
        Some(byte)
    }

    /// Consumes this character if it is next after blanks.
    pub(crate) fn takes(&mut self, byte: u8) -> bool {
        let is_next = self.peek() == Some(byte);
        self.at += usize::from(is_next);
        is_next
    }

    /// Consumes these capital letters if they are next, with any blanks between them.
    pub(crate) fn takes_all(&mut self, letters: &str) -> bool {
        let before = self.at;
        let all = letters.bytes().all(|letter| self.takes(letter));
        if !all {
            self.at = before;
        }
        all
    }

    /// Reads a decimal number with an optional sign; returns its value and number of decimals, `None` without a number.
    pub(crate) fn number(&mut self) -> Option<(f64, u8)> {
        if let Some((value, decimals, length)) = plain(&self.bytes[self.at..], b'.') {
            self.at += length;
            return Some((value, decimals));
        }
        self.number_with_blanks()
    }

    /// Like [`number`](Self::number), for numbers of any length, also with blanks between the digits.
    fn number_with_blanks(&mut self) -> Option<(f64, u8)> {
        let before = self.at;
        let mut digits = Digits::default();
        match self.peek() {
            Some(b'-') => {
                digits.negate();
                self.at += 1;
            }
            Some(b'+') => self.at += 1,
            _ => {}
        }
        let mut end = self.at;
        while let Some(byte) = self.peek() {
            if !digits.take(byte) {
                break;
            }
            self.at += 1;
            end = self.at;
        }
        // Trailing blanks do not belong to the number.
        self.at = end;
        let value = digits.value();
        if value.is_none() {
            self.at = before;
        }
        value.map(|value| (value, digits.decimals()))
    }

    pub(crate) fn takes_text(&mut self) -> Result<bool, Fault> {
        self.peek();
        let column = self.column();
        if !self.takes(b'"') {
            return Ok(false);
        }
        let rest = &self.bytes[self.at..];
        let Some(length) = rest.iter().position(|byte| *byte == b'"') else {
            return Err(column.malformed("the text that begins here does not end with \""));
        };
        self.at += length + 1;
        Ok(true)
    }

    /// Reads a name up to `>` (the `<` is already consumed), in lower case and without blanks.
    pub(crate) fn name(&mut self) -> Result<String, Fault> {
        let column = self.column();
        let mut name = String::new();
        while let Some(byte) = self.next() {
            if byte == b'>' {
                return Ok(name);
            }
            name.push(char::from(byte.to_ascii_lowercase()));
        }
        Err(column.malformed("the name that begins here does not end with >"))
    }
}

#[cfg(test)]
mod tests {
    use rand::{RngExt as _, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    use super::*;

    #[test]
    fn quoted_texts_are_skipped() {
        let mut scanner = Scanner::new(b"  \"MILL \" X");
        assert_eq!(scanner.takes_text(), Ok(true));
        assert_eq!((scanner.takes_text(), scanner.next()), (Ok(false), Some(b'X')));
        let open = Scanner::new(b"  \"MILL").takes_text();
        assert!(matches!(open, Err(Fault::Expression { column: 3, .. })), "{open:?}");
    }

    /// For texts of the characters of numbers, the fast path and the character-by-character path return identical bits.
    #[test]
    fn the_fast_number_reader_equals_the_general_one() {
        let mut draw = ChaCha8Rng::seed_from_u64(7);
        let (mut plainly, mut none) = (0, 0);
        for round in 0..100_000 {
            let letters: &[u8] =
                if round % 2 == 0 { b"0123456789.123456789 " } else { b"0123456789..--++ \tXe" };
            let length = draw.random_range(0..24);
            let text: Vec<u8> =
                (0..length).map(|_| letters[draw.random_range(0..letters.len())]).collect();
            let (mut one, mut other) = (Scanner::new(&text), Scanner::new(&text));
            let (found, expected) = (one.number(), other.number_with_blanks());
            let bits = |found: Option<(f64, u8)>| found.map(|(value, of)| (value.to_bits(), of));
            assert_eq!(bits(found), bits(expected), "{text:?}");
            assert_eq!(one.at(), other.at(), "{text:?}");
            plainly += usize::from(plain(&text, b'.').is_some());
            none += usize::from(found.is_none());
        }
        assert!(plainly > 30_000 && none > 10_000, "{plainly} {none}");
    }
}
