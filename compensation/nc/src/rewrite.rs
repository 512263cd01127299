//! Rewrites a program line as the lines with its correction.

use std::{io, mem::swap, path::PathBuf, sync::Arc};

use volcomp_model::vocabulary::CorrectionLimit;

use crate::{
    NcError,
    block::{Block, BlockStart, Parameter, Word},
    control::{Control, Dialect, INCREMENTS},
    coordinates::{Axes, Frame, LETTERS, dot, each},
    correction::{Bounds, CorrectionCache, Corrector},
    error::BoundViolation,
    expression::{Expressions, Reads},
    heidenhain::{block_number, read_heidenhain, renumber},
    interpreter::{Extrusion, Interpreter, Outcome},
    line::{Edits, Line, Script, end_of_added},
    modal::{FeedMode, Modal, SYSTEMS},
    motion::{ExecutedMotion, MotionSender, Move, Path},
    notes::Note,
    number::{Decimals, Form, Number, Numerals, half_step},
    parameters::Parameters,
    reversal::Reversals,
    rs274::{check_end_of_block, corner, hint, read_control_line, read_increments},
    setup::SetUp,
    siemens::read_siemens,
};

/// Maximum line length without the end; LinuxCNC accepts 256 characters with the end.
pub(crate) const MAX_LINE_BYTES: usize = 254;

/// Counters of a compensation. A line is changed if a coordinate or another value in it is.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "schema", derive(serde::Serialize, schemars::JsonSchema))]
pub struct Counts {
    /// Number of lines read.
    pub lines: u64,
    /// Number of motions in the program.
    pub motions: u64,
    /// Number of changed lines.
    pub changed: u64,
    /// Number of lines added by splitting motions.
    pub added: u64,
}

/// State: the program read so far, and the correction applied at its axes.
#[derive(Clone, Debug)]
pub(crate) struct Rewriter {
    pub(crate) interpreter: Interpreter,
    pub(crate) corrector: Corrector,
    /// E word of the current motion; `extruded` is the fraction already written.
    pub(crate) extrusion: Option<Extrusion>,
    pub(crate) extruded: f64,
    pub(crate) seen: CorrectionCache,
    pub(crate) bounds: Bounds,
    pub(crate) decimals: Decimals,
    pub(crate) strategy: Strategy,
    /// Number of motions whose numbers differ from those of [`Strategy::Plain`].
    pub(crate) rounded_otherwise: u64,
    /// Correction applied at the machine axes, mm and deg.
    pub(crate) carried: Axes,
    pub(crate) applied_correction: AppliedCorrection,
    /// For each work offset, whether the error at its zero was noted or needs no note.
    zeros_noted: [bool; SYSTEMS],
    pub(crate) turns: Reversals,
    /// Corrections contained in the modal depth and plane R of a cycle, mm.
    pub(crate) carried_by_cycle: [f64; 2],
    /// Correction along the depth axis at the start of the first hole of a row, mm.
    pub(crate) carried_at_initial: Option<f64>,
    /// Corrections contained in the positions of G28 and G30, machine coordinates, mm and deg.
    carried_at_home: [Axes; 2],
    pub(crate) contour: Contour,
    /// Cutter radius compensation was switched, and no motion in the plane has followed yet.
    pub(crate) switches_radius: bool,
    pub(crate) before: Option<Meaning>,
    /// Pole active in the control, in program coordinates, mm.
    pub(crate) pole: Option<[f64; 2]>,
    /// The output is in Cartesian mode (G15) where the program has polar coordinates (G16).
    pub(crate) polar_is_off: bool,
    pub(crate) comma: bool,
    pub(crate) computed: ComputedValues,
    pub(crate) folders: Arc<[PathBuf]>,
    more: &'static [u8],
    pub(crate) counts: Counts,
    /// Ends of the parts of each motion as fractions (0 to 1), concatenated over all motions; `None` if not requested.
    pub(crate) shares: Option<Vec<f64>>,
    /// Passes each motion on to another thread.
    pub(crate) motion_sender: Option<MotionSender>,
    /// The last block; `None` while it is processed.
    block: Option<Box<Block>>,
    pub(crate) edits: Edits,
    parts: Vec<f64>,
}

#[derive(Clone, Debug)]
pub(crate) struct Meaning {
    frame: Frame,
    unit_mm: f64,
    diameter: bool,
    absolute: bool,
    polar: Option<[Option<f64>; 2]>,
    feed_mode: FeedMode,
    pub(crate) feed: Option<f64>,
    known: Axes<bool>,
}

