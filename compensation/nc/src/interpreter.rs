//! Executes blocks in the RS-274 order of execution, regardless of the order of their words.
//!
//! It also tracks which assumptions each axis position depends on. Values that the set-up does not state are assumed to
//! be zero. A position named under an assumed offset or length is known in program coordinates only while this offset
//! and length are active. Under another one an added word would lead to an arbitrary position.

use std::{collections::BTreeMap, sync::Arc};

use volcomp_model::{Axis, Machine, vocabulary::AxisKind};

use crate::{
    NcError,
    block::{Block, BlockStart, Cycle, Parameter},
    codes::{BlockWords, Codes, whole},
    control::{Control, DecimalPoints, Dialect},
    coordinates::{Axes, Frame, Tip, axis_of, each, is_rotary, name_of, with_tool},
    modal::{CentrePoint, Code, FeedMode, G500, Modal, Plane, SYSTEMS, WORK_OFFSETS, code_text},
    motion::Move,
    notes::{Note, Notes},
    number::{MAX_DECIMALS, Number, of_steps, steps},
    parameters::{HAS_RETURNED, Parameters, RETURNED, Value},
    setup::SetUp,
};

#[expect(clippy::struct_excessive_bools, reason = "each is a separate event")]
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Outcome {
    pub(crate) motion: Option<Move>,
    /// Further holes of a row (L in G91), after the first one.
    pub(crate) row: Vec<Move>,
    /// Indices in the block of the axis words that define the current position (G92, G10 L20).
    pub(crate) presets: Option<Axes<Option<usize>>>,
    /// The work offset in whose coordinates the words of `presets` are (G10 L20), if it is not the active one.
    pub(crate) preset_system: Option<usize>,
    pub(crate) ends: bool,
    pub(crate) calls: Option<Code>,
    /// Stores the position of G28 (0) or G30 (1).
    pub(crate) stores_home: Option<usize>,
    pub(crate) switches_radius: bool,
    /// Starts or ends polar X and Y words (G16, G15).
    pub(crate) switches_polar: bool,
    /// The words are machine coordinates (SUPA).
    pub(crate) in_machine: bool,
    /// Sets the pole; true for X and Y if relative to the tool position.
    pub(crate) pole: Option<[bool; 2]>,
    pub(crate) cycle: Option<Cycle>,
    /// Filament of the motion, on a printer.
    pub(crate) extrusion: Option<Extrusion>,
}

#[derive(Clone, Debug)]
pub(crate) struct Interpreter {
    pub(crate) modal: Modal,
    pub(crate) frame: Frame,
    /// Axis positions in machine coordinates, mm and deg.
    pub(crate) position: Axes,
    /// Whether each axis position is known.
    pub(crate) known: Axes<bool>,
    pub(crate) assumptions: Assumptions,
    pub(crate) parameters: Parameters,
    pub(crate) tools: BTreeMap<u32, Axes>,
    pub(crate) notes: Notes,
    pub(crate) dialect: Dialect,
    pub(crate) control: Option<Control>,
    /// True if the direction in which a rollover axis turns to a word is known.
    pub(crate) states_rotary_words: bool,
    pub(crate) points: DecimalPoints,
    pub(crate) extruder: Extruder,
    /// Tool put into the spindle by M6.
    pub(crate) in_spindle: Option<u32>,
    /// Whether the program has an M6.
    pub(crate) changes_tools: bool,
    machine: Arc<Machine>,
    /// Kinematics with the active tool; `None` for machines without tool centre point control.
    tip: Option<Arc<Tip>>,
}

/// Minimum decimals of E words, as slicers write them.
const DECIMALS: u8 = 5;

#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Extruder {
    /// M83 is active, regardless of G90 and G91.
    says_relative: bool,
    /// The last of G90, G91, M82 and M83 was a relative one (G91, M83).
    last_relative: bool,
    /// E at the end of the last motion, mm; `None` if unknown.
    pub(crate) at: Option<f64>,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Extrusion {
    /// E at the start of the motion, in program units; `None` if the word is relative or the start is unknown.
    from: Option<f64>,
    to: f64,
    decimals: u8,
    pub(crate) unknown: Option<&'static str>,
}

impl Extruder {
    pub(crate) fn switch(&mut self, relative: bool) {
        (self.says_relative, self.last_relative) = (relative, relative);
    }
}

