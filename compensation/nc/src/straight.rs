//! Corrected straight motions, split into as many parts as needed, and the words for the end of each part.

use std::ops::Range;

use crate::{
    NcError,
    block::{BlockStart, LAST, Manner, Word},
    control::{Control, Dialect},
    coordinates::{Axes, LETTERS, between, each, is_rotary},
    line::{Line, NewWord, Shape},
    modal::FeedMode,
    motion::{Move, Path},
    notes::Note,
    number::{Number, Numerals, half_step, of_steps},
    reversal::{RESTING_WITHIN, Reversals, steps_of},
    rewrite::{AppliedCorrection, Contour, Rewriter, Strategy},
    shortest::through,
};

pub(crate) const MAX_PARTS: usize = 4096;

/// Sampling interval in the search for axis reversals, mm or deg; `MAX_REVERSAL_SAMPLES` limits the number of samples.
const REVERSAL_SAMPLING: f64 = 5.0;

const MAX_REVERSAL_SAMPLES: f64 = 64.0;

const MAX_FOLLOW_STEPS: f64 = 64.0;

/// A part of a motion: its index, and its end as a fraction (0 to 1).
#[derive(Clone, Copy, Debug)]
pub(crate) struct Part<'a> {
    pub(crate) place: usize,
    pub(crate) share: f64,
    pub(crate) motion: &'a Move,
    pub(crate) numbers: &'a Axes<Option<Number>>,
    /// Words that follow `numbers` in an added line: the centre or radius of an arc.
    pub(crate) others: &'a [(u8, Number)],
    /// G2 or G3, if a line added before the part has made another motion code modal.
    pub(crate) code: Option<Number>,
    pub(crate) feed: Option<Number>,
    pub(crate) shape: Shape,
    /// Line that precedes the part, without its end: the centre of the arc; empty if none is needed.
    pub(crate) before: &'a [u8],
}

impl<'a> Part<'a> {
    /// A motion that is not split.
    pub(crate) fn whole(motion: &'a Move, numbers: &'a Axes<Option<Number>>, shape: Shape) -> Self {
        Self {
            place: 0,
            share: 1.0,
            motion,
            numbers,
            others: &[],
            code: None,
            feed: None,
            shape,
            before: &[],
        }
    }
}

#[derive(Clone, Copy, Debug)]
pub(crate) struct Leg<'a> {
    pub(crate) motion: &'a Move,
    pub(crate) line: Line<'a>,
    pub(crate) from: Axes,
    pub(crate) to: Axes,
    /// Machine coordinates at which the correction is evaluated: the end, or half-way down a hole.
    pub(crate) at: Axes,
    pub(crate) writes: Axes<WriteRule>,
    pub(crate) keeps: Axes<bool>,
    /// Correction at the end from joint rounding, in program coordinates; `None`: each number is rounded separately.
    pub(crate) rounded: Option<Axes>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum WriteRule {
    /// Never: the word is not a coordinate of the end, but the depth of a cycle or an unchanged
    /// polar coordinate.
    Never,
    IfChanged,
    /// The word is written if the axis moves: for added lines, which have no words yet.
    IfMoves,
    /// The word is always written if the block has it: the motion is split.
    Anew,
    /// The word is written even if the block does not have it.
    Always,
}

#[derive(Clone, Copy, Debug)]
pub(crate) struct AxisWay {
    pub(crate) from: f64,
    pub(crate) to: f64,
    /// Correction required at the end of the motion, mm or deg.
    pub(crate) delta: f64,
    /// Correction applied at the start of the motion, mm or deg.
    pub(crate) carried: f64,
    pub(crate) incremental: bool,
    pub(crate) manner: Manner,
    pub(crate) keeps: bool,
    pub(crate) written: Option<OutputWord>,
    pub(crate) numerals: Numerals,
}

/// Requirements for the word of an axis in the output.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct OutputWord {
    /// Decimals of the number in the program; 0 if the program has no word for the axis.
    pub(crate) decimals: u8,
    /// The word is written even if nothing changes, because the motion is split.
    pub(crate) anew: bool,
}

