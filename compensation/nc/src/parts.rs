//! The lines in which a motion is written: one for each of its parts.

use crate::{
    NcError,
    block::{Begins, LAST, Manner, Word},
    coordinates::{Axes, LETTERS},
    line::Line,
    modal::FeedMode,
    motion::Polar,
    rewrite::Rewriter,
    script::{NewWord, Shape},
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
    /// G2 or G3 before them, where another code has come in between.
    pub(crate) code: Option<Number>,
    pub(crate) feed: Option<Number>,
    pub(crate) shape: Shape,
    pub(crate) polar: Option<Polar>,
    /// A line that must stand before it, without its end: the centre of an arc.
    pub(crate) before: &'a [u8],
}

impl Rewriter {
    /// # Errors
    /// The F of the parts of a motion (G93) is not known, or their E.
    pub(crate) fn check_shares(&self, line: Line<'_>) -> Result<(), NcError> {
        self.check_extrusion(line)?;
        let modal = &self.interpreter.modal;
        if modal.feed_mode == FeedMode::InverseTime && modal.feed.is_none() {
            return Err(NcError::NotCompensated {
                line: line.number,
                what: "a motion that is split, with an F of inverse time (G93) that only the machine knows: its parts cannot get their F".to_owned(),
            });
        }
        Ok(())
    }

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
        let script = line.script;
        let stops = |word: &&Word| {
            word.letter == LAST || word.letter == b'M' && word.value.is_some_and(is_stop)
        };
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
                let extruded = self.extrusion_up_to(part.share);
                let place = line.place_of(b'E');
                match extruded {
                    Some(number) => self.edits.set(b'E', place, number),
                    None => self.edits.removed.extend(place),
                }
                let words = line.block.words.iter().enumerate();
                let stops = words.filter(|(_, word)| stops(word));
                self.edits.removed.extend(stops.map(|(place, _)| place));
            }
            if !part.before.is_empty() {
                self.counts.added += 1;
                out.extend_from_slice(part.before);
                out.extend_from_slice(line.more);
            }
            self.goes_as(part.shape, part.polar, line);
            self.edits.write(line, out);
            return;
        }
        out.extend_from_slice(line.more);
        if !part.before.is_empty() {
            self.counts.added += 1;
            out.extend_from_slice(part.before);
            out.extend_from_slice(line.more);
        }
        self.begin_line(line, out);
        out.extend_from_slice(script.keyword(part.shape));
        // Where each motion says how it goes, its keyword has said it.
        let code = if script.says_each {
            line.motion_code()
        } else {
            part.code
        };
        if let Some(code) = code.filter(|_| !script.is_heidenhain()) {
            script.write_word(&NewWord::plain((b'G', code)), out);
        }
        let manners = part.words.map(|place| line.manner(place));
        for word in words_of(part.numbers, &manners, part.feed) {
            script.write_word(&word, out);
        }
        for &(letter, number) in part.others {
            let manner = line.manner(line.place_of(letter));
            let word = NewWord {
                letter,
                manner,
                number,
            };
            script.write_word(&word, out);
        }
        if let Some(number) = self.extrusion_up_to(part.share) {
            script.write_word(&NewWord::plain((b'E', number)), out);
        }
        if part.shape != Shape::Straight {
            out.extend_from_slice(line.direction());
        }
        if part.share == 1.0 {
            for word in line.block.words.iter().filter(stops) {
                out.push(b' ');
                out.extend_from_slice(&line.text[word.at..word.text.end]);
            }
        }
    }

    /// A line is added.
    pub(crate) fn begin_line(&mut self, line: Line<'_>, out: &mut Vec<u8>) {
        if line.block.begins == Begins::Slash {
            out.extend_from_slice(&line.text[line.block.skip.clone()]);
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
    manners: &Axes<Manner>,
    feed: Option<Number>,
) -> impl Iterator<Item = NewWord> {
    let words = LETTERS.into_iter().zip(*manners).zip(*numbers);
    let words = words.filter_map(|((letter, manner), number)| {
        Some(NewWord {
            letter,
            manner,
            number: number?,
        })
    });
    words.chain(feed.map(|feed| NewWord::plain((b'F', feed))))
}

/// Whether an M code stops the program once the motion of its block has ended.
fn is_stop(code: f64) -> bool {
    [0.0, 1.0, 2.0, 30.0, 60.0].contains(&code)
}
