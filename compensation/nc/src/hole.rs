//! Canned cycles: the hole is corrected, its depth and its plane R go along.

use crate::{
    NcError,
    coordinates::LETTERS,
    legs::{Leg, Writes},
    line::Line,
    motion::{Move, half_deep},
    number::of_steps,
    rewrite::{Part, Rewriter},
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
        let mut writes = [Writes::IfChanged; 9];
        writes[depth] = Writes::Never;
        let leg = Leg {
            motion,
            line,
            from: before,
            to: end,
            at: middle,
            writes,
        };
        let words = self.words_to(&leg, &mut carried);
        let is_known = self.interpreter.known[depth] && self.corrector.corrects(depth);
        if is_known && !motion.incremental[depth] {
            self.depth(words.delta[depth], depth, places, line);
            if !self.interpreter.modal.comes_back || places[1] > before[depth] {
                carried[depth] = self.carried_by_cycle;
            }
        }
        let part = Part {
            place: 0,
            share: 1.0,
            numbers: &words.numbers,
            words: &motion.words,
            feed: None,
        };
        self.write_part(&part, line, out);
        self.carried = frame.moved_in_machine(&end, &carried);
        // The tool may be above the hole, with the correction of its middle.
        self.is_settled = false;
        Ok(())
    }

    /// The depth of a cycle and its plane R, with a correction.
    fn depth(&mut self, delta: f64, depth: usize, places: [f64; 2], line: Line<'_>) {
        let scale = self.interpreter.modal.scale(depth);
        let decimals = self.decimals.of(depth, self.interpreter.modal.unit_mm);
        let half = 0.5 * of_steps(1, decimals);
        let letters = [LETTERS[depth], b'R'];
        let named = letters.map(|letter| line.place_of(letter));
        let is_named = named.iter().any(Option::is_some);
        let changes = ((delta - self.carried_by_cycle) / scale).abs() >= half
            || is_named && (delta / scale).abs() >= half;
        if !changes {
            if is_named {
                self.carried_by_cycle = 0.0;
            }
            return;
        }
        for ((at, word), letter) in places.into_iter().zip(named).zip(letters) {
            let of_word = line.word(word).and_then(|word| word.decimals).unwrap_or(0);
            let value = (at + delta) / scale;
            if let Some(number) = Number::nearest(value, decimals.max(of_word)) {
                self.carried_by_cycle = number.value() * scale - at;
                self.edits.set(letter, word, number);
            }
        }
    }
}
