//! A line in, the lines with its correction out.

use std::ops::Range;

use crate::{
    NcError,
    block::{Begins, Block, Parameter, Word},
    coordinates::{Axes, LETTERS},
    correction::Corrector,
    expression::Expressions,
    interpret::{Interpreter, Outcome},
    motion::{Move, Path},
    notes::Note,
    number::of_steps,
    parameters::Parameters,
    words::{Decimals, Number, OnItsWay, Written, each},
};

/// A motion is split into so many parts at the most.
const MOST_PARTS: usize = 4096;

/// What was done to a program so far.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Counts {
    /// Lines that were read.
    pub lines: u64,
    /// Motions in them.
    pub motions: u64,
    /// Lines that were changed.
    pub changed: u64,
    /// Lines that were added, since a motion was split.
    pub added: u64,
}

/// What is done to the words of a line.
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
    fn clear(&mut self) {
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

    /// Writes the line with its edits.
    fn write(&self, line: &[u8], block: &Block, out: &mut Vec<u8>) {
        let mut edits: Vec<(Range<usize>, Option<Number>)> = self.ranges.clone();
        for (place, Word { at, text, .. }) in block.words.iter().enumerate() {
            if self.removed.contains(&place) {
                edits.push((*at..text.end, None));
            } else if let Some((_, number)) =
                self.replaced.iter().rev().find(|(of, _)| *of == place)
            {
                edits.push((text.clone(), Some(*number)));
            }
        }
        edits.sort_by_key(|(range, _)| range.start);
        let mut at = 0;
        for (range, number) in edits {
            out.extend_from_slice(&line[at..range.start]);
            if let Some(number) = number {
                number.write(out);
            }
            at = range.end;
        }
        out.extend_from_slice(&line[at..block.end]);
        for (letter, number) in &self.added {
            if !out.is_empty() {
                out.push(b' ');
            }
            out.push(*letter);
            number.write(out);
        }
        out.extend_from_slice(&line[block.end..]);
    }
}

/// State: a program that is read, and the correction that its axes carry.
#[derive(Clone, Debug)]
pub(crate) struct Rewriter {
    pub(crate) interpreter: Interpreter,
    pub(crate) corrector: Corrector,
    pub(crate) decimals: Decimals,
    /// The correction that the axes have, in the coordinates of the machine, mm and deg.
    pub(crate) carried: Axes,
    /// What of it stands in the depth of the cycle that is kept from hole to hole, mm.
    pub(crate) carried_by_cycle: f64,
    /// Values that are computed are written as numbers: the lines that compute them are not executed in this order.
    pub(crate) writes_values: bool,
    pub(crate) counts: Counts,
    pub(crate) block: Block,
    pub(crate) edits: Edits,
}

/// How a line went.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Went {
    /// Nothing of it was changed.
    pub(crate) same: bool,
    /// The program ends here.
    pub(crate) ends: bool,
}

impl Rewriter {
    pub(crate) fn new(interpreter: Interpreter, corrector: Corrector, decimals: Decimals) -> Self {
        Self {
            interpreter,
            corrector,
            decimals,
            carried: [0.0; 9],
            carried_by_cycle: 0.0,
            writes_values: false,
            counts: Counts::default(),
            block: Block::default(),
            edits: Edits::default(),
        }
    }

    /// Whether the line that was read last is a percent sign.
    pub(crate) fn is_percent(&self) -> bool {
        self.block.begins == Begins::Percent
    }

    /// Reads a line without its end (`number` counts from 1), and appends what is to be written instead, whose lines are separated by
    /// `end`, and the last of which has none.
    pub(crate) fn line(
        &mut self,
        line: &[u8],
        end: &[u8],
        number: usize,
        out: &mut Vec<u8>,
    ) -> Result<Went, NcError> {
        self.counts.lines += 1;
        let mut block = std::mem::take(&mut self.block);
        let interpreter = &self.interpreter;
        let expressions = Expressions {
            parameters: &interpreter.parameters,
            provided: &|name| interpreter.provided(name),
            numbered: &|number| interpreter.numbered(number),
        };
        let read = block.read(line, &expressions);
        let went = match read {
            Ok(()) => self.block(&block, line, end, number, out),
            Err(fault) => Err(NcError::Block {
                line: number,
                fault,
            }),
        };
        self.block = block;
        went
    }

