//! A line in, the lines with its correction out.

use std::{
    io,
    path::PathBuf,
    sync::{Arc, mpsc::SyncSender},
};

use crate::{
    NcError,
    block::{Begins, Block, Parameter},
    coordinates::{Axes, LETTERS},
    correction::{Corrector, Seen},
    dialect::Dialect,
    edits::Edits,
    heidenhain::{block_number, renumber},
    hole::InRow,
    interpret::{Interpreter, Outcome},
    line::Line,
    made::Made,
    meaning::Meaning,
    motion::{Move, Path},
    notes::Note,
    number::half_step,
    parameters::Parameters,
    rounding::Strategy,
    script::Script,
    setup::SetUp,
    turns::Turns,
    words::{Decimals, Number, each},
};

/// Some controls take no longer lines: LinuxCNC with the end of the line 256 characters.
pub(crate) const LONGEST: usize = 254;

/// What was done to a program so far.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Counts {
    /// Lines that were read.
    pub lines: u64,
    /// Motions in them.
    pub motions: u64,
    /// Lines that were changed.
    pub changed: u64,
    /// Lines that were added, since a motion was split.
    pub added: u64,
}

/// Which values that the program computes are written as numbers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Computed {
    Kept,
    /// Those with what a subroutine returned: its call is written out.
    ReturnedWritten,
    /// All: the lines that compute them are not executed in this order.
    Written,
}

/// Whether the control compensates the radius of the tool.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Contour {
    None,
    /// It begins or ends to do so with this motion, which must stay one.
    Switches,
    /// It does: each motion in the plane is an element of the contour, which gets no others and is not split. At an inside corner the control
    /// ends an element early by up to the radius of the tool, which parts may be shorter than.
    Follows,
}

/// Whether the correction that the axes carry is the one that belongs to where they are.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Settled {
    Yes,
    No,
    /// It is not, since an axis has turned.
    Turned,
}

/// State: a program that is read, and the correction that its axes carry.
#[expect(clippy::struct_excessive_bools, reason = "each is a state of its own")]
#[derive(Clone, Debug)]
pub(crate) struct Rewriter {
    pub(crate) interpreter: Interpreter,
    pub(crate) corrector: Corrector,
    /// What was computed last.
    pub(crate) seen: Seen,
    pub(crate) decimals: Decimals,
    pub(crate) strategy: Strategy,
    /// The correction that the axes of the machine have, mm and deg.
    pub(crate) carried: Axes,
    pub(crate) settled: Settled,
    /// Where axes turn on the motion that is being written.
    pub(crate) turns: Turns,
    /// By what the depth and the plane R of a cycle, which are kept from hole to hole, are other numbers than in the program, mm.
    pub(crate) carried_by_cycle: [f64; 2],
    /// What of it was in the axis of its depth where the first hole of a row began, mm.
    pub(crate) carried_at_initial: Option<f64>,
    /// What of it is in the places of G28 and G30.
    carried_at_home: [Axes; 2],
    pub(crate) contour: Contour,
    /// Compensating the radius of the tool has been switched, and no motion in the plane has begun or ended it yet.
    pub(crate) switches_radius: bool,
    /// What gave words their meaning before a block that may be an arc.
    pub(crate) before: Option<Meaning>,
    /// The pole that the control has, in the coordinates of the program, mm.
    pub(crate) pole: Option<[f64; 2]>,
    /// It has been told to read X and Y as places again where the program has polar coordinates (G16).
    pub(crate) polar_is_off: bool,
    /// Numbers have decimal commas.
    comma: bool,
    pub(crate) computed: Computed,
    /// Where files with subroutines are.
    pub(crate) folders: Arc<[PathBuf]>,
    /// Lines end with a carriage return, too.
    crlf: bool,
    pub(crate) counts: Counts,
    /// Where the parts of each motion end, from 0 to 1, one motion after the other; `None`: nobody asks.
    pub(crate) shares: Option<Vec<f64>>,
    /// Who is told of each motion.
    pub(crate) tells: Option<SyncSender<Made>>,
    /// The line that was read last; `None` while it is looked at.
    block: Option<Box<Block>>,
    pub(crate) edits: Edits,
    /// Where the parts of a motion end, used for all motions.
    parts: Vec<f64>,
}

