//! Motion of a block: its end position, its arc, or the holes of its cycle.

use crate::{
    NcError,
    block::{BlockStart, Manner, Word},
    codes::{BlockWords, Codes, is_cycle, whole},
    control::{Control, Dialect},
    coordinates::{Axes, LETTERS, each, is_rotary},
    interpreter::{Interpreter, OF_MACHINE, Outcome},
    modal::{CentrePoint, Code, Plane, Sticky, code_text},
    motion::{Arc, Move, Path, Polar},
    notes::Note,
};

/// Margin around half a turn, deg, within which a correction could change the shorter direction.
const HALF_TURN_DEG: f64 = 0.5;

impl Interpreter {
    pub(crate) fn set_motion(&mut self, code: Code) {
        // Only consecutive cycles share their persistent values.
        if self.modal.motion.is_none_or(|before| !is_cycle(before)) || !is_cycle(code) {
            self.modal.sticky = Sticky::default();
        }
        self.modal.motion = (code != 800).then_some(code);
    }

    pub(crate) fn motion(
        &mut self,
        codes: &Codes,
        given: &BlockWords<'_>,
        outcome: &mut Outcome,
    ) -> Result<(), NcError> {
        let polar = given.polar.is_some();
        self.check_polar(codes, given)?;
        self.check_code(codes, given)?;
        let motion_before = self.modal.motion;
        if let Some(code) = codes.motion {
            self.set_motion(code);
        }
        let has_words = given.names_axes() || polar;
        self.check_words(codes, given, has_words)?;
        if self.modal.motion_unsure && codes.motion.is_none() && has_words {
            return Err(given.refused(
                "a motion without a G code after a block that may be skipped (/) and has another one: write the code into this block",
            ));
        }
        if given.block.begins == BlockStart::Slash {
            self.modal.motion_unsure |=
                motion_before.is_some() && self.modal.motion != motion_before;
        } else if codes.motion.is_some() {
            self.modal.motion_unsure = false;
        }
        let Some(code) = self.modal.motion else {
            if has_words {
                return Err(given.refused("axis words without a motion code"));
            }
            return Ok(());
        };
        let has_centre = || b"IJK".iter().any(|letter| given.has(*letter));
        let is_whole_circle = matches!(code, 20 | 30) && codes.motion.is_some() && has_centre();
        if !(has_words || is_whole_circle) {
            if is_cycle(code) && given.has(b'R') {
                return Err(given.refused(
                    "R alone while a cycle is active, which some controls execute as a hole: write it into the block of the next hole",
                ));
            }
            return Ok(());
        }
        let path = match code {
            // Arcs and cycles are built below, once their ends are known.
            _ if code == 0 || is_cycle(code) => Path::Rapid,
            10 | 20 | 30 => Path::Line,
            50..=52 => {
                self.notes.add(Note::GoesWhole(code_text(code)), given.line);
                Path::Spline
            }
            _ => {
                self.notes.add(Note::PassedOn(code_text(code)), given.line);
                Path::Other
            }
        };
        let manner = |axis: usize| given.word(axis).map_or(Manner::Modal, |word| word.manner);
        let incremental: Axes<bool> = each(|axis| match manner(axis) {
            Manner::Modal => !self.modal.absolute && !codes.in_machine,
            manner => manner == Manner::Incremental,
        });
        self.check_new_frame(given, &incremental, codes.in_machine)?;
        let mut motion = Move {
            path,
            from: self.position,
            to: self.end(given, codes.in_machine, &incremental)?,
            words: given.places,
            incremental,
            in_machine: codes.in_machine,
            polar: self.polar_of(given),
            known: self.known_before(given, code),
            arrives_from_unknown: [false; 9],
            wraps: [0.0; 9],
        };
        motion.arrives_from_unknown = self.arrives_from_unknown(&motion);
        self.check_axes_of_tip(&motion, given)?;
        for axis in 0..9 {
            // In RS-274 the direction is a setting of each axis.
            let shorter = self.modal.shorter
                && is_rotary(axis)
                && motion.words[axis].is_some()
                && (self.dialect != Dialect::Rs274 || self.may_roll_over(axis));
            if manner(axis) == Manner::Shortest || shorter && !motion.incremental[axis] {
                self.take_shorter_way(axis, &mut motion, given)?;
            }
            if motion.words[axis].is_some() && !motion.incremental[axis] {
                self.check_rotary_word(axis, &motion, given)?;
            }
        }
        if matches!(code, 20 | 30) {
            self.check_beginning(given)?;
            motion.path = Path::Arc(self.arc(code, given, &motion.to)?);
        } else if is_cycle(code) && !self.hole(given, &mut motion, outcome)? {
            return Ok(());
        }
        if polar {
            self.finish_polar(given)?;
        }
        self.update_known_positions(code, codes, &motion, given);
        if code == 331 {
            // Rigid tapping returns to its start.
            (motion.to, motion.words) = (motion.from, [None; 9]);
        } else {
            self.position = outcome.row.last().map_or(motion.to, |last| last.to);
        }
        if codes.in_machine && self.dialect != Dialect::Rs274 {
            self.check_machine_coordinates(&motion, given)?;
        }
        outcome.motion = Some(motion);
        Ok(())
    }

