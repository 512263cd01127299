//! Executes settings of a block that move no axis.
//!
//! These are tools and their lengths, work offsets, rotations, the coordinate zero, the positions of G28 and G30, and
//! commands of other dialects that have no RS-274 code.

use crate::{
    NcError,
    block::{Command, Cycle, Manner},
    codes::{BlockWords, Codes, whole},
    control::{Control, Dialect},
    coordinates::{Axes, LETTERS, each, turned},
    interpreter::{Interpreter, Outcome},
    modal::{
        CentrePoint, Code, MAX_NUMBERED_OFFSET, NUMBERED, Plane, ProgrammedFrame, RS274_SYSTEMS,
        WORK_OFFSETS, code_text, numbered,
    },
    motion::{Move, Path},
    notes::Note,
};

/// Number of a tool that the program selects by name or not at all.
const UNNAMED_TOOL: u32 = u32::MAX >> 2;

impl Interpreter {
    /// Refuses a block with which LinuxCNC subtracts the tool length, whose number it keeps after G20 and G21.
    pub(crate) fn refuse_length_in(
        &self,
        unit_mm: f64,
        given: &BlockWords<'_>,
        what: &str,
    ) -> Result<(), NcError> {
        if self.modal.tool_offset == [0.0; 9] || self.modal.length_unit_mm == unit_mm {
            return Ok(());
        }
        Err(given.refused(&format!(
            "{what} in another unit than it began (G20, G21), after which LinuxCNC reads its mm as inch: end it with G49 before"
        )))
    }