impl Extrusion {
    /// E word of the part of the motion between two fractions of it; `None` if the part extrudes nothing.
    pub(crate) fn of_part(&self, [from, to]: [f64; 2]) -> Option<Number> {
        let decimals = self.decimals.clamp(DECIMALS, MAX_DECIMALS);
        let written = self.decimals.min(MAX_DECIMALS);
        let Some(begins) = self.from else {
            // Differences of rounded sums, so that the parts add up to the whole word exactly.
            let all = steps(self.to, decimals)?;
            let at = |share: f64| steps(of_steps(all, decimals) * share, decimals);
            let part = at(to)? - at(from)?;
            return Number::shortest_of(of_steps(part, decimals), written, decimals)
                .filter(|_| part != 0);
        };
        let at = |share: f64| {
            let place = match share {
                1.0 => self.to,
                _ => begins + share * (self.to - begins),
            };
            Number::shortest_of(place, written, decimals)
        };
        let before = at(from);
        at(to).filter(|number| Some(*number) != before)
    }
}

/// Identifiers of the unstated work offset, tool length and shift on which the program coordinate of an axis depends; 0 for a stated one.
pub(crate) type Basis = [u32; 3];

/// Position stated in machine coordinates.
pub(crate) const OF_MACHINE: Basis = [0; 3];

/// Position based on an assumption other than an offset, length or shift: a home position that is not stated.
const ASSUMED: Basis = [u32::MAX >> 1; 3];

/// Position possibly changed, without correction, by an unknown code that had a word of this axis.
const UNCLAIMED: Basis = [u32::MAX >> 2; 3];

/// Flag of an identifier that was issued while the axis position was unknown: the machine coordinates are arbitrary.
const LOST: u32 = 1 << 31;

/// State: the unstated quantities that axis positions depend on.
#[derive(Clone, Debug)]
pub(crate) struct Assumptions {
    places: Axes<Basis>,
    offsets: Vec<Axes<u32>>,
    /// Identifier of a tool that the set-up does not state, or 0.
    pub(crate) tool: u32,
    shift: Axes<u32>,
    /// Axes whose position the program has named in its coordinates, not in those of the machine.
    in_program: Axes<bool>,
    /// Axes whose position the program has named under a stated zero ([`Interpreter::has_stated_zero`]).
    named: Axes<bool>,
    /// Axes whose G92 shift was set at a position that was not named under a stated zero: that position, not the work offset, defines their zero.
    from_elsewhere: Axes<bool>,
    /// Work offsets that the program has set (G10).
    set: [bool; SYSTEMS],
    /// For G28 and G30: whether the position of each axis is known, and its basis.
    homes: [Axes<(bool, Basis)>; 2],
    next: u32,
}

impl Assumptions {
    pub(crate) fn new(setup: &SetUp) -> Self {
        let number = |(system, number): (usize, u32)| match setup.offset(system) {
            Some(_) => [0; 9],
            None => [number; 9],
        };
        let offsets: Vec<_> = (0..SYSTEMS).zip(1..).map(number).collect();
        Self {
            places: [OF_MACHINE; 9],
            next: offsets.len().try_into().unwrap_or(LOST >> 1),
            offsets,
            tool: 0,
            shift: [0; 9],
            in_program: [false; 9],
            named: [false; 9],
            from_elsewhere: [false; 9],
            set: [false; SYSTEMS],
            homes: setup.states_homes.map(|stated| {
                stated.map(|stated| (true, if stated { OF_MACHINE } else { ASSUMED }))
            }),
        }
    }

    /// Records the active tool length: of a tool that the set-up does not state (`Some`), or a known one (`None`).
    pub(crate) fn use_tool_length(&mut self, unstated: Option<u32>) {
        self.tool = unstated.map_or(0, |tool| tool.saturating_add(1));
    }

    pub(crate) fn shift_is_zero(&mut self) {
        (self.shift, self.from_elsewhere) = ([0; 9], [false; 9]);
    }

    pub(crate) fn shift_is_stated(&mut self, axis: usize) {
        (self.shift[axis], self.from_elsewhere[axis]) = (0, false);
    }

    pub(crate) fn offset_is_stated(&mut self, system: usize, axis: usize) {
        if let Some(offset) = self.offsets.get_mut(system) {
            offset[axis] = 0;
        }
        self.is_set(system);
    }

    fn is_set(&mut self, system: usize) {
        if let Some(set) = self.set.get_mut(system) {
            *set = true;
        }
    }

    fn new_number(&mut self, known: bool) -> u32 {
        self.next += 1;
        self.next | if known { 0 } else { LOST }
    }
}

