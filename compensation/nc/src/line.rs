//! A line of a program: its text, and the block that was read from it.

use crate::block::{Block, Word};

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
}

impl<'a> Line<'a> {
    /// The word at a place of the block.
    pub(crate) fn word(self, place: Option<usize>) -> Option<&'a Word> {
        self.block.words.get(place?)
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
