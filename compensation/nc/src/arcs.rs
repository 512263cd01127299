//! Corrected arcs: one arc where the circle through three corrected points fits, otherwise several parts.
//!
//! Each corrected arc has its own centre. If the centre differs from the pole active in the control, a pole line
//! precedes the arc. Later polar coordinates would refer to the new pole, so they are rewritten as X and Y.

use std::f64::consts::{FRAC_PI_2, FRAC_PI_4, PI, TAU};

use crate::{
    NcError,
    block::{Manner, Word},
    codes::centre_is_absolute,
    coordinates::{Axes, each},
    line::{Edits, Line, NewWord, Shape},
    motion::{Arc, Move, Polar},
    moves::centre_of,
    notes::Note,
    number::{Number, half_step, of_steps},
    reversal::Reversals,
    rewrite::{Contour, Rewriter},
    straight::{Leg, MAX_PARTS, Part, WriteRule, polar_writes, too_many_parts, words_of},
};

/// Upper bound on the maximum deviation of a part from its circle, as a multiple of the deviation at its quarter
/// points. An error linear within the part causes no deviation at the ends and in the middle, and one maximum in each
/// half.
const BETWEEN_QUARTERS: f64 = 1.15;

/// Samples per turn in the search for axis reversals; `MAX_ARC_SAMPLES` is the maximum number for one arc.
const ARC_SAMPLES_PER_TURN: u32 = 64;

const MAX_ARC_SAMPLES: f64 = 4096.0;

/// An axis counts as stationary near its turning point on an arc: on an arc of radius r within √(`HARDLY_MM`·r) to
/// either side, mm, where it travels at most half of `HARDLY_MM`.
const HARDLY_MM: f64 = 5e-4;

/// Minimum length of a part of an arc, in steps (last decimals) of its words: shorter parts are not split.
const SHORTEST_IN_STEPS: f64 = 20.0;

/// Minimum distance between two axis reversals at which an arc is split, in steps of its words.
const SHORTEST_TURN_IN_STEPS: f64 = 100.0;

/// A part of an arc that is written as one arc: its start and end as fractions (0 to 1) of the
/// whole arc.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Stretch {
    pub(crate) from: f64,
    pub(crate) to: f64,
}

impl Stretch {
    /// Unsigned angle of the part, rad.
    pub(crate) fn turns(self, arc: &Arc) -> f64 {
        (self.to - self.from) * arc.turns_by.abs()
    }

    /// Number of full turns in addition to the last one: 1 for an arc of 2 turns or of 1.5 turns.
    fn more_turns(self, arc: &Arc) -> f64 {
        (self.turns(arc) / (2.0 * PI) - 1e-9).floor().max(0.0)
    }

    pub(crate) fn middle(self) -> f64 {
        0.5 * (self.from + self.to)
    }

    /// True if the part is so close to a whole turn (or longer) that start, middle and end do not determine a circle.
    pub(crate) fn is_whole(self, arc: &Arc) -> bool {
        self.turns(arc) > 1.9 * PI
    }
}

/// Maximum error in the middle of an arc written with its radius, in steps; beyond it the arc is written with its centre.
const OFF_BY_RADIUS: f64 = 1.0;

/// Maximum error in the middle of an arc written with its centre, in steps; both centre words are rounded.
const OFF_BY_CENTRE: f64 = 3.0;

/// A part of an arc as it is written to the output, with the corrections at its ends.
#[derive(Clone, Copy, Debug)]
pub(crate) struct WrittenArc<'a> {
    pub(crate) arc: &'a Arc,
    /// Start and end of the whole arc, in program coordinates.
    pub(crate) ends: [&'a Axes; 2],
    pub(crate) part: Stretch,
    /// Index of the part; `None` if the arc is not split.
    pub(crate) place: Option<usize>,
    /// Corrections at the start and end of the part, in program coordinates.
    pub(crate) carried: [&'a Axes; 2],
}

impl WrittenArc<'_> {
    fn commanded(&self) -> [[f64; 2]; 2] {
        let places = [self.part.from, self.part.to]
            .map(|share| self.arc.place(self.ends[0], self.ends[1], share));
        std::array::from_fn(|i| shifted(self.arc, &places[i], self.carried[i]))
    }
}

#[derive(Clone, Debug, Default)]
pub(crate) struct CircleWords {
    /// Words with new numbers in the program's own line: letter, index of the replaced word (`None`: an added word),
    /// number.
    replaced: Vec<(u8, Option<usize>, Number)>,
    removed: Vec<usize>,
    pub(crate) others: Vec<(u8, Number)>,
}

impl CircleWords {
    fn take_centre(&mut self, letters: [u8; 2]) -> [Option<Number>; 2] {
        let found = letters.map(|letter| {
            let replaced = self.replaced.iter().find(|(of, ..)| *of == letter);
            let replaced = replaced.map(|(.., number)| *number);
            let others = self.others.iter().find(|(of, _)| *of == letter);
            replaced.or(others.map(|(_, number)| *number))
        });
        self.replaced.retain(|(of, ..)| !letters.contains(of));
        self.others.retain(|(of, _)| !letters.contains(of));
        found
    }

