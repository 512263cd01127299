//! Canned cycles: the hole is corrected together with its depth and its plane R. Unsupported cycles are copied unchanged.

use crate::{
    NcError,
    coordinates::{Axes, LETTERS, each},
    interpreter::Outcome,
    line::{Line, Shape, write_comment},
    motion::{Move, Path, at_height, half_deep},
    number::{Number, half_step},
    rewrite::Rewriter,
    straight::{Leg, Part, WriteRule, polar_writes},
};

impl Rewriter {
    /// Writes a row of holes (L in G91). The line stays if the correction already applied fits every hole; otherwise each hole gets its own
    /// line.
    pub(crate) fn row(
        &mut self,
        holes: &[&Move],
        line: Line<'_>,
        out: &mut Vec<u8>,
    ) -> Result<(), NcError> {
        if let Some(first) = holes.first() {
            self.corrector.begin_motion(&first.arrives_from_unknown);
        }
        let stays = self.row_stays(holes);
        if !stays {
            write_comment(line.text, out);
            out.extend_from_slice(line.more);
            self.counts.added += 1;
        }
        for (place, motion) in holes.iter().enumerate() {
            self.counts.motions += 1;
            self.send_motion(motion, line.number, motion.cuts())?;
            self.note_axes(motion, line);
            self.corrector.apply_wraps(&motion.wraps);
            self.hole(motion, (place, stays), line, out);
            self.record_part_end(1.0);
            self.note_zero(line.number);
            self.note_approach(line.number);
        }
        self.note_unstated(line.number);
        Ok(())
    }

    /// True if the correction of each hole equals the applied correction, within half a step of the hole's words.
    fn row_stays(&self, holes: &[&Move]) -> bool {
        let Some(first) = holes.first() else {
            return true;
        };
        let frame = &self.interpreter.frame;
        let carried = frame.moved_in_program(&first.from, &self.carried);
        let mut corrector = self.corrector.clone();
        holes.iter().all(|hole| {
            let Path::Hole { bottom, clearance, depth } = hole.path else {
                return true;
            };
            let end = frame.to_program(&hole.to);
            let at = |height| frame.to_machine(&at_height(&end, depth, height));
            let middle = frame.to_machine(&half_deep(&end, depth, [bottom, clearance]));
            corrector.move_to(&at(clearance));
            corrector.move_to(&middle);
            if hole.polar.is_some() && !self.keeps_polar(hole, &[], &carried) {
                return false;
            }
            let delta_at = |at: &Axes| frame.moved_in_program(at, &corrector.at(at).delta);
            let modal = &self.interpreter.modal;
            let is_kept_in = |scale: f64, axis: usize, off: f64| {
                !self.corrector.has(axis) || (off / scale).abs() < self.half_step(axis)
            };
            let is_kept = |axis: usize, off: f64| is_kept_in(modal.scale(axis), axis, off);
            let delta = delta_at(&middle);
            let mut across = (0..9).filter(|axis| *axis != depth);
            let at_initial = self.carried_at_initial.unwrap_or(carried[depth]);
            let [at_bottom, at_clearance] =
                [bottom, clearance].map(|height| delta_at(&at(height))[depth] - at_initial);
            let [of_bottom, of_clearance] = self.carried_by_cycle;
            let of_r = modal.height_scale(b'R', depth);
            // In an incremental row the depth counts from R.
            across.all(|axis| is_kept(axis, delta[axis] - carried[axis]))
                && is_kept_in(of_r, depth, at_clearance - of_clearance)
                && is_kept(depth, at_bottom - of_bottom - of_clearance)
        })
    }

