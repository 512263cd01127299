//! What is done to the words of a line; all the rest of it comes out as it is.

use std::ops::Range;

use crate::{block::Word, line::Line, script::NewWord, words::Number};

/// Changes of a line.
#[derive(Clone, Debug, Default)]
pub(crate) struct Edits {
    /// The value of the word at a place of the block.
    pub(crate) replaced: Vec<(usize, Number)>,
    /// Words that go.
    pub(crate) removed: Vec<usize>,
    /// Words behind the last one.
    pub(crate) added: Vec<(u8, Number)>,
    /// Other text, and the number instead of it, or nothing.
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

    /// A word of this letter with this value: in the place of the word that the line has, or behind the last one.
    pub(crate) fn set(&mut self, letter: u8, place: Option<usize>, number: Number) {
        match place {
            Some(place) => self.replaced.push((place, number)),
            None => self.added.push((letter, number)),
        }
    }

    /// Writes the line with its edits.
    pub(crate) fn write(&self, line: Line<'_>, out: &mut Vec<u8>) {
        let (text, block) = (line.text, line.block);
        let (mut at, mut added) = (0, false);
        // Further words stand before what follows their place.
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
                let before = &text[range.clone()];
                let has_sign = !before.first().is_some_and(u8::is_ascii_digit);
                line.script.like(before).write_number(number, has_sign, out);
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

    /// What is done to the word at a place of the block.
    fn of_word(
        &self,
        place: usize,
        word: &Word,
        text: &[u8],
    ) -> Option<(Range<usize>, Option<Number>)> {
        if self.removed.contains(&place) {
            // With the blanks before it, unless it begins the line.
            let kept = text[..word.at].trim_ascii_end().len();
            let from = if kept == 0 { word.at } else { kept };
            return Some((from..word.text.end, None));
        }
        let replaced = self.replaced.iter().rev().find(|(of, _)| *of == place);
        replaced.map(|(_, number)| (word.text.clone(), Some(*number)))
    }
}