impl AxisWay {
    /// The number to be written, if any, and the correction applied afterwards. `scale` is mm or deg per unit of the word.
    #[inline]
    pub(crate) fn word(&self, scale: f64, may_be_added: bool) -> (Option<Number>, f64) {
        let nominal = if self.incremental { self.to - self.from } else { self.to };
        let base = if self.incremental { self.from + self.carried } else { 0.0 };
        let wanted = self.to + self.delta - base;
        let half = half_step(self.numerals.decimals);
        let carried_by = |value: f64| base + value * scale - self.to;
        let Some(written) = self.written else {
            // Without a word the axis stays in place with its current correction.
            let needed = (self.to + self.delta) - (self.from + self.carried);
            if !may_be_added || (needed / scale).abs() < half {
                return (None, self.carried + self.from - self.to);
            }
            let number = self.numerals.nearest(wanted / scale, 0);
            let carried = number.map_or(self.carried, |number| carried_by(number.value()));
            return (number, carried);
        };
        let changes = ((wanted - nominal) / scale).abs() >= half;
        if !changes && !written.anew {
            let kept = if self.incremental { self.carried } else { 0.0 };
            return (None, kept);
        }
        let number = (self.numerals).nearest(wanted / scale, written.decimals);
        let carried = number.map_or(self.carried, |number| carried_by(number.value()));
        let number = match number {
            Some(number) if self.manner == Manner::Shortest => number.in_one_turn(),
            _ => number,
        };
        (number, carried)
    }
}

impl Rewriter {
    /// Splits a straight motion into parts within which the correction is linear, and appends the
    /// end of each as a fraction (0 to 1). A first part that ends at 0 applies the correction
    /// missing at the start; a second part that ends at the same fraction crosses the backlash of
    /// an axis that reverses there. `at_ends` are the ends in program coordinates. Errors: more
    /// parts than a motion may have, or an unknown F of the parts.
    pub(crate) fn parts(
        &mut self,
        motion: &Move,
        at_ends: &[Axes; 2],
        line: Line<'_>,
        parts: &mut Vec<f64>,
    ) -> Result<(), NcError> {
        self.turns = self.turns_of(motion);
        // The start must be known too: from an unknown start, the ends of the parts are unknown.
        let is_known =
            (self.corrector.axes()).all(|axis| motion.known[axis] && self.interpreter.known[axis]);
        if !is_known || self.contour != Contour::None {
            let ends = [&motion.from, &motion.to];
            let [from, to] = at_ends;
            let (frame, seen) = (&self.interpreter.frame, &mut self.seen);
            if is_known && !(self.corrector).is_straight_in(frame, seen, ends, [from, to]) {
                self.interpreter.notes.add(Note::ContourWhole, line.number);
            }
            parts.push(1.0);
            return Ok(());
        }
        let sides = self.corrector.sides();
        let (mut begins, mut next) = (0.0, 0);
        let turned = self.turn_once(&mut next, 0.0);
        let lacks = self.lacks_correction(&motion.from, turned);
        if lacks {
            parts.push(0.0);
        }
        while self.turn_once(&mut next, 0.0) {
            if lacks || self.lacks_correction(&motion.from, true) {
                parts.push(0.0);
            }
        }
        while let Some(ends) = self.turns.turns.get(next).map(|turn| turn.share) {
            self.split(motion, at_ends, [begins, ends], line, parts)?;
            self.turn_up_to(&mut next, ends);
            parts.push(ends);
            begins = ends;
        }
        self.split(motion, at_ends, [begins, 1.0], line, parts)?;
        self.corrector.put_back(sides);
        if self.moves_rotary_axes_only([&at_ends[0], &at_ends[1]]) {
            self.follow_turn(at_ends, parts);
        }
        if parts.len() > 1 {
            self.check_shares(line)?;
        }
        Ok(())
    }

    /// Applies the reversals up to this fraction of the motion, beginning with index `next`. Returns true if a reversal
    /// was applied.
    pub(crate) fn turn_up_to(&mut self, next: &mut usize, share: f64) -> bool {
        let first = *next;
        while self.turn_once(next, share) {}
        *next > first
    }

    /// Like [`turn_up_to`](Self::turn_up_to), but stops before an axis reverses for a second time.
    pub(crate) fn turn_once(&mut self, next: &mut usize, share: f64) -> bool {
        let mut turned = [false; 9];
        let turns = self.turns.turns.iter().skip(*next);
        for turn in turns.take_while(|turn| turn.share <= share) {
            if std::mem::replace(&mut turned[turn.axis], true) {
                break;
            }
            self.corrector.turn(turn);
            *next += 1;
        }
        turned.contains(&true)
    }

