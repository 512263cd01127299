//! What other languages say in words for which RS-274 has no code.

use crate::{
    NcError,
    block::Manner,
    cycles::Cycle,
    given::{Given, whole},
    interpret::{Interpreter, Outcome},
    modal::{CentrePoint, MOST_NUMBERED, Programmed, numbered},
    notes::Note,
    parameters::Value,
};

/// A command of a block.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Command {
    /// The words of its block shift the coordinates (TRANS, ATRANS), instead of what shifts and turns them or on top of that.
    Shift {
        adds: bool,
    },
    /// It turns the coordinates by an angle, deg, about the axis normal to X and Y (ROT, AROT).
    Turn {
        adds: bool,
        angle_deg: Value,
    },
    /// Coordinates are those of the centre point of the tool from now on, or of the axes.
    CentrePoint(bool),
    /// One of the work offsets.
    WorkOffset(usize),
    /// CYCL DEF 247: one of the next lines has the number of the preset.
    AwaitsPreset,
    /// The number of that preset.
    Preset(Value),
    /// The words of its block are machine coordinates.
    InMachine,
    /// The cutting edge of the tool whose length holds from now on; 0: none.
    Edge(Value),
    /// The tool that was chosen is in the spindle from now on.
    ChangeTool,
    /// Another tool, which has a name.
    NamedTool,
    /// The rest of the line moves the axes in its own way and passes on.
    Cycle(Cycle),
    /// Such a cycle is done behind each motion from now on, or none any more.
    EachMotion(Option<Cycle>),
    /// A command that is copied and may move the axes: their positions are unknown after it.
    MayMove(String),
    /// A printer homes (G28), which clears the shift of G92.
    Homes {
        all: bool,
    },
    /// E words are relative (M83) or absolute (M82) from now on.
    Extrudes {
        relative: bool,
    },
    /// The program ends here.
    Ends,
    /// The words of its block say the centre of arcs and of polar coordinates (CC).
    Pole,
    /// The words of its block are the datum shift along their axes; the others stay (cycle 7).
    Datum,
    /// Rotary axes go the shorter way from now on, or not (M126, M127).
    Shorter(bool),
    /// The block goes on in the next line.
    GoesOn,
    /// The cycle that is done where one is called, and its call.
    Defines(Cycle),
    CallsDefined,
    /// The tool with this number and an allowance on its length, in the unit of the program.
    CallsTool {
        tool: Value,
        longer: Value,
    },
    /// The length of a tool, in the unit of the program.
    DefinesTool {
        tool: Value,
        length: Value,
    },
}

impl Interpreter {
    /// Executes the commands of a block before its motion. Whether its axis words are theirs.
    pub(crate) fn commands(
        &mut self,
        given: &Given<'_>,
        outcome: &mut Outcome,
    ) -> Result<bool, NcError> {
        let mut takes_words = false;
        self.modal.goes_on = false;
        for command in &given.block.commands {
            match command {
                Command::Shift { adds } => {
                    takes_words = true;
                    if !adds {
                        self.modal.programmed = Programmed::default();
                    }
                    let mut by = [0.0; 9];
                    for (axis, value) in given.axes()? {
                        by[axis] = value * self.modal.scale(axis);
                    }
                    self.modal.programmed.shift(&by);
                }
                Command::Turn { adds, angle_deg } => {
                    takes_words = true;
                    if !adds {
                        self.modal.programmed = Programmed::default();
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
                Command::WorkOffset(system) => self.modal.system = *system,
                Command::AwaitsPreset => self.modal.awaits_preset = true,
                Command::Preset(number) => {
                    if self.modal.programmed.by != [0.0; 9] {
                        return Err(given.refused("a preset (cycle 247) while the datum is shifted: whether the control keeps the shift is not known here; end it before, with TRANS DATUM RESET or with cycle 7 and zeros"));
                    }
                    let number = number.and_then(|number| whole(number, MOST_NUMBERED));
                    let number = number.filter(|number| *number > 0).ok_or_else(|| {
                        given.refused(
                            "a preset other than 1 to 300, whose place the set-up file could state",
                        )
                    })?;
                    self.modal.system = numbered(number);
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
                    self.extruder.forget_position();
                    self.notes.add(Note::MayMove(name.clone()), given.line);
                }
                Command::Homes { all } => {
                    if !all && self.modal.shifted && self.modal.shift != [0.0; 9] {
                        return Err(given.refused("G28 of some axes while a shift (G92) is in force, which it ends for these axes: write G28 alone"));
                    }
                    self.modal.shift = [0.0; 9];
                    self.rests.shift_is_zero();
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
                    // Which place the pole has from now on, is not known here.
                    self.modal.pole = None;
                }
                Command::Shorter(on) => self.modal.shorter = *on,
                Command::GoesOn => self.modal.goes_on = true,
                Command::Defines(cycle) => self.modal.defined = Some(cycle.clone()),
                Command::CallsDefined => {
                    outcome.cycle.clone_from(&self.modal.defined);
                    if outcome.cycle.is_none() {
                        return Err(given.refused("a call of a cycle that is not defined before"));
                    }
                }
            }
        }
        if !given.block.commands.is_empty() {
            self.update_frame();
        }
        Ok(takes_words)
    }

    /// Another tool, or another length of it.
    fn tool_command(&mut self, command: &Command, given: &Given<'_>) -> Result<(), NcError> {
        if matches!(
            command,
            Command::ChangeTool | Command::NamedTool | Command::CallsTool { .. }
        ) {
            self.forget_positions();
        }
        match command {
            Command::ChangeTool => {
                self.in_spindle = self.modal.tool;
                self.changes_tools = true;
                self.take_length(given)?;
            }
            Command::NamedTool => self.modal.tool = None,
            Command::Edge(edge) => {
                let edge = edge.and_then(|edge| whole(edge, 99));
                match edge {
                    Some(0) => {
                        self.modal.tool_offset = [0.0; 9];
                        self.rests.takes_tool(None);
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
                    self.rests.takes_tool(None);
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

    /// CC: along which axes the pole is relative to where the tool is.
    fn take_pole(&mut self, given: &Given<'_>) -> Result<[bool; 2], NcError> {
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
            is_known &= !relative[axis] || self.says_place(axis);
        }
        self.modal.pole = is_known.then_some(pole);
        Ok(relative)
    }

    /// The length of the tool in the spindle holds from now on.
    fn take_length(&mut self, given: &Given<'_>) -> Result<(), NcError> {
        let tool = self.tool_in_spindle();
        let offset = tool.and_then(|tool| self.tools.get(&tool)).copied();
        let unstated = tool.unwrap_or(u32::MAX >> 2);
        self.rests.takes_tool(offset.is_none().then_some(unstated));
        if offset.is_none() {
            self.notes
                .add(tool.map_or(Note::NamedTool, Note::NoToolLength), given.line);
        }
        self.modal.tool_offset = offset.unwrap_or([0.0; 9]);
        self.update_tool()
    }
}
