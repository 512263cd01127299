//! The words that lead a motion, or a part of it, to its end.

use std::ops::Range;

use crate::{
    block::Manner,
    coordinates::{Axes, LETTERS},
    line::Line,
    motion::Move,
    notes::Note,
    number::half_step,
    rewrite::Rewriter,
    words::{Number, Numerals, OnItsWay, Written},
};

/// A motion or a part of it.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Leg<'a> {
    pub(crate) motion: &'a Move,
    pub(crate) line: Line<'a>,
    /// Where it begins and ends, in the coordinates of the program.
    pub(crate) from: Axes,
    pub(crate) to: Axes,
    /// The axes of the machine where its correction belongs: at its end, or half-way down a hole.
    pub(crate) at: Axes,
    pub(crate) writes: Axes<Writes>,
    /// Axes that end with the correction that they have, whatever belongs to the end.
    pub(crate) keeps: Axes<bool>,
    /// The correction with which the numbers come out as they were rounded together; `None`: each is the nearest.
    pub(crate) rounded: Option<Axes>,
}

/// When the word of an axis is written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Writes {
    /// It is no coordinate of the end: the depth of a cycle.
    Never,
    /// Where its number changes.
    IfChanged,
    /// Where it is to leave the place where it stands: in a line of its own, which has no word yet.
    IfMoves,
    /// Whatever its number is, if the block has it: the motion is in parts.
    Anew,
    /// Also if the block does not have it.
    Always,
}

/// One axis on a motion or a part of it, in the coordinates of the program.
#[derive(Clone, Copy, Debug)]
pub(crate) struct AxisWay {
    pub(crate) from: f64,
    pub(crate) to: f64,
    /// The correction that belongs to its end, and the one that it has before.
    pub(crate) delta: f64,
    pub(crate) carried: f64,
    pub(crate) incremental: bool,
    pub(crate) manner: Manner,
    /// It ends with the correction that it has, whatever belongs to the end.
    pub(crate) keeps: bool,
    /// `None`: no word stands there.
    pub(crate) written: Option<Written>,
    pub(crate) numerals: Numerals,
}

impl Rewriter {
    /// The words that lead a motion, or a part of it, to its end: their numbers, and in `carried` the correction that the
    /// axes have there, in the coordinates of the program. What the rotary axes really do, with rounded numbers, the linear
    /// ones follow, so that the tip is where it belongs.
    pub(crate) fn words_to(&mut self, leg: &Leg<'_>, carried: &mut Axes) -> Axes<Option<Number>> {
        let mut numbers = [None; 9];
        self.words_at(
            &leg.at,
            leg.rounded,
            carried,
            |this, axes, delta, carried| {
                this.numbers(leg, axes, delta, carried, &mut numbers);
            },
        );
        self.check_bounds(&leg.to, carried);
        numbers
    }

    /// The same for the correction of a place, `rounded` or as it is: `numbers` makes the words of some axes with the correction that belongs
    /// to them. The correction of the linear axes at the end.
    #[inline]
    pub(crate) fn words_at(
        &mut self,
        at: &Axes,
        rounded: Option<Axes>,
        carried: &mut Axes,
        mut numbers: impl FnMut(&mut Self, Range<usize>, &Axes, &mut Axes),
    ) -> Axes {
        let frame = &self.interpreter.frame;
        let correction = self.seen.at(&self.corrector, at);
        if correction.is_coupled() {
            let delta = frame.others_moved_in_program(at, &correction.delta);
            numbers(self, 3..6, &delta, carried);
            let correction = self.seen.at(&self.corrector, at).with_rotary(carried);
            let delta = self.interpreter.frame.moved_in_program(at, &correction);
            numbers(self, 0..3, &delta, carried);
            numbers(self, 6..9, &delta, carried);
            return delta;
        }
        let delta = &correction.delta;
        let delta = rounded.unwrap_or_else(|| frame.moved_in_program(at, delta));
        numbers(self, 0..9, &delta, carried);
        delta
    }

    /// The numbers of some axes, for this correction.
    fn numbers(
        &mut self,
        leg: &Leg<'_>,
        axes: Range<usize>,
        delta: &Axes,
        carried: &mut Axes,
        numbers: &mut Axes<Option<Number>>,
    ) {
        for axis in axes {
            let word = leg.line.word(leg.motion.words[axis]);
            let writes = leg.writes[axis];
            if writes == Writes::Never || word.is_none() && !self.corrector.has(axis) {
                continue;
            }
            let written = match word {
                _ if writes == Writes::IfMoves => None,
                Some(word) => Some(Written {
                    decimals: word.decimals.unwrap_or(0),
                    anew: writes != Writes::IfChanged,
                }),
                None => (writes == Writes::Always).then_some(Written {
                    decimals: 0,
                    anew: true,
                }),
            };
            let way = AxisWay {
                from: leg.from[axis],
                to: leg.to[axis],
                delta: delta[axis],
                carried: carried[axis],
                incremental: leg.motion.incremental[axis],
                manner: leg.line.manner(leg.motion.words[axis]),
                keeps: leg.keeps[axis],
                written,
                numerals: self.numerals(axis, word),
            };
            let way = self.on_its_way(axis, &way, leg.line.number);
            (numbers[axis], carried[axis]) = way.word();
        }
    }

    /// One axis on its way, with the correction that belongs to its end and the one that it has before.
    #[inline]
    pub(crate) fn on_its_way(&mut self, axis: usize, way: &AxisWay, line: usize) -> OnItsWay {
        let known = self.interpreter.known[axis];
        let corrects = self.corrects(axis);
        let mut delta = match corrects {
            true if way.keeps => way.carried,
            true => way.delta,
            false => 0.0,
        };
        if !known || !self.corrector.has(axis) {
            if self.corrector.has(axis)
                && !way.keeps
                && delta.abs() >= half_step(way.numerals.decimals)
            {
                let note = Note::LeftOut(char::from(LETTERS[axis]));
                self.interpreter.notes.add(note, line);
            }
            delta = if way.keeps || way.incremental || way.written.is_none() {
                way.carried
            } else {
                0.0
            };
        }
        let may_be_added = known && corrects && self.may_add(axis, way, line);
        OnItsWay {
            from: way.from,
            to: way.to,
            delta,
            carried: way.carried,
            scale: self.interpreter.modal.scale(axis),
            numerals: way.numerals,
            incremental: way.incremental,
            in_one_turn: way.manner == Manner::Shortest,
            written: way.written,
            may_be_added,
        }
    }

    /// Whether the words of an axis take part in the correction: those of the tool's centre point do if any linear axis does.
    #[inline]
    fn corrects(&self, axis: usize) -> bool {
        if axis < 3 && self.interpreter.frame.tip.is_some() {
            return (0..3).any(|axis| self.corrector.corrects(axis));
        }
        self.corrector.corrects(axis)
    }
}