impl Rewriter {
    pub(crate) fn new(
        setup: &SetUp,
        corrector: Corrector,
        decimals: Decimals,
        dialect: Dialect,
    ) -> Result<Self, NcError> {
        let interpreter = Interpreter::new(setup, Arc::clone(corrector.machine()), dialect)?;
        let mut corrector = corrector;
        corrector.begins(&interpreter.position);
        Ok(Self {
            interpreter,
            corrector,
            seen: Seen::default(),
            decimals,
            strategy: Strategy::Plain,
            carried: [0.0; 9],
            settled: Settled::No,
            turns: Turns::default(),
            carried_by_cycle: [0.0; 2],
            carried_at_initial: None,
            carried_at_home: [[0.0; 9]; 2],
            contour: Contour::None,
            switches_radius: false,
            before: None,
            pole: None,
            polar_is_off: false,
            comma: false,
            computed: Computed::Kept,
            folders: setup.folders().into(),
            crlf: false,
            counts: Counts::default(),
            shares: None,
            tells: None,
            block: None,
            edits: Edits::default(),
            parts: Vec::new(),
        })
    }

    /// The language of the program.
    pub(crate) fn dialect(&self) -> Dialect {
        self.interpreter.dialect
    }

    /// Whether the line that was read last is a percent sign.
    pub(crate) fn is_percent(&self) -> bool {
        let block = self.block.as_ref();
        block.is_some_and(|block| block.begins == Begins::Percent)
    }

    /// Reads a line without its end (`number` counts from 1), and appends what is to be written instead, whose lines are separated by
    /// `end`, and the last of which has none. Whether the program ends here.
    pub(crate) fn line(
        &mut self,
        text: &[u8],
        end: &[u8],
        number: usize,
        out: &mut Vec<u8>,
    ) -> Result<bool, NcError> {
        self.counts.lines += 1;
        let mut block = self.block.take().unwrap_or_default();
        if !end.is_empty() {
            self.crlf = end.len() == 2;
        }
        let dialect = self.dialect();
        let (begins, added) = (out.len(), self.counts.added);
        let ends = match dialect.read(&mut block, text, number, &self.interpreter) {
            Ok(reads) => {
                let reads_correction =
                    self.carries(&reads.axes) || self.computed != Computed::Kept && reads.returned;
                self.comma = block.comma.unwrap_or(self.comma);
                let line = Line {
                    block: &block,
                    text,
                    more: if self.crlf { b"\r\n" } else { b"\n" },
                    number,
                    script: Script {
                        dialect,
                        comma: self.comma,
                    },
                };
                self.block(line, reads_correction, out)
            }
            Err(error) => Err(error),
        };
        if let Some((place, number)) = &block.number
            && self.counts.added > 0
        {
            renumber(out, begins, place.start, number + added);
        }
        self.block = Some(block);
        ends
    }

    /// A line behind the end of the program, with its end: only the number of its block may change.
    pub(crate) fn after_end(&self, text: &[u8], out: &mut Vec<u8>) {
        let begins = out.len();
        out.extend_from_slice(text);
        if self.dialect() == Dialect::Heidenhain
            && self.counts.added > 0
            && let Some((place, number)) = block_number(text)
        {
            renumber(out, begins, place.start, number + self.counts.added);
        }
    }