    /// Writes one hole of a cycle. `place` is its index in the row; `stays` is true if the line of the row is unchanged.
    pub(crate) fn hole(
        &mut self,
        motion: &Move,
        (place, stays): (usize, bool),
        line: Line<'_>,
        out: &mut Vec<u8>,
    ) {
        let Path::Hole { bottom, clearance, depth } = motion.path else {
            return;
        };
        let places = [bottom, clearance];
        let frame = self.interpreter.frame.clone();
        let mut carried = frame.moved_in_program(&motion.from, &self.carried);
        let [before, end] = [&motion.from, &motion.to].map(|at| frame.to_program(at));
        let middle = frame.to_machine(&half_deep(&end, depth, places));
        // Approach from R, where the drilling motion starts even if the tool moved up to R before.
        self.corrector.move_to(&frame.to_machine(&at_height(&end, depth, clearance)));
        self.corrector.move_to(&middle);
        let in_own_line = place > 0 && !stays;
        let keeps_polar =
            !in_own_line && self.keeps_polar(motion, &[half_deep(&end, depth, places)], &carried);
        let mut writes = if in_own_line {
            // A line without axis words is not a hole.
            let across = |axis: &usize| *axis != depth;
            let names = (0..9).filter(across).any(|axis| motion.words[axis].is_some());
            let stands = (0..9).filter(across).find(|axis| self.corrector.has(*axis));
            each(|axis| match motion.words[axis] {
                Some(_) => WriteRule::Anew,
                None if !names && stands == Some(axis) => WriteRule::Always,
                None => WriteRule::IfMoves,
            })
        } else {
            [WriteRule::IfChanged; 9]
        };
        if motion.polar.is_some() {
            writes[..2].fill(polar_writes(keeps_polar));
        }
        writes[depth] = WriteRule::Never;
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
        // Absolute depth and R do not depend on the start position; incremental ones do.
        let is_known = self.interpreter.known[depth] || !motion.incremental[depth];
        let mut depths = if is_known && self.corrector.corrects[depth] {
            self.heights(motion, &mut carried, (line, in_own_line))
        } else {
            Vec::new()
        };
        self.carried = frame.moved_in_machine(&end, &carried);
        // After the cycle the tool may be above the hole, with the correction for half the depth, and has approached
        // from the bottom.
        self.mark_outdated();
        let at_bottom = frame.to_machine(&at_height(&end, depth, bottom));
        self.corrector.move_to(&at_bottom);
        let drives = [&at_bottom, &motion.to].map(|at| each(|axis| at[axis] + self.carried[axis]));
        self.corrector.move_uncorrected(&motion.to, [&drives[0], &drives[1]]);
        if place > 0 && stays {
            return;
        }
        if place == 0 {
            for (letter, number) in depths.drain(..) {
                self.edits.set(letter, line.place_of(letter), number);
            }
            if !stays {
                let (letter, _) = self.interpreter.repeats_by();
                self.edits.removed.extend(line.place_of(letter));
            }
        }
        let shape = if keeps_polar { Shape::AsItIs } else { Shape::Straight };
        let part = Part { place, others: &depths, ..Part::whole(motion, &words, shape) };
        self.write_part(&part, line, out);
    }

