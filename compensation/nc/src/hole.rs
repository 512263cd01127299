//! Canned cycles: the hole is corrected, its depth and its plane R go along.

use crate::{
    NcError,
    coordinates::LETTERS,
    legs::{Leg, Writes},
    line::Line,
    motion::{Move, half_deep},
    number::of_steps,
    parts::Part,
    polar::polar_writes,
    rewrite::Rewriter,
    script::Shape,
    words::{Number, each},
};

impl Rewriter {
    /// The last hole of a cycle that is done `repeats` times.
    pub(crate) fn hole(
        &mut self,
        motion: &Move,
        depth: usize,
        places: [f64; 2],
        repeats: u32,
        line: Line<'_>,
        out: &mut Vec<u8>,
    ) -> Result<(), NcError> {
        let frame = self.interpreter.frame.clone();
        let mut carried = frame.moved_in_program(&motion.from, &self.carried);
        let [before, end] = [&motion.from, &motion.to].map(|at| frame.to_program(at));
        let middle = frame.to_machine(&half_deep(&end, depth, places));
        self.corrector.goes(&middle);
        if repeats > 1 && motion.incremental.contains(&true) {
            let first = each(|axis| before[axis] + (end[axis] - before[axis]) / f64::from(repeats));
            let [first, last] =
                [&first, &end].map(|at| self.delta_in_program(&half_deep(at, depth, places)));
            let differs = |axis: usize| {
                let decimals = self.decimals.of(axis, self.interpreter.modal.unit_mm);
                (last[axis] - first[axis]).abs() >= 0.5 * of_steps(1, decimals)
            };
            if (0..9).any(differs) {
                return Err(NcError::NotCompensated {
                    line: line.number,
                    what: "a row of holes by L in G91 whose corrections differ: write each hole in a line of its own".to_owned(),
                });
            }
        }
        let keeps_polar = self.keeps_polar(motion, &[half_deep(&end, depth, places)], &carried);
        let mut writes = [Writes::IfChanged; 9];
        if motion.polar.is_some() {
            writes[..2].fill(polar_writes(keeps_polar));
        }
        writes[depth] = Writes::Never;
        let leg = Leg {
            motion,
            line,
            from: before,
            to: end,
            at: middle,
            writes,
            keeps: [false; 9],
            rounded: None,
        };
        let words = self.words_to(&leg, &mut carried);
        if keeps_polar {
            carried[..2].fill(0.0);
        }
        if self.interpreter.known[depth] && self.corrector.corrects(depth) {
            let initial = self.interpreter.modal.sticky.initial;
            let initial = initial.unwrap_or(before[depth]);
            let at_initial = *self.carried_at_initial.get_or_insert(carried[depth]);
            let [bottom, clearance] = places;
            let hole = if motion.incremental[depth] {
                // The depth counts from R, and goes along with it.
                Hole {
                    delta: words.delta[depth] - at_initial,
                    places: vec![(b'R', clearance - initial)],
                    by_initial: at_initial,
                }
            } else {
                Hole {
                    delta: words.delta[depth],
                    places: vec![(LETTERS[depth], bottom), (b'R', clearance)],
                    by_initial: 0.0,
                }
            };
            let carried_by_cycle = self.depth(&hole, depth, line);
            let is_up = self.interpreter.modal.comes_back && clearance <= initial;
            carried[depth] = if is_up { at_initial } else { carried_by_cycle };
        }
        let part = Part {
            place: 0,
            share: 1.0,
            numbers: &words.numbers,
            words: &motion.words,
            others: &[],
            code: None,
            feed: None,
            shape: if keeps_polar {
                Shape::AsItIs
            } else {
                Shape::Straight
            },
            polar: motion.polar,
            before: &[],
        };
        self.write_part(&part, line, out);
        self.carried = frame.moved_in_machine(&end, &carried);
        // The tool may be above the hole, with the correction of its middle.
        self.unsettles();
        Ok(())
    }

    /// The depth of a cycle and its plane R, with a correction; what of it R stands for then.
    fn depth(&mut self, hole: &Hole, depth: usize, line: Line<'_>) -> f64 {
        let Hole {
            delta, by_initial, ..
        } = *hole;
        let scale = self.interpreter.modal.scale(depth);
        let decimals = self.decimals.of(depth, self.interpreter.modal.unit_mm);
        let half = 0.5 * of_steps(1, decimals);
        let is_named = hole
            .places
            .iter()
            .any(|(letter, _)| line.place_of(*letter).is_some());
        let carried = self.carried_by_cycle.unwrap_or(by_initial);
        let changes = ((delta + by_initial - carried) / scale).abs() >= half
            || is_named && (delta / scale).abs() >= half;
        if !changes {
            let carried = if is_named { by_initial } else { carried };
            self.carried_by_cycle = Some(carried);
            return carried;
        }
        let mut carried = by_initial + delta;
        for (letter, at) in &hole.places {
            let word = line.place_of(*letter);
            let of_word = line.word(word).and_then(|word| word.decimals).unwrap_or(0);
            let value = (at + delta) / scale;
            if let Some(number) = Number::nearest(value, decimals.max(of_word)) {
                carried = by_initial + number.value() * scale - at;
                self.edits.set(*letter, word, number);
            }
        }
        self.carried_by_cycle = Some(carried);
        carried
    }
}

/// What a cycle goes down by: its words, with the correction that belongs to them.
struct Hole {
    /// What its words are to change by, mm.
    delta: f64,
    /// The letters and the numbers of its words without a correction, mm.
    places: Vec<(u8, f64)>,
    /// The correction that is in the place from which they count.
    by_initial: f64,
}