    fn block(
        &mut self,
        line: Line<'_>,
        reads_correction: bool,
        out: &mut Vec<u8>,
    ) -> Result<bool, NcError> {
        let mut outcome = Outcome::default();
        self.before = Meaning::before(&self.interpreter, line.block);
        self.interpreter
            .execute(line.block, line.number, &mut outcome)?;
        if outcome.calls.is_some() {
            return Err(NcError::NotCompensated {
                line: line.number,
                what: "M98 and M99 are followed where they stand alone in their line: M98 P1000 L3, M99".to_owned(),
            });
        }
        let other_tool = (self.corrector).take_tool(&self.interpreter.modal.tool_offset)?;
        if other_tool {
            self.unsettles();
        }
        if self.interpreter.modal.sticky.initial.is_none() {
            (self.carried_by_cycle, self.carried_at_initial) = ([0.0; 2], None);
        }
        if let Some(which) = outcome.stores_home {
            self.carried_at_home[which] = self.carried;
        }
        self.switches_radius |= outcome.switches_radius;
        self.contour = match self.interpreter.modal.radius {
            _ if self.switches_radius => Contour::Switches,
            // Each end of a motion would be drilled.
            _ if self.interpreter.modal.each_motion.is_some() => Contour::Switches,
            Some(_) => Contour::Follows,
            None => Contour::None,
        };
        if outcome.switches_polar {
            self.polar_is_off = false;
        }
        if let Some(relative) = outcome.pole {
            self.takes_pole(relative);
        }
        self.edits.clear();
        if self.computed == Computed::Written || reads_correction {
            self.write_values(line.block, reads_correction);
        }
        let length = out.len();
        if let Some(motion) = &outcome.motion
            && !outcome.row.is_empty()
        {
            let holes: Vec<&Move> = [motion].into_iter().chain(&outcome.row).collect();
            self.row(&holes, line, out)?;
        } else if let Some(motion) = &outcome.motion {
            self.counts.motions += 1;
            self.tell(motion, line.number)?;
            self.motion(motion, line, out)?;
            self.ends_part(1.0);
        } else if let Some(words) = &outcome.presets {
            self.presets(words, line);
        }
        if let Some(motion) = &outcome.motion {
            self.switches_radius &= !self.moves_in_plane(motion);
        }
        self.after_cycles(&outcome, line)?;
        if let Some(motion) = &outcome.motion
            && line.block.begins == Begins::Slash
        {
            self.interpreter.may_not_have_moved(motion);
        }
        // A motion that is corrected has written its lines.
        if out.len() == length {
            self.edits.write(line, out);
        }
        if out.len() - length > LONGEST && line.text.len() <= LONGEST {
            let longest = out[length..]
                .split(|byte| *byte == b'\n')
                .map(<[u8]>::len)
                .max();
            if longest > Some(LONGEST) {
                self.interpreter.notes.add(Note::LongLine, line.number);
            }
        }
        if !self.edits.is_empty() {
            self.counts.changed += 1;
        }
        Ok(outcome.ends)
    }

    /// Every computed value as the number that it is here.
    fn write_values(&mut self, block: &Block, also_set: bool) {
        for (place, word) in block.words.iter().enumerate() {
            let value = word.value.filter(|_| word.decimals.is_none());
            let number = value.and_then(|value| Number::shortest(value, 6));
            self.edits
                .replaced
                .extend(number.map(|number| (place, number)));
        }
        let in_sub = self.computed == Computed::Written && self.interpreter.parameters.in_sub();
        if !in_sub && !also_set {
            return;
        }
        // What a subroutine sets for itself must not be set for the program.
        for assignment in &block.assignments {
            let is_local = match &assignment.parameter {
                Parameter::Numbered(number) => Parameters::is_local(*number),
                Parameter::Named(name) => Parameters::is_local_name(name),
            };
            let value = assignment
                .value
                .and_then(|value| Number::shortest(value, 6));
            if is_local && in_sub {
                self.edits.ranges.push((assignment.all.clone(), None));
            } else if value.is_some() {
                self.edits.ranges.push((assignment.text.clone(), value));
            }
        }
    }