    fn has_radius(&self) -> bool {
        let in_line = self.replaced.iter().any(|(letter, ..)| *letter == b'R');
        in_line || self.others.iter().any(|(letter, _)| *letter == b'R')
    }

    fn drops_radius(&self) -> bool {
        !self.removed.is_empty()
    }

    fn edit(&self, edits: &mut Edits) {
        for (letter, place, number) in &self.replaced {
            edits.set(*letter, *place, *number);
        }
        edits.removed.extend(&self.removed);
    }
}

/// An arc of less than a whole turn between two points of the plane.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Bow {
    pub(crate) start: [f64; 2],
    pub(crate) end: [f64; 2],
    /// Distance between the middle of the arc and the middle of its chord, mm.
    sag: f64,
    pub(crate) clockwise: bool,
}

impl Bow {
    pub(crate) fn chord(&self) -> f64 {
        (self.end[0] - self.start[0]).hypot(self.end[1] - self.start[1])
    }

    /// Unit direction from the middle of the chord to the middle of the arc.
    pub(crate) fn normal(&self) -> [f64; 2] {
        let chord = self.chord();
        let way = [self.end[0] - self.start[0], self.end[1] - self.start[1]];
        let side = if self.clockwise { -1.0 } else { 1.0 };
        [side * way[1] / chord, -side * way[0] / chord]
    }

    pub(crate) fn radius(&self) -> f64 {
        let half = 0.5 * self.chord();
        0.5 * (half * half / self.sag + self.sag)
    }

    /// Point on the normal through the middle of the chord at this distance from the chord, mm; positive on the side of the arc.
    fn on_normal(&self, distance: f64) -> [f64; 2] {
        let normal = self.normal();
        std::array::from_fn(|i| 0.5 * (self.start[i] + self.end[i]) + distance * normal[i])
    }

    pub(crate) fn middle(&self) -> [f64; 2] {
        self.on_normal(self.sag)
    }

    pub(crate) fn centre(&self) -> [f64; 2] {
        self.on_normal(self.sag - self.radius())
    }

    /// A similar arc between two points near the ends of this arc. It keeps the radius if this arc turns by less than a
    /// quarter turn, otherwise the sag.
    pub(crate) fn between(&self, start: [f64; 2], end: [f64; 2]) -> Self {
        let mut other = Self { start, end, ..*self };
        let (radius, half) = (self.radius(), 0.5 * other.chord());
        if self.sag < 0.3 * radius && half < radius {
            other.sag = half * half / (radius + (radius * radius - half * half).sqrt());
        }
        other
    }
}