impl Interpreter {
    pub(crate) fn new(
        setup: &SetUp,
        machine: Arc<Machine>,
        dialect: Dialect,
    ) -> Result<Self, NcError> {
        if let Some(control) = setup.control()
            && control.dialect() != dialect
        {
            return Err(NcError::OtherLanguage {
                control: control.name(),
                expected: control.dialect().name(),
                found: dialect.name(),
            });
        }
        if setup.states_rotary_words && dialect != Dialect::Rs274 {
            return Err(NcError::RotaryWords { found: dialect.name() });
        }
        let (position, known) = setup.start();
        let mut modal = setup.modal.clone();
        match dialect {
            Dialect::Siemens => modal.system = G500,
            Dialect::Heidenhain => modal.centre_absolute = true,
            Dialect::Rs274 => {}
        }
        let tip = Tip::new(&machine).map(Arc::new);
        if modal.centre_point != CentrePoint::Off && tip.is_none() {
            return Err(NcError::NoCentrePoint);
        }
        Ok(Self {
            frame: modal.frame(tip.as_ref()),
            modal,
            position,
            known,
            assumptions: Assumptions::new(setup),
            parameters: Parameters::default(),
            tools: setup.tools.clone(),
            notes: Notes::default(),
            dialect,
            control: setup.control(),
            states_rotary_words: setup.states_rotary_words || dialect != Dialect::Rs274,
            points: setup.points(),
            extruder: Extruder::default(),
            in_spindle: None,
            changes_tools: false,
            machine,
            tip,
        })
    }

    pub(crate) fn program_position(&self) -> Axes {
        self.frame.to_program(&self.position)
    }

    fn frame_of(&self, modal: &Modal) -> Frame {
        modal.frame(self.tip.as_ref())
    }

    pub(crate) fn frame_with(&self, system: usize) -> Frame {
        let mut modal = self.modal.clone();
        modal.system = system;
        self.frame_of(&modal)
    }

    /// Updates the frame from the modal state; call it after every change.
    pub(crate) fn update_frame(&mut self) {
        self.frame = self.frame_of(&self.modal);
    }

    pub(crate) fn is_printer(&self) -> bool {
        self.control.is_some_and(Control::is_printer)
    }

    pub(crate) fn machine_has(&self, axis: usize) -> bool {
        self.axis_of_machine(axis).is_some()
    }

    fn axis_of_machine(&self, axis: usize) -> Option<&Axis> {
        name_of(axis).and_then(|name| self.machine.axis(name))
    }

    /// True if a rotary axis may roll over at the control: the machine file has `modulo`, or a travel of a turn or more.
    pub(crate) fn may_roll_over(&self, axis: usize) -> bool {
        self.axis_of_machine(axis).is_some_and(|axis| {
            axis.modulo.is_some() || axis.travel[1] - axis.travel[0] >= 360.0 - 1e-6
        })
    }

    /// True if the direction in which the axis turns to a coordinate is unknown: the axis may roll over, and neither the language nor the
    /// set-up states the direction.
    pub(crate) fn may_turn_either_way(&self, axis: usize) -> bool {
        !self.states_rotary_words && is_rotary(axis) && self.may_roll_over(axis)
    }

    /// True if an axis that may roll over is taken to do so: the machine file has `modulo`, or the control is one whose rotary tables
    /// usually roll over.
    pub(crate) fn rolls_over(&self, axis: usize) -> bool {
        self.axis_of_machine(axis).is_some_and(|axis| axis.modulo.is_some())
            || self.control.is_some_and(Control::is_fanuc_like)
    }

    pub(crate) fn update_tool(&mut self) -> Result<(), NcError> {
        if self.tip.is_some() {
            let machine = with_tool(&self.machine, &self.modal.tool_offset)?;
            self.tip = Tip::new(&machine).map(Arc::new);
        }
        Ok(())
    }

    pub(crate) fn switch_centre_point(
        &mut self,
        to: CentrePoint,
        given: &BlockWords<'_>,
    ) -> Result<(), NcError> {
        let on = to != CentrePoint::Off;
        let mut joints = self.machine.chain().joints().iter();
        let has_rotary = joints.any(|joint| joint.kind == AxisKind::Rotary);
        if on && has_rotary && self.tip.is_none() {
            return Err(given.refused(&NcError::NoCentrePoint.to_string()));
        }
        self.modal.centre_point = to;
        Ok(())
    }

