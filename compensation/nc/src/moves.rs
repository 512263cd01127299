//! The motion of a block: where it leads, along which arc, or as which hole of a cycle.

use crate::{
    NcError,
    block::{Begins, Manner},
    codes::{Codes, is_cycle, text},
    coordinates::{Axes, LETTERS, is_rotary},
    dialect::Dialect,
    given::Given,
    interpret::{Interpreter, Outcome},
    modal::{CentrePoint, Code, Plane, Sticky},
    motion::{Move, Path},
    notes::Note,
    words::each,
};

/// A rotary axis that goes the shorter way and is this near to half a turn, deg, might go the other way round with its correction.
const HALF_TURN_DEG: f64 = 0.5;

impl Interpreter {
    pub(crate) fn set_motion(&mut self, code: Code) {
        // G80 ends a row, and what it has kept.
        if self.modal.motion.is_none_or(|before| !is_cycle(before)) || !is_cycle(code) {
            self.modal.sticky = Sticky::default();
        }
        self.modal.motion = (code != 800).then_some(code);
    }

    pub(crate) fn motion(
        &mut self,
        codes: &Codes,
        given: &Given<'_>,
        outcome: &mut Outcome,
    ) -> Result<(), NcError> {
        let polar = given.polar.is_some();
        self.check_polar(codes, given)?;
        self.check_code(codes, given)?;
        let motion_before = self.modal.motion;
        if let Some(code) = codes.motion() {
            self.set_motion(code);
        }
        let has_words = given.names_axes() || polar;
        self.check_words(codes, given, has_words)?;
        if self.modal.motion_unsure && codes.motion().is_none() && has_words {
            return Err(given.refused(
                "a motion without a G code behind a block that may be skipped (/) and has another one: write the code into this block",
            ));
        }
        if given.block.begins == Begins::Slash {
            self.modal.motion_unsure |=
                motion_before.is_some() && self.modal.motion != motion_before;
        } else if codes.motion().is_some() {
            self.modal.motion_unsure = false;
        }
        let Some(code) = self.modal.motion else {
            if has_words {
                return Err(given.refused("axis words without a motion that takes them"));
            }
            return Ok(());
        };
        let has_centre = || {
            [b'I', b'J', b'K']
                .into_iter()
                .any(|letter| given.has(letter))
        };
        let is_whole_circle = matches!(code, 20 | 30) && codes.motion().is_some() && has_centre();
        if !(has_words || is_whole_circle) {
            if is_cycle(code) && given.has(b'R') {
                return Err(given.refused(
                    "R alone while a cycle holds, which some controls drill with and others do not: write it into the block of the next hole",
                ));
            }
            return Ok(());
        }
        let path = match code {
            // Arcs and cycles are made below, once their ends are known.
            0 => Path::Rapid,
            _ if is_cycle(code) => Path::Rapid,
            10 | 20 | 30 => Path::Line,
            50..=52 => {
                self.notes.add(Note::GoesWhole(text(code)), given.line);
                Path::Spline
            }
            _ => {
                self.notes.add(Note::PassedOn(text(code)), given.line);
                Path::Other
            }
        };
        let manner = |axis: usize| given.word(axis).map_or(Manner::Modal, |word| word.manner);
        let incremental: Axes<bool> = each(|axis| match manner(axis) {
            Manner::Modal => !self.modal.absolute && !codes.in_machine,
            Manner::Incremental => true,
            Manner::Absolute | Manner::Shortest => false,
        });
        self.checks_rotation(given, &incremental)?;
        let mut motion = Move {
            path,
            from: self.position,
            to: self.end(given, codes.in_machine, &incremental)?,
            words: given.places,
            incremental,
            in_machine: codes.in_machine,
            polar: self.polar_of(given),
            known: self.known_before(given, code),
            wraps: [0.0; 9],
        };
        self.check_axes_of_tip(&motion, given)?;
        for axis in 0..9 {
            let shorter = self.modal.shorter && is_rotary(axis) && motion.words[axis].is_some();
            if manner(axis) == Manner::Shortest || shorter && !motion.incremental[axis] {
                self.goes_shorter(axis, &mut motion, given)?;
            }
        }
        if matches!(code, 20 | 30) {
            self.check_beginning(given)?;
            motion.path = Path::Arc(self.arc(code, given, &motion.to)?);
        } else if is_cycle(code) && !self.hole(given, &mut motion, outcome)? {
            return Ok(());
        }
        if polar {
            self.ends_polar(given)?;
        }
        self.names_places(code, codes, &motion, given);
        if code == 331 {
            // It comes back to where it began.
            (motion.to, motion.words) = (motion.from, [None; 9]);
        } else {
            self.position = outcome.row.last().map_or(motion.to, |last| last.to);
        }
        if codes.in_machine && self.dialect != Dialect::Rs274 {
            self.suppresses(&motion, given)?;
        }
        outcome.motion = Some(motion);
        Ok(())
    }

