//! Fast path for the usual line of long programs: a straight motion to a position in plain numbers.
//!
//! It compensates such a line in one pass, in a fraction of the time of the general path ([`Rewriter::line`]), with identical output and
//! state. Any other line is left to that path, before any state has changed.

use std::ops::Range;

use crate::{
    block::Manner,
    codes::LARGEST,
    control::Dialect,
    coordinates::{Axes, LETTERS, axis_of},
    interpreter::Interpreter,
    line::{NewWord, Script},
    modal::{Code, Modal},
    number::{Number, plain},
    rewrite::{AppliedCorrection, Computed, MAX_LINE_BYTES, Rewriter},
    straight::{AxisWay, OriginalWord},
};

#[derive(Clone, Copy, Debug, Default)]
struct AxisWord {
    value: f64,
    from: u8,
    to: u8,
    decimals: u8,
}

impl AxisWord {
    fn text(self) -> Range<usize> {
        usize::from(self.from)..usize::from(self.to)
    }
}

/// A usual line: G0, G1 or neither, and axis words.
#[derive(Clone, Copy, Debug, Default)]
struct PlainLine {
    code: Option<Code>,
    words: Axes<AxisWord>,
    order: Axes<u8>,
    count: usize,
    /// One bit per axis that has a word.
    named: u16,
    end: usize,
}

impl PlainLine {
    /// Parses a usual line; `None` for any other.
    #[expect(
        clippy::cast_possible_truncation,
        reason = "the line is shorter than 256 bytes"
    )]
    #[inline]
    fn read(text: &[u8], needs_points: bool) -> Option<Self> {
        if text.len() > MAX_LINE_BYTES {
            return None;
        }
        let mut line = Self::default();
        let mut rest = text;
        loop {
            rest = without_blanks(rest);
            let [letter, behind @ ..] = rest else { break };
            let number = without_blanks(behind);
            let from = text.len() - number.len();
            let (value, decimals, length) = plain(number)?;
            let to = from + length;
            rest = &number[length..];
            line.end = to;
            let letter = letter.to_ascii_uppercase();
            let Some(axis) = axis_of(letter) else {
                let code = match (letter, value) {
                    (b'G', 0.0) => 0,
                    (b'G', 1.0) => 10,
                    _ => return None,
                };
                if line.code.replace(code).is_some() {
                    return None;
                }
                continue;
            };
            let has_point = decimals > 0 || number[..length].ends_with(b".");
            if line.names(axis) || needs_points && !has_point && value != 0.0 {
                return None;
            }
            line.named |= 1 << axis;
            // A line is shorter than 256 bytes and has at most nine axes.
            line.words[axis] = AxisWord {
                value,
                from: from as u8,
                to: to as u8,
                decimals,
            };
            line.order[line.count] = axis as u8;
            line.count += 1;
        }
        (line.count > 0).then_some(line)
    }

    fn names(&self, axis: usize) -> bool {
        self.named & 1 << axis != 0
    }

    fn order(&self) -> impl Iterator<Item = usize> {
        self.order[..self.count]
            .iter()
            .map(|axis| usize::from(*axis))
    }

    /// Writes the line with new numbers, followed by words of axes that it does not name.
    fn write(
        &self,
        text: &[u8],
        numbers: &Axes<Option<Number>>,
        script: Script,
        out: &mut Vec<u8>,
    ) {
        let mut at = 0;
        for axis in self.order() {
            if let Some(number) = numbers[axis] {
                let word = self.words[axis].text();
                out.extend_from_slice(&text[at..word.start]);
                number.write(out);
                at = word.end;
            }
        }
        out.extend_from_slice(&text[at..self.end]);
        for (axis, number) in numbers.iter().enumerate() {
            if let Some(number) = number.filter(|_| !self.names(axis)) {
                script.write_word(&NewWord::plain((LETTERS[axis], number)), out);
            }
        }
        out.extend_from_slice(&text[self.end..]);
    }
}

#[inline]
fn without_blanks(mut text: &[u8]) -> &[u8] {
    while let [b' ' | b'\t', behind @ ..] = text {
        text = behind;
    }
    text
}

