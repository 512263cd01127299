//! Straight motions with their correction, in as many parts as it needs.

use crate::{
    coordinates::{Axes, is_rotary},
    legs::{Leg, Writes},
    line::Line,
    motion::Move,
    parts::Part,
    rewrite::{Contour, Rewriter},
    words::{between, each},
};

/// A motion is split into so many parts at the most.
pub(crate) const MOST_PARTS: usize = 4096;

impl Rewriter {
    /// The parts of a straight line within which the correction is straight, too: where each ends, from 0 to 1. A first part that
    /// ends at 0 takes up what the axes lack of the correction where the line begins.
    pub(crate) fn parts(&mut self, motion: &Move) -> Vec<f64> {
        let mut parts = Vec::new();
        let is_known = (0..9).all(|axis| self.interpreter.known[axis] || !self.corrector.has(axis));
        let turns = self.corrector.goes(&motion.to);
        if !is_known || self.contour == Contour::Switches {
            parts.push(1.0);
            return parts;
        }
        if self.lacks_correction(motion, turns) {
            parts.push(0.0);
        }
        let frame = &self.interpreter.frame;
        let (from, to) = (frame.to_program(&motion.from), frame.to_program(&motion.to));
        let mut seen = std::mem::take(&mut self.seen);
        let mut is_straight = |[first, last]: [f64; 2]| {
            let ends = [first, last].map(|share| between(&from, &to, share));
            let place = |share: f64, at: &Axes| match share {
                0.0 => motion.from,
                1.0 => motion.to,
                _ => frame.to_machine(at),
            };
            let (start, end) = (place(first, &ends[0]), place(last, &ends[1]));
            let bulge_mm = self.bulge_mm(&ends[0], &ends[1]);
            // A control that moves the centre point of the tool keeps it where it is whatever the rotary axes do.
            let coupled_mm = if frame.tip.is_some() {
                0.0
            } else {
                self.corrector.coupled_mm(&mut seen, &start, &end)
            };
            self.corrector
                .is_straight(&start, &end, bulge_mm, coupled_mm)
        };
        if is_straight([0.0, 1.0]) {
            parts.push(1.0);
            self.seen = seen;
            return parts;
        }
        // Halves of halves, from the beginning on.
        let mut open = vec![[0.5, 1.0], [0.0, 0.5]];
        while let Some([from, to]) = open.pop() {
            let is_end = parts.len() + open.len() >= MOST_PARTS || to - from < 1e-6;
            if is_end || is_straight([from, to]) {
                parts.push(to);
            } else {
                let middle = 0.5 * (from + to);
                open.push([middle, to]);
                open.push([from, middle]);
            }
        }
        self.seen = seen;
        parts
    }

    /// Whether the axes stand further from where a motion is to begin than the tolerance and the rounding of words let them: an
    /// axis `turns`, and its play is to be taken up; another tool is in the spindle; or the axes came here without a correction.
    pub(crate) fn lacks_correction(&self, motion: &Move, turns: bool) -> bool {
        if self.is_settled && !turns || self.contour != Contour::None {
            return false;
        }
        let delta = self.corrector.at(&motion.from).with_rotary(&self.carried);
        let linear = (0..9).filter(|axis| !is_rotary(*axis) && self.corrector.corrects(*axis));
        let squared: f64 = linear
            .map(|axis| (delta[axis] - self.carried[axis]).powi(2))
            .sum();
        squared.sqrt() > self.corrector.split_beyond_mm() + self.step_mm()
    }

    /// A straight motion in parts.
    pub(crate) fn straight(
        &mut self,
        motion: &Move,
        parts: &[f64],
        line: Line<'_>,
        out: &mut Vec<u8>,
    ) {
        let frame = &self.interpreter.frame;
        let splits = parts.len() > 1;
        let [from, end] = [&motion.from, &motion.to].map(|at| frame.to_program(at));
        let mut carried = frame.moved_in_program(&motion.from, &self.carried);
        let (mut before, mut passed) = (from, 0.0);
        self.corrector.goes(&motion.to);
        for (place, &share) in parts.iter().enumerate() {
            let is_last = share == 1.0;
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
                if splits && is_new {
                    Writes::Anew
                } else {
                    Writes::IfChanged
                }
            });
            let leg = Leg {
                motion,
                line,
                from: before,
                to,
                at,
                writes,
                keeps: [false; 9],
            };
            let words = self.words_to(&leg, &mut carried);
            let feed = splits.then(|| self.feed_of_part(share - passed)).flatten();
            let part = Part {
                place,
                share,
                numbers: &words.numbers,
                words: &motion.words,
                others: &[],
                feed,
            };
            self.write_part(&part, line, out);
            (before, passed) = (to, share);
        }
        self.carried = self.interpreter.frame.moved_in_machine(&end, &carried);
        self.is_settled = true;
    }
}
