//! Straight motions with their correction, in as many parts as it needs.

use crate::{
    NcError,
    carried::Settled,
    contour::Contour,
    coordinates::{Axes, is_rotary},
    legs::{Leg, Writes},
    line::Line,
    motion::{Move, Path},
    notes::Note,
    parts::Part,
    polar::polar_writes,
    rewrite::Rewriter,
    script::Shape,
    turns::{Turns, steps_of},
    words::{between, each},
};

/// A motion is split into so many parts at the most.
pub(crate) const MOST_PARTS: usize = 4096;
/// After each so many mm or deg a motion is looked at for axes that turn, so often at the most.
const LOOKED_AT_EACH: f64 = 5.0;
const MOST_LOOKED_AT: f64 = 64.0;

/// Why a motion is not split any further.
pub(crate) fn too_many_parts(line: Line<'_>) -> NcError {
    NcError::NotCompensated {
        line: line.number,
        what: format!(
            "a motion that would be split into more than {MOST_PARTS} parts: a larger --tolerance needs fewer"
        ),
    }
}

impl Rewriter {
    /// The parts of a straight line within which the correction is straight, too: where each ends, from 0 to 1. A first part that
    /// ends at 0 takes up what the axes lack of the correction where the line begins; a second part that ends at the same place
    /// takes up the play of an axis that turns there.
    /// `at_ends` are its ends in the coordinates of the program.
    ///
    /// # Errors
    /// More parts than a motion may have; an F of the parts that is not known.
    pub(crate) fn parts(
        &mut self,
        motion: &Move,
        at_ends: &[Axes; 2],
        line: Line<'_>,
        parts: &mut Vec<f64>,
    ) -> Result<(), NcError> {
        self.turns = self.turns_of(motion);
        // Also where it begins: parts of a way from elsewhere would lead elsewhere.
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
        let turned = self.turn_up_to(&mut next, 0.0);
        if self.lacks_correction(motion, turned) {
            parts.push(0.0);
        }
        while let Some(ends) = self.turns.turns.get(next).map(|turn| turn.share) {
            self.split(motion, at_ends, [begins, ends], line, parts)?;
            self.turn_up_to(&mut next, ends);
            parts.push(ends);
            begins = ends;
        }
        self.split(motion, at_ends, [begins, 1.0], line, parts)?;
        self.corrector.put_back(sides);
        if parts.len() > 1 {
            self.check_shares(line)?;
        }
        Ok(())
    }

    /// The axes turn that turn up to this share of the motion, from the next turn on. Whether there is any.
    pub(crate) fn turn_up_to(&mut self, next: &mut usize, share: f64) -> bool {
        let first = *next;
        while let Some(turn) = self
            .turns
            .turns
            .get(*next)
            .filter(|turn| turn.share <= share)
        {
            self.corrector.turn(turn);
            *next += 1;
        }
        *next > first
    }