    /// Executes a block; `line` is counted from 1. Effects are added to `outcome`, which must be empty.
    pub(crate) fn execute(
        &mut self,
        block: &Block,
        line: usize,
        outcome: &mut Outcome,
    ) -> Result<(), NcError> {
        let mut codes = Codes::of(block, self.control, line)?;
        match codes.polar {
            Some(160) => self.modal.polar = Some([None; 2]),
            Some(150) => self.modal.polar = None,
            _ => {}
        }
        let given = BlockWords::new(block, line, self.takes_polar(&codes))?;
        outcome.ends = codes.ends;
        outcome.calls = codes.calls;
        // G40 without active compensation switches nothing.
        outcome.switches_radius =
            (codes.radius).is_some_and(|code| code != 400 || self.modal.radius.is_some());
        outcome.switches_polar = codes.polar.is_some();
        if let Some(code) = codes.not_followed.filter(|_| self.dialect == Dialect::Rs274) {
            let what = format!(
                "M{}, which is not supported, because it may change coordinates: remove it",
                code / 10
            );
            return Err(given.refused(&what));
        }
        let dwells_by_axis = self.dwells_by_axis(&codes, &given);
        if codes.not_modal == Some(40) && given.names_axes() && !dwells_by_axis {
            return Err(given.refused("a dwell (G4) with the word of an axis, which FANUC controls read as its time: write P"));
        }
        if let Some(code) = codes.harmless.filter(|_| given.names_axes() && codes.motion.is_none())
        {
            let what = format!("{} with the word of an axis", code_text(code));
            return Err(given.refused(&what));
        }
        self.check_meaning(&codes, &given)?;
        if codes.ends_smoothing(given.names_axes(), self.control) {
            return Err(given.refused("smooth interpolation of the named axes (G5.1)"));
        }
        self.check_skipped(&codes, &given)?;
        let length =
            (self.modal.centre_point != CentrePoint::Off).then_some(self.modal.tool_offset);
        self.switch(&codes, &given)?;
        let before = (self.modal.system, self.modal.programmed, self.modal.tool_offset);
        let mut uses_words = self.commands(&given, outcome)?;
        self.mark_new_coordinates(before);
        codes.in_machine |= outcome.in_machine;
        let is_longer = length.is_some_and(|length| length != self.modal.tool_offset);
        if is_longer && self.modal.centre_point != CentrePoint::Off {
            self.has_other_centre_point();
        }
        uses_words |= self.not_modal(&codes, &given, outcome)? || dwells_by_axis;
        uses_words |= self.leaves_arguments(&codes, &given);
        if !uses_words && codes.calls.is_none() {
            self.motion(&codes, &given, outcome)?;
        } else if let Some(motion) = codes.motion {
            self.set_motion(motion);
        }
        if self.is_printer() {
            self.extrude(&codes, &given, outcome)?;
        }
        if codes.exchanges_pallet && self.dialect == Dialect::Rs274 {
            self.forget_positions();
        }
        for assignment in &block.assignments {
            let value = assignment.value;
            match &assignment.parameter {
                Parameter::Named(name) => self.parameters.set_named(name, value),
                Parameter::Numbered(number) => self.parameters.set_numbered(*number, value),
            }
        }
        Ok(())
    }

    /// True if axis words may be arguments of an unknown M code: they are copied unchanged.
    fn leaves_arguments(&mut self, codes: &Codes, given: &BlockWords<'_>) -> bool {
        let names = given.names_axes() || given.polar.is_some();
        let code = codes
            .with_arguments()
            .and_then(|place| given.block.words.get(place))
            .and_then(|word| word.value)
            .filter(|_| names && self.dialect == Dialect::Rs274);
        let Some(code) = code else {
            return false;
        };
        let is_named = |axis: usize| given.word(axis).is_some();
        let of_polar = |axis: usize| axis < 2 && given.polar.is_some();
        self.mark_possibly_moved(&each(|axis| is_named(axis) || of_polar(axis)));
        self.notes.add(Note::MayMove(format!("M{code}")), given.line);
        true
    }

    /// Rejects words that controls interpret differently.
    fn check_meaning(&self, codes: &Codes, given: &BlockWords<'_>) -> Result<(), NcError> {
        if self.dialect != Dialect::Rs274 {
            return Ok(());
        }
        let is_absolute = codes.distance.map_or(self.modal.absolute, |code| code == 900);
        if codes.in_machine && !is_absolute {
            return Err(given.refused(
                "G53 in G91, which LinuxCNC refuses and FANUC controls ignore: write G90 before",
            ));
        }
        let subtracts_length = match codes.not_modal {
            Some(280 | 300) => true,
            Some(100) => given.whole(b'L')? == Some(20),
            _ => codes.in_machine,
        };
        if subtracts_length {
            let unit_mm =
                codes.units.map_or(self.modal.unit_mm, |code| if code == 200 { 25.4 } else { 1.0 });
            let what = "machine coordinates (G53, G28, G30, G10 L20) with a tool length";
            self.refuse_length_in(unit_mm, given, what)?;
        }
        self.check_incremental_letters(codes, given)?;
        let has_own_h = given.has(b'H') && codes.tool_length.is_none();
        if has_own_h && (codes.polar.is_some() || codes.work_offset.is_some()) {
            return Err(given.refused("H with G15, G16 or G54 to G59, with which Okuma controls select a work offset, machine coordinates or a tool length: programs of these controls are not supported"));
        }
        if has_own_h && matches!(codes.radius, Some(410 | 420)) {
            return Err(given.refused("H with G41 or G42, which older FANUC controls read as the number of the tool radius: write D"));
        }
        if has_own_h
            // In G76, this word is the thread angle.
            && codes.motion != Some(760)
            && self.modal.length.is_some()
            && self.modal.length != given.whole(b'H')?
        {
            return Err(given.refused("H without G43 while a tool length is active, which FANUC controls read as another length and LinuxCNC refuses: write G43 before it"));
        }
        for assignment in &given.block.assignments {
            let Parameter::Numbered(number) = assignment.parameter else {
                continue;
            };
            if matches!(number, 5161..=5390 | 5400..=5428) {
                let what = format!(
                    "a value for #{number}, which the control uses for its offsets, homes and places, or sets itself, is not supported: write G10 or the set-up"
                );
                return Err(given.refused(&what));
            }
        }
        Ok(())
    }