    /// Rejects printer coordinates without a motion code.
    fn check_code(&self, codes: &Codes, given: &BlockWords<'_>) -> Result<(), NcError> {
        if self.is_printer() && codes.motion.is_none() && given.names_axes() {
            return Err(given.refused(
                "coordinates without a code, which Klipper does not execute: write G0, G1, G2 or G3 before them",
            ));
        }
        Ok(())
    }

    /// Rejects a word that the motion does not use: LinuxCNC rejects it, and another control may
    /// interpret it.
    fn check_words(
        &self,
        codes: &Codes,
        given: &BlockWords<'_>,
        has_words: bool,
    ) -> Result<(), NcError> {
        let motion = self.modal.motion.filter(|_| has_words || codes.motion.is_some());
        let (Some(motion @ (0 | 10 | 20 | 30)), Dialect::Rs274, false) =
            (motion, self.dialect, codes.has_words)
        else {
            return Ok(());
        };
        let is_arc = motion >= 20;
        let uses = |letter: u8| match letter {
            b'E' => self.is_printer(),
            b'K' => is_arc && self.modal.plane != Plane::Xy,
            b'R' => is_arc,
            _ => false,
        };
        let Some(letter) = b"EKQR".iter().find(|letter| given.has(**letter) && !uses(**letter))
        else {
            return Ok(());
        };
        let why = match letter {
            b'E' => {
                "which is the filament of a printer: state control = \"marlin\" or \"klipper\" in the set-up file"
            }
            b'R' => "which rounds a corner on some controls",
            b'K' if is_arc => "which is not a centre coordinate in the XY plane (G17)",
            _ => "which no code of the block uses (an error on LinuxCNC)",
        };
        let (letter, code) = (char::from(*letter), code_text(motion));
        Err(given.refused(&format!("{letter} with {code}, {why}")))
    }

    /// Rejects an arc that follows an M code with axis words: the M code may have moved the axes,
    /// so it is unknown whether the start of the arc is corrected.
    fn check_beginning(&self, given: &BlockWords<'_>) -> Result<(), NcError> {
        let [first, second, _] = self.modal.plane.axes();
        let Some(axis) = [first, second].into_iter().find(|axis| self.is_unclaimed(*axis)) else {
            return Ok(());
        };
        Err(given.refused(&format!(
            "an arc after an unknown M code with a word of {}, which may have moved the axis: write G0 or G1 into the block of the M code if it moves, or name the axis before the arc",
            char::from(LETTERS[axis])
        )))
    }

    /// Rejects a motion of a rotary axis that the machine file lacks, while tool centre point
    /// control is active.
    fn check_axes_of_tip(&self, motion: &Move, given: &BlockWords<'_>) -> Result<(), NcError> {
        if self.modal.centre_point != CentrePoint::Off
            && let Some(axis) = (3..9).find(|axis| {
                is_rotary(*axis) && motion.words[*axis].is_some() && !self.machine_has(*axis)
            })
        {
            return Err(given.refused(&format!(
                "a motion of {}, which the machine file lacks, while tool centre point control is active (M428, G43.4, TRAORI, M128)",
                char::from(LETTERS[axis])
            )));
        }
        Ok(())
    }