    /// The words of depth and plane R that change; `carried` becomes the correction applied along the depth axis after the hole.
    fn heights(
        &mut self,
        motion: &Move,
        carried: &mut Axes,
        (line, in_own_line): (Line<'_>, bool),
    ) -> Vec<(u8, Number)> {
        let Path::Hole { bottom, clearance, depth } = motion.path else {
            return Vec::new();
        };
        // Incremental: R counts from the start of the first hole, the depth from R.
        let counts_from_r = motion.incremental[depth];
        let [before, end] = self.ends_of(motion);
        let frame = self.interpreter.frame.clone();
        // Rotary axes are at their rounded positions.
        let [at_bottom, at_clearance] = [bottom, clearance].map(|height| {
            let at = frame.to_machine(&at_height(&end, depth, height));
            let in_program = frame.to_program(&at);
            self.words_at([&at, &in_program], None, &mut carried.clone(), |_, _, _, _| ())[depth]
        });
        let initial = self.interpreter.modal.sticky.initial;
        let initial = initial.unwrap_or(before[depth]);
        let at_initial = *self.carried_at_initial.get_or_insert(carried[depth]);
        let [of_bottom, of_clearance] = self.carried_by_cycle;
        let (zero, carried_at_zero) =
            if counts_from_r { (initial, at_initial) } else { (0.0, 0.0) };
        // A tool that is not above R is first lifted to the G98 plane by LinuxCNC, so the corrected R must not be below
        // the tool.
        let stands = before[depth] + carried[depth] - clearance;
        let lifts = self.interpreter.modal.comes_back && clearance >= before[depth];
        let at_clearance = if lifts { at_clearance.max(stands) } else { at_clearance };
        let plane = [clearance - zero, at_clearance - carried_at_zero, of_clearance];
        let (plane, of_clearance) = self.in_cycle(b'R', depth, plane, (line, in_own_line));
        let (zero, carried_at_plane) =
            if counts_from_r { (clearance, of_clearance + carried_at_zero) } else { (0.0, 0.0) };
        let ground = [bottom - zero, at_bottom - carried_at_plane, of_bottom];
        let (ground, of_bottom) = self.in_cycle(LETTERS[depth], depth, ground, (line, in_own_line));
        self.carried_by_cycle = [of_bottom, of_clearance];
        let heights =
            [(bottom, of_bottom + carried_at_plane), (clearance, of_clearance + carried_at_zero)];
        for (height, by) in heights {
            let mut there = *carried;
            there[depth] = by;
            self.check_bounds(&at_height(&end, depth, height), &there);
        }
        let is_up = self.interpreter.modal.comes_back && clearance <= initial;
        carried[depth] = if is_up { at_initial } else { of_clearance + carried_at_zero };
        [ground, plane].into_iter().flatten().collect()
    }

    /// The new number of a cycle's height word (`None`: unchanged), and the correction that the
    /// height then contains, mm. `is` is the programmed value, and `delta` the required correction.
    /// `carried` is the correction in the persistent value, which applies if the block lacks the
    /// word; mm.
    fn in_cycle(
        &self,
        letter: u8,
        depth: usize,
        [is, delta, carried]: [f64; 3],
        (line, in_own_line): (Line<'_>, bool),
    ) -> (Option<(u8, Number)>, f64) {
        let scale = self.interpreter.modal.height_scale(letter, depth);
        let place = line.place_of(letter).filter(|_| !in_own_line);
        // A word of the block replaces the persistent value with its correction.
        let carried = if place.is_some() { 0.0 } else { carried };
        if ((delta - carried) / scale).abs() < self.half_step(depth) {
            return (None, carried);
        }
        let written = line.word(line.place_of(letter));
        let of_word = written.and_then(|word| word.decimals).unwrap_or(0);
        let numerals = self.numerals(depth, written);
        match numerals.nearest((is + delta) / scale, of_word) {
            Some(number) => (Some((letter, number)), number.value() * scale - is),
            None => (None, carried),
        }
    }

    /// Half a step of the words of an axis, in program units.
    fn half_step(&self, axis: usize) -> f64 {
        half_step(self.numerals(axis, None).decimals)
    }

    /// Updates the state after cycles that are copied unchanged: their axes have no correction applied.
    pub(crate) fn after_cycles(
        &mut self,
        outcome: &Outcome,
        line: Line<'_>,
    ) -> Result<(), NcError> {
        let each = self.interpreter.modal.each_motion.clone();
        let each = each.filter(|_| outcome.motion.is_some());
        if let (Some(cycle), Some(motion)) = (&each, &outcome.motion)
            && matches!(motion.path, Path::Arc(_))
        {
            return Err(NcError::not_compensated(
                line.number,
                format!("an arc after which {} is executed (MCALL)", cycle.name),
            ));
        }
        for cycle in each.iter().chain(&outcome.cycle) {
            self.note_zero(line.number);
            let before = self.interpreter.position;
            let frame = self.interpreter.frame.clone();
            let mut carried = frame.moved_in_program(&before, &self.carried);
            let moved = self.interpreter.after_cycle(cycle, line.number);
            for (carried, moved) in carried.iter_mut().zip(moved) {
                if moved {
                    *carried = 0.0;
                }
            }
            let at = self.interpreter.position;
            // The tool returns from the bottom, whose position is unknown.
            self.corrector.begin_motion(&moved);
            self.corrector.move_to(&at);
            self.carried = frame.moved_in_machine(&frame.to_program(&at), &carried);
            self.mark_outdated();
        }
        Ok(())
    }
}