impl Meaning {
    pub(crate) fn before(interpreter: &Interpreter, block: &Block) -> Option<Self> {
        let modal = &interpreter.modal;
        let says_arc = (block.words.iter())
            .any(|word| word.letter == b'G' && matches!(word.value, Some(2.0 | 3.0)));
        let is_arc = matches!(modal.motion, Some(20 | 30)) || says_arc;
        is_arc.then(|| Self {
            frame: interpreter.frame.clone(),
            unit_mm: modal.unit_mm,
            diameter: modal.diameter,
            absolute: modal.absolute,
            polar: modal.polar,
            feed_mode: modal.feed_mode,
            feed: modal.feed,
            known: interpreter.known,
        })
    }

    /// True if a straight motion under these modes can precede a block that switches to `after`: X and Y stay polar or
    /// Cartesian, and F, if the motion takes it from the block, has the same meaning in both modes.
    pub(crate) fn takes_straight(&self, after: &Modal, has_feed: bool) -> bool {
        let has_other_feed = match (self.feed_mode, self.feed) {
            (FeedMode::InverseTime, None) => true,
            (mode, None) => has_feed && mode != after.feed_mode,
            (_, Some(_)) => false,
        };
        self.polar.is_some() == after.polar.is_some() && !has_other_feed
    }

    pub(crate) fn swap(&mut self, interpreter: &mut Interpreter) {
        let modal = &mut interpreter.modal;
        swap(&mut self.frame, &mut interpreter.frame);
        swap(&mut self.unit_mm, &mut modal.unit_mm);
        swap(&mut self.diameter, &mut modal.diameter);
        swap(&mut self.absolute, &mut modal.absolute);
        swap(&mut self.polar, &mut modal.polar);
        swap(&mut self.feed_mode, &mut modal.feed_mode);
        swap(&mut self.feed, &mut modal.feed);
        swap(&mut self.known, &mut interpreter.known);
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Contour {
    None,
    /// Cutter radius compensation starts or ends with this motion, which must not be split.
    Switches,
    /// Cutter radius compensation is active: each motion in the plane is a contour element, and is
    /// neither split nor preceded by others. At an inside corner the control shortens an element by
    /// up to the tool radius, which may exceed the length of a part.
    Follows,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum AppliedCorrection {
    Current,
    Outdated,
    OutdatedByReversal,
}

/// Maximum number of additional decimals of words that define the current position.
const FINER: u8 = 3;

/// How values that the program computes are written to the output.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum ComputedValues {
    /// Expressions and variables stay as they are in the program.
    Kept,
    /// Values that depend on the return value of a subroutine are written as numbers, because its
    /// call is unrolled.
    ReturnedAsNumbers,
    /// All values are written as numbers, because the lines that compute them are not executed in
    /// this order.
    AllAsNumbers,
}

/// Rounding of the numbers of the parts of a line.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Strategy {
    /// Each number is rounded to the nearest step.
    #[default]
    Plain,
    /// The numbers are rounded jointly, to minimize the deviation from the line. A part may end slightly earlier or later along the line,
    /// since the next one continues from there. The solution is the shortest path through the graph of the numbers next to the exact ones.
    Floyd,
}

impl Rewriter {
    pub(crate) fn new(
        setup: &SetUp,
        corrector: Corrector,
        decimals: Decimals,
        dialect: Dialect,
        limit: CorrectionLimit,
    ) -> Result<Self, NcError> {
        let interpreter = Interpreter::new(setup, Arc::clone(&corrector.machine), dialect)?;
        let mut corrector = corrector;
        corrector.start_at(&interpreter.position);
        Ok(Self {
            interpreter,
            bounds: Bounds::new(&corrector, limit),
            corrector,
            extrusion: None,
            extruded: 0.0,
            seen: CorrectionCache::default(),
            decimals,
            strategy: Strategy::Plain,
            rounded_otherwise: 0,
            carried: [0.0; 9],
            applied_correction: AppliedCorrection::Outdated,
            zeros_noted: std::array::from_fn(|system| setup.offset(system).is_none()),
            turns: Reversals::default(),
            carried_by_cycle: [0.0; 2],
            carried_at_initial: None,
            carried_at_home: [[0.0; 9]; 2],
            contour: Contour::None,
            switches_radius: false,
            before: None,
            pole: None,
            polar_is_off: false,
            comma: false,
            computed: ComputedValues::Kept,
            folders: setup.folders.as_slice().into(),
            more: b"\n",
            counts: Counts::default(),
            shares: None,
            motion_sender: None,
            block: None,
            edits: Edits::default(),
            parts: Vec::new(),
        })
    }

