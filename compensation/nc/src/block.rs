//! One line of a program as it is read: its words with their places in the text, so that what is not changed stays as it is.

use std::ops::Range;

use crate::{
    error::{Column, Fault},
    number::{Digits, plain},
    parameters::Value,
};

/// A word: a letter and its value.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Word {
    /// The capital letter, or one of `@`, `^` and `$`.
    pub(crate) letter: u8,
    /// Where the letter stands, bytes from the beginning of the line.
    pub(crate) at: usize,
    /// Where the value stands.
    pub(crate) text: Range<usize>,
    pub(crate) value: Value,
    /// The decimals of a plain number; `None`: it was computed.
    pub(crate) decimals: Option<u8>,
    pub(crate) manner: Manner,
    /// It is written as a number of least increments.
    pub(crate) in_increments: bool,
}

/// What the value of a coordinate is, where its word says so itself.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) enum Manner {
    /// What is switched on.
    #[default]
    Modal,
    /// A place: `AC(..)`.
    Absolute,
    /// A way: `IC(..)`, `IX`.
    Incremental,
    /// The place of a rotary axis, to which it goes by the shorter way: `DC(..)`.
    Shortest,
}

/// The letter of words that mean nothing for coordinates, but must be executed with their motion: a coolant that is switched on.
pub(crate) const OTHER: u8 = b'!';

/// The same where it is done at the end of the motion: a stop. Of a motion in parts it belongs to the last one.
pub(crate) const LAST: u8 = b'&';

/// The letters of polar coordinates, the distance from the pole and the angle.
pub(crate) const POLAR: [u8; 2] = *b"@^";

/// A parameter that a block sets once its other words are read.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Parameter {
    Numbered(u32),
    Named(String),
}

#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Assignment {
    pub(crate) parameter: Parameter,
    pub(crate) value: Value,
    /// Where all of it stands, and its value alone.
    pub(crate) all: Range<usize>,
    pub(crate) text: Range<usize>,
}

/// What a line is, besides its words.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) enum Begins {
    #[default]
    Nothing,
    /// A slash: the operator may have it skipped.
    Slash,
    /// A percent sign: the program begins or ends here.
    Percent,
}

/// A line that was read; made once, and used for all lines.
#[derive(Clone, Debug, Default)]
pub(crate) struct Block {
    pub(crate) words: Vec<Word>,
    pub(crate) assignments: Vec<Assignment>,
    /// What its language says in words that RS-274 has no code for.
    pub(crate) commands: Vec<Command>,
    pub(crate) begins: Begins,
    /// The number of the block, where each block must have the next one, and where it stands.
    pub(crate) number: Option<(Range<usize>, u64)>,
    /// The word that says how the motion goes, where added lines need one, too.
    pub(crate) keyword: Range<usize>,
    /// Numbers have decimal commas; `None`: it has no decimals.
    pub(crate) comma: Option<bool>,
    /// Whether the last coordinate of the program so far was a number of least increments; `None`: there was none yet, or the control does not count in them.
    pub(crate) last_in_increments: Option<bool>,
    /// The mark with which the operator may have it skipped.
    pub(crate) skip: Range<usize>,
    /// Where a further word may be put: behind the last one.
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
        self.words.push(Word {
            letter,
            at,
            text,
            value,
            decimals,
            manner,
            in_increments: false,
        });
    }
}

#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Command {
    /// The words of its block shift the coordinates (TRANS, ATRANS), instead of what shifts and turns them or on top of that.
    Shift {
        adds: bool,
    },
    /// It turns the coordinates by an angle, deg, about the axis normal to X and Y (ROT, AROT).
    Turn {
        adds: bool,
        angle_deg: Value,
    },
    /// Coordinates are those of the centre point of the tool from now on, or of the axes.
    CentrePoint(bool),
    WorkOffset(usize),
    /// CYCL DEF 247: one of the next lines has the number of the preset.
    AwaitsPreset,
    /// The number of that preset.
    Preset(Value),
    /// The words of its block are machine coordinates.
    InMachine,
    /// The cutting edge of the tool whose length holds from now on; 0: none.
    Edge(Value),
    /// The tool that was chosen is in the spindle from now on.
    ChangeTool,
    NamedTool,
    /// The rest of the line moves the axes in its own way and passes on.
    Cycle(Cycle),
    /// Such a cycle is done behind each motion from now on, or none any more.
    EachMotion(Option<Cycle>),
    /// A command that is copied and may move the axes: their positions are unknown after it.
    MayMove(String),
    /// A printer homes (G28), which clears the shift of G92.
    Homes {
        all: bool,
    },
    /// E words are relative (M83) or absolute (M82) from now on.
    Extrudes {
        relative: bool,
    },
    Ends,
    /// The words of its block say the centre of arcs and of polar coordinates (CC).
    Pole,
    /// The words of its block are the datum shift along their axes; the others stay (cycle 7).
    Datum,
    /// F means something else from now on (FGROUP, FGREF).
    GroupsFeed,
    /// Rotary axes go the shorter way from now on, or not (M126, M127).
    Shorter(bool),
    /// The block goes on in the next line.
    GoesOn,
    /// The cycle that is done where one is called, and its call.
    Defines(Cycle),
    CallsDefined,
    /// The tool with this number and an allowance on its length, in the unit of the program.
    CallsTool {
        tool: Value,
        longer: Value,
    },
    /// The length of a tool, in the unit of the program.
    DefinesTool {
        tool: Value,
        length: Value,
    },
}