    /// Axes whose start position is known: in program coordinates for the axes that the motion moves, in machine coordinates for the
    /// others.
    fn known_before(&self, given: &BlockWords<'_>, code: Code) -> Axes<bool> {
        let in_plane = given.word(0).is_some() || given.word(1).is_some();
        let turns = self.frame.rotation_deg != 0.0 && in_plane || given.polar.is_some();
        let of_arc = matches!(code, 20 | 30).then(|| self.modal.plane.axes());
        each(|axis| {
            let moves = given.word(axis).is_some()
                || axis < 2 && turns
                || axis < 3 && self.frame.tip.is_some()
                || of_arc.is_some_and(|[first, second, _]| axis == first || axis == second);
            self.known[axis] && (!moves || self.knows_program_position(axis))
        })
    }

    /// Axes whose start position is unknown relative to the end of a motion, so that the direction of approach is unknown. The direction of an
    /// incremental word is known.
    fn arrives_from_unknown(&self, motion: &Move) -> Axes<bool> {
        let own = each(|axis| {
            let is_named = motion.words[axis].is_some();
            let is_way = is_named && motion.incremental[axis];
            let starts_in_program =
                motion.in_machine && is_named && self.known_basis(axis) != Some(OF_MACHINE);
            !is_way && (!motion.known[axis] || starts_in_program)
        });
        let has_unknown_lever =
            self.frame.tip.is_some() && (3..6).any(|axis| self.machine_has(axis) && own[axis]);
        each(|axis| axis < 3 && has_unknown_lever || self.mixed_with(axis).any(|axis| own[axis]))
    }

    fn update_known_positions(
        &mut self,
        code: Code,
        codes: &Codes,
        motion: &Move,
        given: &BlockWords<'_>,
    ) {
        // The end of a probing move is only known at the machine.
        let is_probe = (380..=389).contains(&code);
        // The tool does not stay at the bottom of a hole.
        let is_depth =
            |axis: usize| matches!(motion.path, Path::Hole { depth, .. } if depth == axis);
        for (axis, place) in given.places.iter().enumerate() {
            if place.is_none() {
                continue;
            }
            if is_probe {
                self.known[axis] = false;
            } else if codes.in_machine {
                self.mark_machine_position(axis);
                self.forget_under_length(axis);
            } else if !motion.incremental[axis] && !is_depth(axis) {
                self.mark_named(axis);
            }
        }
        if let Path::Hole { clearance, depth, .. } = motion.path {
            self.finish_hole(clearance, depth, motion.incremental[depth], given.line);
        }
    }

    /// Rejects incremental words of an axis before an absolute position names it in new coordinates.
    /// After G68 some controls rotate the word about the tool position. On SINUMERIK, setting data
    /// decide whether the axis also moves by the change.
    fn check_new_frame(
        &mut self,
        given: &BlockWords<'_>,
        incremental: &Axes<bool>,
        in_machine: bool,
    ) -> Result<(), NcError> {
        if in_machine {
            return Ok(());
        }
        let names = |axis: usize| given.word(axis).is_some();
        let is_unclear =
            |axis: usize| self.modal.frame_is_new[axis] && names(axis) && incremental[axis];
        if (0..9).any(is_unclear) {
            return Err(given.refused(if self.dialect == Dialect::Siemens {
                "an incremental motion (G91, IC) of an axis whose frame, work offset or tool length has changed since its last absolute position: program an absolute position first, because setting data 42440 and 42442 decide whether the axis moves by the change too"
            } else {
                "an incremental motion (G91) after G68 or G69 before X or Y was programmed in G90, which FANUC controls rotate about the tool position, or begin elsewhere"
            }));
        }
        let is_turned = self.modal.rotation.is_some() || self.modal.programmed.angle_deg != 0.0;
        if given.polar.is_some() || is_turned && (names(0) || names(1)) {
            self.modal.frame_is_new[..2].fill(false);
        }
        for axis in (0..9).filter(|axis| names(*axis)) {
            self.modal.frame_is_new[axis] = false;
        }
        Ok(())
    }