    /// Words that say where the axes stand: there is a correction in the axes.
    fn presets(&mut self, words: &Axes<Option<usize>>, line: Line<'_>) {
        let interpreter = &self.interpreter;
        let carried = interpreter
            .frame
            .moved_in_program(&interpreter.position, &self.carried);
        let modal = &interpreter.modal;
        for axis in 0..9 {
            let Some(word) = line.word(words[axis]) else {
                continue;
            };
            let decimals = self.decimals.of(axis, modal.unit_mm);
            let is_carried = carried[axis].abs() >= half_step(decimals);
            let Some(value) = word.value.filter(|_| is_carried) else {
                continue;
            };
            let decimals = decimals.max(word.decimals.unwrap_or(0));
            let value = value + carried[axis] / modal.scale(axis);
            if let Some(number) = Number::nearest(value, decimals) {
                self.edits.set(LETTERS[axis], words[axis], number);
            }
        }
    }

    /// Whether any of these axes carries a correction, so that the control has another place for it.
    pub(crate) fn carries(&self, axes: &Axes<bool>) -> bool {
        if *axes == [false; 9] {
            return false;
        }
        let interpreter = &self.interpreter;
        let frame = &interpreter.frame;
        let carried = frame.moved_in_program(&interpreter.position, &self.carried);
        (0..9).any(|axis| axes[axis] && carried[axis].abs() > 1e-9)
    }

    /// Tells whoever wants to know what the program does.
    pub(crate) fn tell(&mut self, motion: &Move, number: usize) -> Result<(), NcError> {
        let Some(tells) = &self.tells else {
            return Ok(());
        };
        let made = Made {
            line: number,
            motion: motion.clone(),
            frame: self.interpreter.frame.clone(),
            tool: self.interpreter.modal.tool_offset,
            system: self.interpreter.modal.system,
            known: (0..3).all(|axis| self.interpreter.known[axis] || !self.corrector.has(axis)),
            in_inches: self.interpreter.modal.unit_mm != 1.0,
        };
        let told = tells.send(made);
        told.map_err(|_| io::Error::from(io::ErrorKind::BrokenPipe).into())
    }

    fn motion(&mut self, motion: &Move, line: Line<'_>, out: &mut Vec<u8>) -> Result<(), NcError> {
        self.note_axes(motion, line);
        self.note_unknown(motion, line.number);
        self.corrector.wraps(&motion.wraps);
        match motion.path {
            _ if motion.in_machine => self.is_uncorrected(motion),
            Path::Other | Path::Home(_) => self.is_uncorrected(motion),
            Path::Rapid => {
                self.turns = self.turns_of(motion);
                self.straight(motion, &self.ends_of(motion), &[1.0], line, out);
            }
            Path::Line => {
                let ends = self.ends_of(motion);
                let mut parts = std::mem::take(&mut self.parts);
                parts.clear();
                self.parts(motion, &ends, line, &mut parts)?;
                self.straight(motion, &ends, &parts, line, out);
                self.parts = parts;
            }
            Path::Arc(arc) => self.arc(motion, &arc, line, out)?,
            Path::Hole {
                bottom,
                clearance,
                depth,
            } => {
                let places = [bottom, clearance];
                self.hole(motion, depth, places, InRow::ALONE, line, out);
            }
        }
        self.notes_unstated(line.number);
        Ok(())
    }

    /// Notes axes that the machine lacks or that leave their travel.
    pub(crate) fn note_axes(&mut self, motion: &Move, line: Line<'_>) {
        let has_tip = self.interpreter.frame.tip.is_some();
        for (axis, place) in motion.words.iter().enumerate() {
            if place.is_some() && !self.corrector.has(axis) && line.word(*place).is_some() {
                let note = Note::NoAxis(char::from(LETTERS[axis]));
                self.interpreter.notes.add(note, line.number);
            }
        }
        for axis in self.corrector.axes() {
            let moves = motion.words[axis].is_some() || axis < 3 && has_tip;
            let is_outside = !self.corrector.is_within_travel(axis, motion.to[axis]);
            if moves && self.interpreter.known[axis] && is_outside {
                let note = Note::OutsideTravel(char::from(LETTERS[axis]));
                self.interpreter.notes.add(note, line.number);
            }
        }
        if self.interpreter.modal.radius.is_some() {
            let note = Note::RadiusCompensated;
            self.interpreter.notes.add(note, line.number);
        }
    }