    /// Updates the state if the tool length changes while tool centre point control is active. If a rotary axis may be
    /// away from zero, controls differ in the new X, Y and Z, so the positions of X, Y and Z are unknown until the
    /// program names them.
    fn has_other_centre_point(&mut self) {
        let is_off = |axis: usize| {
            self.machine_has(axis) && !(self.known[axis] && self.position[axis] == 0.0)
        };
        if (3..6).any(is_off) {
            self.known[..3].fill(false);
        }
    }

    fn switch(&mut self, codes: &Codes, given: &BlockWords<'_>) -> Result<(), NcError> {
        let modal = &mut self.modal;
        match codes.feed {
            Some(930) => modal.feed_mode = FeedMode::InverseTime,
            Some(940) => modal.feed_mode = FeedMode::PerMinute,
            Some(950) => modal.feed_mode = FeedMode::PerRevolution,
            _ => {}
        }
        modal.exact_stop = codes.exact_stop.unwrap_or(modal.exact_stop);
        if self.dialect == Dialect::Rs274 && self.control.is_none_or(Control::is_fanuc_like) {
            modal.clamped = codes.clamps.unwrap_or(modal.clamped);
        }
        if let Some(feed) = given.find(b'F') {
            modal.feed = feed.value;
        }
        if let Some(tool) = given.find(b'T').and_then(|tool| tool.value) {
            modal.tool = whole(tool, 99_999);
        }
        if codes.changes_tool && self.dialect == Dialect::Rs274 {
            self.in_spindle = modal.tool;
            self.changes_tools = true;
            self.forget_positions();
        }
        if codes.states_tool {
            self.in_spindle = given.whole(b'Q')?;
            self.changes_tools = true;
        }
        let modal = &mut self.modal;
        match codes.plane {
            Some(170) => modal.plane = Plane::Xy,
            Some(180) => modal.plane = Plane::Zx,
            Some(190) => modal.plane = Plane::Yz,
            _ => {}
        }
        if let Some(code) = codes.units {
            modal.unit_mm = if code == 200 { 25.4 } else { 1.0 };
        }
        modal.diameter = codes.diameter.map_or(modal.diameter, |code| code == 70);
        if codes.radius.is_some() {
            modal.radius = codes.radius.filter(|code| *code != 400);
        }
        modal.absolute = codes.distance.map_or(modal.absolute, |code| code == 900);
        modal.centre_absolute = (codes.centre).map_or(modal.centre_absolute, |code| code == 901);
        modal.comes_back = codes.comes_back.map_or(modal.comes_back, |code| code == 980);
        modal.says_return |= codes.comes_back.is_some();
        if let Some(code) = codes.tool_length {
            let before = (self.modal.tool_offset, self.assumptions.tool);
            self.tool_length(code, given)?;
            self.update_tool()?;
            if matches!(code, 430 | 490) {
                self.forget_lengthened(before);
            }
            self.states_length();
            match self.modal.centre_point {
                _ if code == 434 => {
                    self.switch_centre_point(CentrePoint::WithToolLength, given)?;
                }
                CentrePoint::WithToolLength => self.modal.centre_point = CentrePoint::Off,
                CentrePoint::Off | CentrePoint::Switched => {}
            }
        }
        if codes.own_kinematics && self.modal.centre_point == CentrePoint::Switched {
            return Err(given.refused(
                "M430 after M428, which switches LinuxCNC to unknown kinematics of the user: write M429 before",
            ));
        }
        match codes.centre_point {
            Some(true) => self.switch_centre_point(CentrePoint::Switched, given)?,
            Some(false) => self.modal.centre_point = CentrePoint::Off,
            None => {}
        }
        if let Some(code) = codes.work_offset {
            let system = self.system_of(code, codes, given)?;
            self.use_system(system);
        }
        match codes.rotation {
            Some(680) => self.rotation(given)?,
            Some(690) if self.modal.rotation.take().is_some() => self.forget_turned(),
            _ => {}
        }
        if codes.tool_length.is_some()
            || codes.centre_point.is_some()
            || codes.work_offset.is_some()
            || codes.rotation.is_some()
        {
            self.update_frame();
        }
        Ok(())
    }