    /// # Errors
    /// Coordinates of a printer without a code.
    fn check_code(&self, codes: &Codes, given: &Given<'_>) -> Result<(), NcError> {
        if self.is_printer() && codes.motion().is_none() && given.names_axes() {
            return Err(given.refused(
                "coordinates without a code, which Klipper does not execute: write G0, G1, G2 or G3 before them",
            ));
        }
        Ok(())
    }

    /// # Errors
    /// A word beside a motion that does not use it: LinuxCNC refuses such, and another control may mean something by it.
    fn check_words(
        &self,
        codes: &Codes,
        given: &Given<'_>,
        has_words: bool,
    ) -> Result<(), NcError> {
        let motion = self
            .modal
            .motion
            .filter(|_| has_words || codes.motion().is_some());
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
        let Some(letter) = b"EKQR"
            .iter()
            .find(|letter| given.has(**letter) && !uses(**letter))
        else {
            return Ok(());
        };
        let why = match letter {
            b'E' => {
                "which is the filament of a printer: state control = \"marlin\" or \"klipper\" in the set-up file"
            }
            b'R' => "with which some controls round a corner",
            b'K' if is_arc => "which is no part of the centre in the plane of X and Y (G17)",
            _ => "which no code of the block uses, so that LinuxCNC refuses it",
        };
        let (letter, code) = (char::from(*letter), text(motion));
        Err(given.refused(&format!("{letter} beside {code}, {why}")))
    }

    /// # Errors
    /// An arc that begins where an M code with the words of axes may have left them, with a correction or without.
    fn check_beginning(&self, given: &Given<'_>) -> Result<(), NcError> {
        let [first, second, _] = self.modal.plane.axes();
        let Some(axis) = [first, second]
            .into_iter()
            .find(|axis| self.is_unclaimed(*axis))
        else {
            return Ok(());
        };
        Err(given.refused(&format!(
            "an arc after an unknown M code with a word of {}, which may have moved the axis: write G0 or G1 into the block of the M code if it moves, or name the axis before the arc",
            char::from(LETTERS[axis])
        )))
    }

    /// # Errors
    /// A rotary axis that the machine file lacks moves while the tip of the tool is to keep its place.
    fn check_axes_of_tip(&self, motion: &Move, given: &Given<'_>) -> Result<(), NcError> {
        if self.modal.centre_point != CentrePoint::Off
            && let Some(axis) = (3..9).find(|axis| {
                is_rotary(*axis) && motion.words[*axis].is_some() && !self.machine_has(*axis)
            })
        {
            return Err(given.refused(&format!(
                "a motion of {}, which the machine file does not have, while the control keeps the tip of the tool in its place (M428, G43.4, TRAORI, M128)",
                char::from(LETTERS[axis])
            )));
        }
        Ok(())
    }

    /// Of which axes it is known where a motion begins: of those that it moves in the coordinates of the program, of the others in those of
    /// the machine.
    fn known_before(&self, given: &Given<'_>, code: Code) -> Axes<bool> {
        let in_plane = given.word(0).is_some() || given.word(1).is_some();
        let turns = self.frame.rotation_deg != 0.0 && in_plane || given.polar.is_some();
        let of_arc = matches!(code, 20 | 30).then(|| self.modal.plane.axes());
        each(|axis| {
            let moves = given.word(axis).is_some()
                || axis < 2 && turns
                || axis < 3 && self.frame.tip.is_some()
                || of_arc.is_some_and(|[first, second, _]| axis == first || axis == second);
            self.known[axis] && (!moves || self.says_place(axis))
        })
    }