    pub(crate) fn tool_length(
        &mut self,
        code: Code,
        given: &BlockWords<'_>,
    ) -> Result<(), NcError> {
        self.refuse_length_in(self.modal.unit_mm, given, "a tool length that ends")?;
        self.modal.length_unit_mm = self.modal.unit_mm;
        if code == 490 {
            self.modal.tool_offset = [0.0; 9];
            self.modal.length = None;
            self.assumptions.use_tool_length(None);
            return Ok(());
        }
        if code == 431 {
            self.assumptions.use_tool_length(None);
            for (axis, value) in given.axes()? {
                self.modal.tool_offset[axis] = value * self.modal.scale(axis);
            }
            return Ok(());
        }
        let number = self.length_number(given)?;
        let offset = self.tools.get(&number.unwrap_or(0)).copied();
        // H0 is no length, but an unnamed tool in the spindle has one.
        let unstated = match number {
            _ if offset.is_some() => None,
            Some(number) => Some(number).filter(|number| *number != 0),
            None => Some(UNNAMED_TOOL),
        };
        if unstated.is_some() {
            let note = number.map_or(Note::UnnamedTool, Note::NoToolLength);
            self.notes.add(note, given.line);
        }
        let number = number.unwrap_or(0);
        match (code, unstated) {
            // G43.2 adds to the active length, which may be unknown as well.
            (432, None) => {}
            (432, Some(number)) => self.assumptions.use_tool_length(Some(number + 100_000)),
            _ => self.assumptions.use_tool_length(unstated),
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

    /// Number of the length that G43 activates; `None`: that of the tool in the spindle, which the program does not name.
    fn length_number(&self, given: &BlockWords<'_>) -> Result<Option<u32>, NcError> {
        match given.whole(b'H')? {
            Some(0) if self.control.is_none() => Err(given.refused(
                "G43 H0, the length of the tool in the spindle on LinuxCNC and no length on FANUC controls: write G49 or the number of the tool, or state the control in the set-up file",
            )),
            Some(number) if number > 0 || self.control != Some(Control::LinuxCnc) => {
                Ok(Some(number))
            }
            _ => Ok(self.tool_in_spindle()),
        }
    }

    /// Number of the tool in the spindle: by M6 or M61, or, except on LinuxCNC, by T in a program without M6.
    pub(crate) fn tool_in_spindle(&self) -> Option<u32> {
        if self.changes_tools || self.control == Some(Control::LinuxCnc) {
            self.in_spindle
        } else {
            self.modal.tool
        }
    }

    pub(crate) fn rotation(&mut self, given: &BlockWords<'_>) -> Result<(), NcError> {
        let angle = given.letter(b'R')?;
        let angle = angle.ok_or_else(|| given.refused("G68 without an angle R"))?;
        if !self.modal.absolute {
            return Err(given.refused(
                "G68 in G91, where some controls add R to the angle of the last G68: write G90 before",
            ));
        }
        if self.modal.plane != Plane::Xy {
            return Err(given.refused("a rotation outside the XY plane (G17)"));
        }
        if ![0, 1].into_iter().all(|axis| given.word(axis).is_some()) {
            return Err(given.refused(
                "G68 without X and Y, about the tool position: write the centre of the rotation",
            ));
        }
        if self.is_shifted_in_plane() {
            return Err(
                given.refused("G68 while a shift (G52, G92) is active, which is not supported")
            );
        }
        let mut centre = [0.0; 2];
        for (axis, centre) in centre.iter_mut().enumerate() {
            *centre = given.axis(axis)?.unwrap_or(0.0) * self.modal.scale(axis);
        }
        self.modal.rotation = Some((angle, centre));
        self.forget_turned();
        Ok(())
    }

    /// Marks X and Y after G68 and G69: a control may keep the coordinate of an axis that the next block does not name, or its position.
    pub(crate) fn forget_turned(&mut self) {
        self.modal.frame_is_new[..2].fill(true);
        for axis in 0..2 {
            self.mark_assumed(axis);
        }
    }

    /// Whether the control may treat tool lengths otherwise than LinuxCNC and Grbl.
    fn may_move_by_length(&self) -> bool {
        !matches!(self.control, Some(Control::LinuxCnc | Control::Grbl))
    }

    /// Marks the axes whose tool length G43 or G49 has changed from `before`, unless the control is LinuxCNC or Grbl: FANUC controls may move an axis by
    /// the length even if the block does not name it (parameter 5006#6).
    pub(crate) fn forget_lengthened(&mut self, before: (Axes, u32)) {
        let (offset, tool) = before;
        let is_other = self.assumptions.tool != tool;
        if !self.may_move_by_length() {
            return;
        }
        for axis in 0..9 {
            if self.modal.tool_offset[axis] != offset[axis] || axis == 2 && is_other {
                self.mark_assumed(axis);
            }
        }
    }

    /// Marks an axis at a machine position or home while it has a tool length, unless the control is LinuxCNC: Haas controls cancel the length
    /// at G28.
    pub(crate) fn forget_under_length(&mut self, axis: usize) {
        let has_length =
            self.modal.tool_offset[axis] != 0.0 || axis == 2 && self.assumptions.tool != 0;
        if has_length && self.dialect == Dialect::Rs274 && self.may_move_by_length() {
            self.mark_assumed(axis);
        }
    }

    fn is_shifted_in_plane(&self) -> bool {
        self.modal.shifted && self.modal.shift[..2].iter().any(|by| *by != 0.0)
    }

    /// Executes non-modal codes. Returns true if they use the axis words.
    pub(crate) fn not_modal(
        &mut self,
        codes: &Codes,
        given: &BlockWords<'_>,
        outcome: &mut Outcome,
    ) -> Result<bool, NcError> {
        match codes.not_modal {
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
                self.store_home(which);
                outcome.stores_home = Some(which);
            }
            Some(920) => {
                self.shifts_by(false, given)?;
                self.update_frame();
                for (axis, value) in given.axes()? {
                    // The current position gets this program coordinate.
                    let at = self.program_position()[axis] - value * self.modal.scale(axis);
                    self.set_shift_from_position(axis, given.line);
                    self.modal.shift[axis] += at;
                    self.update_frame();
                }
                outcome.presets = Some(given.places);
            }
            Some(520) => {
                self.shifts_by(true, given)?;
                for (axis, value) in given.axes()? {
                    self.modal.shift[axis] = value * self.modal.scale(axis);
                    self.assumptions.shift_is_stated(axis);
                }
            }
            Some(921) => {
                self.check_end_of_shift(given)?;
                self.forget_unsaid_shifts(|_| true);
                (self.modal.shift, self.modal.shifted) = ([0.0; 9], false);
                // With axes named, some controls end the shifts of those alone.
                let ends = |axis: usize| {
                    !self.has_two_shifts() || !given.names_axes() || given.word(axis).is_some()
                };
                let ended: Axes<bool> = each(ends);
                self.say_shifts(&ended);
                self.assumptions.shift_is_zero();
            }
            Some(922) => {
                self.forget_unsaid_shifts(|_| true);
                self.modal.shifted = false;
            }
            Some(923) => {
                if !self.modal.has_set_shift {
                    return Err(given.refused("G92.3 before any G92, G52 or G92.1, which brings back what an earlier program has left in the control: write G92 or G92.1 before"));
                }
                self.modal.shifted = true;
            }
            _ => {
                let are_taken = codes.tool_length == Some(431) || codes.rotation == Some(680);
                return Ok(are_taken);
            }
        }
        self.update_frame();
        Ok(codes.not_modal != Some(40))
    }

    /// Starts a shift of some axes by G52 (`local`) or G92; shifts that G92.2 has suspended do not return. Errors: G52 and G92 shifts together, on a
    /// control that adds them.
    fn shifts_by(&mut self, local: bool, given: &BlockWords<'_>) -> Result<(), NcError> {
        if self.modal.rotation.is_some() && (given.word(0).is_some() || given.word(1).is_some()) {
            return Err(given.refused(
                "a shift of X or Y (G52, G92) while a rotation (G68) is active, which controls forbid or add before or after the rotation: end the rotation first, by G69",
            ));
        }
        let is_shifted = self.modal.shifted && self.modal.shift != [0.0; 9];
        if is_shifted && self.modal.shift_is_local != local && self.has_two_shifts() {
            return Err(given.refused(if local {
                "G52 while a G92 shift is active: this control adds the two, LinuxCNC replaces one by the other; end the G92 shift first, by G92.1 with every shifted axis"
            } else {
                "G92 while a G52 shift is active: this control adds the two, LinuxCNC replaces one by the other; end the G52 shift first, by zeros (G52 X0)"
            }));
        }
        self.modal.shift_is_local = local;
        if local {
            let named: Axes<bool> = each(|axis| given.word(axis).is_some());
            self.forget_unsaid_shifts(|axis| named[axis]);
            self.say_shifts(&named);
        }
        if !self.modal.shifted {
            self.modal.shift = [0.0; 9];
            self.assumptions.shift_is_zero();
        }
        (self.modal.shifted, self.modal.has_set_shift) = (true, true);
        Ok(())
    }

    /// Forgets the positions of those axes whose shift the program has not stated and now ends or replaces.
    fn forget_unsaid_shifts(&mut self, ends: impl Fn(usize) -> bool) {
        for axis in (0..9).filter(|axis| ends(*axis)) {
            if !self.modal.shift_is_said[axis] {
                self.forget_named(axis..axis + 1);
            }
        }
    }

    fn say_shifts(&mut self, axes: &Axes<bool>) {
        for (is_said, says) in self.modal.shift_is_said.iter_mut().zip(axes) {
            *is_said |= says;
        }
        self.modal.has_set_shift = true;
    }

    /// True if the control adds the shifts of G52 and G92, and G92.1 cancels those of the named axes only.
    fn has_two_shifts(&self) -> bool {
        self.control.is_some_and(Control::is_fanuc_like)
    }

    /// Rejects a G92.1 that cancels only some of the active shifts.
    fn check_end_of_shift(&self, given: &BlockWords<'_>) -> Result<(), NcError> {
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

    fn set_table(&mut self, given: &BlockWords<'_>, outcome: &mut Outcome) -> Result<(), NcError> {
        let (kind, place) = (given.whole(b'L')?, given.whole(b'P')?);
        // On FANUC-like controls L20 sets one of the numbered offsets, and L1 and L10 to L13 set tables of tools.
        let control = self.control.filter(|control| control.is_fanuc_like());
        let has_own = control.is_some();
        match kind {
            Some(20) if has_own => {
                if !self.modal.absolute {
                    return Err(given.refused(
                        "G10 L20 in G91, where the control adds to the offset: write G90 before",
                    ));
                }
                let most = control.map_or(MAX_NUMBERED_OFFSET, Control::last_numbered);
                let number = place.filter(|number| (1..=most).contains(number));
                let system = number.map(numbered).ok_or_else(|| {
                    given.refused(&format!(
                        "G10 L20 without a P from 1 to {most}, the number of the work offset"
                    ))
                })?;
                for (axis, value) in given.axes()? {
                    self.modal.offsets[system].offset[axis] = value * self.modal.scale(axis);
                    self.assumptions.offset_is_stated(system, axis);
                }
            }
            // Geometry and wear of the tool radius, which the control compensates itself.
            Some(12 | 13) if has_own => {}
            Some(1 | 10 | 11) | None if has_own => {
                return Err(given.refused("G10 that sets the length of a tool in the table of the control: state the length in the set-up file"));
            }
            Some(2 | 20) => {
                if kind == Some(2) && !self.modal.absolute {
                    return Err(given.refused("G10 L2 in G91, where FANUC controls add to the offset and LinuxCNC replaces it: write G90 before"));
                }
                if kind == Some(2) && matches!(place, Some(0) | None) {
                    return Err(given.refused("G10 L2 without a P from 1 to 9: P0 is the active offset on LinuxCNC and the common offset on FANUC controls"));
                }
                let system = match place {
                    Some(0) | None => self.modal.system,
                    Some(system) if system as usize <= RS274_SYSTEMS => system as usize - 1,
                    Some(_) => {
                        return Err(
                            given.refused("G10 with a P that is not a work offset from 1 to 9")
                        );
                    }
                };
                if let Some(angle) = given.letter(b'R')? {
                    let turns = angle != self.modal.offsets[system].rotation_deg;
                    if turns && system == self.modal.system && self.is_shifted_in_plane() {
                        return Err(given.refused("G10 L2 with R, which rotates the active work offset, while X or Y is shifted (G52, G92): LinuxCNC then omits the shift from the tool position: write G92.1 before, or rotate an inactive offset"));
                    }
                    self.modal.offsets[system].rotation_deg = angle;
                }
                for (axis, value) in given.axes()? {
                    let value = value * self.modal.scale(axis);
                    if kind == Some(2) {
                        self.modal.offsets[system].offset[axis] = value;
                        self.assumptions.offset_is_stated(system, axis);
                        continue;
                    }
                    self.set_offset_from_position(system, axis, given.line);
                    // The work offset in which the current position has this coordinate.
                    let frame = self.frame_with(system);
                    let mut way = [0.0; 9];
                    way[axis] = frame.to_program(&self.position)[axis] - value;
                    let offset = &mut self.modal.offsets[system].offset;
                    for (offset, way) in offset.iter_mut().zip(turned(&way, frame.rotation_deg)) {
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

    fn go_home(
        &mut self,
        which: usize,
        given: &BlockWords<'_>,
        outcome: &mut Outcome,
    ) -> Result<(), NcError> {
        // The intermediate point is not corrected, but its coordinates must be known.
        for axis in 0..9 {
            given.axis(axis)?;
        }
        let all = !given.names_axes();
        if !all
            && self.frame.rotation_deg != 0.0
            && given.places[0].is_some() != given.places[1].is_some()
        {
            return Err(given.refused(
                "G28 or G30 of X or Y alone while the coordinates are rotated, where LinuxCNC moves along the rotated axis and others along the machine's: name both, or use G53",
            ));
        }
        if !all && self.modal.polar.is_some() {
            return Err(given.refused(
                "an intermediate point (G28, G30) under G16, which controls interpret differently: write G15 before",
            ));
        }
        let is_other = which == 1 && given.has(b'P') && given.whole(b'P')? != Some(2);
        let known = each(|axis| self.knows_program_position(axis));
        let before = each(|axis| self.known_basis(axis));
        let from = self.position;
        let incremental = each(|axis| self.is_way(given.word(axis)));
        let through = self.end(given, false, &incremental)?;
        let mut says_all = true;
        for (axis, place) in given.places.iter().enumerate() {
            if all || place.is_some() {
                if !self.move_home(which, axis) && self.machine_has(axis) {
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
            path: Path::Home { which, through },
            from,
            to: self.position,
            words: if all { [Some(usize::MAX); 9] } else { given.places },
            incremental: [false; 9],
            in_machine: true,
            polar: None,
            known,
            arrives_from_unknown: each(|axis| {
                before[axis].is_none() || before[axis] != self.known_basis(axis)
            }),
            wraps: [0.0; 9],
        });
        for axis in (0..9).filter(|axis| all || given.places[*axis].is_some()) {
            self.forget_under_length(axis);
            // On these controls a home without an axis may move none.
            if all && matches!(self.control, Some(Control::Fanuc | Control::Mazak)) {
                self.mark_assumed(axis);
            }
        }
        Ok(())
    }

    pub(crate) fn system_of(
        &self,
        code: Code,
        codes: &Codes,
        given: &BlockWords<'_>,
    ) -> Result<usize, NcError> {
        let control = self.control;
        let is_numbered = control.is_some_and(|control| control.has_numbered_offset(code));
        // FANUC controls read G54 P2 as G54.1 P2.
        let with_p = code == 540
            && given.has(b'P')
            && matches!(control, Some(Control::Fanuc | Control::Mazak));
        if !is_numbered && !with_p {
            let found = WORK_OFFSETS.iter().position(|of| *of == code);
            return Ok(found.unwrap_or(self.modal.system));
        }
        if (1100..=1290).contains(&code) {
            return Ok(NUMBERED + usize::from(code / 10 - 110));
        }
        let is_elsewhere = codes.not_modal.is_some()
            || codes
                .motion
                .or(self.modal.motion)
                .is_some_and(|code| code > 30 && given.names_axes());
        let most = control.map_or(MAX_NUMBERED_OFFSET, Control::last_numbered);
        match given.whole(b'P')? {
            Some(number) if (1..=most).contains(&number) && !is_elsewhere => Ok(numbered(number)),
            _ => Err(given.refused(&format!(
                "{} without its own P from 1 to {most}, the number of the work offset",
                code_text(code)
            ))),
        }
    }

    /// True if a dwell has its time (s) in X or U, as on FANUC and Mazak controls.
    pub(crate) fn dwells_by_axis(&self, codes: &Codes, given: &BlockWords<'_>) -> bool {
        let has_time = given.has(b'X') || given.has(b'U');
        let others = (0..9).any(|axis| given.word(axis).is_some() && !matches!(axis, 0 | 6));
        codes.not_modal == Some(40)
            && codes.motion.is_none()
            && has_time
            && !others
            && matches!(self.control, Some(Control::Fanuc | Control::Mazak))
    }

    /// Rejects U, V or W on a machine without this axis: lathes with these controls read it as an
    /// incremental X, Y or Z.
    pub(crate) fn check_incremental_letters(
        &self,
        codes: &Codes,
        given: &BlockWords<'_>,
    ) -> Result<(), NcError> {
        let is_lacked = |axis: &usize| given.word(*axis).is_some() && !self.machine_has(*axis);
        let axis = (6..9).find(is_lacked).filter(|_| {
            codes.not_modal != Some(40)
                && codes.with_arguments().is_none()
                && self.control.is_some_and(Control::is_fanuc_like)
        });
        let Some(axis) = axis else {
            return Ok(());
        };
        let [letter, of] = [axis, axis - 6].map(|axis| char::from(LETTERS[axis]));
        Err(given.refused(&format!(
            "{letter} without such an axis in the machine file: lathes with this control read it as an incremental {of}; program the position of {of}, or add the axis {letter} to the machine file"
        )))
    }

    /// Letter of the word for the repeat count of a cycle, and whether a count of 0 stores the cycle without drilling.
    pub(crate) fn repeats_by(&self) -> (u8, bool) {
        match self.control {
            Some(Control::Fanuc) => (b'K', true),
            Some(Control::Haas) => (b'L', true),
            _ => (b'L', false),
        }
    }

    pub(crate) fn commands(
        &mut self,
        given: &BlockWords<'_>,
        outcome: &mut Outcome,
    ) -> Result<bool, NcError> {
        let mut takes_words = false;
        self.modal.goes_on = false;
        for command in &given.block.commands {
            match command {
                Command::Shift { adds } => {
                    takes_words = true;
                    if !adds {
                        self.modal.programmed = ProgrammedFrame::default();
                    }
                    let mut by = [0.0; 9];
                    for (axis, value) in given.axes()? {
                        by[axis] = value * self.modal.scale(axis);
                    }
                    self.modal.programmed.shift(&by);
                }
                Command::Rotation { adds, angle_deg } => {
                    takes_words = true;
                    if !adds {
                        self.modal.programmed = ProgrammedFrame::default();
                    }
                    let angle_deg = angle_deg.ok_or_else(|| {
                        given.refused("a rotation by an angle that only the machine knows")
                    })?;
                    self.modal.programmed.angle_deg += angle_deg;
                }
                Command::CentrePoint(true) => {
                    self.switch_centre_point(CentrePoint::Switched, given)?;
                }
                Command::CentrePoint(false) => self.modal.centre_point = CentrePoint::Off,
                Command::WorkOffset(system) => self.use_system(*system),
                Command::AwaitsPreset => self.modal.awaits_preset = true,
                Command::Preset(number) => {
                    if self.modal.programmed.by != [0.0; 9] {
                        return Err(given.refused("a preset (cycle 247) while the datum is shifted: it is unknown whether the control keeps the shift: end it before, with TRANS DATUM RESET or with cycle 7 and zeros"));
                    }
                    let number = number.and_then(|number| whole(number, MAX_NUMBERED_OFFSET));
                    let number = number.filter(|number| *number > 0).ok_or_else(|| {
                        given.refused(
                            "a preset other than 1 to 300, which the set-up file cannot state",
                        )
                    })?;
                    self.use_system(numbered(number));
                    (self.modal.pole, self.modal.awaits_preset) = (None, false);
                }
                Command::InMachine => outcome.in_machine = true,
                Command::ChangeTool
                | Command::NamedTool
                | Command::Edge(_)
                | Command::CallsTool { .. }
                | Command::DefinesTool { .. } => self.tool_command(command, given)?,
                Command::Cycle(cycle) => outcome.cycle = Some(cycle.clone()),
                Command::EachMotion(cycle) => self.modal.each_motion.clone_from(cycle),
                Command::Ends => outcome.ends = true,
                Command::MayMove(name) => {
                    self.forget_positions();
                    self.extruder.at = None;
                    self.notes.add(Note::MayMove(name.clone()), given.line);
                }
                Command::Homes { all } => {
                    if !all && self.modal.shifted && self.modal.shift != [0.0; 9] {
                        return Err(given.refused("G28 of some axes while a shift (G92) is active, which it ends for these axes: write G28 alone"));
                    }
                    self.modal.shift = [0.0; 9];
                    self.assumptions.shift_is_zero();
                }
                Command::Extrudes { relative } => self.extruder.switch(*relative),
                Command::Pole => {
                    takes_words = true;
                    outcome.pole = Some(self.take_pole(given)?);
                }
                Command::Datum => {
                    takes_words = true;
                    for (axis, value) in given.axes()? {
                        let value = value * self.modal.scale(axis);
                        let by = &mut self.modal.programmed.by[axis];
                        *by = match given.word(axis).map(|word| word.manner) {
                            Some(Manner::Incremental) => *by + value,
                            _ => value,
                        };
                    }
                    // Whether the pole moves with the shift is unknown.
                    self.modal.pole = None;
                }
                Command::Shorter(on) => self.modal.shorter = *on,
                Command::GoesOn => self.modal.goes_on = true,
                Command::Defines(cycle) => self.modal.defined = Some(cycle.clone()),
                Command::CallsDefined => {
                    outcome.cycle.clone_from(&self.modal.defined);
                    if outcome.cycle.is_none() {
                        return Err(given.refused("a call of a cycle that was not defined before"));
                    }
                }
            }
        }
        if !given.block.commands.is_empty() {
            self.update_frame();
        }
        Ok(takes_words)
    }

    /// Marks the axes whose coordinates on SINUMERIK have changed. `before` holds the previous work offset, programmed
    /// frame and tool offset.
    pub(crate) fn mark_new_coordinates(&mut self, before: (usize, ProgrammedFrame, Axes)) {
        if self.dialect != Dialect::Siemens {
            return;
        }
        let (system, programmed, tool_offset) = before;
        let modal = &self.modal;
        let is_turned = modal.programmed.angle_deg != programmed.angle_deg;
        let is_new: Axes<bool> = each(|axis| {
            axis < 2 && is_turned
                || self.machine_has(axis) && modal.system != system
                || modal.programmed.by[axis] != programmed.by[axis]
                || modal.tool_offset[axis] != tool_offset[axis]
        });
        for (marked, is_new) in self.modal.frame_is_new.iter_mut().zip(is_new) {
            *marked |= is_new;
        }
    }

    fn tool_command(&mut self, command: &Command, given: &BlockWords<'_>) -> Result<(), NcError> {
        if matches!(command, Command::ChangeTool | Command::NamedTool | Command::CallsTool { .. }) {
            self.forget_positions();
            // A tool that is named alone is preselected, and its length is not active.
            self.modal.length_is_said |= !matches!(command, Command::NamedTool);
        }
        match command {
            Command::ChangeTool => {
                self.in_spindle = self.modal.tool;
                self.changes_tools = true;
                self.take_length(given)?;
            }
            Command::NamedTool => self.modal.tool = None,
            Command::Edge(edge) => {
                self.states_length();
                let edge = edge.and_then(|edge| whole(edge, 99));
                match edge {
                    Some(0) => {
                        self.modal.tool_offset = [0.0; 9];
                        self.assumptions.use_tool_length(None);
                        self.update_tool()?;
                    }
                    Some(1) => self.take_length(given)?,
                    _ => {
                        return Err(given.refused(
                            "a cutting edge other than D0 and D1, whose length the set-up does not state",
                        ));
                    }
                }
            }
            Command::CallsTool { tool, longer } => {
                self.modal.tool = tool.and_then(|tool| whole(tool, 99_999));
                let longer = longer
                    .ok_or_else(|| given.refused("an allowance DL that only the machine knows"))?;
                if self.modal.tool == Some(0) {
                    self.modal.tool_offset = [0.0; 9];
                    self.assumptions.use_tool_length(None);
                    self.update_tool()?;
                } else {
                    self.take_length(given)?;
                    self.modal.tool_offset[2] += longer * self.modal.unit_mm;
                    self.update_tool()?;
                }
            }
            Command::DefinesTool { tool, length } => {
                let tool = tool.and_then(|tool| whole(tool, 99_999));
                let (Some(tool), Some(length)) = (tool, length) else {
                    return Err(given.refused("a tool that only the machine knows"));
                };
                let mut offset = [0.0; 9];
                offset[2] = length * self.modal.unit_mm;
                self.tools.insert(tool, offset);
            }
            _ => {}
        }
        Ok(())
    }

    /// Sets the pole (CC). Returns, for X and Y, true if it is relative to the tool position.
    fn take_pole(&mut self, given: &BlockWords<'_>) -> Result<[bool; 2], NcError> {
        let at = self.program_position();
        let (mut pole, mut relative) = ([0.0; 2], [true; 2]);
        let named = [0, 1].map(|axis| given.word(axis).is_some());
        if named[0] != named[1] {
            return Err(given.refused("a pole CC with one coordinate"));
        }
        let mut is_known = true;
        for axis in 0..2 {
            pole[axis] = at[axis];
            if let (Some(word), Some(value)) = (given.word(axis), given.axis(axis)?) {
                relative[axis] = word.manner == Manner::Incremental;
                pole[axis] = value * self.modal.scale(axis);
                if relative[axis] {
                    pole[axis] += at[axis];
                }
            }
            is_known &= !relative[axis] || self.knows_program_position(axis);
        }
        self.modal.pole = is_known.then_some(pole);
        Ok(relative)
    }

    fn take_length(&mut self, given: &BlockWords<'_>) -> Result<(), NcError> {
        let tool = self.tool_in_spindle();
        let offset = tool.and_then(|tool| self.tools.get(&tool)).copied();
        let unstated = tool.unwrap_or(UNNAMED_TOOL);
        self.assumptions.use_tool_length(offset.is_none().then_some(unstated));
        if offset.is_none() {
            self.notes.add(tool.map_or(Note::NamedTool, Note::NoToolLength), given.line);
        }
        self.modal.tool_offset = offset.unwrap_or([0.0; 9]);
        self.update_tool()
    }

    /// Updates the axis positions after a cycle that is copied unchanged. Returns the axes that it may have moved.
    pub(crate) fn after_cycle(&mut self, cycle: &Cycle, line: usize) -> [bool; 9] {
        self.notes.add(Note::PassedOn(cycle.name.clone()), line);
        let [_, _, depth] = self.modal.plane.axes();
        let mut moved = [false; 9];
        let Some(ends) = cycle.drills_to else {
            // The cycle may end anywhere.
            for axis in 0..3 {
                moved[axis] = true;
                self.known[axis] = false;
            }
            return moved;
        };
        moved[depth] = true;
        let mut at = self.program_position();
        match ends {
            Some(_) => self.mark_named(depth),
            None => self.known[depth] = false,
        }
        if let Some(ends) = ends {
            at[depth] = ends * self.modal.scale(depth);
            let at = self.frame.to_machine(&at);
            let takes_along = self.frame.tip.is_some();
            for axis in 0..3 {
                if axis == depth || takes_along {
                    self.position[axis] = at[axis];
                }
            }
        }
        moved
    }
}