    fn block(
        &mut self,
        block: &Block,
        line: &[u8],
        end: &[u8],
        number: usize,
        out: &mut Vec<u8>,
    ) -> Result<Went, NcError> {
        let before = self.interpreter.modal.sticky;
        let outcome = self.interpreter.execute(block, number)?;
        if outcome.calls.is_some() {
            return Err(NcError::NotCompensated {
                line: number,
                what: "M98 and M99: subroutines by number are not followed yet".to_owned(),
            });
        }
        if self.interpreter.modal.sticky != before {
            self.carried_by_cycle = 0.0;
        }
        self.edits.clear();
        if self.writes_values {
            self.write_values(block);
        }
        let mut same = self.edits.is_empty();
        if let Some(motion) = &outcome.motion {
            self.counts.motions += 1;
            same = self.motion(motion, &outcome, block, line, end, number, out)?;
        } else if let Some(words) = &outcome.presets {
            self.presets(words, block);
            same = self.edits.is_empty();
        }
        if same {
            out.extend_from_slice(line);
        } else {
            if out.is_empty() {
                self.edits.write(line, block, out);
            }
            self.counts.changed += 1;
        }
        Ok(Went {
            same,
            ends: outcome.ends,
        })
    }

    /// Every computed value as the number that it is here.
    fn write_values(&mut self, block: &Block) {
        for (place, word) in block.words.iter().enumerate() {
            let value = word.value.filter(|_| word.decimals.is_none());
            let number = value.and_then(|value| Number::shortest(value, 6));
            self.edits
                .replaced
                .extend(number.map(|number| (place, number)));
        }
        if !self.interpreter.parameters.in_sub() {
            return;
        }
        // What a subroutine sets for itself must not be set for the program.
        for assignment in &block.assignments {
            let is_local = match &assignment.parameter {
                Parameter::Numbered(number) => Parameters::is_local(*number),
                Parameter::Named(name) => Parameters::is_local_name(name),
            };
            let value = assignment
                .value
                .and_then(|value| Number::shortest(value, 6));
            if is_local {
                self.edits.ranges.push((assignment.all.clone(), None));
            } else if value.is_some() {
                self.edits.ranges.push((assignment.text.clone(), value));
            }
        }
    }

    /// Words that say where the axes stand: there is a correction in the axes.
    fn presets(&mut self, words: &Axes<Option<usize>>, block: &Block) {
        let carried = self.interpreter.frame.way_to_program(&self.carried);
        for axis in 0..9 {
            let word = words[axis].and_then(|place| Some((place, block.words.get(place)?)));
            let Some((place, word)) = word else { continue };
            let decimals = self.decimals.of(axis, self.interpreter.modal.unit_mm);
            let (Some(value), true) = (
                word.value,
                carried[axis].abs() >= 0.5 * of_steps(1, decimals),
            ) else {
                continue;
            };
            let value = value + carried[axis] / self.interpreter.modal.scale(axis);
            let decimals = decimals.max(word.decimals.unwrap_or(0));
            if let Some(number) = Number::nearest(value, decimals) {
                self.edits.replaced.push((place, number));
            }
        }
    }