    fn extrude(
        &mut self,
        codes: &Codes,
        given: &BlockWords<'_>,
        outcome: &mut Outcome,
    ) -> Result<(), NcError> {
        if let Some(code) = codes.distance {
            self.extruder.last_relative = code == 910;
        }
        if codes.not_modal == Some(920) && !given.names_axes() && !given.has(b'E') {
            return Err(given.refused("G92 without an axis, which sets all axes to zero in Klipper and does nothing in Marlin: name the axes"));
        }
        let Some(value) = given.letter(b'E')? else {
            return Ok(());
        };
        let unit = self.modal.unit_mm;
        if codes.not_modal == Some(920) {
            self.extruder.at = Some(value * unit);
            return Ok(());
        }
        // Klipper and Marlin 1: relative by M83 or by G91. Marlin 2: by the last of these codes.
        let by_both = self.extruder.says_relative || !self.modal.absolute;
        let is_unclear =
            self.control == Some(Control::Marlin) && by_both != self.extruder.last_relative;
        let from = self.extruder.at.map(|at| at / unit);
        let unknown = if is_unclear {
            Some(
                "versions of Marlin differ in whether its E is absolute or relative after G90 or G91 here: write M82 or M83 after that",
            )
        } else if !by_both && from.is_none() {
            Some("the position of E before it is unknown: write G92 E0 before it")
        } else {
            None
        };
        outcome.extrusion = Some(Extrusion {
            from: if by_both { None } else { from },
            to: value,
            decimals: (given.find(b'E').and_then(|word| word.decimals)).unwrap_or(DECIMALS),
            unknown,
        });
        self.extruder.at = match (is_unclear, by_both) {
            (true, _) => None,
            (_, true) => self.extruder.at.map(|at| at + value * unit),
            (_, false) => Some(value * unit),
        };
        Ok(())
    }

    /// Basis of an axis position that the program states now.
    fn basis(&self, axis: usize) -> Basis {
        let (assumptions, modal) = (&self.assumptions, &self.modal);
        // The tool length is along Z; in another plane, or on a lathe, it may be along another linear axis.
        let has_length = axis == 2 || axis < 3 && modal.plane != Plane::Xy;
        [
            assumptions.offsets.get(modal.system).map_or(0, |of| of[axis]),
            if has_length { assumptions.tool } else { 0 },
            if modal.shifted { assumptions.shift[axis] } else { 0 },
        ]
    }

    /// True if the program coordinate of an axis is known, so that a word with this value leads to the current position.
    #[inline]
    pub(crate) fn knows_program_position(&self, axis: usize) -> bool {
        self.known[axis] && self.assumptions.places[axis] == self.basis(axis)
    }

    /// Basis of the position of an axis; `None` if the position is unknown, assumed, or may have changed.
    pub(crate) fn known_basis(&self, axis: usize) -> Option<Basis> {
        let basis = self.assumptions.places[axis];
        (self.known[axis] && basis != ASSUMED && basis != UNCLAIMED).then_some(basis)
    }

    /// True if the active work offset of the set-up file defines the program zero: neither G10 nor a G92 shift from another position has
    /// replaced it.
    pub(crate) fn has_stated_zero(&self) -> bool {
        let is_set = self.assumptions.set[self.modal.system.min(SYSTEMS - 1)];
        let is_elsewhere = self.modal.shifted && self.assumptions.from_elsewhere.contains(&true);
        !is_set && !is_elsewhere
    }

    pub(crate) fn mark_named(&mut self, axis: usize) {
        let basis = self.basis(axis);
        self.assumptions.places[axis] = basis;
        self.assumptions.named[axis] = self.has_stated_zero();
        self.assumptions.in_program[axis] = true;
        self.known[axis] = basis.iter().all(|number| number & LOST == 0);
    }

    pub(crate) fn mark_machine_position(&mut self, axis: usize) {
        self.assumptions.places[axis] = OF_MACHINE;
        self.assumptions.named[axis] = false;
        self.assumptions.in_program[axis] = false;
        self.known[axis] = true;
    }

    /// Marks the program coordinate of an axis as unknown; the machine coordinate keeps its state.
    pub(crate) fn mark_assumed(&mut self, axis: usize) {
        self.assumptions.places[axis] = ASSUMED;
        self.assumptions.named[axis] = false;
    }

    /// Marks the program coordinates of X, Y and Z as unknown after a change of the tool or pallet: many machines stay where they change it.
    pub(crate) fn forget_positions(&mut self) {
        for axis in 0..3 {
            self.mark_assumed(axis);
        }
    }