impl Rewriter {
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
        // Reversals within a contour get no separate block: the change of correction that they require is spread over
        // the motion.
        if self.contour == Contour::None {
            self.take_up(motion, arc, &mut next, line, out);
            self.turn_up_to(&mut next, 0.0);
        } else {
            self.turn_up_to(&mut next, 1.0);
        }
        let mut carried = frame.moved_in_program(&motion.from, &self.carried);
        let mut before = from;
        // A closed circle ends at its start, with the same correction.
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
                // Every part needs its end point.
                true if axis == first || axis == second => WriteRule::Always,
                true => WriteRule::Anew,
                false => WriteRule::IfChanged,
            });
            // If the correction changes along an arc of a few steps, the arc becomes a different one. Such an arc keeps
            // the correction of its start.
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
                let written = WrittenArc {
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
                return Err(NcError::not_compensated(
                    line.number,
                    "an arc too small for its correction at these decimals: --decimals allows more",
                ));
            };
            carried = after;
            let (shape, centre) = self.shape_of_arc(keeps_polar, arc, &mut circle, line);
            if shape == Shape::AsItIs {
                carried[..2].fill(0.0);
            }
            self.note_superposed(&words, motion, line);
            circle.edit(&mut self.edits);
            let share = stretch.to - stretch.from;
            let part = Part {
                place,
                share: stretch.to,
                others: &circle.others,
                code,
                feed: splits.then(|| self.feed_of_part(share)).flatten(),
                before: &centre,
                ..Part::whole(motion, &words, shape)
            };
            self.write_part(&part, line, out);
            before = at;
        }
        self.carried = frame.moved_in_machine(&to, &carried);
        self.finish_motion(motion);
        Ok(())
    }

    /// Checks the extreme points of an arc in its plane against the ends of travel.
    fn check_arc_bounds(&mut self, motion: &Move, arc: &Arc) {
        let frame = &self.interpreter.frame;
        let [from, to] = [&motion.from, &motion.to].map(|at| frame.to_program(at));
        let (_, start) = arc.start(&from);
        let [first, second, _] = arc.axes;
        let rotation = frame.rotation_deg.to_radians();
        // One turn is enough: a helix repeats the same points of its plane.
        let sweep = arc.turns_by.clamp(-TAU, TAU);
        let places: Vec<Axes> = (-8..=8)
            .filter_map(|quarter| {
                let angle = f64::from(quarter) * FRAC_PI_2 - rotation - start;
                let share = angle / arc.turns_by;
                (share > 0.0 && share < sweep / arc.turns_by).then(|| arc.place(&from, &to, share))
            })
            .collect();
        for place in places {
            let machine = self.interpreter.frame.to_machine(&place);
            let is_near = |axis: usize| self.bounds.is_near_end(axis, machine[axis]);
            if is_near(first) || is_near(second) {
                let delta = self.corrector.at(&machine).delta;
                let by = each(|axis| if self.corrector.corrects[axis] { delta[axis] } else { 0.0 });
                if self.bounds.violated.is_none() {
                    self.bounds.violated = self.violation_in_machine(&machine, &by);
                }
            }
        }
    }

    /// Writes an arc that cannot be corrected because its position is unknown. Its end and centre keep the correction active at its start;
    /// another correction would change its shape.
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
            self.pass_uncorrected(motion);
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
                _ => WriteRule::IfChanged,
            }),
            keeps: [true; 9],
            rounded: None,
        };
        let words = self.words_to(&leg, &mut carried);
        let mut circle = self.circle_about(arc, start, centre, line);
        let (shape, before) = self.shape_of_arc(false, arc, &mut circle, line);
        circle.edit(&mut self.edits);
        let part =
            Part { others: &circle.others, before: &before, ..Part::whole(motion, &words, shape) };
        self.write_part(&part, line, out);
        let carried = frame.moved_in_machine(to, &carried);
        self.finish_uncorrected(motion, carried);
    }

    /// Applies the correction missing at the start of an arc in an added line, under the modes active before the codes of the arc's line.
    fn take_up(
        &mut self,
        motion: &Move,
        arc: &Arc,
        next: &mut usize,
        line: Line<'_>,
        out: &mut Vec<u8>,
    ) {
        let turned = self.turn_once(next, 0.0);
        let mut lacks = self.lacks_correction(&motion.from, turned);
        while !lacks && self.turn_once(next, 0.0) {
            lacks = self.lacks_correction(&motion.from, true);
        }
        if !lacks {
            return;
        }
        // The added line precedes the codes of the arc's line, so it needs the modes before them.
        let Some(mut meaning) = self.before.take() else {
            return;
        };
        let feed = line.block.word(b'F');
        if !meaning.takes_straight(&self.interpreter.modal, feed.is_some()) {
            self.interpreter.notes.add(Note::NotTakenUp, line.number);
            return;
        }
        let feed = feed.filter(|_| line.script.is_heidenhain() || meaning.feed.is_none());
        meaning.swap(&mut self.interpreter);
        let frame = self.interpreter.frame.clone();
        let from = frame.to_program(&motion.from);
        let mut carried = frame.moved_in_program(&motion.from, &self.carried);
        let mut is_written = false;
        loop {
            let taken_up = self.take_up_here(motion, 0.0, [&from, &carried], line, out);
            if let Some(taken_up) = taken_up {
                carried = taken_up;
                if let Some(feed) = feed.filter(|_| !is_written) {
                    // This F may be the first of the program.
                    out.push(b' ');
                    out.extend_from_slice(&line.text[feed.at..feed.text.end]);
                }
                out.extend_from_slice(line.more);
                is_written = true;
            }
            if !self.turn_once(next, 0.0) {
                break;
            }
        }
        meaning.swap(&mut self.interpreter);
        if !is_written {
            return;
        }
        self.carried = frame.moved_in_machine(&from, &carried);
        let is_arc = |word: &Word| word.letter == b'G' && matches!(word.value, Some(2.0 | 3.0));
        // The added line makes G1 modal, so the arc needs its own code.
        if !line.block.words.iter().any(is_arc) {
            let code = code_of(arc);
            self.edits.added.extend(code.map(|code| (b'G', code)));
        }
        // In inverse time the F word applies to the arc alone.
        let feed = self.feed_of_part(1.0);
        if line.place_of(b'F').is_none() {
            self.edits.added.extend(feed.map(|feed| (b'F', feed)));
        }
    }

    /// Writes a line that applies the correction missing at the fraction `share` of the motion. `from` is the program
    /// position there, `carried` the correction applied so far. Returns the new correction, or `None` if no correction
    /// is missing. At `share` 0 the caller writes the line terminator.
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
            writes: [WriteRule::IfChanged; 9],
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
            // The words of the added line are Cartesian.
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
        self.record_part_end(share);
        Some(carried)
    }

    /// Length of one step (last decimal) of length words, mm.
    pub(crate) fn step_mm(&self) -> f64 {
        let unit = self.interpreter.modal.unit_mm;
        of_steps(1, self.numerals(0, None).decimals) * unit
    }

    /// The arc through the corrected start, middle and end of a part of less than a turn. If the correction bends more than the arc does,
    /// the sag stays between half and twice the programmed one, so that the arc never flips.
    pub(crate) fn corrected(&self, arc: &Arc, ends: [&Axes; 2], part: Stretch) -> Bow {
        let programmed = programmed(arc, ends, part);
        let [start, middle, end] = [part.from, part.middle(), part.to].map(|share| {
            let at = arc.place(ends[0], ends[1], share);
            in_plane(arc, &self.delta_in_program(&at))
        });
        let normal = programmed.normal();
        let bend: f64 = (0..2).map(|i| normal[i] * (middle[i] - 0.5 * (start[i] + end[i]))).sum();
        let sag = programmed.sag;
        Bow {
            start: std::array::from_fn(|i| programmed.start[i] + start[i]),
            end: std::array::from_fn(|i| programmed.end[i] + end[i]),
            sag: (sag + bend).clamp(0.5 * sag, 2.0 * sag),
            ..programmed
        }
    }

    /// Splits an arc into the parts to be written. Errors: the arc needs more parts than a motion may have.
    fn stretches(
        &mut self,
        arc: &Arc,
        [from, to]: [&Axes; 2],
        line: Line<'_>,
    ) -> Result<Vec<Stretch>, NcError> {
        let mut stretches = Vec::new();
        self.turns = self.turns_of_arc(arc, [from, to]);
        if self.contour != Contour::None {
            let whole = Stretch { from: 0.0, to: 1.0 };
            if !self.fits(arc, [from, to], whole) {
                self.interpreter.notes.add(Note::ContourWhole, line.number);
            }
            return Ok(vec![whole]);
        }
        let mut open = self.turn_to_turn();
        let sides = self.corrector.sides();
        let mut next = 0;
        let (radius, _) = arc.start(from);
        let shortest = SHORTEST_IN_STEPS * self.step_mm();
        while let Some(stretch) = open.pop() {
            self.turn_up_to(&mut next, stretch.from);
            let is_short = stretch.turns(arc) * radius < shortest;
            if stretches.len() + open.len() >= MAX_PARTS {
                return Err(too_many_parts(line));
            }
            if is_short || self.fits(arc, [from, to], stretch) {
                stretches.push(stretch);
            } else {
                let middle = stretch.middle();
                open.push(Stretch { from: middle, ..stretch });
                open.push(Stretch { to: middle, ..stretch });
            }
        }
        self.corrector.put_back(sides);
        Ok(stretches)
    }

    fn turns_of_arc(&self, arc: &Arc, [from, to]: [&Axes; 2]) -> Reversals {
        if !self.corrector.bidirectional {
            return Reversals::default();
        }
        let frame = &self.interpreter.frame;
        let steps = f64::from(ARC_SAMPLES_PER_TURN) * (arc.turns_by.abs() / (2.0 * PI)).max(1.0);
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "at most a few thousand"
        )]
        let steps = steps.ceil().min(MAX_ARC_SAMPLES) as u32;
        let place = |share: f64| match share {
            0.0 => frame.to_machine(from),
            1.0 => frame.to_machine(to),
            _ => frame.to_machine(&arc.place(from, to, share)),
        };
        let carriages = self.corrector.carriages(steps, place);
        let mut found = self.corrector.turns(steps, carriages);
        // A part shorter than this would become a different arc when the backlash is crossed, and an axis hardly moves
        // near its turning point.
        let (radius, _) = arc.start(from);
        let shortest = (SHORTEST_TURN_IN_STEPS * self.step_mm()).max((HARDLY_MM * radius).sqrt());
        let shortest = shortest / (radius * arc.turns_by.abs());
        found.keep_before(1.0 - shortest);
        let mut passed = 0.0;
        for turn in &mut found.turns {
            if turn.share - passed < shortest {
                turn.share = passed;
            }
            passed = turn.share;
        }
        if !self.lacks_correction(&place(0.0), false) {
            found.keep_last_at_start();
        }
        found
    }

    /// The parts between axis reversals, in reverse order (a stack).
    fn turn_to_turn(&self) -> Vec<Stretch> {
        let mut parts = vec![Stretch { from: 0.0, to: 1.0 }];
        for turn in &self.turns.turns {
            let Some(last) = parts.last_mut() else { break };
            if turn.share > last.from {
                last.to = turn.share;
                parts.push(Stretch { from: turn.share, to: 1.0 });
            }
        }
        parts.reverse();
        parts
    }

    /// True if a part can stay one arc: the arc through its corrected start, middle and end deviates from the corrected path by no more
    /// than the tolerance. Deviations by errors linear within the part are largest near the quarter points, which are sampled; those by
    /// curved errors are bounded by their derivatives.
    fn fits(&self, arc: &Arc, [from, to]: [&Axes; 2], part: Stretch) -> bool {
        let tolerance = self.corrector.split_beyond_mm;
        let [first, second, _] = arc.axes;
        let turns = part.turns(arc);
        let is_whole = part.is_whole(arc);
        let eighths = (turns / FRAC_PI_4).ceil().clamp(4.0, 4096.0);
        let count = if is_whole { eighths } else { 4.0 };
        let mut shares = (0..).map(f64::from).map(|place| place / count);
        let place = |share: f64| {
            let at = arc.place(from, to, part.from + share * (part.to - part.from));
            (at, self.delta_in_program(&at))
        };
        let places: Vec<_> = shares
            .by_ref()
            .take_while(|share| *share <= 1.0)
            .map(|share| (share, place(share)))
            .collect();
        let (Some((_, start)), Some((_, end))) = (places.first(), places.last()) else {
            return false;
        };
        // Bounding box of the part, and the maximum deviation of the correction from a linear one within it.
        let frame = &self.interpreter.frame;
        let (radius, _) = arc.start(from);
        let bulge = radius * (1.0 - (0.5 * turns / count).cos());
        let boxed = |turned: bool, of: &dyn Fn(&Axes) -> Axes| {
            let [mut low, mut high] = [of(&start.0); 2];
            for (_, (at, _)) in &places {
                let at = of(at);
                low = each(|axis| low[axis].min(at[axis]));
                high = each(|axis| high[axis].max(at[axis]));
            }
            for axis in 0..3 {
                if turned || axis == first || axis == second {
                    low[axis] -= bulge;
                    high[axis] += bulge;
                }
            }
            (low, high)
        };
        let (low, high) = boxed(false, &|at| *at);
        let bulge_mm = self.bulge_mm(&low, &high);
        // With a rotation or kinematics the arc may bulge along X, Y and Z of the machine, not only in its plane.
        let turned = frame.rotation_deg != 0.0 || frame.tip.is_some();
        let (low, high) = boxed(turned, &|at| frame.to_machine(at));
        let curved = self.corrector.bound_mm(&low, &high, bulge_mm);
        if 2.0 * curved > tolerance {
            return false;
        }
        let off_plane = |share: f64, delta: &Axes| {
            let away: f64 = (0..9)
                .filter(|axis| *axis != first && *axis != second)
                .map(|axis| {
                    (delta[axis] - start.1[axis] - share * (end.1[axis] - start.1[axis])).powi(2)
                })
                .sum();
            away.sqrt()
        };
        let circles = (!is_whole).then(|| {
            // The deviation of the programmed circle is subtracted: it is rounding of its numbers, which must not be corrected.
            [self.corrected(arc, [from, to], part), programmed(arc, [from, to], part)]
                .map(|bow| (bow.centre(), bow.radius()))
        });
        let mut largest = 0.0_f64;
        for (share, (at, delta)) in &places {
            let off = if let Some([corrected, programmed]) = circles {
                let off = |(centre, radius): ([f64; 2], f64), [x, y]: [f64; 2]| {
                    (x - centre[0]).hypot(y - centre[1]) - radius
                };
                (off(corrected, shifted(arc, at, delta)) - off(programmed, in_plane(arc, at))).abs()
            } else {
                // A whole circle keeps its radius and is shifted by the correction of its start.
                let of_start = &start.1;
                (delta[first] - of_start[first]).hypot(delta[second] - of_start[second])
            };
            largest = largest.max(off).max(off_plane(*share, delta));
        }
        BETWEEN_QUARTERS * largest + 2.0 * curved <= tolerance
    }

    /// The circle words of a part of an arc; `None` if a control would execute a different arc from these words.
    pub(crate) fn circle(&self, written: &WrittenArc<'_>, line: Line<'_>) -> Option<CircleWords> {
        let (arc, part) = (written.arc, written.part);
        let [start, end] = written.commanded();
        let begins = in_plane(arc, &arc.place(written.ends[0], written.ends[1], part.from));
        let ends = in_plane(arc, &arc.place(written.ends[0], written.ends[1], part.to));
        let middle = middle_of(begins, ends, arc.centre, arc.turns_by < 0.0);
        // Displacement of the centre and the middle from those of the programmed circle, and change of the radius.
        let (centre_by, middle_by, radius_by);
        if part.is_whole(arc) {
            let by = std::array::from_fn(|i| start[i] - begins[i]);
            (centre_by, middle_by, radius_by) = (by, by, 0.0);
        } else {
            let plain = programmed(arc, written.ends, part);
            let bow = self.corrected(arc, written.ends, part).between(start, end);
            let way = |to: [f64; 2], from: [f64; 2]| -> [f64; 2] {
                std::array::from_fn(|i| to[i] - from[i])
            };
            centre_by = way(bow.centre(), plain.centre());
            middle_by = way(bow.middle(), plain.middle());
            radius_by = bow.radius() - plain.radius();
        }
        let wanted: [f64; 2] = std::array::from_fn(|i| middle[i] + middle_by[i]);
        let is_good = |centre: [f64; 2], most_steps: f64| {
            let found = middle_of(start, end, centre, arc.turns_by < 0.0);
            (found[0] - wanted[0]).hypot(found[1] - wanted[1]) <= most_steps * self.step_mm()
        };
        if arc.by_radius
            && let Some((mut words, radius)) = self.by_radius(written, radius_by, line)
            && let Ok(centre) = centre_of(start, end, radius, arc.turns_by < 0.0)
            && is_good(centre, OFF_BY_RADIUS)
        {
            add_turns(written, line, &mut words);
            return Some(words);
        }
        let centre = std::array::from_fn(|i| arc.centre[i] + centre_by[i]);
        let (mut words, centre) = self.by_centre(written, start, centre, line)?;
        add_turns(written, line, &mut words);
        is_good(centre, OFF_BY_CENTRE).then_some(words)
    }

    fn circle_about(
        &self,
        arc: &Arc,
        start: [f64; 2],
        centre: [f64; 2],
        line: Line<'_>,
    ) -> CircleWords {
        if arc.by_radius {
            return CircleWords::default();
        }
        let written = WrittenArc {
            arc,
            ends: [&[0.0; 9]; 2],
            part: Stretch { from: 0.0, to: 1.0 },
            place: None,
            carried: [&[0.0; 9]; 2],
        };
        let words = self.by_centre(&written, start, centre, line);
        words.map(|(words, _)| words).unwrap_or_default()
    }

    /// The R word, and the radius that it commands, mm.
    fn by_radius(
        &self,
        written: &WrittenArc<'_>,
        radius_by: f64,
        line: Line<'_>,
    ) -> Option<(CircleWords, f64)> {
        let unit = self.interpreter.modal.unit_mm;
        let place = line.place_of(b'R');
        let word = line.word(place)?;
        let sign = match written.place {
            // For a half circle either sign is valid: keep the programmed one.
            None => word.value?.signum(),
            Some(_) if written.part.turns(written.arc) > PI => -1.0,
            Some(_) => 1.0,
        };
        // R changes by as much as the radius, so that the rounding of the programmed value stays.
        let size = word.value?.abs() + radius_by / unit;
        let mut words = CircleWords::default();
        let said = self.word(written, (b'R', sign * size), place, line, &mut words)?;
        Some((words, said * unit))
    }

    /// The centre words along both axes, and the centre that they command, mm.
    fn by_centre(
        &self,
        written: &WrittenArc<'_>,
        start: [f64; 2],
        centre: [f64; 2],
        line: Line<'_>,
    ) -> Option<(CircleWords, [f64; 2])> {
        let modal = &self.interpreter.modal;
        let unit = modal.unit_mm;
        let mut words = CircleWords::default();
        let mut said = [0.0; 2];
        if written.arc.by_radius && written.place.unwrap_or(0) == 0 {
            words.removed.extend(line.place_of(b'R'));
        }
        for (i, letter) in modal.plane.centre_letters().into_iter().enumerate() {
            let place = line.place_of(letter);
            let manner = line.word(place).map(|word| word.manner);
            let base = if centre_is_absolute(manner, modal) { 0.0 } else { start[i] };
            let value = (letter, (centre[i] - base) / unit);
            said[i] = base + unit * self.word(written, value, place, line, &mut words)?;
        }
        Some((words, said))
    }

    /// Adds one word and returns its value. An existing word of the program's line is replaced only if its number
    /// changes.
    fn word(
        &self,
        written: &WrittenArc<'_>,
        (letter, value): (u8, f64),
        place: Option<usize>,
        line: Line<'_>,
        words: &mut CircleWords,
    ) -> Option<f64> {
        let word = line.word(place);
        let numerals = self.numerals(0, word);
        let said = self.pole_along(letter);
        let before = word.and_then(|word| word.value).or(said).unwrap_or(0.0);
        let changes = (value - before).abs() >= half_step(numerals.decimals);
        let is_missing = letter != b'R' && written.arc.by_radius;
        if !changes && written.place.is_none() && !is_missing {
            return Some(before);
        }
        let of_word = word.and_then(|word| word.decimals).unwrap_or(0);
        let number = numerals.nearest(value, of_word)?;
        if written.place.is_some_and(|part| part > 0) {
            words.others.push((letter, number));
        } else if changes || place.is_some() || is_missing {
            words.replaced.push((letter, place, number));
        } else {
            return Some(before);
        }
        Some(number.value())
    }

    /// Coordinate of the pole active in the control along the axis of a centre letter, in the unit of the word.
    fn pole_along(&self, letter: u8) -> Option<f64> {
        let place = match letter {
            b'I' => 0,
            b'J' => 1,
            _ => return None,
        };
        self.pole.map(|pole| pole[place] / self.interpreter.modal.unit_mm)
    }

    /// True if a motion can keep its polar words: the pole active at the control equals the programmed pole, and the
    /// corrections of X and Y at the start and at all `places` round to zero.
    pub(crate) fn keeps_polar(&self, motion: &Move, places: &[Axes], carried: &Axes) -> bool {
        let Some(polar) = motion.polar else {
            return false;
        };
        let unit_mm = self.interpreter.modal.unit_mm;
        let half_mm = 0.5 * unit_mm * of_steps(1, self.numerals(0, None).decimals);
        let is_small = |by: &Axes| by[..2].iter().all(|by| by.abs() < half_mm);
        // Coordinates relative to the tool include the correction at the tool.
        let begins = if polar.from_here {
            carried[..2].iter().all(|by| by.abs() < 1e-9)
        } else {
            is_small(carried)
        };
        begins
            && self.has_pole_of_program()
            && !self.polar_is_off
            && places.iter().all(|at| is_small(&self.delta_in_program(at)))
    }

    fn has_pole_of_program(&self) -> bool {
        match (self.pole, self.interpreter.modal.pole) {
            (Some(said), Some(pole)) => (0..2).all(|i| (said[i] - pole[i]).abs() < 1e-9),
            (said, pole) => said == pole,
        }
    }

    /// Records the pole set by a block. A relative coordinate includes the correction at the tool.
    pub(crate) fn takes_pole(&mut self, relative: [bool; 2]) {
        let interpreter = &self.interpreter;
        let carried = interpreter.frame.moved_in_program(&interpreter.position, &self.carried);
        self.pole = interpreter.modal.pole.map(|pole| {
            std::array::from_fn(|i| pole[i] + if relative[i] { carried[i] } else { 0.0 })
        });
    }

    /// How an arc is written, and the HEIDENHAIN pole line that must precede it (empty if none).
    fn shape_of_arc(
        &mut self,
        keeps_polar: bool,
        arc: &Arc,
        circle: &mut CircleWords,
        line: Line<'_>,
    ) -> (Shape, Vec<u8>) {
        if !line.script.is_heidenhain() {
            let shape = if keeps_polar { Shape::AsItIs } else { Shape::Centre };
            return (shape, Vec::new());
        }
        let centre = circle.take_centre([b'I', b'J']);
        if keeps_polar {
            return (Shape::AsItIs, Vec::new());
        }
        let keeps_radius = arc.by_radius && !circle.drops_radius() && centre == [None; 2];
        if circle.has_radius() || keeps_radius {
            return (Shape::Radius, Vec::new());
        }
        let unit = self.interpreter.modal.unit_mm;
        let before = self.pole;
        let numbers = std::array::from_fn(|i| {
            let said = before.map(|pole| pole[i] / unit).unwrap_or_default();
            let decimals = self.decimals.of(0, unit);
            centre[i].or(Number::nearest(said, decimals))
        });
        let [Some(x), Some(y)] = numbers else {
            return (Shape::Centre, Vec::new());
        };
        let changes = |i: usize, number: Number| {
            centre[i].is_some()
                && before.is_none_or(|pole| (unit * number.value() - pole[i]).abs() > 1e-9)
        };
        if !changes(0, x) && !changes(1, y) {
            return (Shape::Centre, Vec::new());
        }
        self.pole = Some([unit * x.value(), unit * y.value()]);
        (Shape::Centre, pole_line([x, y], line))
    }

    fn puts_pole_back(&mut self, line: Line<'_>, out: &mut Vec<u8>) {
        let Some(pole) = self.interpreter.modal.pole else {
            return;
        };
        if !line.script.is_heidenhain() || self.has_pole_of_program() {
            return;
        }
        let unit = self.interpreter.modal.unit_mm;
        let [Some(x), Some(y)] = pole.map(|at| Number::shortest(at / unit, 6)) else {
            return;
        };
        out.extend_from_slice(&pole_line([x, y], line));
        out.extend_from_slice(line.more);
        self.counts.added += 1;
        self.pole = Some(pole);
        self.edits.write(line, out);
    }

    /// Sets the path word of the program's line to `shape`, and removes polar coordinates where the motion is written in X and Y.
    pub(crate) fn goes_as(&mut self, shape: Shape, polar: Option<Polar>, line: Line<'_>) {
        if shape == Shape::AsItIs {
            return;
        }
        let keyword = line.block.keyword.clone();
        let length = line.script.keyword(shape).len();
        if length < keyword.len() {
            // LP, CP and CR become L and C.
            let rest = keyword.start + length..keyword.end;
            self.edits.ranges.push((rest, None));
        }
        let Some(polar) = polar else { return };
        self.edits.removed.extend(polar.words.into_iter().flatten());
        if self.interpreter.modal.polar.is_none() {
            return;
        }
        // G15 makes X and Y Cartesian until the program has G16 again.
        let is_g16 = |word: &Word| word.letter == b'G' && word.value == Some(16.0);
        let place = line.block.words.iter().position(is_g16);
        if let Some(code) = Number::nearest(15.0, 0)
            && (place.is_some() || !self.polar_is_off)
        {
            self.edits.set(b'G', place, code);
        }
        self.polar_is_off = true;
    }

    fn note_superposed(&mut self, words: &Axes<Option<Number>>, motion: &Move, line: Line<'_>) {
        // A polar helix becomes an arc in X and Y with a third word; any other arc gets an additional word.
        let is_new = |axis: usize| {
            words[axis].is_some() && (motion.words[axis].is_none() || motion.polar.is_some())
        };
        if line.script.is_heidenhain() && (2..9).any(is_new) {
            self.interpreter.notes.add(Note::Superposed, line.number);
        }
    }
}

