//! A line in, the lines with its correction out.

use std::{
    io,
    path::PathBuf,
    sync::{Arc, mpsc::SyncSender},
};

use volcomp_model::vocabulary::CorrectionLimit;

use crate::{
    NcError,
    block::{Begins, Block},
    bounds::Bounds,
    carried::Settled,
    contour::Contour,
    coordinates::{Axes, LETTERS},
    correction::{Corrector, Seen},
    dialect::Dialect,
    edits::Edits,
    extruder::Extrusion,
    heidenhain::{block_number, renumber},
    hole::InRow,
    interpret::{Interpreter, Outcome},
    line::Line,
    line_ends::end_of_added,
    made::Made,
    meaning::Meaning,
    modal::SYSTEMS,
    motion::{Move, Path},
    notes::Note,
    rounding::Strategy,
    script::Script,
    setup::SetUp,
    turns::Turns,
    values::Computed,
    words::Decimals,
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

/// State: a program that is read, and the correction that its axes carry.
#[derive(Clone, Debug)]
pub(crate) struct Rewriter {
    pub(crate) interpreter: Interpreter,
    pub(crate) corrector: Corrector,
    /// The E word of the motion that is being written, and up to which share of it E is written.
    pub(crate) extrusion: Option<Extrusion>,
    pub(crate) extruded: f64,
    /// What was computed last.
    pub(crate) seen: Seen,
    pub(crate) bounds: Bounds,
    pub(crate) decimals: Decimals,
    pub(crate) strategy: Strategy,
    /// Motions with other numbers than [`Strategy::Plain`] gives.
    pub(crate) rounded_otherwise: u64,
    /// The correction that the axes of the machine have, mm and deg.
    pub(crate) carried: Axes,
    pub(crate) settled: Settled,
    /// At the zero of which work offsets it was noted how far the machine is off, or nothing is to be noted.
    zeros_noted: [bool; SYSTEMS],
    /// Where axes turn on the motion that is being written.
    pub(crate) turns: Turns,
    /// By what the depth and the plane R of a cycle, which are kept from hole to hole, are other numbers than in the program, mm.
    pub(crate) carried_by_cycle: [f64; 2],
    /// What of it was in the axis of its depth where the first hole of a row began, mm.
    pub(crate) carried_at_initial: Option<f64>,
    /// What of it is in the places of G28 and G30.
    pub(crate) carried_at_home: [Axes; 2],
    pub(crate) contour: Contour,
    /// Compensating the radius of the tool has been switched, and no motion in the plane has begun or ended it yet.
    pub(crate) switches_radius: bool,
    /// What gave words their meaning before a block that may be an arc.
    pub(crate) before: Option<Meaning>,
    /// The pole that the control has, in the coordinates of the program, mm.
    pub(crate) pole: Option<[f64; 2]>,
    /// The result has switched to X and Y as places (G15) where the program has polar coordinates (G16).
    pub(crate) polar_is_off: bool,
    /// Numbers have decimal commas.
    comma: bool,
    pub(crate) computed: Computed,
    /// Where files with subroutines are.
    pub(crate) folders: Arc<[PathBuf]>,
    /// The end of lines that are added.
    more: &'static [u8],
    pub(crate) counts: Counts,
    /// Where the parts of each motion end, from 0 to 1, one motion after the other; `None`: nobody asks.
    pub(crate) shares: Option<Vec<f64>>,
    /// Receives each motion.
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
        limit: CorrectionLimit,
    ) -> Result<Self, NcError> {
        let interpreter = Interpreter::new(setup, Arc::clone(corrector.machine()), dialect)?;
        let mut corrector = corrector;
        corrector.begins(&interpreter.position);
        Ok(Self {
            interpreter,
            bounds: Bounds::new(&corrector, limit),
            corrector,
            extrusion: None,
            extruded: 0.0,
            seen: Seen::default(),
            decimals,
            strategy: Strategy::Plain,
            rounded_otherwise: 0,
            carried: [0.0; 9],
            settled: Settled::No,
            zeros_noted: std::array::from_fn(|system| setup.offset(system).is_none()),
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
            more: b"\n",
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
            self.more = end_of_added(end).unwrap_or(self.more);
        }
        let dialect = self.dialect();
        let (begins, added) = (out.len(), self.counts.added);
        let ends = match dialect.read(&mut block, text, number, &self.interpreter) {
            Ok(reads) => {
                let reads_correction =
                    self.carries(&reads.axes) || self.computed != Computed::Kept && reads.returned;
                self.comma = block.comma.unwrap_or(self.comma);
                let points = &mut self.interpreter.points;
                points.last_in_increments = block.last_in_increments.or(points.last_in_increments);
                let line = Line {
                    block: &block,
                    text,
                    more: self.more,
                    number,
                    script: Script {
                        dialect,
                        comma: self.comma,
                        says_each: self.interpreter.is_printer(),
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
        (self.extrusion, self.extruded) = (outcome.extrusion, 0.0);
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
            let calls = outcome.cycle.is_some() || self.interpreter.modal.each_motion.is_some();
            self.tell(motion, line.number, calls || motion.cuts())?;
            self.motion(motion, line, out)?;
            self.ends_part(1.0);
        } else if let Some(words) = &outcome.presets {
            self.presets(words, outcome.preset_system, line);
        }
        if let Some(motion) = &outcome.motion {
            self.switches_radius &= !self.moves_in_plane(motion);
        }
        self.after_cycles(&outcome, line)?;
        if let Some(violation) = self.bounds.take_violation() {
            return Err(NcError::OutOfBounds {
                line: line.number,
                violation,
            });
        }
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
                .split(|byte| matches!(byte, b'\r' | b'\n'))
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

    /// Sends a motion of the program to the receiver, if there is one.
    pub(crate) fn tell(&mut self, motion: &Move, number: usize, cuts: bool) -> Result<(), NcError> {
        let Some(tells) = &self.tells else {
            return Ok(());
        };
        let made = Made {
            line: number,
            motion: motion.clone(),
            frame: self.interpreter.frame.clone(),
            tool: self.interpreter.modal.tool_offset,
            system: self.interpreter.modal.system,
            cuts_from_stated_zero: cuts && self.interpreter.rests_on_stated_zero(),
            known: self.knows_place(),
            in_inches: self.interpreter.modal.unit_mm != 1.0,
        };
        let sent = tells.send(made);
        sent.map_err(|_| io::Error::from(io::ErrorKind::BrokenPipe).into())
    }

    /// Whether it is known where X, Y and Z stand, as far as the machine has them.
    fn knows_place(&self) -> bool {
        (0..3).all(|axis| self.interpreter.known[axis] || !self.corrector.has(axis))
    }

    fn motion(&mut self, motion: &Move, line: Line<'_>, out: &mut Vec<u8>) -> Result<(), NcError> {
        self.note_axes(motion, line);
        self.note_unknown(motion, line.number);
        self.corrector.wraps(&motion.wraps);
        match motion.path {
            _ if motion.in_machine => self.is_uncorrected(motion),
            Path::Other | Path::Home(_) => self.is_uncorrected(motion),
            Path::Spline if motion.polar.is_some() => self.is_uncorrected(motion),
            Path::Spline => self.spline(motion, line, out),
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
        if motion.cuts() {
            self.notes_zero(line.number);
        }
        Ok(())
    }

    /// Whether nothing is to be noted of the work offset that holds.
    pub(crate) fn is_zero_noted(&self) -> bool {
        let system = self.interpreter.modal.system;
        self.zeros_noted.get(system).is_none_or(|noted| *noted)
            || !self.interpreter.rests_on_stated_zero()
    }

    /// Notes, where the program first cuts with a work offset that the set-up states, how far the machine is off at its zero.
    pub(crate) fn notes_zero(&mut self, line: usize) {
        if self.is_zero_noted() || !self.knows_place() {
            return;
        }
        let system = self.interpreter.modal.system;
        self.zeros_noted[system] = true;
        let of_offset = self.interpreter.frame.of_offset();
        let off_mm = self.corrector.off_at_zero_mm(&of_offset);
        if let Some(note) = Note::off_at_zero(system, off_mm) {
            self.interpreter.notes.add(note, line);
        }
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