    /// Forgets the positions that the program named before it first states a work offset, shift or tool length. Until
    /// then the control may have used a value of an earlier program instead of the assumed value.
    pub(crate) fn forget_named(&mut self, axes: std::ops::Range<usize>) {
        for axis in axes {
            if self.assumptions.in_program[axis] {
                self.mark_assumed(axis);
            }
        }
    }

    pub(crate) fn use_system(&mut self, system: usize) {
        if !std::mem::replace(&mut self.modal.system_is_said, true) {
            self.forget_named(0..9);
        }
        self.modal.system = system;
    }

    pub(crate) fn states_length(&mut self) {
        if !std::mem::replace(&mut self.modal.length_is_said, true) {
            let first = if self.modal.plane == Plane::Xy { 2 } else { 0 };
            self.forget_named(first..3);
        }
    }

    fn mark_possibly_moved(&mut self, named: &Axes<bool>) {
        for (axis, named) in named.iter().enumerate() {
            self.mark_assumed(axis);
            if *named {
                self.assumptions.places[axis] = UNCLAIMED;
                self.known[axis] = false;
            }
        }
    }

    /// True if an unknown code had a word of the axis, and the axis has not been named since.
    pub(crate) fn is_unclaimed(&self, axis: usize) -> bool {
        self.assumptions.places[axis] == UNCLAIMED
    }

    pub(crate) fn store_home(&mut self, which: usize) {
        self.modal.homes[which] = self.position;
        self.assumptions.homes[which] =
            std::array::from_fn(|axis| (self.known[axis], self.assumptions.places[axis]));
    }

    /// Moves an axis to the position of G28 or G30. Returns true if the set-up or G28.1 has stated that position.
    pub(crate) fn move_home(&mut self, which: usize, axis: usize) -> bool {
        self.position[axis] = self.modal.homes[which][axis];
        let (known, basis) = self.assumptions.homes[which][axis];
        (self.known[axis], self.assumptions.places[axis]) = (known, basis);
        self.assumptions.named[axis] = false;
        self.assumptions.in_program[axis] = false;
        known && basis != ASSUMED
    }

    /// Axes whose positions contribute to the coordinate of an axis: X and Y under a rotation.
    pub(crate) fn mixed_with(&self, axis: usize) -> std::ops::Range<usize> {
        if axis < 2 && self.frame.rotation_deg != 0.0 { 0..2 } else { axis..axis + 1 }
    }

    /// Updates the assumptions after G92, which sets the shift from the current position. Unless
    /// that position is known under the active offsets, the shift gets a new identifier.
    pub(crate) fn set_shift_from_position(&mut self, axis: usize, line: usize) {
        let known = self.mixed_with(axis).all(|axis| self.known[axis]);
        if !(self.mixed_with(axis)).all(|axis| self.assumptions.named[axis])
            && self.machine_has(axis)
        {
            self.assumptions.from_elsewhere[axis] = true;
        }
        if !known {
            self.assumptions.shift[axis] = self.assumptions.new_number(false);
            self.notes.add(Note::NoStart, line);
        } else if self.assumptions.places[axis] != self.basis(axis) {
            self.assumptions.shift[axis] = self.assumptions.new_number(true);
        }
        self.assumptions.places[axis] = self.basis(axis);
    }

    /// Updates the assumptions after G10 L20, which sets a work offset from the current position.
    pub(crate) fn set_offset_from_position(&mut self, system: usize, axis: usize, line: usize) {
        let mixed = self.mixed_with(axis);
        let known = mixed.clone().all(|axis| self.known[axis]);
        self.assumptions.is_set(system);
        if !known {
            self.notes.add(Note::NoStart, line);
        }
        for axis in mixed {
            let [_, tool, shift] = self.basis(axis);
            let place = self.assumptions.places[axis];
            let is_exact = known && place == OF_MACHINE && [tool, shift] == [0; 2];
            let stays = known && system == self.modal.system && place == self.basis(axis);
            if !stays && let Some(offset) = self.assumptions.offsets.get(system).copied() {
                let mut offset = offset;
                offset[axis] = if is_exact { 0 } else { self.assumptions.new_number(known) };
                self.assumptions.offsets[system] = offset;
            }
        }
        if system == self.modal.system {
            self.assumptions.places[axis] = self.basis(axis);
        }
    }

    /// Index of the active work offset, if it is not stated and zero was assumed.
    pub(crate) fn unstated_offset(&self) -> Option<usize> {
        let system = self.modal.system;
        let offset = self.assumptions.offsets.get(system)?;
        let number = u32::try_from(system).ok()? + 1;
        offset.contains(&number).then_some(system)
    }