    /// Where axes turn on a straight motion.
    pub(crate) fn turns_of(&self, motion: &Move) -> Turns {
        if !self.corrector.is_bidirectional() {
            return Turns::default();
        }
        let frame = &self.interpreter.frame;
        let [from, to] = [&motion.from, &motion.to].map(|at| frame.to_program(at));
        // What is added to an axis that stands may turn on the way, too.
        let least = if self.corrector.has_play() {
            let ways = (0..9).map(|axis| (motion.to[axis] - motion.from[axis]).abs());
            (ways.fold(0.0, f64::max) / LOOKED_AT_EACH).min(MOST_LOOKED_AT)
        } else {
            1.0
        };
        let steps = steps_of(self.bulge_mm(&from, &to)).max(least);
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "1 to 1024"
        )]
        let steps = steps.ceil().max(1.0) as u32;
        if motion.path == Path::Rapid {
            // It is not split: the carriages go as the control leads them from the one corrected place to the other.
            let [from, to] = [&motion.from, &motion.to].map(|at| {
                let more = frame.moved_in_program(at, &self.corrector.without_play(at));
                let at = frame.to_program(at);
                each(|axis| at[axis] + more[axis])
            });
            let carriages = |share| frame.to_machine(&between(&from, &to, share));
            return self.corrector.turns(steps, |share| {
                let (at, carriage) = (self.place_of(motion, share), carriages(share));
                each(|axis| {
                    if self.corrector.lags(axis) {
                        carriage[axis]
                    } else {
                        at[axis]
                    }
                })
            });
        }
        let nominal = |share| self.place_of(motion, share);
        self.corrector
            .turns(steps, self.corrector.carriages(steps, nominal))
    }

    /// The axes at a share of a straight motion.
    pub(crate) fn place_of(&self, motion: &Move, share: f64) -> Axes {
        if share == 0.0 || share == 1.0 {
            return if share == 0.0 { motion.from } else { motion.to };
        }
        let frame = &self.interpreter.frame;
        let [from, to] = [&motion.from, &motion.to].map(|at| frame.to_program(at));
        frame.to_machine(&between(&from, &to, share))
    }

    /// Appends the parts between two shares of a straight motion.
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
            // Halves of halves, from the beginning on.
            let mut open = halves([begins, ends]).to_vec();
            while let Some([from, to]) = open.pop() {
                if parts.len() + open.len() >= MOST_PARTS {
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

    /// Whether the axes stand further from where a motion is to begin than they may: where an axis `turns`, than words round, since
    /// its play is to be taken up; with another tool in the spindle, or where the axes came here without a correction, than the
    /// tolerance and the rounding of words let them.
    pub(crate) fn lacks_correction(&self, motion: &Move, turns: bool) -> bool {
        if self.settled == Settled::Yes && !turns || self.contour != Contour::None {
            return false;
        }
        let delta = self.corrector.at(&motion.from).with_rotary(&self.carried);
        if turns || self.settled == Settled::Turned {
            let frame = &self.interpreter.frame;
            let [wanted, carried] =
                [&delta, &self.carried].map(|by| frame.moved_in_program(&motion.from, by));
            return (0..9).any(|axis| {
                let missing = (wanted[axis] - carried[axis]).abs();
                !is_rotary(axis) && missing >= 0.5 * self.step_mm()
            });
        }
        let linear = (0..9).filter(|axis| !is_rotary(*axis) && self.corrector.corrects(*axis));
        let squared: f64 = linear
            .map(|axis| (delta[axis] - self.carried[axis]).powi(2))
            .sum();
        squared.sqrt() > self.corrector.split_beyond_mm() + self.step_mm()
    }

    /// A spline, or a control point of one: its end goes by the correction that the axes have where it begins, as its other points do, which
    /// are ways from its ends.
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
            writes: [Writes::IfChanged; 9],
            keeps: [true; 9],
            rounded: None,
        };
        let words = self.words_to(&leg, &mut carried);
        let part = Part {
            place: 0,
            share: 1.0,
            numbers: &words,
            words: &motion.words,
            others: &[],
            code: None,
            feed: None,
            shape: Shape::AsItIs,
            polar: None,
            before: &[],
        };
        self.write_part(&part, line, out);
        self.carried = self.interpreter.frame.moved_in_machine(&to, &carried);
        self.corrector.goes(&motion.to);
        self.settled = Settled::No;
    }

    /// A straight motion in parts, whose ends are these in the coordinates of the program.
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
        let mut carried = frame.moved_in_program(&motion.from, &self.carried);
        let (mut before, mut passed) = (from, 0.0);
        let mut next = 0;
        // What is not taken up by a block of its own is spread over the motion.
        let is_cut =
            (self.turns.turns.iter()).all(|turn| turn.share == 0.0 || parts.contains(&turn.share));
        self.turn_up_to(&mut next, if is_cut { 0.0 } else { 1.0 });
        let keeps_polar = !splits && self.keeps_polar(motion, &[from, end], &carried);
        let shape = if keeps_polar {
            Shape::AsItIs
        } else {
            Shape::Straight
        };
        let keeps = self.keeps_in_plane(motion);
        let together = self.rounded_together(motion, parts, line);
        for (place, &share) in parts.iter().enumerate() {
            let is_last = share == 1.0;
            self.turn_up_to(&mut next, passed);
            let to = if is_last {
                end
            } else {
                between(&from, &end, share)
            };
            let at = if is_last {
                motion.to
            } else {
                self.interpreter.frame.to_machine(&to)
            };
            let writes = each(|axis| {
                let is_new = place == 0 || motion.incremental[axis] || to[axis] != before[axis];
                let only_takes_up = place > 0 && share == passed;
                match splits {
                    _ if motion.polar.is_some() && axis < 2 && !only_takes_up => {
                        polar_writes(keeps_polar)
                    }
                    true if is_new => Writes::Anew,
                    true => Writes::IfMoves,
                    false => Writes::IfChanged,
                }
            });
            let leg = Leg {
                motion,
                line,
                from: before,
                to,
                at,
                writes,
                keeps,
                rounded: together.as_ref().map(|deltas| deltas[place]),
            };
            let words = self.words_to(&leg, &mut carried);
            if keeps_polar {
                carried[..2].fill(0.0);
            }
            if place > 0 && share == passed && words.iter().all(Option::is_none) {
                // There is nothing to take up.
                continue;
            }
            let feed = splits.then(|| self.feed_of_part(share - passed)).flatten();
            let part = Part {
                place,
                share,
                numbers: &words,
                words: &motion.words,
                others: &[],
                code: None,
                feed,
                shape,
                polar: motion.polar,
                before: &[],
            };
            self.write_part(&part, line, out);
            (before, passed) = (to, share);
        }
        self.carried = self.interpreter.frame.moved_in_machine(&end, &carried);
        self.has_moved(motion);
        if keeps.contains(&true) {
            self.unsettles();
        }
    }
}
