//! What a block sets without moving: tool lengths, work offsets, a rotation, the zero of the coordinates, the places of G28
//! and G30.

use crate::{
    NcError,
    codes::Codes,
    control::Control,
    coordinates::LETTERS,
    given::Given,
    interpret::{Interpreter, Outcome},
    modal::{Code, MOST_NUMBERED, Plane, RS274_SYSTEMS, numbered},
    motion::{Move, Path},
    notes::Note,
    words::each,
};

impl Interpreter {
    /// G43, G43.1, G43.2, G43.4 and G49.
    pub(crate) fn tool_length(&mut self, code: Code, given: &Given<'_>) -> Result<(), NcError> {
        let unit_mm = self.modal.unit_mm;
        if self.modal.tool_offset != [0.0; 9] && self.modal.length_unit_mm != unit_mm {
            return Err(given.refused(
                "a tool length that ends in another unit than it began (G20, G21), after which LinuxCNC takes its mm for inch: end it with G49 before",
            ));
        }
        self.modal.length_unit_mm = unit_mm;
        if code == 490 {
            self.modal.tool_offset = [0.0; 9];
            self.modal.length = None;
            self.rests.takes_tool(None);
            return Ok(());
        }
        if code == 431 {
            self.rests.takes_tool(None);
            for (axis, value) in given.axes()? {
                self.modal.tool_offset[axis] = value * self.modal.scale(axis);
            }
            return Ok(());
        }
        let number = given.whole(b'H')?.or(self.tool_in_spindle()).unwrap_or(0);
        let offset = self.tools.get(&number).copied();
        if offset.is_none() && number != 0 {
            self.notes.add(Note::NoToolLength(number), given.line);
        }
        let unstated = (offset.is_none() && number != 0).then_some(number);
        match (code, unstated) {
            // On top of a length that may be unknown, too.
            (432, None) => {}
            (432, Some(number)) => self.rests.takes_tool(Some(number + 100_000)),
            _ => self.rests.takes_tool(unstated),
        }
        self.modal.length = (code != 432).then_some(number);
        if code != 432 {
            self.modal.tool_offset = [0.0; 9];
        }
        let offset = offset.unwrap_or([0.0; 9]);
        for (sum, offset) in self.modal.tool_offset.iter_mut().zip(offset) {
            *sum += offset;
        }
        Ok(())
    }

    /// The number of the tool in the spindle: the one that M6 has put there, and of a program without M6 the one that T has named.
    pub(crate) fn tool_in_spindle(&self) -> Option<u32> {
        if self.changes_tools {
            self.in_spindle
        } else {
            self.modal.tool
        }
    }

    /// G68.
    pub(crate) fn rotation(&mut self, given: &Given<'_>) -> Result<(), NcError> {
        let angle = given.letter(b'R')?;
        let angle = angle.ok_or_else(|| given.refused("G68 without an angle R"))?;
        if self.modal.plane != Plane::Xy {
            return Err(given.refused("a rotation in another plane than X Y (G17)"));
        }
        if ![0, 1].into_iter().all(|axis| given.word(axis).is_some()) {
            return Err(given.refused("G68 without X and Y, about the place of the tool: write the centre of the rotation"));
        }
        if self.is_shifted_in_plane() {
            return Err(given.refused("G68 while a shift (G52, G92) is in force, in whose coordinates its centre is not followed"));
        }
        let mut centre = [0.0; 2];
        for (axis, centre) in centre.iter_mut().enumerate() {
            *centre = given.axis(axis)?.unwrap_or(0.0) * self.modal.scale(axis);
        }
        self.modal.rotation = Some((angle, centre));
        self.modal.rotation_is_new = true;
        Ok(())
    }

    /// A shift of X or Y is in force.
    fn is_shifted_in_plane(&self) -> bool {
        self.modal.shifted && self.modal.shift[..2].iter().any(|by| *by != 0.0)
    }