    /// True if [`check_rotary_word`](Self::check_rotary_word) may reject, or note, a word that turns the axis by `way_deg`.
    pub(crate) fn must_check_rotary_word(&self, axis: usize, way_deg: f64) -> bool {
        let is_noted = |letter: u8| self.notes.has(&Note::RollsOver(char::from(letter)));
        self.may_turn_either_way(axis)
            && (way_deg.abs() > 180.0 - HALF_TURN_DEG || !is_noted(LETTERS[axis]))
    }

    /// Controls turn a rollover axis to the same word in three ways: as a linear axis, by the shorter way, or in the direction of the sign. Errors: a
    /// word of half a turn or more, if the set-up does not state the direction.
    fn check_rotary_word(
        &mut self,
        axis: usize,
        motion: &Move,
        given: &BlockWords<'_>,
    ) -> Result<(), NcError> {
        if !self.may_turn_either_way(axis) {
            return Ok(());
        }
        let letter = char::from(LETTERS[axis]);
        let way = motion.to[axis] - motion.from[axis];
        if self.known[axis] && way.abs() > 180.0 - HALF_TURN_DEG && self.rolls_over(axis) {
            return Err(given.refused(&format!(
                "a word of {letter} half a turn away or more: it may roll over by the machine file (modulo, or a travel of a turn or more), and some controls turn such an axis by the shorter way. State rotary_words = \"linear\" or \"shorter\" in the set-up file"
            )));
        }
        self.notes.add(Note::RollsOver(letter), given.line);
        Ok(())
    }

    /// Makes a rotary axis take the shorter way, by adding whole turns to its start position.
    fn take_shorter_way(
        &self,
        axis: usize,
        motion: &mut Move,
        given: &BlockWords<'_>,
    ) -> Result<(), NcError> {
        if !is_rotary(axis) {
            return Err(given.refused("the shorter way (DC) of an axis that is not rotary"));
        }
        let way = motion.to[axis] - motion.from[axis];
        let turns = 360.0 * (way / 360.0).round();
        if turns != 0.0 && self.machine_has(axis) && !self.may_roll_over(axis) {
            return Err(given.refused(
                "the shorter way (DC, M126) over the end of a travel of less than a turn: such an axis follows its travel. State the travel of the axis, or modulo, in the machine file",
            ));
        }
        if self.known[axis] && (way - turns).abs() > 180.0 - HALF_TURN_DEG {
            return Err(given.refused(
                "half a turn by the shorter way (DC, M126), whose direction the correction could reverse",
            ));
        }
        motion.from[axis] += turns;
        motion.wraps[axis] = turns;
        Ok(())
    }

    /// Checks machine coordinates on a SINUMERIK (G53, G153, SUPA) or HEIDENHAIN control (M91): a setting of the control decides whether
    /// they include the tool length.
    fn check_machine_coordinates(
        &mut self,
        motion: &Move,
        given: &BlockWords<'_>,
    ) -> Result<(), NcError> {
        if motion.incremental.contains(&true) || !self.modal.absolute {
            return Err(given.refused("incremental machine coordinates (G53, G153, SUPA, M91)"));
        }
        if self.modal.centre_point != CentrePoint::Off {
            return Err(given.refused(
                "machine coordinates (G53, G153, SUPA, M91) while TRAORI or M128 is active: switch it off before",
            ));
        }
        for axis in 0..9 {
            let has_length =
                self.modal.tool_offset[axis] != 0.0 || axis == 2 && self.assumptions.tool != 0;
            if motion.words[axis].is_some() && has_length {
                self.known[axis] = false;
            }
        }
        Ok(())
    }