    pub(crate) fn is_percent(&self) -> bool {
        let block = self.block.as_ref();
        block.is_some_and(|block| block.begins == BlockStart::Percent)
    }

    /// Processes a line without its terminator (`number` counts from 1) and appends its replacement: lines separated by
    /// `end`, the last line without a terminator. Returns true if the program ends here.
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
        let dialect = self.interpreter.dialect;
        let (begins, added) = (out.len(), self.counts.added);
        let ends = match read_block(dialect, &mut block, text, number, &self.interpreter) {
            Ok(reads) => {
                let reads_correction = self.carries(&reads.axes)
                    || self.computed != ComputedValues::Kept && reads.returned;
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

    /// Copies a line after the end of the program, with its terminator; only its block number may change.
    pub(crate) fn after_end(&self, text: &[u8], out: &mut Vec<u8>) {
        let begins = out.len();
        out.extend_from_slice(text);
        if self.interpreter.dialect == Dialect::Heidenhain
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
        self.interpreter.execute(line.block, line.number, &mut outcome)?;
        if outcome.calls.is_some() {
            return Err(NcError::not_compensated(
                line.number,
                "M98 and M99 must be alone in their line: M98 P1000 L3, M99",
            ));
        }
        let other_tool = (self.corrector).take_tool(&self.interpreter.modal.tool_offset)?;
        if other_tool {
            self.mark_outdated();
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
            // A modal cycle would drill at the end of every part.
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
        if self.computed == ComputedValues::AllAsNumbers || reads_correction {
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
            self.send_motion(motion, line.number, calls || motion.cuts())?;
            self.motion(motion, line, out)?;
            self.record_part_end(1.0);
        } else if let Some(words) = &outcome.presets {
            self.presets(words, outcome.preset_system, line);
        }
        if let Some(motion) = &outcome.motion {
            self.switches_radius &= !self.moves_in_plane(motion);
        }
        self.after_cycles(&outcome, line)?;
        if let Some(violation) = self.bounds.violated.take() {
            return Err(NcError::OutOfBounds { line: line.number, violation });
        }
        if let Some(motion) = &outcome.motion
            && line.block.begins == BlockStart::Slash
        {
            self.interpreter.forget_skipped_motion(motion);
        }
        // The lines of a corrected motion are already written.
        if out.len() == length {
            self.edits.write(line, out);
        }
        if out.len() - length > MAX_LINE_BYTES && line.text.len() <= MAX_LINE_BYTES {
            let longest =
                out[length..].split(|byte| matches!(byte, b'\r' | b'\n')).map(<[u8]>::len).max();
            if longest > Some(MAX_LINE_BYTES) {
                self.interpreter.notes.add(Note::LongLine, line.number);
            }
        }
        if !self.edits.is_empty() {
            self.counts.changed += 1;
        }
        Ok(outcome.ends)
    }

    /// Sends a motion to the receiver of executed motions, if any.
    pub(crate) fn send_motion(
        &self,
        motion: &Move,
        number: usize,
        cuts: bool,
    ) -> Result<(), NcError> {
        if self.motion_sender.is_none() {
            return Ok(());
        }
        self.send_executed(motion.clone(), self.ends_of(motion), number, cuts)
    }

    /// Like [`send_motion`](Self::send_motion), with the ends of the motion in program coordinates.
    pub(crate) fn send_executed(
        &self,
        motion: Move,
        in_program: [Axes; 2],
        number: usize,
        cuts: bool,
    ) -> Result<(), NcError> {
        let Some(motion_sender) = &self.motion_sender else {
            return Ok(());
        };
        let sent = motion_sender.send(ExecutedMotion {
            line: number,
            motion,
            in_program,
            frame: self.interpreter.frame.clone(),
            tool: self.interpreter.modal.tool_offset,
            system: self.interpreter.modal.system,
            cuts_from_stated_zero: cuts && self.interpreter.has_stated_zero(),
            known: self.knows_position(),
            in_inches: self.interpreter.modal.unit_mm != 1.0,
        });
        sent.map_err(|_| io::Error::from(io::ErrorKind::BrokenPipe).into())
    }

    /// True if the positions of X, Y and Z are known; an axis that the machine lacks counts as known.
    fn knows_position(&self) -> bool {
        (0..3).all(|axis| self.interpreter.known[axis] || !self.corrector.has(axis))
    }

    fn motion(&mut self, motion: &Move, line: Line<'_>, out: &mut Vec<u8>) -> Result<(), NcError> {
        self.corrector.begin_motion(&motion.arrives_from_unknown);
        self.note_axes(motion, line);
        self.note_unknown(motion, line.number);
        self.corrector.apply_wraps(&motion.wraps);
        match motion.path {
            _ if motion.in_machine => self.pass_uncorrected(motion),
            Path::Other | Path::Home { .. } => self.pass_uncorrected(motion),
            Path::Spline if motion.polar.is_some() => self.pass_uncorrected(motion),
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
            Path::Hole { .. } => self.hole(motion, (0, true), line, out),
        }
        self.note_unstated(line.number);
        if motion.cuts() {
            self.note_zero(line.number);
            self.note_approach(line.number);
        }
        Ok(())
    }

    /// True if the active work offset needs no note.
    pub(crate) fn zero_needs_no_note(&self) -> bool {
        let system = self.interpreter.modal.system;
        self.zeros_noted.get(system).is_none_or(|noted| *noted)
            || !self.interpreter.has_stated_zero()
    }

    /// Adds a note about the error at zero, when the program first cuts with a work offset that the set-up states.
    pub(crate) fn note_zero(&mut self, line: usize) {
        if self.zero_needs_no_note() || !self.knows_position() {
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

    /// Adds notes about axes that the machine lacks or that leave their travel, and about cutter radius compensation.
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

    /// The correction at a position, both in program coordinates.
    pub(crate) fn delta_in_program(&self, at: &Axes) -> Axes {
        let frame = &self.interpreter.frame;
        let machine = frame.to_machine(at);
        frame.moved_in_program(&machine, &self.corrector.at(&machine).delta)
    }

    pub(crate) fn ends_of(&self, motion: &Move) -> [Axes; 2] {
        let frame = &self.interpreter.frame;
        [&motion.from, &motion.to].map(|at| frame.to_program(at))
    }

    /// Maximum deviation of the linear axes from a straight path while the tool centre point moves
    /// in a straight line between two program positions, mm.
    pub(crate) fn bulge_mm(&self, from: &Axes, to: &Axes) -> f64 {
        self.corrector.bulge_in_frame_mm(&self.interpreter.frame, from, to)
    }

    fn moves_in_plane(&self, motion: &Move) -> bool {
        let [from, to] = self.ends_of(motion);
        let [first, second, _] = self.interpreter.modal.plane.axes();
        // A rotated or tilted frame reproduces resting coordinates to about 1e-12 mm.
        let moves = |axis: usize| (to[axis] - from[axis]).abs() > 1e-9;
        moves(first) || moves(second)
    }

    /// Axes that keep their current correction. During cutter radius compensation the control treats any motion in the
    /// plane, even of a few µm, as a contour element, and moves the tool around its corner. So a motion without travel
    /// in the plane gets no correction in the plane.
    pub(crate) fn keeps_in_plane(&self, motion: &Move) -> Axes<bool> {
        let compensates = self.switches_radius || self.interpreter.modal.radius.is_some();
        if !compensates || self.moves_in_plane(motion) {
            return [false; 9];
        }
        let [first, second, _] = self.interpreter.modal.plane.axes();
        each(|axis| axis == first || axis == second)
    }

    /// True if any of these axes has a correction applied, so that the control's position for it differs from the program's.
    pub(crate) fn carries(&self, axes: &Axes<bool>) -> bool {
        if *axes == [false; 9] {
            return false;
        }
        let interpreter = &self.interpreter;
        let frame = &interpreter.frame;
        let carried = frame.moved_in_program(&interpreter.position, &self.carried);
        (0..9).any(|axis| axes[axis] && carried[axis].abs() > 1e-9)
    }

    pub(crate) fn finish_motion(&mut self, motion: &Move) {
        let turns = std::mem::take(&mut self.turns);
        if self.corrector.bidirectional {
            self.corrector.set_furthest(&turns.furthest);
        }
        self.applied_correction = if self.corrector.move_to(&motion.to) {
            AppliedCorrection::OutdatedByReversal
        } else {
            AppliedCorrection::Current
        };
    }

    /// Marks the applied correction as possibly that of another position or tool.
    pub(crate) fn mark_outdated(&mut self) {
        if self.applied_correction == AppliedCorrection::Current {
            self.applied_correction = AppliedCorrection::Outdated;
        }
    }

    /// Updates the state after a motion that is copied unchanged. Axes with absolute words lose their correction; a
    /// motion to G28 or G30 gives them the correction of the stored position. The other axes keep their correction.
    pub(crate) fn pass_uncorrected(&mut self, motion: &Move) {
        let frame = &self.interpreter.frame;
        let mut carried = if motion.in_machine {
            self.carried
        } else {
            frame.moved_in_program(&motion.from, &self.carried)
        };
        for axis in 0..9 {
            if motion.words[axis].is_some() && !motion.incremental[axis] {
                carried[axis] = match motion.path {
                    Path::Home { which, .. } => self.carried_at_home[which][axis],
                    _ => 0.0,
                };
            }
        }
        let carried = if motion.in_machine {
            carried
        } else {
            frame.moved_in_machine(&frame.to_program(&motion.to), &carried)
        };
        self.finish_uncorrected(motion, carried);
    }

    /// Updates directions of approach and applied correction after a motion that ends with the correction `carried`
    /// (machine coordinates) instead of the correction required there.
    pub(crate) fn finish_uncorrected(&mut self, motion: &Move, carried: Axes) {
        let mut before = each(|axis| motion.from[axis] + self.carried[axis]);
        if let Path::Home { through, .. } = motion.path {
            let drive = each(|axis| match motion.words[axis] {
                Some(_) => through[axis],
                None => before[axis],
            });
            self.corrector.move_uncorrected(&through, [&before, &drive]);
            self.corrector.begin_motion(&motion.arrives_from_unknown);
            before = drive;
        }
        let after = each(|axis| motion.to[axis] + carried[axis]);
        self.corrector.move_uncorrected(&motion.to, [&before, &after]);
        self.carried = carried;
        self.applied_correction = AppliedCorrection::Outdated;
    }

    fn write_values(&mut self, block: &Block, also_set: bool) {
        for (place, word) in block.words.iter().enumerate() {
            let value = word.value.filter(|_| word.decimals.is_none());
            let number = value.and_then(|value| Number::shortest(value, 6));
            let is_coordinate = b"XYZABCUVWIJKR".contains(&word.letter);
            let needs_point = is_coordinate && self.interpreter.points.means_increments;
            let number =
                number.map(|number| if needs_point { number.form(Form::Point) } else { number });
            self.edits.replaced.extend(number.map(|number| (place, number)));
        }
        let in_sub =
            self.computed == ComputedValues::AllAsNumbers && self.interpreter.parameters.in_sub();
        if !in_sub && !also_set {
            return;
        }
        // The unrolled program must not set a local variable of a subroutine.
        for assignment in &block.assignments {
            let is_local = match &assignment.parameter {
                Parameter::Numbered(number) => Parameters::is_local(*number),
                Parameter::Named(name) => Parameters::is_local_name(name),
            };
            let value = assignment.value.and_then(|value| Number::shortest(value, 6));
            if is_local && in_sub {
                self.edits.ranges.push((assignment.all.clone(), None));
            } else if value.is_some() {
                self.edits.ranges.push((assignment.text.clone(), value));
            }
        }
    }

    pub(crate) fn presets(
        &mut self,
        words: &Axes<Option<usize>>,
        system: Option<usize>,
        line: Line<'_>,
    ) {
        let interpreter = &self.interpreter;
        let modal = &interpreter.modal;
        // An inactive work offset may have a different rotation.
        let frame = interpreter.frame_with(system.unwrap_or(modal.system));
        let carried = frame.moved_in_program(&interpreter.position, &self.carried);
        for axis in 0..9 {
            let Some(word) = line.word(words[axis]) else {
                continue;
            };
            // The control keeps the rounding error of this word for all later motions, so the word gets more decimals.
            let numerals = self.numerals(axis, Some(word));
            let decimals = numerals.decimals;
            let finest = if numerals.form == Form::Increments {
                decimals
            } else {
                (decimals + FINER).max(word.decimals.unwrap_or(0))
            };
            let carried = carried[axis] / modal.scale(axis);
            let Some(value) = word.value.filter(|_| carried.abs() >= half_step(finest)) else {
                continue;
            };
            let number = Number::shortest_of(value + carried, decimals, finest);
            if let Some(number) = number {
                (self.edits).set(LETTERS[axis], words[axis], number.form(numerals.form));
            }
        }
    }

    /// Bound violated by the correction `carried` at a position, both in program coordinates; `None` if it is within all bounds.
    fn bound_violation(&self, at: &Axes, carried: &Axes) -> Option<BoundViolation> {
        let frame = &self.interpreter.frame;
        let in_machine = frame.to_machine(at);
        let by = frame.moved_in_machine_at([&in_machine, at], carried);
        self.violation_in_machine(&in_machine, &by)
    }

    /// Bound violated by the correction `by` at a position, both in machine coordinates; `None` if it is within all bounds.
    pub(crate) fn violation_in_machine(&self, at: &Axes, by: &Axes) -> Option<BoundViolation> {
        let of_axes = self.bounds.violation(&self.interpreter.known, at, by);
        of_axes.or_else(|| {
            let most_mm = || self.corrector.moves_at_most_mm(at, by);
            self.bounds.violation_at_tool(most_mm, || {
                let moved = each(|axis| at[axis] + by[axis]);
                let [from, to] = [at, &moved].map(|at| self.corrector.ideal_tip_mm(at));
                let way: [f64; 3] = std::array::from_fn(|i| to[i] - from[i]);
                dot(way, way).sqrt()
            })
        })
    }

    /// Checks the correction applied at a position, both in program coordinates; the line is rejected if it is out of bounds.
    pub(crate) fn check_bounds(&mut self, at: &Axes, carried: &Axes) {
        if self.bounds.violated.is_none() {
            self.bounds.violated = self.bound_violation(at, carried);
        }
    }

    /// Number format of an axis: the format of the word to be replaced, or of an added word.
    #[inline]
    pub(crate) fn numerals(&self, axis: usize, word: Option<&Word>) -> Numerals {
        let points = &self.interpreter.points;
        let increments =
            word.map_or(points.last_in_increments == Some(true), |word| word.in_increments);
        let decimals = if increments { INCREMENTS } else { self.decimals };
        let form = match (increments, points.means_increments) {
            (true, _) => Form::Increments,
            (false, true) => Form::Point,
            (false, false) => Form::Plain,
        };
        Numerals { decimals: decimals.of(axis, self.interpreter.modal.unit_mm), form }
    }

    /// Rejects an E word that cannot be divided between the parts of a split motion.
    pub(crate) fn check_extrusion(&self, line: Line<'_>) -> Result<(), NcError> {
        match self.extrusion.and_then(|extrusion| extrusion.unknown) {
            None => Ok(()),
            Some(why) => {
                Err(NcError::not_compensated(line.number, format!("a motion that is split: {why}")))
            }
        }
    }

    /// E word of the part that ends at a fraction of its motion; `None` if the block has none or
    /// the part extrudes nothing.
    pub(crate) fn extrusion_up_to(&mut self, share: f64) -> Option<Number> {
        let from = std::mem::replace(&mut self.extruded, share);
        self.extrusion?.of_part([from, share])
    }
}

/// Parses a block; `text` is the line without its terminator.
fn read_block(
    dialect: Dialect,
    block: &mut Block,
    text: &[u8],
    number: usize,
    interpreter: &Interpreter,
) -> Result<Reads, NcError> {
    let fault = |fault| NcError::Block { line: number, fault };
    match dialect {
        Dialect::Rs274 => {
            if let Some(control) = interpreter.control
                && read_control_line(control, block, text).map_err(fault)?
            {
                return Ok(Reads::default());
            }
            let expressions = Expressions::new(interpreter);
            block
                .read(text, &expressions)
                .map_err(|of| fault(corner(text, &of).or_else(|| hint(text)).unwrap_or(of)))?;
            if interpreter.control.is_some_and(Control::is_fanuc_like) {
                check_end_of_block(&text[block.end..], block.end).map_err(fault)?;
            }
            read_increments(block, text, interpreter).map_err(fault)?;
            Ok(expressions.reads.get())
        }
        Dialect::Siemens => {
            read_siemens(block, text, interpreter).map_err(fault)?;
            Ok(Reads::default())
        }
        Dialect::Heidenhain => {
            read_heidenhain(block, text, interpreter).map_err(fault)?;
            Ok(Reads::default())
        }
    }
}