fn code_of(arc: &Arc) -> Option<Number> {
    Number::nearest(if arc.turns_by < 0.0 { 2.0 } else { 3.0 }, 0)
}

pub(crate) fn in_plane(arc: &Arc, at: &Axes) -> [f64; 2] {
    let [first, second, _] = arc.axes;
    [at[first], at[second]]
}

pub(crate) fn shifted(arc: &Arc, at: &Axes, delta: &Axes) -> [f64; 2] {
    let [first, second, _] = arc.axes;
    [at[first] + delta[first], at[second] + delta[second]]
}

/// The programmed part of an arc of less than a turn.
pub(crate) fn programmed(arc: &Arc, [from, to]: [&Axes; 2], part: Stretch) -> Bow {
    let [start, end] = [part.from, part.to].map(|share| in_plane(arc, &arc.place(from, to, share)));
    let radius = |at: [f64; 2]| (at[0] - arc.centre[0]).hypot(at[1] - arc.centre[1]);
    Bow {
        start,
        end,
        sag: sag_of(0.5 * (radius(start) + radius(end)), part.turns(arc)),
        clockwise: arc.turns_by < 0.0,
    }
}

/// Adds the number of turns (P) to a part of a split arc.
fn add_turns(written: &WrittenArc<'_>, line: Line<'_>, words: &mut CircleWords) {
    let Some(part) = written.place else {
        return;
    };
    let place = line.place_of(b'P');
    let turns = written.part.more_turns(written.arc) + 1.0;
    let number = Number::nearest(turns, 0).filter(|_| turns > 1.0);
    match number {
        Some(number) if part > 0 => words.others.push((b'P', number)),
        Some(number) => words.replaced.push((b'P', place, number)),
        None if part == 0 => words.removed.extend(place),
        None => {}
    }
}