    /// Number of steps in which the reversals of a straight motion are searched. Ends in machine and in program coordinates.
    pub(crate) fn reversal_steps(&self, ends: [&Axes; 2], [from, to]: [&Axes; 2]) -> u32 {
        // The correction added to a resting axis may also reverse during the motion.
        let least = if self.corrector.play.any {
            let ways = (0..9).map(|axis| (ends[1][axis] - ends[0][axis]).abs());
            (ways.fold(0.0, f64::max) / REVERSAL_SAMPLING).min(MAX_REVERSAL_SAMPLES)
        } else {
            1.0
        };
        let steps = steps_of(self.bulge_mm(from, to)).max(least);
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "1 to 1024")]
        let steps = steps.ceil().max(1.0) as u32;
        steps
    }

    pub(crate) fn turns_of(&self, motion: &Move) -> Reversals {
        if !self.corrector.bidirectional {
            return Reversals::default();
        }
        let frame = &self.interpreter.frame;
        let [from, to] = [&motion.from, &motion.to].map(|at| frame.to_program(at));
        let steps = self.reversal_steps([&motion.from, &motion.to], [&from, &to]);
        if motion.path == Path::Rapid {
            // A rapid motion is not split: the carriages follow the control's path between the two corrected positions.
            let [mut before, after] =
                [&motion.from, &motion.to].map(|at| self.corrector.without_play(at));
            if self.lacks_correction(&motion.from, false) {
                for axis in self.corrector.axes_at_flank() {
                    before[axis] = self.corrector.furthest[axis] - motion.from[axis];
                }
            }
            let [from, to] = [(&motion.from, before), (&motion.to, after)].map(|(at, more)| {
                let more = frame.moved_in_program(at, &more);
                let at = frame.to_program(at);
                each(|axis| at[axis] + more[axis])
            });
            let carriages = |share| frame.to_machine(&between(&from, &to, share));
            return self.corrector.turns(steps, |share| {
                let (at, carriage) = (self.place_of(motion, share), carriages(share));
                each(|axis| if self.corrector.lags(axis) { carriage[axis] } else { at[axis] })
            });
        }
        let nominal = |share| self.place_of(motion, share);
        let mut found = self.corrector.turns(steps, self.corrector.carriages(steps, nominal));
        if !self.lacks_correction(&motion.from, false) {
            found.keep_last_at_start();
        }
        found
    }

    pub(crate) fn place_of(&self, motion: &Move, share: f64) -> Axes {
        if share == 0.0 || share == 1.0 {
            return if share == 0.0 { motion.from } else { motion.to };
        }
        let frame = &self.interpreter.frame;
        let [from, to] = [&motion.from, &motion.to].map(|at| frame.to_program(at));
        frame.to_machine(&between(&from, &to, share))
    }

    fn split(
        &mut self,
        motion: &Move,
        [from, to]: &[Axes; 2],
        [begins, ends]: [f64; 2],
        line: Line<'_>,
        parts: &mut Vec<f64>,
    ) -> Result<(), NcError> {
        let (frame, corrector) = (&self.interpreter.frame, &self.corrector);
        let seen = &mut self.seen;
        let mut is_straight = |shares: [f64; 2]| {
            if shares == [0.0, 1.0] {
                let ends = [&motion.from, &motion.to];
                return corrector.is_straight_in(frame, seen, ends, [from, to]);
            }
            let [first, last] = &shares.map(|share| between(from, to, share));
            let place = |share: f64, at: &Axes| match share {
                0.0 => motion.from,
                1.0 => motion.to,
                _ => frame.to_machine(at),
            };
            let ends = [&place(shares[0], first), &place(shares[1], last)];
            corrector.is_straight_in(frame, seen, ends, [first, last])
        };
        let halves = |[from, to]: [f64; 2]| {
            let middle = 0.5 * (from + to);
            [[middle, to], [from, middle]]
        };
        if is_straight([begins, ends]) {
            parts.push(ends);
        } else {
            // Bisect repeatedly, from the start on.
            let mut open = halves([begins, ends]).to_vec();
            while let Some([from, to]) = open.pop() {
                if parts.len() + open.len() >= MAX_PARTS {
                    return Err(too_many_parts(line));
                }
                if to - from < 1e-6 || is_straight([from, to]) {
                    parts.push(to);
                } else {
                    open.extend(halves([from, to]));
                }
            }
        }
        Ok(())
    }

    /// True if the correction missing at the start of a motion exceeds a limit; `from` is in machine coordinates. After
    /// a reversal (`turns`) the limit is the rounding of words, because the backlash must be crossed. With another
    /// tool, or if the axes arrived without correction, the limit is the tolerance plus the rounding.
    pub(crate) fn lacks_correction(&self, from: &Axes, turns: bool) -> bool {
        if self.applied_correction == AppliedCorrection::Current && !turns
            || self.contour != Contour::None
        {
            return false;
        }
        let delta = self.corrector.at(from).with_rotary(&self.carried);
        if turns || self.applied_correction == AppliedCorrection::OutdatedByReversal {
            let frame = &self.interpreter.frame;
            let [wanted, carried] =
                [&delta, &self.carried].map(|by| frame.moved_in_program(from, by));
            return (0..9).any(|axis| {
                let missing = (wanted[axis] - carried[axis]).abs();
                !is_rotary(axis) && missing >= 0.5 * self.step_mm()
            });
        }
        let linear = (0..9).filter(|axis| !is_rotary(*axis) && self.corrector.corrects[*axis]);
        let squared: f64 = linear.map(|axis| (delta[axis] - self.carried[axis]).powi(2)).sum();
        squared.sqrt() > self.corrector.split_beyond_mm + self.step_mm()
    }

    /// Writes a spline or one of its control points. Its end keeps the correction of its start, since the other points are relative to its
    /// ends.
    pub(crate) fn spline(&mut self, motion: &Move, line: Line<'_>, out: &mut Vec<u8>) {
        let [from, to] = self.ends_of(motion);
        let frame = &self.interpreter.frame;
        let mut carried = frame.moved_in_program(&motion.from, &self.carried);
        let leg = Leg {
            motion,
            line,
            from,
            to,
            at: motion.to,
            writes: [WriteRule::IfChanged; 9],
            keeps: [true; 9],
            rounded: None,
        };
        let words = self.words_to(&leg, &mut carried);
        self.write_part(&Part::whole(motion, &words, Shape::AsItIs), line, out);
        let carried = self.interpreter.frame.moved_in_machine(&to, &carried);
        self.finish_uncorrected(motion, carried);
    }

    pub(crate) fn straight(
        &mut self,
        motion: &Move,
        &[from, end]: &[Axes; 2],
        parts: &[f64],
        line: Line<'_>,
        out: &mut Vec<u8>,
    ) {
        let frame = &self.interpreter.frame;
        let splits = parts.len() > 1;
        let moves_rotary_axes_only =
            motion.path == Path::Line && self.moves_rotary_axes_only([&from, &end]);
        let mut carried = frame.moved_in_program(&motion.from, &self.carried);
        let (mut before, mut passed) = (from, 0.0);
        let mut next = 0;
        // Reversals without a separate block are spread over the motion.
        let is_cut =
            (self.turns.turns.iter()).all(|turn| turn.share == 0.0 || parts.contains(&turn.share));
        // Parts at the same fraction apply the reversals there one by one.
        if !is_cut {
            self.turn_up_to(&mut next, 1.0);
        } else if parts.first() != Some(&0.0) {
            self.turn_up_to(&mut next, 0.0);
        }
        let keeps_polar = !splits && self.keeps_polar(motion, &[from, end], &carried);
        let shape = if keeps_polar { Shape::AsItIs } else { Shape::Straight };
        let keeps = self.keeps_in_plane(motion);
        let keeps_on_way = each(|axis| keeps[axis] || moves_rotary_axes_only && axis < 3);
        let together = self.rounded_together(motion, parts, line);
        for (place, &share) in parts.iter().enumerate() {
            let is_last = share == 1.0;
            if parts.get(place + 1) == Some(&passed) {
                self.turn_once(&mut next, passed);
            } else {
                self.turn_up_to(&mut next, passed);
            }
            let to = if is_last { end } else { between(&from, &end, share) };
            let at = if is_last { motion.to } else { self.interpreter.frame.to_machine(&to) };
            let writes = each(|axis| {
                let is_new = place == 0 || motion.incremental[axis] || to[axis] != before[axis];
                let only_takes_up = place > 0 && share == passed;
                match splits {
                    _ if motion.polar.is_some() && axis < 2 && !only_takes_up => {
                        polar_writes(keeps_polar)
                    }
                    true if is_new => WriteRule::Anew,
                    true => WriteRule::IfMoves,
                    false => WriteRule::IfChanged,
                }
            });
            let leg = Leg {
                motion,
                line,
                from: before,
                to,
                at,
                writes,
                keeps: if share == passed { keeps } else { keeps_on_way },
                rounded: together.as_ref().map(|deltas| deltas[place]),
            };
            let words = self.words_to(&leg, &mut carried);
            if keeps_polar {
                carried[..2].fill(0.0);
            }
            if place > 0 && share == passed && words.iter().all(Option::is_none) {
                // The part needs no line: the correction is already applied.
                continue;
            }
            let feed = splits.then(|| self.feed_of_part(share - passed)).flatten();
            let part = Part { place, share, feed, ..Part::whole(motion, &words, shape) };
            self.write_part(&part, line, out);
            (before, passed) = (to, share);
        }
        self.carried = self.interpreter.frame.moved_in_machine(&end, &carried);
        self.finish_motion(motion);
        if keeps_on_way.contains(&true) {
            self.mark_outdated();
        }
    }

    /// True if a motion moves only axes other than X, Y and Z, on a control that applies F to X, Y and Z as soon as one of them moves, and
    /// gives the rotary axes the same time (LinuxCNC; NIST IR 6556, 2.1.2.5). A correction of 1 µm in Y would then turn an axis programmed
    /// at F600 at its maximum speed. Therefore X, Y and Z keep their correction during such a motion, and are corrected in separate blocks.
    pub(crate) fn moves_rotary_axes_only(&self, [from, to]: [&Axes; 2]) -> bool {
        let moves = |mut axes: Range<usize>| {
            axes.any(|axis| (to[axis] - from[axis]).abs() > RESTING_WITHIN)
        };
        let takes_together = self.interpreter.dialect == Dialect::Heidenhain
            || self.interpreter.is_printer()
            || matches!(self.interpreter.control, Some(Control::Fanuc | Control::Mazak));
        !moves(0..3) && moves(3..9) && !takes_together
    }

    /// Splits a motion of rotary axes alone wherever the corrections of X, Y and Z lag by the tolerance; X, Y and Z
    /// follow there in a separate block.
    fn follow_turn(&mut self, [from, to]: &[Axes; 2], parts: &mut Vec<f64>) {
        let tolerance = self.corrector.split_beyond_mm;
        let mut shares = Vec::new();
        let (mut begins, mut before) = (0.0, self.delta_in_program(from));
        for &ends in parts.iter() {
            let after = self.delta_in_program(&between(from, to, ends));
            let lag = (0..3).map(|axis| (after[axis] - before[axis]).abs());
            let steps = (lag.fold(0.0, f64::max) / tolerance).ceil();
            let steps = steps.clamp(1.0, MAX_FOLLOW_STEPS);
            let mut step = 1.0;
            while step < steps {
                shares.extend([begins + (ends - begins) * step / steps; 2]);
                step += 1.0;
            }
            // The next motion applies the correction that is missing at the end of this motion.
            let is_inside = ends > 0.0 && ends < 1.0;
            shares.extend(std::iter::repeat_n(ends, if is_inside { 2 } else { 1 }));
            (begins, before) = (ends, after);
        }
        *parts = shares;
    }

    /// Rejects a split motion whose parts have an unknown F (in G93) or E.
    pub(crate) fn check_shares(&mut self, line: Line<'_>) -> Result<(), NcError> {
        self.check_extrusion(line)?;
        if self.interpreter.modal.exact_stop {
            self.interpreter.notes.add(Note::ExactStop, line.number);
        }
        let modal = &self.interpreter.modal;
        if modal.feed_mode == FeedMode::InverseTime && modal.feed.is_none() {
            return Err(NcError::not_compensated(
                line.number,
                "a motion that is split, with an inverse-time F (G93) that only the machine knows: the F of its parts cannot be computed",
            ));
        }
        Ok(())
    }

    /// F of a part with this fraction of the motion in inverse-time mode; `None` in other modes.
    pub(crate) fn feed_of_part(&self, share: f64) -> Option<Number> {
        let modal = &self.interpreter.modal;
        let feed = modal.feed.filter(|_| modal.feed_mode == FeedMode::InverseTime)?;
        Number::nearest(feed / share_of_time(share), 4)
    }

    /// Writes a part: the first one into the program's own line, each other one into an added line.
    pub(crate) fn write_part(&mut self, part: &Part<'_>, line: Line<'_>, out: &mut Vec<u8>) {
        if part.share < 1.0 {
            self.record_part_end(part.share);
        }
        let script = line.script;
        let ends_late = self.interpreter.control.is_none_or(Control::is_fanuc_like);
        let stops = |word: &&Word| match (word.letter, word.value) {
            (LAST, _) => true,
            (b'M', Some(code)) => is_stop(code) || ends_late && is_switched_off(code),
            // An exact stop applies to the end of the motion.
            (b'G', Some(code)) => code == 9.0,
            _ => false,
        };
        if part.place == 0 {
            for (axis, number) in part.numbers.iter().enumerate() {
                if let Some(number) = number {
                    self.edits.set(LETTERS[axis], part.motion.words[axis], *number);
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
            self.goes_as(part.shape, part.motion.polar, line);
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
        // The keyword already states the motion type, if every motion has one.
        let code = if script.says_each { line.motion_code() } else { part.code };
        if let Some(code) = code.filter(|_| !script.is_heidenhain()) {
            script.write_word(&NewWord::plain((b'G', code)), out);
        }
        let manners = part.motion.words.map(|place| line.manner(place));
        for word in words_of(part.numbers, &manners, part.feed) {
            script.write_word(&word, out);
        }
        for &(letter, number) in part.others {
            let manner = line.manner(line.place_of(letter));
            let word = NewWord { letter, manner, number };
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

    pub(crate) fn begin_line(&mut self, line: Line<'_>, out: &mut Vec<u8>) {
        if line.block.begins == BlockStart::Slash {
            out.extend_from_slice(&line.text[line.block.skip.clone()]);
        }
        self.counts.added += 1;
    }

    pub(crate) fn record_part_end(&mut self, share: f64) {
        if let Some(shares) = &mut self.shares {
            shares.push(share);
        }
    }

    /// The words that move the axes to the end of a leg. `carried` becomes the correction applied there, in program coordinates. The linear
    /// axes compensate the rounded rotary positions, so that the tip is in place.
    pub(crate) fn words_to(&mut self, leg: &Leg<'_>, carried: &mut Axes) -> Axes<Option<Number>> {
        let mut numbers = [None; 9];
        let in_program = self.interpreter.frame.to_program(&leg.at);
        self.words_at(
            [&leg.at, &in_program],
            leg.rounded,
            carried,
            |this, axes, delta, carried| {
                this.numbers(leg, axes, delta, carried, &mut numbers);
            },
        );
        self.check_bounds(&leg.to, carried);
        numbers
    }

    /// Creates the words that apply the correction at a position, which is given in machine and in
    /// program coordinates. The correction is `rounded` if given, else exact. `numbers` is called for
    /// each range of axes, creates their words and updates `carried`. Returns the required
    /// correction, in program coordinates.
    #[inline]
    pub(crate) fn words_at(
        &mut self,
        [at, in_program]: [&Axes; 2],
        rounded: Option<Axes>,
        carried: &mut Axes,
        mut numbers: impl FnMut(&mut Self, Range<usize>, &Axes, &mut Axes),
    ) -> Axes {
        let frame = &self.interpreter.frame;
        let correction = self.seen.at(&self.corrector, at);
        if correction.follow.is_some() {
            let delta = frame.others_moved_in_program(at, &correction.delta);
            numbers(self, 3..6, &delta, carried);
            let correction = self.seen.at(&self.corrector, at).with_rotary(carried);
            let frame = &self.interpreter.frame;
            let delta = frame.moved_in_program_at([at, in_program], &correction);
            numbers(self, 0..3, &delta, carried);
            numbers(self, 6..9, &delta, carried);
            return delta;
        }
        let delta = &correction.delta;
        let delta = rounded.unwrap_or_else(|| frame.moved_in_program_at([at, in_program], delta));
        numbers(self, 0..9, &delta, carried);
        delta
    }

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
            if writes == WriteRule::Never || word.is_none() && !self.corrector.has(axis) {
                continue;
            }
            let written = match word {
                _ if writes == WriteRule::IfMoves => None,
                Some(word) => Some(OutputWord {
                    decimals: word.decimals.unwrap_or(0),
                    anew: writes != WriteRule::IfChanged,
                }),
                None => {
                    (writes == WriteRule::Always).then_some(OutputWord { decimals: 0, anew: true })
                }
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
            (numbers[axis], carried[axis]) = self.axis_word(axis, &way, leg.line.number);
        }
    }

    /// The number to be written for an axis, if any, and the correction applied afterwards.
    #[inline]
    pub(crate) fn axis_word(
        &mut self,
        axis: usize,
        way: &AxisWay,
        line: usize,
    ) -> (Option<Number>, f64) {
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
        let scale = self.interpreter.modal.scale(axis);
        let (number, carried) = AxisWay { delta, ..*way }.word(scale, may_be_added);
        let is_added = way.written.is_none() && number.is_some();
        if is_added && is_rotary(axis) && self.interpreter.modal.clamped {
            let note = Note::Clamped(char::from(LETTERS[axis]));
            self.interpreter.notes.add(note, line);
        }
        (number, carried)
    }

    /// True if the words of an axis include a correction; with tool centre point control X, Y and Z do if any linear axis is corrected.
    #[inline]
    pub(crate) fn corrects(&self, axis: usize) -> bool {
        if axis < 3 && self.interpreter.frame.tip.is_some() {
            return (0..3).any(|axis| self.corrector.corrects[axis]);
        }
        self.corrector.corrects[axis]
    }

    /// Corrections at the end of each part, in program coordinates, that yield jointly rounded numbers (shortest path). `None` if each
    /// number is rounded separately: [`Strategy::Plain`], unsplit lines, corrected rotary axes, tool centre point control, incremental
    /// coordinates, lines that take up play, contours, and fewer than two axes with a choice.
    fn rounded_together(
        &mut self,
        motion: &Move,
        parts: &[f64],
        line: Line<'_>,
    ) -> Option<Vec<Axes>> {
        let frame = &self.interpreter.frame;
        let is_plain = self.strategy == Strategy::Plain
            || parts.len() < 2
            || parts.windows(2).any(|pair| pair[0] == pair[1])
            || parts[0] == 0.0
            || frame.tip.is_some()
            || self.contour != Contour::None
            || (0..9).any(|axis| {
                motion.incremental[axis] || is_rotary(axis) && self.corrector.corrects[axis]
            });
        if is_plain {
            return None;
        }
        let [from, end] = [&motion.from, &motion.to].map(|at| frame.to_program(at));
        // Step of each axis with a free choice of number; the others are rounded to nearest.
        let step: Axes<Option<f64>> = each(|axis| {
            let word = line.word(motion.words[axis])?;
            let decimals = self.numerals(axis, Some(word)).decimals;
            let decimals = decimals.max(word.decimals.unwrap_or(0));
            let is_free = self.corrector.corrects[axis] && end[axis] != from[axis];
            is_free.then(|| self.interpreter.modal.scale(axis) * of_steps(1, decimals))
        });
        let free: Vec<usize> = (0..9).filter(|axis| step[*axis].is_some()).collect();
        if free.len() < 2 {
            return None;
        }
        let way: Axes = each(|axis| end[axis] - from[axis]);
        let square: f64 = free.iter().map(|axis| way[*axis] * way[*axis]).sum();
        // Deviation of a number perpendicular to the line.
        let across = |off: &Axes| -> Axes {
            let along: f64 = free.iter().map(|axis| off[*axis] * way[*axis]).sum();
            each(|axis| off[axis] - along / square * way[axis])
        };
        let mut layers: Vec<Vec<(Axes, Axes)>> = Vec::with_capacity(parts.len() + 1);
        let delta = self.delta_in_program(&from);
        let carried = self.interpreter.frame.moved_in_program(&motion.from, &self.carried);
        let off = each(|axis| if step[axis].is_some() { carried[axis] - delta[axis] } else { 0.0 });
        layers.push(vec![(carried, across(&off))]);
        for &share in parts {
            let to = if share == 1.0 { end } else { between(&from, &end, share) };
            let delta = self.delta_in_program(&to);
            let mut candidates = vec![(delta, [0.0; 9])];
            for axis in 0..9 {
                let Some(step) = step[axis] else { continue };
                let exact = (to[axis] + delta[axis]) / step;
                let nearest = exact.round();
                let other = if exact > nearest { nearest + 1.0 } else { nearest - 1.0 };
                // The next line starts at the end of this one and may have any direction.
                let numbers = if share == 1.0 { vec![nearest] } else { vec![nearest, other] };
                candidates = candidates
                    .iter()
                    .flat_map(|(delta, off)| {
                        numbers.iter().map(move |number| {
                            let (mut delta, mut off) = (*delta, *off);
                            delta[axis] = number * step - to[axis];
                            off[axis] = (number - exact) * step;
                            (delta, off)
                        })
                    })
                    .collect();
            }
            let layer = candidates.into_iter().map(|(delta, off)| (delta, across(&off)));
            layers.push(layer.collect());
        }
        let counts: Vec<usize> = layers.iter().map(Vec::len).collect();
        let dot = |a: &Axes, b: &Axes| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
        let lengths = [0.0].iter().chain(parts).zip(parts);
        let lengths: Vec<f64> = lengths.map(|(from, to)| to - from).collect();
        // Mean square deviation of a part with deviation a at its start and b at its end, linear in between.
        let found = through(&counts, |layer, from, to| {
            let (a, b) = (&layers[layer][from].1, &layers[layer + 1][to].1);
            lengths[layer] * (dot(a, a) + dot(a, b) + dot(b, b)) / 3.0
        })?;
        // The first candidate of each layer has the nearest numbers.
        let differs = found.nodes.iter().skip(1).any(|node| *node != 0);
        self.rounded_otherwise += u64::from(differs);
        let nodes = layers.iter().zip(&found.nodes).skip(1);
        Some(nodes.map(|(layer, node)| layer[*node].0).collect())
    }

    /// True if a word may be added for an axis that the block does not name; adds a note if a needed word is omitted.
    fn may_add(&mut self, axis: usize, way: &AxisWay, line: usize) -> bool {
        if way.incremental || self.interpreter.knows_program_position(axis) {
            return true;
        }
        let needed = (way.delta - way.carried) / self.interpreter.modal.scale(axis);
        if way.written.is_none() && needed.abs() >= half_step(way.numerals.decimals) {
            let note = Note::LeftOut(char::from(LETTERS[axis]));
            self.interpreter.notes.add(note, line);
        }
        false
    }

    /// Adds a note about a motion that is copied or not split, because it is in machine coordinates or starts at an unknown position.
    pub(crate) fn note_unknown(&mut self, motion: &Move, line: usize) {
        if motion.in_machine || matches!(motion.path, Path::Home { .. }) {
            self.interpreter.notes.add(Note::InMachine, line);
            return;
        }
        let of_plane = match motion.path {
            Path::Line => None,
            Path::Arc(arc) => Some([arc.axes[0], arc.axes[1]]),
            _ => return,
        };
        let is_unknown = |axis: &usize| {
            of_plane.is_none_or(|of| of.contains(axis))
                && !(motion.known[*axis] && self.interpreter.known[*axis])
        };
        let Some(axis) = self.corrector.axes().find(is_unknown) else {
            return;
        };
        let matters = match motion.path {
            Path::Line => {
                let in_program = self.ends_of(motion);
                let ends = [&motion.from, &motion.to];
                let frame = &self.interpreter.frame;
                let [from, to] = &in_program;
                !(self.corrector).is_straight_in(frame, &mut self.seen, ends, [from, to])
            }
            _ => self.corrector.at(&motion.to).delta != [0.0; 9],
        };
        if matters {
            let note = Note::NotSplit(char::from(LETTERS[axis]));
            self.interpreter.notes.add(note, line);
        }
    }

    /// Adds a note about each axis that is corrected by the mean of both directions, because its direction of approach is unknown.
    pub(crate) fn note_approach(&mut self, line: usize) {
        for axis in self.corrector.axes_with_unknown_approach() {
            if self.interpreter.known[axis] {
                let note = Note::UnknownApproach(char::from(LETTERS[axis]));
                self.interpreter.notes.add(note, line);
            }
        }
    }

    /// Adds a note if a written correction relies on an unstated work offset.
    pub(crate) fn note_unstated(&mut self, line: usize) {
        if self.carried != [0.0; 9]
            && let Some(system) = self.interpreter.unstated_offset()
        {
            self.interpreter.notes.add(Note::NoOffset(system), line);
        }
    }
}

pub(crate) fn too_many_parts(line: Line<'_>) -> NcError {
    NcError::not_compensated(
        line.number,
        format!(
            "a motion that needs more than {MAX_PARTS} parts: a larger --tolerance needs fewer"
        ),
    )
}

/// Fraction of the time of a motion for one of its parts. A part that only crosses backlash gets a
/// minimum.
fn share_of_time(share: f64) -> f64 {
    if share == 0.0 { 1e-3 } else { share }
}

/// The words of axes, followed by F.
pub(crate) fn words_of(
    numbers: &Axes<Option<Number>>,
    manners: &Axes<Manner>,
    feed: Option<Number>,
) -> impl Iterator<Item = NewWord> {
    let words = LETTERS.into_iter().zip(*manners).zip(*numbers);
    let words = words
        .filter_map(|((letter, manner), number)| Some(NewWord { letter, manner, number: number? }));
    words.chain(feed.map(|feed| NewWord::plain((b'F', feed))))
}

/// True if an M code stops the program after the motion of its block.
fn is_stop(code: f64) -> bool {
    [0.0, 1.0, 2.0, 30.0, 60.0].contains(&code)
}

/// True if an M code stops or orients the spindle, or stops the coolant: after the motion of its block on FANUC and
/// Haas controls, before it on LinuxCNC.
fn is_switched_off(code: f64) -> bool {
    [5.0, 9.0, 19.0].contains(&code)
}

/// How X and Y of a motion in polar coordinates are written.
pub(crate) fn polar_writes(keeps: bool) -> WriteRule {
    if keeps { WriteRule::Never } else { WriteRule::Always }
}