    pub(crate) fn provided(&self, name: &str) -> Option<Value> {
        let truth = |truth: bool| Some(Some(f64::from(u8::from(truth))));
        let modal = &self.modal;
        if let Some(axis) = axis_of_name(name) {
            let at = self.program_position()[axis] / modal.scale(axis);
            return Some(self.knows_program_position(axis).then_some(at));
        }
        match name {
            "_metric" => truth(modal.unit_mm == 1.0),
            "_imperial" => truth(modal.unit_mm != 1.0),
            "_absolute" => truth(modal.absolute),
            "_incremental" => truth(!modal.absolute),
            "_feed" => Some(modal.feed),
            "_coord_system" => WORK_OFFSETS.get(modal.system).map(|code| Some(f64::from(*code))),
            "_current_tool" => Some(self.tool_in_spindle().map(f64::from)),
            "_selected_tool" => Some(modal.tool.map(f64::from)),
            "_motion_mode" => Some(modal.motion.map(f64::from)),
            // Known only at the machine.
            "_vmajor" | "_vminor" | "_line" | "_rpm" | "_task" | "_remote_call" | RETURNED
            | HAS_RETURNED => Some(None),
            _ => ["_ini[", "_hal["].iter().any(|of| name.starts_with(of)).then_some(None),
        }
    }

    pub(crate) fn numbered(&self, number: u32) -> Option<Value> {
        let place = |first: u32| Some((number - first) as usize);
        let (list, axis): (&Axes, _) = match number {
            5161..=5169 => (&self.modal.homes[0], place(5161)?),
            5181..=5189 => (&self.modal.homes[1], place(5181)?),
            5211..=5219 => (&self.modal.shift, place(5211)?),
            5220 => return Some(Some(self.modal.system as f64 + 1.0)),
            5221..=5390 => {
                let (system, axis) = (place(5221)? / 20, place(5221)? % 20);
                let offset = self.modal.offsets.get(system)?;
                if axis == 9 {
                    return Some(Some(offset.rotation_deg));
                }
                let at = *offset.offset.get(axis)?;
                return Some(Some(at / self.length_unit(axis)));
            }
            5400 => return Some(self.tool_in_spindle().map(f64::from)),
            5401..=5409 => (&self.modal.tool_offset, place(5401)?),
            5420..=5428 => {
                let axis = axis_of_place(number)?;
                let at = self.program_position()[axis] / self.modal.scale(axis);
                return Some(self.knows_program_position(axis).then_some(at));
            }
            _ => return None,
        };
        let at = *list.get(axis)?;
        Some(Some(at / self.length_unit(axis)))
    }

    fn length_unit(&self, axis: usize) -> f64 {
        if is_rotary(axis) { 1.0 } else { self.modal.unit_mm }
    }

    /// Rejects a block that may be skipped but changes the meaning of later coordinates.
    fn check_skipped(&mut self, codes: &Codes, given: &BlockWords<'_>) -> Result<(), NcError> {
        if given.block.begins != BlockStart::Slash {
            return Ok(());
        }
        let switches = [
            codes.plane,
            codes.units,
            codes.diameter,
            codes.radius,
            codes.distance,
            codes.centre,
            codes.tool_length,
            codes.work_offset,
            codes.rotation,
            codes.polar,
            codes.comes_back,
            codes.feed,
            // A dwell changes nothing.
            codes.not_modal.filter(|code| *code != 40),
        ];
        let block = given.block;
        if switches.iter().any(Option::is_some)
            || codes.centre_point.is_some()
            || codes.ends
            || codes.changes_tool
            || given.has(b'T')
            || !block.assignments.is_empty()
            || !block.commands.is_empty()
        {
            return Err(given.refused(
                "a block that may be skipped (/) and changes the meaning of later lines (offsets, planes, units, G90, G91, G98, G99, the tool and its length, the mode of the feed, a parameter, the end of the program): the following lines can be corrected for one of the two cases only: remove the slash or the block",
            ));
        }
        self.notes.add(Note::MayBeSkipped, given.line);
        Ok(())
    }

    /// Marks the positions of the axes that a motion moves as unknown, because the operator may skip the motion.
    pub(crate) fn forget_skipped_motion(&mut self, motion: &Move) {
        let takes_along = self.frame.tip.is_some();
        for axis in 0..9 {
            let in_plane = axis < 2 && motion.polar.is_some();
            if motion.words[axis].is_some() || in_plane || axis < 3 && takes_along {
                self.known[axis] = false;
            }
        }
    }
}

/// Index of the axis of a named position parameter, such as `_x`; `None` for other names.
pub(crate) fn axis_of_name(name: &str) -> Option<usize> {
    match name.as_bytes() {
        [b'_', letter] => axis_of(letter.to_ascii_uppercase()),
        _ => None,
    }
}

pub(crate) fn axis_of_place(number: u32) -> Option<usize> {
    let axis = number.checked_sub(5420)? as usize;
    (axis < 9).then_some(axis)
}