    /// A motion; whether its line stays as it is.
    #[expect(
        clippy::too_many_arguments,
        reason = "the line and all that is known of it"
    )]
    fn motion(
        &mut self,
        motion: &Move,
        outcome: &Outcome,
        block: &Block,
        line: &[u8],
        end: &[u8],
        number: usize,
        out: &mut Vec<u8>,
    ) -> Result<bool, NcError> {
        for axis in 0..9 {
            if motion.words[axis].is_none() {
                continue;
            }
            if !self.corrector.has(axis) {
                let note = Note::NoAxis(char::from(LETTERS[axis]));
                self.interpreter.notes.add(note, number);
            } else if self.interpreter.known[axis]
                && !self.corrector.is_within_travel(axis, motion.to[axis])
            {
                let note = Note::OutsideTravel(char::from(LETTERS[axis]));
                self.interpreter.notes.add(note, number);
            }
        }
        if self.interpreter.modal.radius.is_some() {
            self.interpreter.notes.add(Note::RadiusCompensated, number);
        }
        match motion.path {
            _ if motion.in_machine => {
                self.is_uncorrected(motion);
                Ok(self.edits.is_empty())
            }
            Path::Other => {
                self.is_uncorrected(motion);
                Ok(self.edits.is_empty())
            }
            Path::Rapid => Ok(self.straight(motion, &[1.0], block, line, end, number, out)),
            Path::Line => {
                let parts = self.parts(motion);
                Ok(self.straight(motion, &parts, block, line, end, number, out))
            }
            Path::Arc(arc) => Ok(self.arc(motion, &arc, block, line, end, number, out)),
            Path::Hole { bottom, clearance } => self.hole(
                motion,
                [bottom, clearance],
                outcome,
                block,
                line,
                number,
                out,
            ),
        }
    }

    /// A motion that passes on as it is: its axes carry no correction afterwards, but those whose words are ways.
    fn is_uncorrected(&mut self, motion: &Move) {
        self.corrector.goes(&motion.to);
        if motion.incremental {
            return;
        }
        let frame = &self.interpreter.frame;
        let mut carried = if motion.in_machine {
            self.carried
        } else {
            frame.way_to_program(&self.carried)
        };
        for (carried, word) in carried.iter_mut().zip(&motion.words) {
            if word.is_some() {
                *carried = 0.0;
            }
        }
        self.carried = if motion.in_machine {
            carried
        } else {
            frame.way_to_machine(&carried)
        };
    }

    /// The parts of a straight line within which the correction is straight, too: where each ends, from 0 to 1.
    fn parts(&mut self, motion: &Move) -> Vec<f64> {
        let mut parts = Vec::new();
        let is_known = (0..9).all(|axis| self.interpreter.known[axis] || !self.corrector.has(axis));
        self.corrector.goes(&motion.to);
        if !is_known || self.corrector.is_straight(&motion.from, &motion.to) {
            parts.push(1.0);
            return parts;
        }
        let at = |share: f64| {
            each(|axis| motion.from[axis] + share * (motion.to[axis] - motion.from[axis]))
        };
        // Halves of halves, from the beginning on.
        let mut open = vec![[0.0, 1.0]];
        while let Some([from, to]) = open.pop() {
            let is_end = parts.len() + open.len() >= MOST_PARTS || to - from < 1e-6;
            if is_end || self.corrector.is_straight(&at(from), &at(to)) {
                parts.push(to);
            } else {
                let middle = 0.5 * (from + to);
                open.push([middle, to]);
                open.push([from, middle]);
            }
        }
        parts
    }

    /// One axis on its way to a place.
    #[expect(
        clippy::too_many_arguments,
        reason = "everything that a word depends on"
    )]
    pub(crate) fn on_its_way(
        &mut self,
        axis: usize,
        [from, to]: [&Axes; 2],
        delta: &Axes,
        carried: &Axes,
        incremental: bool,
        written: Option<Written>,
        number: usize,
    ) -> OnItsWay {
        let modal = &self.interpreter.modal;
        let decimals = self.decimals.of(axis, modal.unit_mm);
        let known = self.interpreter.known[axis];
        let mut delta = if self.corrector.corrects(axis) {
            delta[axis]
        } else {
            0.0
        };
        if !known || !self.corrector.has(axis) {
            if self.corrector.has(axis) && delta.abs() >= 0.5 * of_steps(1, decimals) {
                let note = Note::LeftOut(char::from(LETTERS[axis]));
                self.interpreter.notes.add(note, number);
            }
            delta = if incremental || written.is_none() {
                carried[axis]
            } else {
                0.0
            };
        }
        OnItsWay {
            from: from[axis],
            to: to[axis],
            delta,
            carried: carried[axis],
            scale: modal.scale(axis),
            decimals,
            incremental,
            written,
            may_be_added: known && self.corrector.corrects(axis),
        }
    }

    /// A straight motion in parts.
    #[expect(
        clippy::too_many_arguments,
        reason = "the line and all that is known of it"
    )]
    fn straight(
        &mut self,
        motion: &Move,
        parts: &[f64],
        block: &Block,
        line: &[u8],
        end: &[u8],
        number: usize,
        out: &mut Vec<u8>,
    ) -> bool {
        let frame = self.interpreter.frame.clone();
        let splits = parts.len() > 1;
        let mut carried = frame.way_to_program(&self.carried);
        let mut before = frame.to_program(&motion.from);
        let mut passed = 0.0;
        self.corrector.goes(&motion.to);
        for (place, share) in parts.iter().enumerate() {
            let at = each(|axis| motion.from[axis] + share * (motion.to[axis] - motion.from[axis]));
            let at = if *share == 1.0 { motion.to } else { at };
            let delta = frame.way_to_program(&self.corrector.delta(&at));
            let to = frame.to_program(&at);
            let mut numbers = [None; 9];
            for axis in 0..9 {
                let word = motion.words[axis].and_then(|place| block.words.get(place));
                if word.is_none() && !self.corrector.has(axis) {
                    continue;
                }
                let anew = splits && (to[axis] != before[axis] || place == 0 || motion.incremental);
                let written = word.map(|word| Written {
                    decimals: word.decimals.unwrap_or(0),
                    anew,
                });
                let way = self.on_its_way(
                    axis,
                    [&before, &to],
                    &delta,
                    &carried,
                    motion.incremental,
                    written,
                    number,
                );
                (numbers[axis], carried[axis]) = way.word();
            }
            let feed = splits.then(|| self.feed_of_part(share - passed)).flatten();
            self.write_part(place, &numbers, &motion.words, feed, block, line, end, out);
            (before, passed) = (to, *share);
        }
        self.carried = frame.way_to_machine(&carried);
        !splits && self.edits.is_empty()
    }

    /// Where F is one over the time of a motion, the F of a part of it.
    pub(crate) fn feed_of_part(&self, share: f64) -> Option<Number> {
        use crate::modal::FeedMode;
        let modal = &self.interpreter.modal;
        let feed = modal
            .feed
            .filter(|_| modal.feed_mode == FeedMode::InverseTime)?;
        Number::nearest(feed / share, 4)
    }

    /// The first part goes into the line itself, each other one into a line of its own.
    #[expect(
        clippy::too_many_arguments,
        reason = "the line and all that is written of it"
    )]
    pub(crate) fn write_part(
        &mut self,
        place: usize,
        numbers: &Axes<Option<Number>>,
        words: &Axes<Option<usize>>,
        feed: Option<Number>,
        block: &Block,
        line: &[u8],
        end: &[u8],
        out: &mut Vec<u8>,
    ) {
        if place == 0 {
            for (axis, number) in numbers.iter().enumerate() {
                match (number, words[axis]) {
                    (Some(number), Some(word)) => self.edits.replaced.push((word, *number)),
                    (Some(number), None) => self.edits.added.push((LETTERS[axis], *number)),
                    (None, _) => {}
                }
            }
            if let Some(feed) = feed {
                match block.words.iter().position(|word| word.letter == b'F') {
                    Some(word) => self.edits.replaced.push((word, feed)),
                    None => self.edits.added.push((b'F', feed)),
                }
            }
            if !self.edits.is_empty() {
                self.edits.write(line, block, out);
            }
            return;
        }
        self.begin_line(block, end, out);
        let mut is_first = true;
        let feed = feed.map(|feed| (b'F', feed));
        let numbers = numbers.iter().zip(LETTERS);
        let numbers = numbers.filter_map(|(number, letter)| Some((letter, (*number)?)));
        for (letter, number) in numbers.chain(feed) {
            if !is_first {
                out.push(b' ');
            }
            is_first = false;
            out.push(letter);
            number.write(out);
        }
    }

    /// A further line begins.
    pub(crate) fn begin_line(&mut self, block: &Block, end: &[u8], out: &mut Vec<u8>) {
        out.extend_from_slice(if end.is_empty() { b"\n" } else { end });
        if block.begins == Begins::Slash {
            out.push(b'/');
        }
        self.counts.added += 1;
    }

    /// A canned cycle: its hole is corrected, its depth and its plane R go along.
    #[expect(
        clippy::too_many_arguments,
        reason = "the line and all that is known of it"
    )]
    fn hole(
        &mut self,
        motion: &Move,
        [bottom, clearance]: [f64; 2],
        outcome: &Outcome,
        block: &Block,
        line: &[u8],
        number: usize,
        out: &mut Vec<u8>,
    ) -> Result<bool, NcError> {
        let frame = self.interpreter.frame.clone();
        let [_, _, depth] = self.interpreter.modal.plane.axes();
        let mut carried = frame.way_to_program(&self.carried);
        let before = frame.to_program(&motion.from);
        let end = frame.to_program(&motion.to);
        let place = |depth_at: f64| {
            let mut at = end;
            at[depth] = depth_at;
            at
        };
        let middle = frame.to_machine(&place(0.5 * (bottom + clearance)));
        self.corrector.goes(&middle);
        let delta = frame.way_to_program(&self.corrector.delta(&middle));
        if outcome.repeats > 1 && motion.incremental {
            // The first of the holes in a row.
            let first =
                each(|axis| before[axis] + (end[axis] - before[axis]) / f64::from(outcome.repeats));
            let mut at = first;
            at[depth] = 0.5 * (bottom + clearance);
            let other = frame.way_to_program(&self.corrector.delta(&frame.to_machine(&at)));
            let differs = |axis: usize| {
                let decimals = self.decimals.of(axis, self.interpreter.modal.unit_mm);
                (other[axis] - delta[axis]).abs() >= 0.5 * of_steps(1, decimals)
            };
            if (0..9).any(differs) {
                return Err(NcError::NotCompensated {
                    line: number,
                    what: "a row of holes by L in G91 whose corrections differ: write each hole in a line of its own".to_owned(),
                });
            }
        }
        let mut numbers = [None; 9];
        for axis in (0..9).filter(|axis| *axis != depth) {
            let word = motion.words[axis].and_then(|place| block.words.get(place));
            if word.is_none() && !self.corrector.has(axis) {
                continue;
            }
            let written = word.map(|word| Written {
                decimals: word.decimals.unwrap_or(0),
                anew: false,
            });
            let ways = [&before, &end];
            let way = self.on_its_way(
                axis,
                ways,
                &delta,
                &carried,
                motion.incremental,
                written,
                number,
            );
            (numbers[axis], carried[axis]) = way.word();
        }
        let is_known = self.interpreter.known[depth] && self.corrector.corrects(depth);
        if is_known && !motion.incremental {
            let scale = self.interpreter.modal.scale(depth);
            let decimals = self.decimals.of(depth, self.interpreter.modal.unit_mm);
            let half = 0.5 * of_steps(1, decimals);
            let named = [
                motion.words[depth],
                block.words.iter().position(|word| word.letter == b'R'),
            ];
            let is_named = named.iter().any(Option::is_some);
            let changes = ((delta[depth] - self.carried_by_cycle) / scale).abs() >= half
                || is_named && (delta[depth] / scale).abs() >= half;
            if changes {
                let letters = [LETTERS[depth], b'R'];
                for ((at, word), letter) in [bottom, clearance].into_iter().zip(named).zip(letters)
                {
                    let decimals_of = word.and_then(|place| block.words.get(place)?.decimals);
                    let Some(number) = Number::nearest(
                        (at + delta[depth]) / scale,
                        decimals.max(decimals_of.unwrap_or(0)),
                    ) else {
                        continue;
                    };
                    self.carried_by_cycle = number.value() * scale - at;
                    match word {
                        Some(word) => self.edits.replaced.push((word, number)),
                        None => self.edits.added.push((letter, number)),
                    }
                }
            } else if is_named {
                self.carried_by_cycle = 0.0;
            }
            if !self.interpreter.modal.comes_back || clearance > before[depth] {
                carried[depth] = self.carried_by_cycle;
            }
        }
        self.write_part(0, &numbers, &motion.words, None, block, line, &[], out);
        self.carried = frame.way_to_machine(&carried);
        Ok(self.edits.is_empty())
    }
}
