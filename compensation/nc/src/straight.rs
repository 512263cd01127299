//! Straight motions with their correction, in as many parts as it needs.

use crate::{
    coordinates::{Axes, is_rotary},
    legs::{Leg, Writes},
    line::Line,
    motion::Move,
    parts::Part,
    polar::polar_writes,
    rewrite::{Contour, Rewriter},
    script::Shape,
    words::{between, each},
};

/// A motion is split into so many parts at the most.
pub(crate) const MOST_PARTS: usize = 4096;
/// In so many equal parts a motion of the centre point is looked at for axes that turn.
const LOOKED_AT: u32 = 64;

impl Rewriter {
    /// The parts of a straight line within which the correction is straight, too: where each ends, from 0 to 1. A first part that
    /// ends at 0 takes up what the axes lack of the correction where the line begins; a second part that ends at the same place
    /// takes up the play of an axis that turns there.
    pub(crate) fn parts(&mut self, motion: &Move) -> Vec<f64> {
        let mut parts = Vec::new();
        let is_known = (0..9).all(|axis| self.interpreter.known[axis] || !self.corrector.has(axis));
        if !is_known || self.contour == Contour::Switches {
            parts.push(1.0);
            return parts;
        }
        let turns_at = self.turning_points(motion);
        let sides = self.corrector.sides();
        let mut begins = 0.0;
        for (place, ends) in turns_at.iter().copied().chain([1.0]).enumerate() {
            let at = self.place_of(motion, ends);
            let turns = self.corrector.goes(&at);
            if place > 0 || self.lacks_correction(motion, turns) {
                parts.push(begins);
            }
            self.split(motion, [begins, ends], &mut parts);
            begins = ends;
        }
        if !turns_at.is_empty() {
            self.corrector.put_back(sides);
        }
        parts
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

    /// Where linear axes with play turn while the centre point of the tool goes straight, from 0 to 1.
    pub(crate) fn turning_points(&self, motion: &Move) -> Vec<f64> {
        let frame = &self.interpreter.frame;
        let mut found = Vec::new();
        if frame.tip.is_none()
            || !self.corrector.is_bidirectional()
            || self.contour != Contour::None
        {
            return found;
        }
        let [from, to] = [&motion.from, &motion.to].map(|at| frame.to_program(at));
        // An axis that turns is at least so far from its straight way.
        let least = (0..3).map(|axis| self.corrector.turned_after(axis));
        if self.bulge_mm(&from, &to) <= least.fold(f64::INFINITY, f64::min) {
            return found;
        }
        let at = |share: f64| frame.to_machine(&between(&from, &to, share));
        let share = |place: u32| f64::from(place) / f64::from(LOOKED_AT);
        let places: Vec<Axes> = (0..=LOOKED_AT).map(|place| at(share(place))).collect();
        for axis in 0..3 {
            let turned_after = self.corrector.turned_after(axis);
            // The sign of the motion, and the furthest place of it.
            let (mut sign, mut furthest) = (0.0, 0);
            for place in 1..=LOOKED_AT {
                let way = |from: u32| places[place as usize][axis] - places[from as usize][axis];
                if sign == 0.0 {
                    if way(0).abs() > turned_after {
                        (sign, furthest) = (way(0).signum(), place);
                    }
                } else if sign * way(furthest) > 0.0 {
                    furthest = place;
                } else if sign * way(furthest) < -turned_after {
                    // By thirds around it: one extremum is there.
                    let (mut low, mut high) =
                        (share(furthest.saturating_sub(1)), share(furthest + 1));
                    for _ in 0..40 {
                        let (first, second) = ((2.0 * low + high) / 3.0, (low + 2.0 * high) / 3.0);
                        if sign * at(first)[axis] < sign * at(second)[axis] {
                            low = first;
                        } else {
                            high = second;
                        }
                    }
                    found.push(0.5 * (low + high));
                    (sign, furthest) = (-sign, place);
                }
            }
        }
        found.retain(|share| (1e-6..1.0 - 1e-6).contains(share));
        found.sort_by(f64::total_cmp);
        found.dedup_by(|a, b| *a - *b < 1e-6);
        found
    }

    /// Appends the parts between two shares of a straight motion.
    fn split(&mut self, motion: &Move, [begins, ends]: [f64; 2], parts: &mut Vec<f64>) {
        let mut seen = std::mem::take(&mut self.seen);
        let frame = &self.interpreter.frame;
        let (from, to) = (frame.to_program(&motion.from), frame.to_program(&motion.to));
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
                let is_end = parts.len() + open.len() >= MOST_PARTS || to - from < 1e-6;
                if is_end || is_straight([from, to]) {
                    parts.push(to);
                } else {
                    open.extend(halves([from, to]));
                }
            }
        }
        self.seen = seen;
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
        let turns_on_the_way = parts.windows(2).any(|pair| pair[0] == pair[1]);
        if !turns_on_the_way {
            self.corrector.goes(&motion.to);
        }
        let keeps_polar = motion.polar && !splits && self.keeps_polar(&[from, end], &carried);
        let shape = if keeps_polar {
            Shape::AsItIs
        } else {
            Shape::Straight
        };
        let together = self.rounded_together(motion, parts, line);
        for (place, &share) in parts.iter().enumerate() {
            let is_last = share == 1.0;
            if turns_on_the_way {
                // What takes up the play sets out for the end of the next part, and for the place where the next axis turns.
                let rest = parts[place..].windows(2);
                let mut turns = rest.filter(|pair| pair[0] == pair[1] && pair[0] > passed);
                let turns = turns.next().map_or(1.0, |pair| pair[0]);
                let [here, there] = [passed, turns].map(|share| self.place_of(motion, share));
                self.corrector.faces(&here, &there);
                let ends = parts[place..].iter().find(|ends| **ends > passed);
                let sets_out = self.place_of(motion, ends.copied().unwrap_or(1.0));
                self.corrector.goes(&sets_out);
            }
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
                match splits {
                    _ if motion.polar && axis < 2 => polar_writes(keeps_polar),
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
                keeps: [false; 9],
                rounded: together.as_ref().map(|deltas| deltas[place]),
            };
            let words = self.words_to(&leg, &mut carried);
            if keeps_polar {
                carried[..2].fill(0.0);
            }
            if place > 0 && share == passed && words.numbers.iter().all(Option::is_none) {
                // There is nothing to take up.
                continue;
            }
            let feed = splits.then(|| self.feed_of_part(share - passed)).flatten();
            let part = Part {
                place,
                share,
                numbers: &words.numbers,
                words: &motion.words,
                others: &[],
                feed,
                shape,
                before: &[],
            };
            self.write_part(&part, line, out);
            (before, passed) = (to, share);
        }
        self.carried = self.interpreter.frame.moved_in_machine(&end, &carried);
        self.is_settled = true;
    }
}