    /// A motion has been written: the axes have done what they do on it.
    pub(crate) fn has_moved(&mut self, motion: &Move) {
        let turns = std::mem::take(&mut self.turns);
        if self.corrector.is_bidirectional() {
            self.corrector.reaches(&turns.furthest);
        }
        self.settled = if self.corrector.goes(&motion.to) {
            Settled::Turned
        } else {
            Settled::Yes
        };
    }

    /// The correction that the axes carry may be that of another place, or of another tool.
    pub(crate) fn unsettles(&mut self) {
        if self.settled == Settled::Yes {
            self.settled = Settled::No;
        }
    }

    /// A motion that passes on as it is: its axes carry no correction afterwards, but those whose words are ways.
    pub(crate) fn is_uncorrected(&mut self, motion: &Move) {
        self.corrector.goes(&motion.to);
        self.settled = Settled::No;
        let frame = &self.interpreter.frame;
        let mut carried = if motion.in_machine {
            self.carried
        } else {
            frame.moved_in_program(&motion.from, &self.carried)
        };
        for axis in 0..9 {
            if motion.words[axis].is_some() && !motion.incremental[axis] {
                carried[axis] = match motion.path {
                    Path::Home(which) => self.carried_at_home[which][axis],
                    _ => 0.0,
                };
            }
        }
        self.carried = if motion.in_machine {
            carried
        } else {
            frame.moved_in_machine(&frame.to_program(&motion.to), &carried)
        };
    }

    /// Whether a motion leads elsewhere in the plane of arcs and of the tool's radius.
    fn moves_in_plane(&self, motion: &Move) -> bool {
        let [from, to] = self.ends_of(motion);
        let [first, second, _] = self.interpreter.modal.plane.axes();
        // A turned or tilted frame brings back what stands still to some 1e-12 mm.
        let moves = |axis: usize| (to[axis] - from[axis]).abs() > 1e-9;
        moves(first) || moves(second)
    }

    /// Axes that keep the correction that they have: while the control compensates the radius of the tool, it takes each motion in the plane, of
    /// however few µm, for an element of the contour, and so turns the tool about its corner. A motion without a way in the plane gets none.
    pub(crate) fn keeps_in_plane(&self, motion: &Move) -> Axes<bool> {
        let compensates = self.switches_radius || self.interpreter.modal.radius.is_some();
        if !compensates || self.moves_in_plane(motion) {
            return [false; 9];
        }
        let [first, second, _] = self.interpreter.modal.plane.axes();
        each(|axis| axis == first || axis == second)
    }

    /// The correction at a place, both in the coordinates of the program.
    pub(crate) fn delta_in_program(&self, at: &Axes) -> Axes {
        let frame = &self.interpreter.frame;
        let machine = frame.to_machine(at);
        frame.moved_in_program(&machine, &self.corrector.at(&machine).delta)
    }

    /// Where a motion begins and ends, in the coordinates of the program.
    pub(crate) fn ends_of(&self, motion: &Move) -> [Axes; 2] {
        let frame = &self.interpreter.frame;
        [&motion.from, &motion.to].map(|at| frame.to_program(at))
    }

    /// How far the axes are from their straight way where the centre point of the tool goes straight between two places of the
    /// program, mm.
    pub(crate) fn bulge_mm(&self, from: &Axes, to: &Axes) -> f64 {
        self.corrector
            .bulge_in_frame_mm(&self.interpreter.frame, from, to)
    }
}