    pub(crate) fn end(
        &self,
        given: &BlockWords<'_>,
        in_machine: bool,
        incremental: &Axes<bool>,
    ) -> Result<Axes, NcError> {
        if in_machine {
            let mut end = self.position;
            for (axis, value) in given.axes()? {
                end[axis] = value * self.modal.scale(axis);
            }
            return Ok(end);
        }
        let before = self.program_position();
        let mut end = before;
        let polar = self.polar_end(given, &before)?;
        if let Some(at) = polar {
            end[..2].copy_from_slice(&at);
        }
        for (axis, value) in given.axes()? {
            let value = value * self.modal.scale(axis);
            end[axis] = if incremental[axis] { before[axis] + value } else { value };
        }
        Ok(self.reached(&end, |axis| given.places[axis].is_some(), polar.is_some()))
    }

    /// Machine coordinates of an end position given in program coordinates. Axes that are not named keep their exact position, unless a
    /// rotation, polar coordinates or tool centre point control moves them.
    pub(crate) fn reached(
        &self,
        end: &Axes,
        is_named: impl Fn(usize) -> bool,
        polar: bool,
    ) -> Axes {
        let to = self.frame.to_machine(end);
        let turns = self.frame.rotation_deg != 0.0 && (is_named(0) || is_named(1));
        each(|axis| {
            let goes_along = axis < 2 && (turns || polar) || axis < 3 && self.frame.tip.is_some();
            if is_named(axis) || goes_along { to[axis] } else { self.position[axis] }
        })
    }

    /// Builds the hole or row of holes of a block; returns false if the cycle has no hole and is stored for the next block.
    pub(crate) fn hole(
        &mut self,
        given: &BlockWords<'_>,
        motion: &mut Move,
        outcome: &mut Outcome,
    ) -> Result<bool, NcError> {
        let (letter, may_store) = self.repeats_by();
        let [_, _, depth] = self.modal.plane.axes();
        let before = self.program_position();
        let [of_r, of_depth] =
            [b'R', LETTERS[depth]].map(|letter| self.modal.height_scale(letter, depth));
        let incremental = motion.incremental[depth];
        let is_known = self.knows_program_position(depth);
        let sticky = &mut self.modal.sticky;
        sticky.initial_is_known.get_or_insert(is_known);
        let initial = *sticky.initial.get_or_insert(before[depth]);
        if let Some(value) = given.letter(b'R')? {
            sticky.clearance = Some(value * of_r);
            sticky.incremental[1] = incremental;
        }
        if let Some(value) = given.axis(depth)? {
            sticky.depth = Some(value * of_depth);
            sticky.incremental[0] = incremental;
        }
        let (Some(way), Some(clearance)) = (sticky.depth, sticky.clearance) else {
            return Err(given.refused("a cycle without its depth or its plane R"));
        };
        let is_fanuc_like = self.control.is_some_and(Control::is_fanuc_like);
        if is_fanuc_like && sticky.incremental != [incremental; 2] {
            return Err(given.refused(
                "a cycle whose depth or plane R was given under the other of G90 and G91: LinuxCNC interprets the number again, and no manual states what this control does: write both into this block",
            ));
        }
        let [clearance, bottom] = if incremental {
            [initial + clearance, initial + clearance + way]
        } else {
            [clearance, way]
        };
        if letter == b'K' && given.has(b'L') {
            return Err(given.refused(
                "a cycle with L, which FANUC controls read as the number of holes in the format of series 10 and 11 only: write K",
            ));
        }
        if letter != b'K' && given.has(b'K') {
            return Err(given.refused(
                "a cycle with K, which some controls read as the number of holes: write L, or each hole in a separate line",
            ));
        }
        let repeats = match given.letter(letter)? {
            Some(repeats) => whole(repeats, 100_000)
                .filter(|repeats| *repeats > 0 || may_store)
                .ok_or_else(|| {
                    let letter = char::from(letter);
                    given.refused(&format!("a cycle with {letter} that is not a number of holes"))
                })?,
            None => 1,
        };
        if repeats == 0 {
            // The control may or may not move to the hole position.
            for axis in (0..9).filter(|axis| *axis != depth) {
                let in_plane = axis < 2 && given.polar.is_some();
                if given.places[axis].is_some() || in_plane {
                    self.mark_assumed(axis);
                }
            }
            return Ok(false);
        }
        motion.path = Path::Hole { bottom, clearance, depth };
        let mut end = self.frame.to_program(&motion.to);
        end[depth] = if self.modal.comes_back { initial.max(clearance) } else { clearance };
        motion.to = self.frame.to_machine(&end);
        if !incremental {
            // Absolute words repeat the same hole.
            return Ok(true);
        }
        let way = each(|axis| match given.places[axis] {
            Some(_) if axis != depth => end[axis] - before[axis],
            _ => 0.0,
        });
        for _ in 1..repeats {
            let from = self.frame.to_machine(&end);
            if given.polar.is_some() {
                self.finish_polar(given)?;
            }
            if let Some(place) = self.polar_end(given, &end)? {
                end[..2].copy_from_slice(&place);
            }
            for (end, way) in end.iter_mut().zip(way) {
                *end += way;
            }
            outcome.row.push(Move {
                from,
                to: self.frame.to_machine(&end),
                wraps: [0.0; 9],
                ..motion.clone()
            });
        }
        Ok(true)
    }

