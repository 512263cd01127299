//! Canned cycles: the hole is corrected, its depth and its plane R go along.

use crate::{
    NcError,
    coordinates::LETTERS,
    legs::{Leg, Writes},
    line::{Line, write_comment},
    motion::{Move, Path, half_deep},
    number::of_steps,
    parts::Part,
    polar::polar_writes,
    rewrite::Rewriter,
    script::Shape,
    words::{Number, each},
};

impl Rewriter {
    /// The holes of a row that is written by L in G91: the line stays where each of them is off by what the axes carry already,
    /// otherwise each hole gets a line of its own.
    pub(crate) fn row(
        &mut self,
        holes: &[&Move],
        line: Line<'_>,
        out: &mut Vec<u8>,
    ) -> Result<(), NcError> {
        let stays = self.row_stays(holes);
        if !stays {
            write_comment(line.text, out);
            out.extend_from_slice(line.more);
            self.counts.added += 1;
        }
        for (place, motion) in holes.iter().enumerate() {
            self.counts.motions += 1;
            self.tell(motion, line.number)?;
            self.note_axes(motion, line);
            self.corrector.wraps(&motion.wraps);
            if let Path::Hole {
                bottom,
                clearance,
                depth,
            } = motion.path
            {
                let hole = InRow { place, stays };
                self.hole(motion, depth, [bottom, clearance], hole, line, out);
            }
            self.ends_part(1.0);
        }
        Ok(())
    }

    /// Whether the correction of each of these holes is the one that the axes carry, to half a step of their words.
    fn row_stays(&self, holes: &[&Move]) -> bool {
        let Some(first) = holes.first() else {
            return true;
        };
        let frame = &self.interpreter.frame;
        let carried = frame.moved_in_program(&first.from, &self.carried);
        let unit_mm = self.interpreter.modal.unit_mm;
        let mut corrector = self.corrector.clone();
        holes.iter().all(|hole| {
            let Path::Hole {
                bottom,
                clearance,
                depth,
            } = hole.path
            else {
                return true;
            };
            let end = frame.to_program(&hole.to);
            let middle = frame.to_machine(&half_deep(&end, depth, [bottom, clearance]));
            corrector.goes(&middle);
            if hole.polar.is_some() && !self.keeps_polar(hole, &[], &carried) {
                return false;
            }
            let delta = frame.moved_in_program(&middle, &corrector.at(&middle).delta);
            (0..9).all(|axis| {
                let by_cycle = self.carried_by_cycle.filter(|_| axis == depth);
                let carried = by_cycle.unwrap_or(carried[axis]);
                let half = 0.5 * of_steps(1, self.decimals.of(axis, unit_mm));
                let off = (delta[axis] - carried) / self.interpreter.modal.scale(axis);
                off.abs() < half || !self.corrector.has(axis)
            })
        })
    }

    /// A hole of a cycle.
    pub(crate) fn hole(
        &mut self,
        motion: &Move,
        depth: usize,
        places: [f64; 2],
        InRow { place, stays }: InRow,
        line: Line<'_>,
        out: &mut Vec<u8>,
    ) {
        let frame = self.interpreter.frame.clone();
        let mut carried = frame.moved_in_program(&motion.from, &self.carried);
        let [before, end] = [&motion.from, &motion.to].map(|at| frame.to_program(at));
        let middle = frame.to_machine(&half_deep(&end, depth, places));
        self.corrector.goes(&middle);
        let in_own_line = place > 0 && !stays;
        let keeps_polar =
            !in_own_line && self.keeps_polar(motion, &[half_deep(&end, depth, places)], &carried);
        let mut writes = if in_own_line {
            each(|axis| match motion.words[axis] {
                Some(_) => Writes::Anew,
                None => Writes::IfMoves,
            })
        } else {
            [Writes::IfChanged; 9]
        };
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
        let mut depths = Vec::new();
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
            let (words, carried_by_cycle) = self.depth(&hole, depth, line);
            depths = words;
            let is_up = self.interpreter.modal.comes_back && clearance <= initial;
            carried[depth] = if is_up { at_initial } else { carried_by_cycle };
        }
        self.carried = frame.moved_in_machine(&end, &carried);
        // The tool may be above the hole, with the correction of its middle.
        self.unsettles();
        if place > 0 && stays {
            return;
        }
        if place == 0 {
            for (letter, number) in depths.drain(..) {
                self.edits.set(letter, line.place_of(letter), number);
            }
            if !stays {
                self.edits.removed.extend(line.place_of(b'L'));
            }
        }
        let part = Part {
            place,
            share: 1.0,
            numbers: &words.numbers,
            words: &motion.words,
            others: &depths,
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
    }

    /// The words for the depth of a cycle and its plane R that change, and what of the correction R stands for then.
    fn depth(&mut self, hole: &Hole, depth: usize, line: Line<'_>) -> (Vec<(u8, Number)>, f64) {
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
            return (Vec::new(), carried);
        }
        let mut words = Vec::new();
        let mut carried = by_initial + delta;
        for (letter, at) in &hole.places {
            let word = line.place_of(*letter);
            let of_word = line.word(word).and_then(|word| word.decimals).unwrap_or(0);
            let value = (at + delta) / scale;
            if let Some(number) = Number::nearest(value, decimals.max(of_word)) {
                carried = by_initial + number.value() * scale - at;
                words.push((*letter, number));
            }
        }
        self.carried_by_cycle = Some(carried);
        (words, carried)
    }
}

/// Which hole of a row it is, counted from 0, and whether the line of the row stays as it is.
#[derive(Clone, Copy, Debug)]
pub(crate) struct InRow {
    pub(crate) place: usize,
    pub(crate) stays: bool,
}

impl InRow {
    /// A hole that is no part of a row.
    pub(crate) const ALONE: Self = Self {
        place: 0,
        stays: true,
    };
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
