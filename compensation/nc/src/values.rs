//! Words that become other numbers though nothing moves: values that a program computes, and places at which it sets its axes.

use crate::{
    block::{Block, Parameter},
    coordinates::{Axes, LETTERS},
    line::Line,
    number::half_step,
    parameters::Parameters,
    rewrite::Rewriter,
    words::{Form, Number},
};

/// Words that say where the axes stand have so many further decimals where they need them.
const FINER: u8 = 3;

/// Which values that the program computes are written as numbers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Computed {
    Kept,
    /// Those with what a subroutine returned: its call is written out.
    ReturnedWritten,
    /// All: the lines that compute them are not executed in this order.
    Written,
}

impl Rewriter {
    /// Every computed value as the number that it is here.
    pub(crate) fn write_values(&mut self, block: &Block, also_set: bool) {
        for (place, word) in block.words.iter().enumerate() {
            let value = word.value.filter(|_| word.decimals.is_none());
            let number = value.and_then(|value| Number::shortest(value, 6));
            let is_coordinate = b"XYZABCUVWIJKR".contains(&word.letter);
            let needs_point = is_coordinate && self.interpreter.points.means_increments;
            let number = number.map(|number| {
                if needs_point {
                    number.form(Form::Point)
                } else {
                    number
                }
            });
            self.edits
                .replaced
                .extend(number.map(|number| (place, number)));
        }
        let in_sub = self.computed == Computed::Written && self.interpreter.parameters.in_sub();
        if !in_sub && !also_set {
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
            if is_local && in_sub {
                self.edits.ranges.push((assignment.all.clone(), None));
            } else if value.is_some() {
                self.edits.ranges.push((assignment.text.clone(), value));
            }
        }
    }

    /// Words that say where the axes stand: there is a correction in the axes.
    pub(crate) fn presets(
        &mut self,
        words: &Axes<Option<usize>>,
        system: Option<usize>,
        line: Line<'_>,
    ) {
        let interpreter = &self.interpreter;
        let modal = &interpreter.modal;
        // A work offset that is not in force may be turned otherwise.
        let frame = interpreter.frame_with(system.unwrap_or(modal.system));
        let carried = frame.moved_in_program(&interpreter.position, &self.carried);
        for axis in 0..9 {
            let Some(word) = line.word(words[axis]) else {
                continue;
            };
            // The control keeps what is rounded here for all motions behind it.
            let numerals = self.numerals(axis, Some(word));
            let decimals = numerals.decimals;
            let finest = if numerals.form == Form::Increments {
                decimals
            } else {
                (decimals + FINER).max(word.decimals.unwrap_or(0))
            };
            let carried = carried[axis] / modal.scale(axis);
            let Some(value) = word.value.filter(|_| carried.abs() >= half_step(finest)) else {
                continue;
            };
            let number = Number::shortest_of(value + carried, decimals, finest);
            if let Some(number) = number {
                (self.edits).set(LETTERS[axis], words[axis], number.form(numerals.form));
            }
        }
    }
}