    /// After a hole the tool is at plane R, or at the initial position, which may be unknown.
    fn finish_hole(&mut self, clearance: f64, depth: usize, by_ways: bool, line: usize) {
        let Sticky { initial, initial_is_known, .. } = self.modal.sticky;
        if self.modal.comes_back && initial_is_known != Some(true) {
            // Incremental words return to the initial position, so that a known position stays
            // known.
            self.known[depth] &= by_ways;
        } else if !by_ways {
            self.mark_named(depth);
        }
        if !self.modal.says_return && initial.is_some_and(|initial| initial > clearance) {
            // The default is G99 on LinuxCNC, G98 on FANUC controls.
            self.mark_assumed(depth);
            let note = Note::ReturnPlane(char::from(LETTERS[depth]));
            self.notes.add(note, line);
        }
    }

    pub(crate) fn arc(
        &self,
        code: Code,
        given: &BlockWords<'_>,
        end: &Axes,
    ) -> Result<Arc, NcError> {
        let axes = self.modal.plane.axes();
        let [first, second, _] = axes;
        let (from, to) = (self.program_position(), self.frame.to_program(end));
        let (start, end) = ([from[first], from[second]], [to[first], to[second]]);
        let letters = self.modal.plane.centre_letters();
        let unit = self.modal.unit_mm;
        let mut ways = [None; 2];
        for (way, letter) in ways.iter_mut().zip(letters) {
            *way = given.letter(letter)?.map(|value| value * unit);
        }
        let clockwise = code == 20;
        let radius = given.letter(b'R')?.map(|radius| radius * unit);
        let (centre, by_radius) = match (radius, ways) {
            (Some(_), [Some(_), _] | [_, Some(_)]) => {
                return Err(given.refused("an arc with a radius R and a centre"));
            }
            (Some(radius), _) => (
                centre_of(start, end, radius, clockwise).map_err(|what| given.refused(what))?,
                true,
            ),
            (None, [None, None]) if self.modal.pole.is_some() => {
                (self.modal.pole.unwrap_or_default(), false)
            }
            (None, [None, None]) => {
                return Err(given.refused(if self.dialect == Dialect::Heidenhain {
                    "an arc without a radius and without a pole (CC) at a known position: program X and Y before a CC that is relative to them"
                } else {
                    "an arc without a centre and without a radius R"
                }));
            }
            (None, ways) => {
                let centre = std::array::from_fn(|i| {
                    let base = if given.centre_is_absolute(letters[i], &self.modal) {
                        0.0
                    } else {
                        start[i]
                    };
                    base + ways[i].unwrap_or(0.0)
                });
                (centre, false)
            }
        };
        let [begins, ends] = [start, end].map(|at| (at[0] - centre[0]).hypot(at[1] - centre[1]));
        if (begins - ends).abs() > MAX_SPIRAL_MM {
            return Err(given.refused(&format!(
                "an arc with a radius of {begins:.3} mm at its start and of {ends:.3} mm at its end"
            )));
        }
        let angle = |at: [f64; 2]| (at[1] - centre[1]).atan2(at[0] - centre[0]);
        let mut turns_by = angle(end) - angle(start);
        let whole_turn = 2.0 * std::f64::consts::PI;
        // An end equal to the start is a full turn.
        if clockwise {
            while turns_by > -1e-12 {
                turns_by -= whole_turn;
            }
        } else {
            while turns_by < 1e-12 {
                turns_by += whole_turn;
            }
        }
        if let Some(turns) = given.letter(b'P')? {
            let turns = whole(turns, 100_000).filter(|turns| *turns > 0);
            let more = turns
                .ok_or_else(|| given.refused("an arc with a P that is not a number of turns"))?
                - 1;
            turns_by += f64::from(more) * whole_turn.copysign(turns_by);
        }
        Ok(Arc { axes, centre, turns_by, by_radius })
    }