    /// Codes that hold for their block only. Whether the axis words are theirs.
    pub(crate) fn not_modal(
        &mut self,
        codes: &Codes,
        given: &Given<'_>,
        outcome: &mut Outcome,
    ) -> Result<bool, NcError> {
        match codes.not_modal() {
            Some(100) => self.set_table(given, outcome)?,
            Some(code @ (280 | 300)) => {
                self.go_home(usize::from(code == 300), given, outcome)?;
            }
            Some(code @ (281 | 301)) => {
                let lacks = |axis: usize| self.machine_has(axis) && !self.known[axis];
                if (0..9).any(lacks) {
                    self.notes.add(Note::HomeUnknown, given.line);
                }
                let which = usize::from(code == 301);
                self.stores_home(which);
                outcome.stores_home = Some(which);
            }
            Some(920) => {
                self.shifts_by(false, given)?;
                self.update_frame();
                for (axis, value) in given.axes()? {
                    // Where the axis is, the program reads this value from now on.
                    let at = self.program_position()[axis] - value * self.modal.scale(axis);
                    self.shift_is_from_place(axis, given.line);
                    self.modal.shift[axis] += at;
                    self.update_frame();
                }
                outcome.presets = Some(given.places);
            }
            Some(520) => {
                self.shifts_by(true, given)?;
                for (axis, value) in given.axes()? {
                    self.modal.shift[axis] = value * self.modal.scale(axis);
                    self.rests.shift_is_stated(axis);
                }
            }
            Some(921) => {
                self.check_end_of_shift(given)?;
                (self.modal.shift, self.modal.shifted) = ([0.0; 9], false);
                self.modal.shift_is_said = true;
                self.rests.shift_is_zero();
            }
            Some(922) => self.modal.shifted = false,
            Some(923) => {
                if !self.modal.shift_is_said {
                    return Err(given.refused("G92.3 before any G92, G52 or G92.1, which brings back what an earlier program has left in the control: write G92 or G92.1 before"));
                }
                self.modal.shifted = true;
            }
            _ => {
                let are_taken = codes.tool_length() == Some(431) || codes.rotation() == Some(680);
                return Ok(are_taken);
            }
        }
        self.update_frame();
        Ok(codes.not_modal() != Some(40))
    }

    /// Starts a shift of some axes by G52 (`local`) or G92: those that G92.2 has switched off do not come back.
    ///
    /// # Errors
    /// G52 and G92 shifts together, on a control that adds them.
    fn shifts_by(&mut self, local: bool, given: &Given<'_>) -> Result<(), NcError> {
        let is_shifted = self.modal.shifted && self.modal.shift != [0.0; 9];
        if is_shifted && self.modal.shift_is_local != local && self.has_two_shifts() {
            return Err(given.refused(if local {
                "G52 while a G92 shift is active: this control adds the two, LinuxCNC replaces one by the other; end the G92 shift first, by G92.1 with every shifted axis"
            } else {
                "G92 while a G52 shift is active: this control adds the two, LinuxCNC replaces one by the other; end the G52 shift first, by zeros (G52 X0)"
            }));
        }
        self.modal.shift_is_local = local;
        if !self.modal.shifted {
            self.modal.shift = [0.0; 9];
            self.rests.shift_is_zero();
        }
        (self.modal.shifted, self.modal.shift_is_said) = (true, true);
        Ok(())
    }

    /// Whether the control adds the shifts of G52 and G92, and G92.1 ends those of the named axes only.
    fn has_two_shifts(&self) -> bool {
        self.control.is_some_and(Control::is_fanuc_like)
    }

    /// # Errors
    /// G92.1 that ends the shift of some of the shifted axes only.
    fn check_end_of_shift(&self, given: &Given<'_>) -> Result<(), NcError> {
        let stays = |axis: &usize| {
            self.modal.shifted && self.modal.shift[*axis] != 0.0 && given.word(*axis).is_none()
        };
        match (0..9).find(stays) {
            Some(axis) if given.names_axes() && self.has_two_shifts() => {
                let letter = char::from(LETTERS[axis]);
                Err(given.refused(&format!(
                    "G92.1 without {letter}, which is shifted, too: this control keeps that shift, LinuxCNC ends it; name every shifted axis, also {letter}"
                )))
            }
            _ => Ok(()),
        }
    }