impl Interpreter {
    /// True if axis words alone are absolute positions, and all axes of the machine are at known positions. The pattern names every modal
    /// field, so that a new one must be classified here.
    fn allows_fast_path(&self) -> bool {
        let Self {
            modal,
            dialect,
            points,
            ..
        } = self;
        let Modal {
            absolute,
            shorter,
            goes_on,
            each_motion,
            radius,
            polar,
            motion: _,
            motion_unsure,
            clamped,
            // Scale of words.
            unit_mm: _,
            diameter: _,
            // Part of the frame.
            system: _,
            offsets: _,
            shift: _,
            shifted: _,
            shift_is_local: _,
            shift_is_said: _,
            tool_offset: _,
            length_unit_mm: _,
            length: _,
            centre_point: _,
            rotation: _,
            rotation_is_new,
            programmed: _,
            // Only relevant to arcs, cycles and other words.
            plane: _,
            centre_absolute: _,
            feed_mode: _,
            feed: _,
            exact_stop: _,
            pole: _,
            awaits_preset: _,
            defined: _,
            comes_back: _,
            says_return: _,
            sticky: _,
            tool: _,
            homes: _,
        } = modal;
        *dialect == Dialect::Rs274
            && (!points.means_increments || points.last_in_increments == Some(false))
            && *absolute
            && !*shorter
            && !*goes_on
            && each_motion.is_none()
            && radius.is_none()
            && polar.is_none()
            && !*motion_unsure
            && !*clamped
            && !*rotation_is_new
    }
}

impl Rewriter {
    /// Compensates a usual line, without its line end; `None` for any other line, before anything has changed.
    pub(crate) fn fast_line(&mut self, text: &[u8], out: &mut Vec<u8>) -> Option<()> {
        let is_settled = self.applied_correction == AppliedCorrection::Current
            && self.computed == Computed::Kept
            && self.carried_at_initial.is_none()
            && !self.switches_radius;
        let is_plain = is_settled
            && self.interpreter.allows_fast_path()
            && !self.corrector.bidirectional
            && self.motion_receiver.is_none()
            && (self.corrector.axes()).all(|axis| self.interpreter.knows_program_position(axis));
        if !is_plain {
            return None;
        }
        let line = PlainLine::read(text, self.interpreter.points.means_increments)?;
        if line.code.is_none() && self.interpreter.is_printer() {
            return None;
        }
        let code = line.code.or(self.interpreter.modal.motion);
        let code = code.filter(|code| matches!(code, 0 | 10))?;
        // The first motion that cuts with a work offset may need a note.
        if code == 10 && !self.zero_needs_no_note() {
            return None;
        }
        let (interpreter, corrector) = (&self.interpreter, &self.corrector);
        let (frame, modal) = (&interpreter.frame, &interpreter.modal);
        let from = interpreter.position;
        let before = frame.to_program(&from);
        let mut after = before;
        for axis in line.order() {
            let value = line.words[axis].value;
            if !corrector.has(axis) || value.abs() > LARGEST {
                return None;
            }
            after[axis] = value * modal.scale(axis);
        }
        let to = interpreter.reached(&after, |axis| line.names(axis), false);
        let must_check = |axis| interpreter.must_check_rotary_word(axis, to[axis] - from[axis]);
        let takes_along = frame.tip.is_some();
        let leaves = |axis: usize| {
            (line.names(axis) || axis < 3 && takes_along)
                && !corrector.is_within_travel(axis, to[axis])
        };
        if corrector.axes().any(leaves) || line.order().any(must_check) {
            return None;
        }
        let after = frame.to_program(&to);
        // F applies to the rotary axes alone, which must stay so.
        if code != 0 && self.moves_rotary_axes_only(&[before, after]) {
            return None;
        }
        let (ends, ends_in_program) = ([&from, &to], [&before, &after]);
        // Rapid motions are not split.
        if code != 0 && !corrector.is_straight_in(frame, &mut self.seen, ends, ends_in_program) {
            return None;
        }
        let mut carried = frame.moved_in_program(&from, &self.carried);
        let mut numbers = [None; 9];
        self.words_at(&to, None, &mut carried, |this, axes, delta, carried| {
            for axis in axes {
                let is_named = line.names(axis);
                if !is_named && !this.corrector.has(axis) {
                    continue;
                }
                let way = AxisWay {
                    from: before[axis],
                    to: after[axis],
                    delta: delta[axis],
                    carried: carried[axis],
                    incremental: false,
                    manner: Manner::Modal,
                    keeps: false,
                    written: is_named.then(|| OriginalWord {
                        decimals: line.words[axis].decimals,
                        anew: false,
                    }),
                    numerals: this.numerals(axis, None),
                };
                // All axes are known, so the line needs no note.
                (numbers[axis], carried[axis]) = this.axis_word(axis, &way, 0);
            }
        });
        // The general path rejects this line.
        if self.bound_violation(&after, &carried).is_some() {
            return None;
        }
        let begins = out.len();
        line.write(text, &numbers, Script::default(), out);
        if out.len() - begins > MAX_LINE_BYTES {
            out.truncate(begins);
            return None;
        }
        if let Some(code) = line.code {
            self.interpreter.set_motion(code);
        }
        self.interpreter.position = to;
        for axis in line.order() {
            self.interpreter.mark_named(axis);
        }
        self.carried = (self.interpreter.frame).moved_in_machine(&after, &carried);
        self.counts.lines += 1;
        self.counts.motions += 1;
        self.counts.changed += u64::from(numbers.iter().any(Option::is_some));
        self.record_part_end(1.0);
        Some(())
    }
}