    /// True if X and Y words of the block are polar coordinates: those of motions under G16.
    pub(crate) fn takes_polar(&self, codes: &Codes) -> bool {
        let says_no_place = codes.not_modal.is_some() || codes.rotation == Some(680);
        self.modal.polar.is_some() && !codes.in_machine && !says_no_place
    }

    /// Rejects polar coordinates that controls interpret differently.
    fn check_polar(&self, codes: &Codes, given: &BlockWords<'_>) -> Result<(), NcError> {
        let under_g16 = self.modal.polar.is_some();
        if given.polar.is_none() && !under_g16 {
            return Ok(());
        }
        if self.modal.plane != Plane::Xy && (given.polar.is_some() || given.names_axes()) {
            return Err(given.refused("polar coordinates outside the XY plane (G17)"));
        }
        if self.dialect != Dialect::Rs274 || given.polar.is_none() {
            return Ok(());
        }
        if codes.in_machine {
            return Err(given.refused("polar coordinates that are machine coordinates (G53)"));
        }
        let motion = codes.motion.or(self.modal.motion);
        let is_arc = matches!(motion, Some(20 | 30));
        if is_arc && under_g16 && (given.has(b'I') || given.has(b'J')) {
            return Err(given.refused(
                "an arc with a centre under G16, which controls interpret differently: write it with R",
            ));
        }
        if under_g16 && self.is_way(given.polar_word(0)) {
            return Err(given.refused(
                "a distance under G16 in G91, which controls measure from different points: write it in G90",
            ));
        }
        Ok(())
    }

    fn polar_of(&self, given: &BlockWords<'_>) -> Option<Polar> {
        let words = given.polar?;
        let knows_program_position = |of: usize| {
            let word = given.polar_word(of);
            word.is_some() && !self.is_way(word)
        };
        // Under G16 polar values are relative to the last values, not to the tool position.
        let from_here =
            self.modal.polar.is_none() && !(knows_program_position(0) && knows_program_position(1));
        Some(Polar { words, from_here })
    }

    pub(crate) fn is_way(&self, word: Option<&Word>) -> bool {
        word.is_some_and(|word| match word.manner {
            Manner::Incremental => true,
            Manner::Modal => !self.modal.absolute,
            Manner::Absolute | Manner::Shortest => false,
        })
    }