    /// A motion has ended: of which axes the place is known now.
    fn names_places(&mut self, code: Code, codes: &Codes, motion: &Move, given: &Given<'_>) {
        // Where a probing move ends is only known at the machine.
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
                self.is_at_machine_place(axis);
            } else if !motion.incremental[axis] && !is_depth(axis) {
                self.is_named(axis);
            }
        }
        if let Path::Hole {
            clearance, depth, ..
        } = motion.path
        {
            self.is_behind_hole(clearance, depth, motion.incremental[depth], given.line);
        }
    }

    /// What is a way turns about the place of the tool until a place has been named under a rotation.
    fn checks_rotation(
        &mut self,
        given: &Given<'_>,
        incremental: &Axes<bool>,
    ) -> Result<(), NcError> {
        if !self.modal.rotation_is_new {
            return Ok(());
        }
        let is_way = |axis: usize| given.word(axis).is_some() && incremental[axis];
        if is_way(0) || is_way(1) {
            return Err(given.refused("a way (G91) behind G68 before X or Y was named in G90, which FANUC controls turn about the place of the tool"));
        }
        if given.word(0).is_some() || given.word(1).is_some() || given.polar.is_some() {
            self.modal.rotation_is_new = false;
        }
        Ok(())
    }

    /// A rotary axis goes to its place by the shorter way: it begins at the number from which that leads there.
    fn goes_shorter(
        &self,
        axis: usize,
        motion: &mut Move,
        given: &Given<'_>,
    ) -> Result<(), NcError> {
        if !is_rotary(axis) {
            return Err(given.refused("the shorter way (DC) of an axis that does not turn"));
        }
        let way = motion.to[axis] - motion.from[axis];
        let turns = 360.0 * (way / 360.0).round();
        if self.known[axis] && (way - turns).abs() > 180.0 - HALF_TURN_DEG {
            return Err(given.refused(
                "half a turn by the shorter way (DC, M126), which its correction would turn round",
            ));
        }
        motion.from[axis] += turns;
        motion.wraps[axis] = turns;
        Ok(())
    }

    /// Machine coordinates at a SINUMERIK control (G53, G153, SUPA) and at a HEIDENHAIN control (M91): whether the length of the tool counts there is a setting of the
    /// control.
    fn suppresses(&mut self, motion: &Move, given: &Given<'_>) -> Result<(), NcError> {
        if motion.incremental.contains(&true) || !self.modal.absolute {
            return Err(given.refused("machine coordinates (G53, G153, SUPA, M91) that are ways"));
        }
        if self.modal.centre_point != CentrePoint::Off {
            return Err(given.refused(
                "machine coordinates (G53, G153, SUPA, M91) while TRAORI or M128 is on: switch it off before",
            ));
        }
        for axis in 0..9 {
            let has_length =
                self.modal.tool_offset[axis] != 0.0 || axis == 2 && self.rests.has_unstated_tool();
            if motion.words[axis].is_some() && has_length {
                self.known[axis] = false;
            }
        }
        Ok(())
    }

    /// Where the words of a motion lead, in the coordinates of the machine.
    fn end(
        &self,
        given: &Given<'_>,
        in_machine: bool,
        incremental: &Axes<bool>,
    ) -> Result<Axes, NcError> {
        if in_machine {
            let mut end = self.position;
            given.each_axis(|axis, value| end[axis] = value * self.modal.scale(axis))?;
            return Ok(end);
        }
        let before = self.program_position();
        let mut end = before;
        let polar = self.polar_end(given, &before)?;
        if let Some(at) = polar {
            end[..2].copy_from_slice(&at);
        }
        given.each_axis(|axis, value| {
            let value = value * self.modal.scale(axis);
            end[axis] = if incremental[axis] {
                before[axis] + value
            } else {
                value
            };
        })?;
        Ok(self.reached(&end, |axis| given.places[axis].is_some(), polar.is_some()))
    }

    /// Where words lead whose end this is in the coordinates of the program: what is not named stays where it is, to the last digit, unless
    /// another axis takes it along.
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
            if is_named(axis) || goes_along {
                to[axis]
            } else {
                self.position[axis]
            }
        })
    }
}
