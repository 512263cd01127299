//! Arcs with their correction: still arcs where the circle through three corrected places fits, else parts of them.

use crate::{
    NcError,
    block::{Manner, Word},
    carried::Settled,
    circle::Written,
    contour::Contour,
    coordinates::Axes,
    legs::{Leg, Writes},
    line::Line,
    motion::{Arc, Move},
    notes::Note,
    parts::{Part, words_of},
    polar::polar_writes,
    rewrite::Rewriter,
    script::Shape,
    stretches::{in_plane, shifted},
    words::{Number, each},
};

impl Rewriter {
    /// An arc.
    #[expect(clippy::too_many_lines, reason = "one part after the other")]
    pub(crate) fn arc(
        &mut self,
        motion: &Move,
        arc: &Arc,
        line: Line<'_>,
        out: &mut Vec<u8>,
    ) -> Result<(), NcError> {
        let frame = self.interpreter.frame.clone();
        let [first, second, _] = arc.axes;
        let [from, to] = [&motion.from, &motion.to].map(|at| frame.to_program(at));
        let known = [first, second]
            .into_iter()
            .all(|axis| motion.known[axis] && self.interpreter.known[axis]);
        let (radius, _) = arc.start(&from);
        if !known || radius == 0.0 {
            self.arc_as_a_whole(motion, arc, [&from, &to], line, out);
            return Ok(());
        }
        self.check_arc_bounds(motion, arc);
        let stretches = self.stretches(arc, [&from, &to], line)?;
        let splits = stretches.len() > 1;
        if splits {
            self.check_shares(line)?;
        }
        let mut next = 0;
        // What is not taken up by a block of its own is spread over the motion.
        let cut = if self.contour == Contour::None {
            0.0
        } else {
            1.0
        };
        let turned = self.turn_up_to(&mut next, cut);
        self.take_up(motion, arc, turned, line, out);
        let mut carried = frame.moved_in_program(&motion.from, &self.carried);
        let mut before = from;
        // The end of a closed circle is its beginning, whatever the correction there should be.
        let [[x, y], [to_x, to_y]] = [&from, &to].map(|at| in_plane(arc, at));
        let is_closed = !splits && (to_x - x).hypot(to_y - y) < 1e-9;
        for (place, stretch) in stretches.iter().enumerate() {
            let at = arc.place(&from, &to, stretch.to);
            let machine = frame.to_machine(&at);
            let mut code = None;
            if place > 0 && self.turn_up_to(&mut next, stretch.from) {
                let here = [&before, &carried];
                let taken_up = self.take_up_here(motion, stretch.from, here, line, out);
                carried = taken_up.unwrap_or(carried);
                code = taken_up.and_then(|_| code_of(arc));
            }
            let places = [from, arc.place(&from, &to, 0.5), to];
            let keeps_polar = !splits && self.keeps_polar(motion, &places, &carried);
            let writes = each(|axis| match splits {
                _ if motion.polar.is_some() && axis < 2 => polar_writes(keeps_polar),
                // Each part needs its end.
                true if axis == first || axis == second => Writes::Always,
                true => Writes::Anew,
                false => Writes::IfChanged,
            });
            // An arc of a few steps ends with the correction with which it begins, where any other made another arc of it.
            let mut found = None;
            for keeps in [is_closed, true] {
                let leg = Leg {
                    motion,
                    line,
                    from: before,
                    to: at,
                    at: machine,
                    writes,
                    keeps: each(|axis| keeps && (axis == first || axis == second)),
                    rounded: None,
                };
                let mut after = carried;
                let words = self.words_to(&leg, &mut after);
                let written = Written {
                    arc,
                    ends: [&from, &to],
                    part: *stretch,
                    place: splits.then_some(place),
                    carried: [&carried, &after],
                };
                if let Some(circle) = self.circle(&written, line) {
                    found = Some((words, circle, after));
                    break;
                }
            }
            let Some((words, mut circle, after)) = found else {
                return Err(NcError::NotCompensated {
                    line: line.number,
                    what: "an arc so small that its correction makes another arc of it, with these decimals of its words: --decimals allows more of them".to_owned(),
                });
            };
            carried = after;
            let (shape, centre) = self.shape_of_arc(keeps_polar, arc, &mut circle, line);
            if shape == Shape::AsItIs {
                carried[..2].fill(0.0);
            }
            self.notes_superposed(&words, motion, line);
            circle.edit(&mut self.edits);
            let share = stretch.to - stretch.from;
            let part = Part {
                place,
                share: stretch.to,
                numbers: &words,
                words: &motion.words,
                others: &circle.others,
                code,
                feed: splits.then(|| self.feed_of_part(share)).flatten(),
                shape,
                polar: motion.polar,
                before: &centre,
            };
            self.write_part(&part, line, out);
            before = at;
        }
        self.carried = frame.moved_in_machine(&to, &carried);
        self.has_moved(motion);
        Ok(())
    }

