//! Fast path for the most frequent line of long programs: a straight motion to a position in plain
//! numbers, optionally with a block number, F and a comment at its end.
//!
//! The fast path compensates such a line in one pass, in a fraction of the time of the general path
//! ([`Rewriter::line`]), with identical output and state. It leaves any other line to the general path before it
//! changes any state.

use std::ops::Range;

use memchr::memchr;

use crate::{
    NcError,
    block::Manner,
    codes::LARGEST,
    control::{Control, Dialect},
    coordinates::{Axes, LETTERS, axis_of, each},
    heidenhain::{block_number, write_block_number},
    interpreter::Interpreter,
    line::{NewWord, Script},
    modal::{Code, Modal},
    motion::{Move, Path},
    notes::Note,
    number::{Number, plain},
    rewrite::{AppliedCorrection, ComputedValues, MAX_LINE_BYTES, Rewriter},
    straight::{AxisWay, OutputWord},
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

/// Syntax of a language and control.
#[derive(Clone, Copy, Debug)]
struct Syntax {
    /// Set if the fast path reads a leading block number (N) and F.
    reads_others: bool,
    /// Characters that begin a comment.
    comments: &'static [u8],
    dialect: Dialect,
    decimal_sign: u8,
    /// Set if a coordinate without a decimal point counts least increments.
    needs_points: bool,
}

impl Syntax {
    fn of(interpreter: &Interpreter, comma: bool) -> Self {
        let is_printer = interpreter.is_printer();
        let is_fanuc_like = interpreter.control.is_some_and(Control::is_fanuc_like);
        Self {
            reads_others: !is_printer,
            comments: match interpreter.dialect {
                Dialect::Siemens | Dialect::Heidenhain => b";",
                _ if is_printer => b"",
                // A semicolon ends a block of these controls.
                _ if is_fanuc_like => b"(",
                _ => b"(;",
            },
            dialect: interpreter.dialect,
            // A line with the other decimal sign takes the general path, which sets the sign for
            // the lines after it.
            decimal_sign: if comma { b',' } else { b'.' },
            needs_points: interpreter.points.means_increments,
        }
    }
}

/// A usual line, parsed: G0, G1 or neither (HEIDENHAIN: L), and axis words.
#[derive(Clone, Copy, Debug, Default)]
struct PlainLine {
    code: Option<Code>,
    words: Axes<AxisWord>,
    order: Axes<u8>,
    count: usize,
    feed: Option<f64>,
    /// One bit per axis that has a word.
    named: u16,
    /// End of the last word; HEIDENHAIN: of the last coordinate.
    end: usize,
    number: Option<BlockNumber>,
}

/// Block number of a HEIDENHAIN line, and its byte range.
#[derive(Clone, Copy, Debug)]
struct BlockNumber {
    from: usize,
    to: usize,
    value: u64,
}

impl PlainLine {
    /// Parses a usual line; `None` for any other line.
    #[expect(clippy::cast_possible_truncation, reason = "the line is shorter than 256 bytes")]
    #[inline]
    fn read(text: &[u8], syntax: Syntax) -> Option<Self> {
        if text.len() > MAX_LINE_BYTES {
            return None;
        }
        let mut line = Self::default();
        let mut rest = text;
        loop {
            rest = without_blanks(rest);
            let [letter, behind @ ..] = rest else { break };
            let letter = letter.to_ascii_uppercase();
            let axis = axis_of(letter);
            if axis.is_none() && syntax.comments.contains(&letter) {
                if !ends_in_comment(rest) {
                    return None;
                }
                break;
            }
            if syntax.dialect == Dialect::Heidenhain {
                let length = line.keyword(text, rest)?;
                if length > 0 {
                    rest = &rest[length..];
                    continue;
                }
            }
            let number = without_blanks(behind);
            let from = text.len() - number.len();
            let (value, decimals, length) = plain(number, syntax.decimal_sign)?;
            let to = from + length;
            rest = &number[length..];
            let before = std::mem::replace(&mut line.end, to);
            let Some(axis) = axis else {
                let digits = &number[..length];
                let needs_digits = syntax.dialect == Dialect::Siemens && letter != b'F';
                if needs_digits && !digits.iter().all(u8::is_ascii_digit) {
                    return None;
                }
                let code = match (letter, value) {
                    (b'G', 0.0) => 0,
                    (b'G', 1.0) => 10,
                    (b'N', _) if syntax.reads_others && before == 0 => continue,
                    (b'F', _) if syntax.reads_others && line.feed.is_none() => {
                        line.feed = Some(value);
                        if syntax.dialect == Dialect::Heidenhain {
                            line.end = before;
                        }
                        continue;
                    }
                    _ => return None,
                };
                if line.code.replace(code).is_some() {
                    return None;
                }
                continue;
            };
            let has_point = decimals > 0 || number[..length].ends_with(b".");
            if line.names(axis) || syntax.needs_points && !has_point && value != 0.0 {
                return None;
            }
            line.named |= 1 << axis;
            // A line is shorter than 256 bytes and has at most nine axes.
            line.words[axis] = AxisWord { value, from: from as u8, to: to as u8, decimals };
            line.order[line.count] = axis as u8;
            line.count += 1;
        }
        (line.count > 0).then_some(line)
    }

    /// Reads a block number or a keyword of a HEIDENHAIN line at the beginning of `rest`. Returns its length, 0 for another word; `None` if
    /// the line is not usual.
    #[inline]
    fn keyword(&mut self, text: &[u8], rest: &[u8]) -> Option<usize> {
        let from = text.len() - rest.len();
        match (rest.first()?.to_ascii_uppercase(), self.code) {
            (b'0'..=b'9', None) if self.number.is_none() => {
                let (place, value) = block_number(text)?;
                let length = place.len();
                let to = from + length;
                self.number = Some(BlockNumber { from, to, value });
                Some(length)
            }
            (b'L', None) if begins_with(rest, b"L") => {
                (self.code, self.end) = (Some(10), from + 1);
                Some(1)
            }
            (_, None) => None,
            (b'F', Some(10)) if begins_with(rest, b"FMAX") => {
                self.code = Some(0);
                Some(4)
            }
            // Radius compensation is off, and stays so.
            (b'R', _) if begins_with(rest, b"R0") => Some(2),
            _ => Some(0),
        }
    }

    fn names(&self, axis: usize) -> bool {
        self.named & 1 << axis != 0
    }

    fn order(&self) -> impl Iterator<Item = usize> {
        self.order[..self.count].iter().map(|axis| usize::from(*axis))
    }

    /// Writes the line with new numbers, followed by words of axes that it does not name. `added` is the number of lines that were added
    /// before.
    fn write(
        &self,
        text: &[u8],
        numbers: &Axes<Option<Number>>,
        script: Script,
        added: u64,
        out: &mut Vec<u8>,
    ) {
        let mut at = 0;
        if let Some(number) = self.number.filter(|_| added > 0) {
            out.extend_from_slice(&text[..number.from]);
            write_block_number(&text[number.from..number.to], number.value + added, out);
            at = number.to;
        }
        for axis in self.order() {
            if let Some(number) = numbers[axis] {
                let word = self.words[axis].text();
                out.extend_from_slice(&text[at..word.start]);
                script.write_like(&text[word.clone()], number, out);
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

/// True if a text that begins with a comment contains nothing after the comment.
fn ends_in_comment(text: &[u8]) -> bool {
    let is_closed = match text {
        [b'(', behind @ ..] => (memchr(b')', behind))
            .is_some_and(|length| without_blanks(&behind[length + 1..]).is_empty()),
        _ => true,
    };
    // Zero bytes are rejected.
    is_closed && !text.contains(&0)
}

/// True if a text begins with this name and no letter, digit or underscore follows.
#[inline]
fn begins_with(text: &[u8], name: &[u8]) -> bool {
    let goes_on = |byte: &u8| byte.is_ascii_alphanumeric() || *byte == b'_';
    let next = text.get(..name.len());
    next.is_some_and(|next| next.eq_ignore_ascii_case(name))
        && !text.get(name.len()).is_some_and(goes_on)
}

#[inline]
fn without_blanks(mut text: &[u8]) -> &[u8] {
    while let [b' ' | b'\t', behind @ ..] = text {
        text = behind;
    }
    text
}

impl Interpreter {
    /// True if axis words alone are positions, or distances in G91. All modal fields are named one by one: a new field must be classified
    /// here.
    fn allows_fast_path(&self) -> bool {
        let Self { modal, points, .. } = self;
        let Modal {
            // Meaning of axis words.
            absolute: _,
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
            has_set_shift: _,
            length_is_said: _,
            system_is_said: _,
            tool_offset: _,
            length_unit_mm: _,
            length: _,
            centre_point: _,
            rotation: _,
            frame_is_new,
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
        (!points.means_increments || points.last_in_increments == Some(false))
            && !*shorter
            && !*goes_on
            && each_motion.is_none()
            && radius.is_none()
            && polar.is_none()
            && !*motion_unsure
            && !*clamped
            && *frame_is_new == [false; 9]
    }
}

impl Rewriter {
    fn allows_fast_path(&self) -> bool {
        self.applied_correction == AppliedCorrection::Current
            && self.computed == ComputedValues::Kept
            && self.carried_at_initial.is_none()
            && !self.switches_radius
            && self.interpreter.allows_fast_path()
            && (self.corrector.axes()).all(|axis| self.interpreter.knows_program_position(axis))
    }

    /// End of a line in program coordinates; `None` if it names an axis that the machine lacks, or a number is too large.
    #[inline]
    fn end_in_program(&self, line: &PlainLine, from: &Axes) -> Option<Axes> {
        let modal = &self.interpreter.modal;
        let mut end = *from;
        for axis in line.order() {
            let value = line.words[axis].value;
            if !self.corrector.has(axis) || value.abs() > LARGEST {
                return None;
            }
            let value = value * modal.scale(axis);
            end[axis] = if modal.absolute { value } else { from[axis] + value };
        }
        Some(end)
    }

    /// Motion code of a line; `None` if the general path must execute it.
    fn code_of(&self, line: &PlainLine) -> Option<Code> {
        if line.code.is_none() && self.interpreter.is_printer() {
            return None;
        }
        let code = line.code.or(self.interpreter.modal.motion);
        // The first motion that cuts with a work offset may need a note.
        code.filter(|code| *code == 0 || *code == 10 && self.zero_needs_no_note())
    }

    /// True if the correction `carried` at the end of a line needs a note (it is the first correction with an assumed
    /// work offset) or a rejection (it is out of bounds). Machine coordinates.
    fn needs_note_or_rejection(&self, end: &Axes, carried: &Axes) -> bool {
        let is_noted = |system| self.interpreter.notes.has(&Note::NoOffset(system));
        let unstated = self.interpreter.unstated_offset();
        *carried != [0.0; 9] && unstated.is_some_and(|system| !is_noted(system))
            || self.violation_in_machine(end, carried).is_some()
    }

    /// Compensates a usual line; `text` is the line without its terminator. `None` if the general path must take the
    /// line; in that case nothing was changed.
    pub(crate) fn fast_line(
        &mut self,
        text: &[u8],
        number: usize,
        out: &mut Vec<u8>,
    ) -> Option<()> {
        if !self.allows_fast_path() {
            return None;
        }
        let line = PlainLine::read(text, Syntax::of(&self.interpreter, self.comma))?;
        let code = self.code_of(&line)?;
        let (interpreter, corrector) = (&self.interpreter, &self.corrector);
        let frame = &interpreter.frame;
        let from = interpreter.position;
        let before = frame.to_program(&from);
        let incremental = !interpreter.modal.absolute;
        let after = self.end_in_program(&line, &before)?;
        let to = interpreter.reached(&after, |axis| line.names(axis), false);
        let must_check = |axis| interpreter.must_check_rotary_word(axis, to[axis] - from[axis]);
        let takes_along = frame.tip.is_some();
        let leaves = |axis: usize| {
            (line.names(axis) || axis < 3 && takes_along)
                && !corrector.is_within_travel(axis, to[axis])
        };
        if corrector.axes().any(leaves) || !incremental && line.order().any(must_check) {
            return None;
        }
        let after = frame.to_program(&to);
        // F applies to the rotary axes alone; a correction of X, Y or Z would change its meaning.
        if code != 0 && self.moves_rotary_axes_only([&before, &after]) {
            return None;
        }
        let (ends, ends_in_program) = ([&from, &to], [&before, &after]);
        // Rapid motions are not split.
        if code != 0 && !corrector.is_straight_in(frame, &mut self.seen, ends, ends_in_program) {
            return None;
        }
        let furthest = if self.corrector.bidirectional {
            Some(self.furthest_after(code, ends, ends_in_program)?)
        } else {
            None
        };
        let frame = &self.interpreter.frame;
        let mut carried = frame.moved_in_program_at([&from, &before], &self.carried);
        let mut numbers = [None; 9];
        // On a machine without errors, as in `verify`, no word changes.
        if self.corrector.corrects.contains(&true) || carried != [0.0; 9] {
            self.words_at([&to, &after], None, &mut carried, |this, axes, delta, carried| {
                // The machine has each named axis.
                for axis in this.corrector.axes().filter(|axis| axes.contains(axis)) {
                    let is_named = line.names(axis);
                    let corrects = this.corrects(axis);
                    let way = AxisWay {
                        from: before[axis],
                        to: after[axis],
                        delta: if corrects { delta[axis] } else { 0.0 },
                        carried: carried[axis],
                        incremental,
                        manner: Manner::Modal,
                        keeps: false,
                        written: is_named.then(|| OutputWord {
                            decimals: line.words[axis].decimals,
                            anew: false,
                        }),
                        numerals: this.numerals(axis, None),
                    };
                    // As in `axis_word`: all axes are known and none is clamped, so the line needs no
                    // note.
                    let scale = this.interpreter.modal.scale(axis);
                    (numbers[axis], carried[axis]) = way.word(scale, corrects);
                }
            });
        }
        // The general path rejects the line, with a message.
        let carried = self.interpreter.frame.moved_in_machine_at([&to, &after], &carried);
        if self.needs_note_or_rejection(&to, &carried) {
            return None;
        }
        let begins = out.len();
        let script =
            Script { dialect: self.interpreter.dialect, comma: self.comma, ..Script::default() };
        line.write(text, &numbers, script, self.counts.added, out);
        if out.len() - begins > MAX_LINE_BYTES {
            out.truncate(begins);
            return None;
        }
        // The general path reports an error.
        if self.send_usual(&line, code, [&from, &to], [&before, &after], number).is_err() {
            out.truncate(begins);
            return None;
        }
        if let Some(code) = line.code {
            self.interpreter.set_motion(code);
        }
        self.interpreter.position = to;
        self.interpreter.modal.feed = line.feed.or(self.interpreter.modal.feed);
        for axis in line.order().filter(|_| !incremental) {
            self.interpreter.mark_named(axis);
        }
        self.carried = carried;
        if let Some(furthest) = furthest {
            self.corrector.go_on_to(&to, furthest);
        }
        self.counts.lines += 1;
        self.counts.motions += 1;
        self.counts.changed += u64::from(numbers.iter().any(Option::is_some));
        self.record_part_end(1.0);
        Some(())
    }

    /// Sends the motion of a usual line to the receiver of executed motions, if any.
    fn send_usual(
        &self,
        line: &PlainLine,
        code: Code,
        [from, to]: [&Axes; 2],
        [before, after]: [&Axes; 2],
        number: usize,
    ) -> Result<(), NcError> {
        if self.motion_sender.is_none() {
            return Ok(());
        }
        let motion = Move {
            path: if code == 0 { Path::Rapid } else { Path::Line },
            from: *from,
            to: *to,
            words: each(|axis| line.names(axis).then_some(axis)),
            incremental: [!self.interpreter.modal.absolute; 9],
            in_machine: false,
            polar: None,
            known: self.interpreter.known,
            arrives_from_unknown: [false; 9],
            wraps: [0.0; 9],
        };
        let cuts = motion.cuts();
        self.send_executed(motion, [*before, *after], number, cuts)
    }

    /// Furthest position of each axis after a motion on which no axis reverses. `None` if the motion must take the
    /// general path.
    fn furthest_after(
        &mut self,
        code: Code,
        ends: [&Axes; 2],
        in_program: [&Axes; 2],
    ) -> Option<Axes> {
        let [from, to] = ends;
        let is_unknown = || self.corrector.axes_with_unknown_approach().next().is_some();
        // The general path adds the note that a cutting motion with an unknown direction of
        // approach needs, and handles rapid motions with backlash, whose carriage positions do not
        // follow from the ends alone.
        if code != 0 && is_unknown()
            || code == 0 && self.corrector.play.any
            || self.reversal_steps(ends, in_program) > 1
        {
            return None;
        }
        let mut carriages = *to;
        if self.corrector.play.any {
            let delta = self.seen.at(&self.corrector, to).delta;
            let more = self.corrector.without_play_of(to, &delta);
            for (carriage, more) in carriages.iter_mut().zip(more) {
                *carriage += more;
            }
        }
        self.corrector.furthest_after(from, &carriages)
    }
}
