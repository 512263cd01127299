//! The lines in which a motion is written: one for each of its parts.

use crate::{
    block::{Begins, Word},
    coordinates::{Axes, LETTERS},
    edits::write_word,
    line::Line,
    modal::FeedMode,
    rewrite::Rewriter,
    words::Number,
};

/// One of the parts that a motion is written in, counted from 0, and where it ends, from 0 to 1.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Part<'a> {
    pub(crate) place: usize,
    pub(crate) share: f64,
    pub(crate) numbers: &'a Axes<Option<Number>>,
    /// The words that the block has.
    pub(crate) words: &'a Axes<Option<usize>>,
    /// Words behind these in a line of its own: the circle of an arc.
    pub(crate) others: &'a [(u8, Number)],
    pub(crate) feed: Option<Number>,
}

impl Rewriter {
    /// Where F is one over the time of a motion, the F of a part of it.
    pub(crate) fn feed_of_part(&self, share: f64) -> Option<Number> {
        let modal = &self.interpreter.modal;
        let feed = modal
            .feed
            .filter(|_| modal.feed_mode == FeedMode::InverseTime)?;
        // Taking up the play of an axis takes a little time, too.
        let share = if share == 0.0 { 1e-3 } else { share };
        Number::nearest(feed / share, 4)
    }

    /// The first part goes into the line itself, each other one into a line of its own.
    pub(crate) fn write_part(&mut self, part: &Part<'_>, line: Line<'_>, out: &mut Vec<u8>) {
        if part.share < 1.0 {
            self.ends_part(part.share);
        }
        let stops = |word: &&Word| word.letter == b'M' && word.value.is_some_and(is_stop);
        if part.place == 0 {
            for (axis, number) in part.numbers.iter().enumerate() {
                if let Some(number) = number {
                    self.edits.set(LETTERS[axis], part.words[axis], *number);
                }
            }
            if let Some(feed) = part.feed {
                self.edits.set(b'F', line.place_of(b'F'), feed);
            }
            if part.share < 1.0 {
                let words = line.block.words.iter().enumerate();
                let stops = words.filter(|(_, word)| stops(word));
                self.edits.removed.extend(stops.map(|(place, _)| place));
            }
            self.edits.write(line, out);
            return;
        }
        out.extend_from_slice(line.more);
        self.begin_line(line, out);
        for word in words_of(part.numbers, part.feed) {
            write_word(word, out);
        }
        for word in part.others {
            write_word(*word, out);
        }
        if part.share == 1.0 {
            for word in line.block.words.iter().filter(stops) {
                if let Some(number) = word.value.and_then(|code| Number::nearest(code, 0)) {
                    write_word((b'M', number), out);
                }
            }
        }
    }

    /// A line is added.
    pub(crate) fn begin_line(&mut self, line: Line<'_>, out: &mut Vec<u8>) {
        if line.block.begins == Begins::Slash {
            out.push(b'/');
        }
        self.counts.added += 1;
    }

    /// A part of a motion, or all of it, ends at this share.
    pub(crate) fn ends_part(&mut self, share: f64) {
        if let Some(shares) = &mut self.shares {
            shares.push(share);
        }
    }
}

/// The words of axes, and F behind them.
pub(crate) fn words_of(
    numbers: &Axes<Option<Number>>,
    feed: Option<Number>,
) -> impl Iterator<Item = (u8, Number)> {
    let numbers = LETTERS.into_iter().zip(*numbers);
    let numbers = numbers.filter_map(|(letter, number)| Some((letter, number?)));
    numbers.chain(feed.map(|feed| (b'F', feed)))
}

/// Whether an M code stops the program once the motion of its block has ended.
fn is_stop(code: f64) -> bool {
    [0.0, 1.0, 2.0, 30.0, 60.0].contains(&code)
}