    /// G10.
    fn set_table(&mut self, given: &Given<'_>, outcome: &mut Outcome) -> Result<(), NcError> {
        let (kind, place) = (given.whole(b'L')?, given.whole(b'P')?);
        // On these controls L20 sets one of the offsets that have numbers; the others are tables of the control.
        let control = self.control.filter(|control| control.is_fanuc_like());
        let has_own = control.is_some();
        match kind {
            Some(20) if has_own => {
                if !self.modal.absolute {
                    return Err(given.refused(
                        "G10 L20 in G91, where the control adds to the offset: write G90 before",
                    ));
                }
                let most = control.map_or(MOST_NUMBERED, Control::last_numbered);
                let number = place.filter(|number| (1..=most).contains(number));
                let system = number.map(numbered).ok_or_else(|| {
                    given.refused(&format!(
                        "G10 L20 without a P from 1 to {most}, the number of the work offset"
                    ))
                })?;
                for (axis, value) in given.axes()? {
                    self.modal.offsets[system].offset[axis] = value * self.modal.scale(axis);
                    self.rests.offset_is_stated(system, axis);
                }
            }
            // Geometry and wear of the radius of a tool, which the control compensates by itself.
            Some(12 | 13) if has_own => {}
            Some(1 | 10 | 11) | None if has_own => {
                return Err(given.refused("G10 that sets the length of a tool in the table of the control: state the length in the set-up file"));
            }
            Some(2 | 20) => {
                if kind == Some(2) && !self.modal.absolute {
                    return Err(given.refused("G10 L2 in G91, where FANUC controls add to the offset and LinuxCNC replaces it: write G90 before"));
                }
                if kind == Some(2) && matches!(place, Some(0) | None) {
                    return Err(given.refused("G10 L2 without a P from 1 to 9: P0 is the offset in force for LinuxCNC, and the common offset of all for FANUC controls"));
                }
                let system = match place {
                    Some(0) | None => self.modal.system,
                    Some(system) if system as usize <= RS274_SYSTEMS => system as usize - 1,
                    Some(_) => {
                        return Err(given.refused("G10 with a P that is no work offset, 1 to 9"));
                    }
                };
                if let Some(angle) = given.letter(b'R')? {
                    let turns = angle != self.modal.offsets[system].rotation_deg;
                    if turns && system == self.modal.system && self.is_shifted_in_plane() {
                        return Err(given.refused("G10 L2 with R, which turns the work offset in force, while X or Y is shifted (G52, G92): LinuxCNC forgets the shift where it works out the place of the tool: write G92.1 before, or turn an offset that is not in force"));
                    }
                    self.modal.offsets[system].rotation_deg = angle;
                }
                for (axis, value) in given.axes()? {
                    let value = value * self.modal.scale(axis);
                    if kind == Some(2) {
                        self.modal.offsets[system].offset[axis] = value;
                        self.rests.offset_is_stated(system, axis);
                        continue;
                    }
                    self.offset_is_from_place(system, axis, given.line);
                    // The offset with which the axis is where it is at this value.
                    let frame = self.frame_with(system);
                    let mut way = [0.0; 9];
                    way[axis] = frame.to_program(&self.position)[axis] - value;
                    let offset = &mut self.modal.offsets[system].offset;
                    for (offset, way) in offset.iter_mut().zip(frame.way_of_offset(&way)) {
                        *offset += way;
                    }
                }
                if kind == Some(20) {
                    outcome.presets = Some(given.places);
                    outcome.preset_system = Some(system);
                }
            }
            Some(1) => {
                let tool =
                    place.ok_or_else(|| given.refused("G10 L1 without the number of a tool P"))?;
                let mut offset = self.tools.get(&tool).copied().unwrap_or([0.0; 9]);
                for (axis, value) in given.axes()? {
                    offset[axis] = value * self.modal.scale(axis);
                }
                self.tools.insert(tool, offset);
            }
            _ => return Err(given.refused("G10 with another L than 1, 2 or 20")),
        }
        Ok(())
    }

    /// G28 and G30: over the place that the words name to the place of the machine that is set.
    fn go_home(
        &mut self,
        which: usize,
        given: &Given<'_>,
        outcome: &mut Outcome,
    ) -> Result<(), NcError> {
        // The place between is passed without a correction, but it must be known.
        for axis in 0..9 {
            given.axis(axis)?;
        }
        let all = !given.names_axes();
        if !all && self.modal.polar.is_some() {
            return Err(given.refused(
                "a place on the way home (G28, G30) under G16, which controls read in different ways: say G15 before",
            ));
        }
        let is_other = which == 1 && given.has(b'P') && given.whole(b'P')? != Some(2);
        let known = each(|axis| self.says_place(axis));
        let from = self.position;
        let mut says_all = true;
        for (axis, place) in given.places.iter().enumerate() {
            if all || place.is_some() {
                if !self.is_at_home(which, axis) && self.machine_has(axis) {
                    says_all = false;
                }
                if is_other {
                    self.known[axis] = false;
                }
            }
        }
        if !says_all || is_other {
            let note = Note::NoHome(["G28", "G30"][which]);
            self.notes.add(note, given.line);
        }
        outcome.motion = Some(Move {
            path: Path::Home(which),
            from,
            to: self.position,
            words: if all {
                [Some(usize::MAX); 9]
            } else {
                given.places
            },
            incremental: [false; 9],
            in_machine: true,
            polar: None,
            known,
            wraps: [0.0; 9],
        });
        Ok(())
    }
}