    /// An arc that cannot be corrected, since it is not known where it is: it goes with the correction that its axes have where it begins,
    /// and so do its end and its centre, or it was another arc.
    fn arc_as_a_whole(
        &mut self,
        motion: &Move,
        arc: &Arc,
        [from, to]: [&Axes; 2],
        line: Line<'_>,
        out: &mut Vec<u8>,
    ) {
        let frame = self.interpreter.frame.clone();
        let mut carried = frame.moved_in_program(&motion.from, &self.carried);
        if in_plane(arc, &carried) == [0.0; 2] {
            self.puts_pole_back(line, out);
            self.is_uncorrected(motion);
            return;
        }
        let start = shifted(arc, from, &carried);
        let centre = in_plane(arc, &carried);
        let centre = std::array::from_fn(|i| arc.centre[i] + centre[i]);
        let leg = Leg {
            motion,
            line,
            from: *from,
            to: *to,
            at: motion.to,
            writes: each(|axis| match axis {
                0 | 1 if motion.polar.is_some() => polar_writes(false),
                _ => Writes::IfChanged,
            }),
            keeps: [true; 9],
            rounded: None,
        };
        let words = self.words_to(&leg, &mut carried);
        let mut circle = self.circle_about(arc, start, centre, line);
        let (shape, before) = self.shape_of_arc(false, arc, &mut circle, line);
        circle.edit(&mut self.edits);
        let part = Part {
            place: 0,
            share: 1.0,
            numbers: &words,
            words: &motion.words,
            others: &circle.others,
            code: None,
            feed: None,
            shape,
            polar: motion.polar,
            before: &before,
        };
        self.write_part(&part, line, out);
        self.carried = frame.moved_in_machine(to, &carried);
        self.corrector.goes(&motion.to);
        self.settled = Settled::No;
    }

    /// Where the axes lack a correction at the beginning of an arc, a line before it takes that up, in what holds before the codes of the
    /// line of the arc.
    fn take_up(
        &mut self,
        motion: &Move,
        arc: &Arc,
        turned: bool,
        line: Line<'_>,
        out: &mut Vec<u8>,
    ) {
        if !self.lacks_correction(motion, turned) {
            return;
        }
        // The line is read before the codes of this one.
        let Some(mut meaning) = self.before.take() else {
            return;
        };
        let feed = line.block.word(b'F');
        if !meaning.takes_straight(&self.interpreter.modal, feed.is_some()) {
            self.interpreter.notes.add(Note::NotTakenUp, line.number);
            return;
        }
        let feed = feed.filter(|_| line.script.is_heidenhain() || meaning.lacks_feed());
        meaning.swap(&mut self.interpreter);
        let frame = self.interpreter.frame.clone();
        let from = frame.to_program(&motion.from);
        let carried = frame.moved_in_program(&motion.from, &self.carried);
        let carried = self.take_up_here(motion, 0.0, [&from, &carried], line, out);
        meaning.swap(&mut self.interpreter);
        let Some(carried) = carried else {
            return;
        };
        if let Some(feed) = feed {
            // It may be the first one.
            out.push(b' ');
            out.extend_from_slice(&line.text[feed.at..feed.text.end]);
        }
        out.extend_from_slice(line.more);
        self.carried = frame.moved_in_machine(&from, &carried);
        let is_arc = |word: &Word| word.letter == b'G' && matches!(word.value, Some(2.0 | 3.0));
        // From now on G1 is what coordinates alone stand for.
        if !line.block.words.iter().any(is_arc) {
            let code = code_of(arc);
            self.edits.added.extend(code.map(|code| (b'G', code)));
        }
        // The time that F stands for is that of the arc alone.
        let feed = self.feed_of_part(1.0);
        if line.place_of(b'F').is_none() {
            self.edits.added.extend(feed.map(|feed| (b'F', feed)));
        }
    }

    /// A line that takes up what the axes lack at a share of the motion, with the place there in the program and what they carry
    /// there; what they carry then. At the beginning of the motion its end is left to be written. `None`: there is nothing to take up.
    fn take_up_here(
        &mut self,
        motion: &Move,
        share: f64,
        [from, carried]: [&Axes; 2],
        line: Line<'_>,
        out: &mut Vec<u8>,
    ) -> Option<Axes> {
        let here = self.interpreter.frame.to_machine(from);
        let stays = Move {
            words: [None; 9],
            incremental: [!self.interpreter.modal.absolute; 9],
            to: here,
            ..motion.clone()
        };
        let leg = Leg {
            motion: &stays,
            line,
            from: *from,
            to: *from,
            at: here,
            writes: [Writes::IfChanged; 9],
            keeps: [false; 9],
            rounded: None,
        };
        let mut carried = *carried;
        let words = self.words_to(&leg, &mut carried);
        if words.iter().all(Option::is_none) {
            return None;
        }
        let feed = self.feed_of_part(0.0);
        if share > 0.0 {
            out.extend_from_slice(line.more);
        }
        self.begin_line(line, out);
        if self.interpreter.modal.polar.is_some() && !self.polar_is_off {
            // The words of this line are X and Y.
            out.extend_from_slice(b"G15 ");
            self.polar_is_off = true;
        }
        out.extend_from_slice(match line.script.keyword(Shape::Straight) {
            [] => b"G1",
            keyword => keyword,
        });
        for word in words_of(&words, &[Manner::Modal; 9], feed) {
            line.script.write_word(&word, out);
        }
        self.ends_part(share);
        Some(carried)
    }
}

/// G2 or G3.
fn code_of(arc: &Arc) -> Option<Number> {
    Number::nearest(if arc.turns_by < 0.0 { 2.0 } else { 3.0 }, 0)
}