/// A cycle that passes on as it is.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Cycle {
    pub(crate) name: String,
    /// It only moves along the tool, and ends at this place (RTP), in the unit of the program.
    pub(crate) drills_to: Option<Value>,
}

/// A line, read from the left. Places are bytes.
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

    /// Whether this word is next, in capital letters or small ones; no blanks are passed.
    pub(crate) fn is_next(&self, word: &str) -> bool {
        let next = self.rest().get(..word.len());
        next.is_some_and(|next| next.eq_ignore_ascii_case(word.as_bytes()))
    }

    pub(crate) fn go_to(&mut self, at: usize) {
        self.at = at.min(self.bytes.len());
    }

    /// The place of the next character as people count.
    pub(crate) fn column(&self) -> Column {
        Column(self.at + 1)
    }

    /// The next character as a capital letter, which stays; blanks before it are passed.
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

    /// The next character as a capital letter.
    #[inline]
    pub(crate) fn next(&mut self) -> Option<u8> {
        let byte = self.peek()?;
        self.at += 1;
        Some(byte)
    }

    /// Passes this character where it is the next one.
    pub(crate) fn takes(&mut self, byte: u8) -> bool {
        let is_next = self.peek() == Some(byte);
        self.at += usize::from(is_next);
        is_next
    }

    /// Passes these capital letters where they are next, whatever blanks are between.
    pub(crate) fn takes_all(&mut self, letters: &str) -> bool {
        let before = self.at;
        let all = letters.bytes().all(|letter| self.takes(letter));
        if !all {
            self.at = before;
        }
        all
    }

    /// A decimal number with a sign or without, and its decimals.
    pub(crate) fn number(&mut self) -> Option<(f64, u8)> {
        if let Some((value, decimals, length)) = plain(&self.bytes[self.at..]) {
            self.at += length;
            return Some((value, decimals));
        }
        self.number_with_blanks()
    }

    /// The same for a number with any digits, and blanks between them.
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
        // Blanks after the last digit are not of the number.
        self.at = end;
        let value = digits.value();
        if value.is_none() {
            self.at = before;
        }
        value.map(|value| (value, digits.decimals()))
    }

    /// Passes a text in quotation marks where it is next.
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

    /// A name between `<` and `>`, whose `<` is passed already: small letters, without blanks.
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
    fn texts_are_passed_with_their_marks() {
        let mut scanner = Scanner::new(b"  \"MILL \" X");
        assert_eq!(scanner.takes_text(), Ok(true));
        assert_eq!(
            (scanner.takes_text(), scanner.next()),
            (Ok(false), Some(b'X'))
        );
        let open = Scanner::new(b"  \"MILL").takes_text();
        assert!(
            matches!(open, Err(Fault::Expression { column: 3, .. })),
            "{open:?}"
        );
    }

    /// Texts of the characters that numbers have and may have: one pass over a plain number finds what the reader of single characters
    /// finds, to the last bit.
    #[test]
    fn plain_numbers_are_read_as_character_by_character() {
        let mut draw = ChaCha8Rng::seed_from_u64(7);
        let (mut plainly, mut none) = (0, 0);
        for round in 0..100_000 {
            let letters: &[u8] = if round % 2 == 0 {
                b"0123456789.123456789 "
            } else {
                b"0123456789..--++ \tXe"
            };
            let length = draw.random_range(0..24);
            let text: Vec<u8> = (0..length)
                .map(|_| letters[draw.random_range(0..letters.len())])
                .collect();
            let (mut one, mut other) = (Scanner::new(&text), Scanner::new(&text));
            let (found, expected) = (one.number(), other.number_with_blanks());
            let bits = |found: Option<(f64, u8)>| found.map(|(value, of)| (value.to_bits(), of));
            assert_eq!(bits(found), bits(expected), "{text:?}");
            assert_eq!(one.at(), other.at(), "{text:?}");
            plainly += usize::from(plain(&text).is_some());
            none += usize::from(found.is_none());
        }
        assert!(plainly > 30_000 && none > 10_000, "{plainly} {none}");
    }
}
