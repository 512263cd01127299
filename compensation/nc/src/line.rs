//! A line of a program: its text, and the block that was read from it.

use crate::{
    block::{Block, Manner, Word},
    script::Script,
    words::Number,
};

/// A line that is compensated.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Line<'a> {
    pub(crate) block: &'a Block,
    /// Its bytes without the end of line.
    pub(crate) text: &'a [u8],
    /// The end of a line that is added beside it.
    pub(crate) more: &'static [u8],
    /// Counted from 1.
    pub(crate) number: usize,
    pub(crate) script: Script,
}

impl<'a> Line<'a> {
    /// The word at a place of the block.
    pub(crate) fn word(self, place: Option<usize>) -> Option<&'a Word> {
        self.block.words.get(place?)
    }

    /// What a further word is that stands for the same as the one at a place of the block.
    pub(crate) fn manner(self, place: Option<usize>) -> Manner {
        self.word(place).map_or(Manner::Modal, |word| word.manner)
    }

    /// How an arc turns, where its line says that behind its coordinates: with a blank before it.
    pub(crate) fn direction(self) -> &'static [u8] {
        if !self.script.is_heidenhain() {
            return b"";
        }
        let is_clockwise = |word: &Word| word.letter == b'G' && word.value == Some(2.0);
        if self.block.words.iter().any(is_clockwise) {
            b" DR-"
        } else {
            b" DR+"
        }
    }

    /// The code of its motion, G0 to G3.
    pub(crate) fn motion_code(self) -> Option<Number> {
        let mut codes = (self.block.words.iter()).filter(|word| word.letter == b'G');
        let code = codes.find_map(|word| word.value.filter(|code| (0.0..=3.0).contains(code)));
        Number::nearest(code?, 0)
    }

    /// The place of the first word with this letter.
    pub(crate) fn place_of(self, letter: u8) -> Option<usize> {
        let words = &self.block.words;
        words.iter().position(|word| word.letter == letter)
    }
}

/// The end of a line that is added beside one with this end, which the last line of a program may lack.
pub(crate) fn end_of_more(end: &[u8]) -> &[u8] {
    if end.is_empty() { b"\n" } else { end }
}

/// Writes a line as a comment that every control of RS-274 knows.
pub(crate) fn write_comment(line: &[u8], out: &mut Vec<u8>) {
    out.push(b'(');
    out.extend(line.iter().filter(|byte| !b"()".contains(byte)));
    out.push(b')');
}