/// Middle of the last turn from `start` to `end` about a centre; its radius is the mean of the radii at both ends.
fn middle_of(start: [f64; 2], end: [f64; 2], centre: [f64; 2], clockwise: bool) -> [f64; 2] {
    let polar = |at: [f64; 2]| {
        let way = [at[0] - centre[0], at[1] - centre[1]];
        (way[0].hypot(way[1]), way[1].atan2(way[0]))
    };
    let ((from_radius, from), (to_radius, to)) = (polar(start), polar(end));
    let sign = if clockwise { -1.0 } else { 1.0 };
    let mut turns = sign * (sign * (to - from)).rem_euclid(2.0 * PI);
    // If the end is the start, the arc is a full turn.
    if (end[0] - start[0]).hypot(end[1] - start[1]) < 1e-9 {
        turns = sign * 2.0 * PI;
    }
    let angle = from + 0.5 * turns;
    let radius = 0.5 * (from_radius + to_radius);
    [centre[0] + radius * angle.cos(), centre[1] + radius * angle.sin()]
}

/// Sag, mm, of an arc of this radius, mm, that turns by this angle, rad.
fn sag_of(radius: f64, turns: f64) -> f64 {
    2.0 * radius * (0.25 * turns).sin().powi(2)
}

/// A HEIDENHAIN pole line such as `CC X+1.000 Y+2.000`.
fn pole_line(centre: [Number; 2], line: Line<'_>) -> Vec<u8> {
    let mut text = b"CC".to_vec();
    for word in [b'X', b'Y'].into_iter().zip(centre) {
        line.script.write_word(&NewWord::plain(word), &mut text);
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    fn assert_at(found: [f64; 2], expected: [f64; 2]) {
        let off = (found[0] - expected[0]).hypot(found[1] - expected[1]);
        assert!(off < 1e-9, "{found:?}, expected {expected:?}");
    }

    #[test]
    fn arc_parts_of_a_circle() {
        let half_root = 0.5_f64.sqrt();
        for (turns, end, middle) in [
            (0.5, [0.0, 10.0], [10.0 * half_root, 10.0 * half_root]),
            (1.0, [-10.0, 0.0], [0.0, 10.0]),
            (1.5, [0.0, -10.0], [-10.0 * half_root, 10.0 * half_root]),
        ] {
            let bow = Bow {
                start: [10.0, 0.0],
                end,
                sag: sag_of(10.0, turns * std::f64::consts::PI),
                clockwise: false,
            };
            assert_at(bow.middle(), middle);
            assert_at(bow.centre(), [0.0, 0.0]);
            // The same arc in the opposite direction.
            let back = Bow { start: bow.end, end: bow.start, clockwise: true, ..bow };
            assert_at(back.middle(), middle);
            assert_at(back.centre(), [0.0, 0.0]);
            assert!((back.radius() - 10.0).abs() < 1e-9);
        }
    }

    /// A chord one step longer keeps the radius of a shallow arc and the sag of a half circle, so the centre does not jump.
    #[test]
    fn the_rounding_of_a_chord_hardly_moves_the_centre() {
        let shallow = Bow {
            start: [10.0, 0.0],
            end: [10.4, 0.0],
            sag: 0.04 / (100.0 + 0.2_f64.hypot(100.0)),
            clockwise: false,
        };
        assert_at(shallow.centre(), [10.2, 100.0]);
        let longer = shallow.between([10.0, 0.0], [10.401, 0.0]);
        assert!((longer.radius() - shallow.radius()).abs() < 1e-9);
        let half = Bow { start: [0.0, 0.0], end: [100.0, 0.0], sag: 50.0, clockwise: false };
        let longer = half.between([0.0, 0.0], [100.009, 0.0]);
        assert!(longer.centre()[1].abs() < 0.01, "{:?}", longer.centre());
    }
}