    /// End position given by polar coordinates, in program coordinates, mm; `None` if the block has none.
    fn polar_end(
        &self,
        given: &BlockWords<'_>,
        before: &Axes,
    ) -> Result<Option<[f64; 2]>, NcError> {
        if given.polar.is_none() {
            return Ok(None);
        }
        if given.places[0].is_some() || given.places[1].is_some() {
            return Err(given.refused("X or Y with polar coordinates"));
        }
        if let Some(polar) = self.modal.polar {
            let [Some(radius), Some(angle_deg)] = self.said(polar, given)? else {
                return Err(given.refused(
                    "polar coordinates under G16 before both the distance and the angle were programmed",
                ));
            };
            let (sin, cos) = angle_deg.to_radians().sin_cos();
            return Ok(Some([radius * cos, radius * sin]));
        }
        let pole = match self.dialect {
            // @ and ^ of LinuxCNC refer to the zero of the current coordinates.
            Dialect::Rs274 => [0.0; 2],
            _ => self.modal.pole.ok_or_else(|| given.refused(NO_POLE))?,
        };
        let from = [before[0] - pole[0], before[1] - pole[1]];
        let [distance, angle] = [0, 1].map(|of| given.polar_word(of));
        let needs_angle = angle.is_none_or(|_| self.is_way(angle));
        if self.dialect == Dialect::Rs274 && needs_angle && from == [0.0; 2] {
            return Err(given
                .refused("polar coordinates whose angle is relative to a tool position at zero"));
        }
        let unit = self.modal.unit_mm;
        let mut radius = from[0].hypot(from[1]);
        if let Some(word) = distance {
            let is_way = self.is_way(distance);
            radius = given.value_of(word)? * unit + if is_way { radius } else { 0.0 };
        }
        let start_deg = from[1].atan2(from[0]).to_degrees();
        let mut angle_deg = start_deg;
        if let Some(word) = angle {
            let value = given.value_of(word)?;
            let is_way = self.is_way(angle);
            angle_deg = value + if is_way { start_deg } else { 0.0 };
            if is_way && distance.is_none() && (value / 360.0).fract() == 0.0 {
                // Whole turns end exactly where they start.
                return Ok(Some([before[0], before[1]]));
            }
        }
        let (sin, cos) = angle_deg.to_radians().sin_cos();
        Ok(Some([pole[0] + radius * cos, pole[1] + radius * sin]))
    }

    /// Distance (mm) and angle (deg) under G16, including the words of this block.
    fn said(
        &self,
        [mut distance, mut angle]: [Option<f64>; 2],
        given: &BlockWords<'_>,
    ) -> Result<[Option<f64>; 2], NcError> {
        if let Some(word) = given.polar_word(0) {
            distance = Some(given.value_of(word)? * self.modal.scale(0));
        }
        if let Some(word) = given.polar_word(1) {
            let value = given.value_of(word)?;
            angle = if self.is_way(Some(word)) {
                angle.map(|angle| angle + value)
            } else {
                Some(value)
            };
        }
        Ok([distance, angle])
    }

    /// Updates which positions are known after a polar motion: X and Y are known if both words are absolute, or under
    /// G16.
    fn finish_polar(&mut self, given: &BlockWords<'_>) -> Result<(), NcError> {
        let is_place =
            |of: usize| given.polar_word(of).is_some_and(|word| !self.is_way(Some(word)));
        let is_known = is_place(0) && is_place(1);
        if let Some(polar) = self.modal.polar {
            self.modal.polar = Some(self.said(polar, given)?);
        }
        if is_known || self.modal.polar.is_some() {
            self.mark_named(0);
            self.mark_named(1);
        }
        Ok(())
    }
}

/// Maximum difference between the radii at the ends of an arc, mm: LinuxCNC's default limit; other controls accept far less.
const MAX_SPIRAL_MM: f64 = 0.127;

/// Maximum rounding error of the radius of a half circle, mm, as in LinuxCNC.
const ROUNDED_MM: f64 = 0.00127;

/// Centre of an arc given by its radius; a negative radius selects the longer arc.
pub(crate) fn centre_of(
    start: [f64; 2],
    end: [f64; 2],
    radius: f64,
    clockwise: bool,
) -> Result<[f64; 2], &'static str> {
    let way = [end[0] - start[0], end[1] - start[1]];
    let chord = way[0].hypot(way[1]);
    if chord == 0.0 || radius == 0.0 {
        return Err("an arc with a radius R that ends at its start");
    }
    let rest = radius * radius - 0.25 * chord * chord;
    // A half circle may be short by the rounding of its numbers.
    let short = 0.5 * chord - radius.abs();
    if rest < 0.0 && short > (1e-4 * radius.abs()).max(ROUNDED_MM) {
        return Err("an arc whose radius R is too small for its end");
    }
    let height = rest.max(0.0).sqrt();
    // For the shorter counterclockwise arc the centre is to the left of the chord.
    let side = if (radius > 0.0) == clockwise { -1.0 } else { 1.0 };
    let normal = [-way[1] / chord, way[0] / chord];
    Ok(std::array::from_fn(|i| 0.5 * (start[i] + end[i]) + side * height * normal[i]))
}

const NO_POLE: &str = "polar coordinates without a pole (CC) at a known position: program X and Y before a CC that is relative to them";
