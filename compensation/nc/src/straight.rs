//! Straight motions with their correction, in as many parts as it needs.

use crate::{
    coordinates::Axes,
    line::Line,
    motion::Move,
    rewrite::{Leg, Part, Rewriter, Writes},
    words::each,
};

/// A motion is split into so many parts at the most.
const MOST_PARTS: usize = 4096;

impl Rewriter {
    /// The parts of a straight line within which the correction is straight, too: where each ends, from 0 to 1. A first part that
    /// ends at 0 takes up the play of an axis that turns.
    pub(crate) fn parts(&mut self, motion: &Move) -> Vec<f64> {
        let mut parts = Vec::new();
        let is_known = (0..9).all(|axis| self.interpreter.known[axis] || !self.corrector.has(axis));
        if self.corrector.jumps(&motion.from, &motion.to) && is_known {
            // An axis turns: its play is taken up before it goes on.
            parts.push(0.0);
        }
        self.corrector.goes(&motion.to);
        if !is_known {
            parts.push(1.0);
            return parts;
        }
        let frame = &self.interpreter.frame;
        let (from, to) = (frame.to_program(&motion.from), frame.to_program(&motion.to));
        let is_straight = |[first, last]: [f64; 2]| {
            let ends = [first, last].map(|share| between(&from, &to, share));
            let [start, end] = [&ends[0], &ends[1]].map(|at| frame.to_machine(at));
            let bulge_mm = self.bulge_mm(&ends[0], &ends[1]);
            self.corrector.is_straight(&start, &end, bulge_mm)
        };
        // Halves of halves, from the beginning on.
        let mut open = vec![[0.0, 1.0]];
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
        parts
    }

    /// A straight motion in parts.
    pub(crate) fn straight(
        &mut self,
        motion: &Move,
        parts: &[f64],
        line: Line<'_>,
        out: &mut Vec<u8>,
    ) {
        let frame = self.interpreter.frame.clone();
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
                frame.to_machine(&to)
            };
            let leg = Leg {
                from: before,
                to,
                at,
            };
            let writes = each(|axis| {
                let is_new = place == 0 || motion.incremental[axis] || to[axis] != before[axis];
                if splits && is_new {
                    Writes::Anew
                } else {
                    Writes::IfChanged
                }
            });
            let words = self.words_to(motion, line, &leg, &writes, &mut carried);
            let feed = splits.then(|| self.feed_of_part(share - passed)).flatten();
            let part = Part {
                place,
                share,
                numbers: &words.numbers,
                words: &motion.words,
                feed,
            };
            self.write_part(&part, line, out);
            (before, passed) = (to, share);
        }
        self.carried = frame.moved_in_machine(&end, &carried);
    }
}

/// The place at a share of a straight way.
fn between(from: &Axes, to: &Axes, share: f64) -> Axes {
    each(|axis| from[axis] + share * (to[axis] - from[axis]))
}
