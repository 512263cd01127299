//! Executes blocks as RS-274 does: in the order of its rules, whatever the order of the words.

use std::{collections::HashMap, sync::Arc};

use volcomp_model::{Machine, vocabulary::AxisKind};

use crate::{
    NcError,
    basis::Rests,
    block::{Block, Parameter},
    codes::{Codes, Refusal, UnknownCode, text},
    control::{Control, DecimalPoints, why_refused},
    coordinates::{Axes, Frame, name_of},
    cycles::Cycle,
    dialect::Dialect,
    extruder::{Extruder, Extrusion},
    given::{Given, whole},
    modal::{CentrePoint, Code, FeedMode, G500, Modal, Plane},
    motion::Move,
    notes::{Note, Notes},
    parameters::Parameters,
    setup::SetUp,
    tip::{Tip, with_tool},
    words::each,
};

/// What a block did.
#[expect(clippy::struct_excessive_bools, reason = "each is an event of its own")]
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Outcome {
    pub(crate) motion: Option<Move>,
    /// The further holes of a row that is written by L in G91.
    pub(crate) row: Vec<Move>,
    /// Its axis words say where the axes stand (G92, G10 L20): they are the words at these places.
    pub(crate) presets: Option<Axes<Option<usize>>>,
    /// The work offset that they set (G10 L20), if another one than that in force: its coordinates are theirs.
    pub(crate) preset_system: Option<usize>,
    /// The program ends here.
    pub(crate) ends: bool,
    /// M98 or M99.
    pub(crate) calls: Option<Code>,
    /// It stores the place of G28 (0) or G30 (1).
    pub(crate) stores_home: Option<usize>,
    /// Compensating the radius of the tool begins or ends here (G40 to G42.1).
    pub(crate) switches_radius: bool,
    /// X and Y are a distance and an angle from here on, or places again (G16, G15).
    pub(crate) switches_polar: bool,
    /// Its words are machine coordinates (SUPA).
    pub(crate) in_machine: bool,
    /// It says the pole: along which of X and Y relative to where the tool is.
    pub(crate) pole: Option<[bool; 2]>,
    /// A cycle that passes on as it is.
    pub(crate) cycle: Option<Cycle>,
    /// The filament that a printer takes for its motion.
    pub(crate) extrusion: Option<Extrusion>,
}

/// State: everything that a program has set, and where its axes are.
#[derive(Clone, Debug)]
pub(crate) struct Interpreter {
    pub(crate) modal: Modal,
    pub(crate) frame: Frame,
    /// Where the axes of the machine are, mm and deg, and whether that is known.
    pub(crate) position: Axes,
    pub(crate) known: Axes<bool>,
    pub(crate) rests: Rests,
    pub(crate) parameters: Parameters,
    /// The offset of each tool.
    pub(crate) tools: HashMap<u32, Axes>,
    pub(crate) notes: Notes,
    pub(crate) dialect: Dialect,
    /// The control that runs the program, if it is stated.
    pub(crate) control: Option<Control>,
    pub(crate) points: DecimalPoints,
    pub(crate) extruder: Extruder,
    /// The tool that M6 has put into the spindle, and whether the program has an M6.
    pub(crate) in_spindle: Option<u32>,
    pub(crate) changes_tools: bool,
    machine: Arc<Machine>,
    /// With the tool that is in the spindle; `None` on machines whose control has no centre point to move.
    tip: Option<Arc<Tip>>,
}

impl Interpreter {
    /// Before the first line of a program for a machine.
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
        let (position, known) = setup.start();
        let mut modal = setup.modal();
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
            rests: Rests::new(setup),
            parameters: Parameters::default(),
            tools: setup.tools(),
            notes: Notes::default(),
            dialect,
            control: setup.control(),
            points: setup.points(),
            extruder: Extruder::default(),
            in_spindle: None,
            changes_tools: false,
            machine,
            tip,
        })
    }

    /// Where the axes are, in the coordinates of the program.
    pub(crate) fn program_position(&self) -> Axes {
        self.frame.to_program(&self.position)
    }

    /// What lies between program and machine while this is switched on.
    pub(crate) fn frame_of(&self, modal: &Modal) -> Frame {
        modal.frame(self.tip.as_ref())
    }

    /// The coordinates that hold with another work offset.
    pub(crate) fn frame_with(&self, system: usize) -> Frame {
        let mut modal = self.modal.clone();
        modal.system = system;
        self.frame_of(&modal)
    }

    /// Takes up what was switched: from now on coordinates mean what it says.
    pub(crate) fn update_frame(&mut self) {
        self.frame = self.frame_of(&self.modal);
    }

    /// Whether the control is that of a printer.
    pub(crate) fn is_printer(&self) -> bool {
        self.control.is_some_and(Control::is_printer)
    }

    /// Whether the machine has the axis at a place.
    pub(crate) fn machine_has(&self, axis: usize) -> bool {
        name_of(axis).is_some_and(|name| self.machine.index_of(name).is_ok())
    }

    /// Puts the tool of the offset that holds into the spindle.
    pub(crate) fn update_tool(&mut self) -> Result<(), NcError> {
        if self.tip.is_some() {
            let machine = with_tool(&self.machine, &self.modal.tool_offset)?;
            self.tip = Tip::new(&machine).map(Arc::new);
        }
        Ok(())
    }

    /// Coordinates are those of the centre point of the tool from now on, or of the axes.
    pub(crate) fn switch_centre_point(
        &mut self,
        to: CentrePoint,
        given: &Given<'_>,
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

    /// Executes a block that was read; `line` is counted from 1.
    /// What it did goes into `outcome`, which is that of no block.
    pub(crate) fn execute(
        &mut self,
        block: &Block,
        line: usize,
        outcome: &mut Outcome,
    ) -> Result<(), NcError> {
        let mut codes = Codes::of(block, self.control)
            .map_err(|refusal| refused(refusal, block, line, self.control))?;
        match codes.polar() {
            Some(160) => self.modal.polar = Some([None; 2]),
            Some(150) => self.modal.polar = None,
            _ => {}
        }
        let given = Given::new(block, line, self.takes_polar(&codes))?;
        outcome.ends = codes.ends;
        outcome.calls = codes.calls;
        // What is off already is not switched off.
        outcome.switches_radius =
            (codes.radius()).is_some_and(|code| code != 400 || self.modal.radius.is_some());
        outcome.switches_polar = codes.polar().is_some();
        if let Some(code) = codes
            .not_followed
            .filter(|_| self.dialect == Dialect::Rs274)
        {
            let what = format!(
                "M{}, which is not followed: behind it other coordinates may hold",
                code / 10
            );
            return Err(given.refused(&what));
        }
        let dwells_by_axis = self.dwells_by_axis(&codes, &given);
        if codes.not_modal() == Some(40) && given.names_axes() && !dwells_by_axis {
            return Err(given.refused("a dwell (G4) with the word of an axis, which FANUC controls read as its time: write P"));
        }
        if let Some(code) = codes
            .harmless
            .filter(|_| given.names_axes() && codes.motion().is_none())
        {
            let what = format!("{} with the word of an axis", text(code));
            return Err(given.refused(&what));
        }
        self.check_meaning(&codes, &given)?;
        codes.ends_smoothing(given.names_axes());
        self.check_skipped(&codes, &given)?;
        let length =
            (self.modal.centre_point != CentrePoint::Off).then_some(self.modal.tool_offset);
        self.switch(&codes, &given)?;
        let mut uses_words = self.commands(&given, outcome)?;
        codes.in_machine |= outcome.in_machine;
        let is_longer = length.is_some_and(|length| length != self.modal.tool_offset);
        if is_longer && self.modal.centre_point != CentrePoint::Off {
            self.has_other_centre_point();
        }
        uses_words |= self.not_modal(&codes, &given, outcome)? || dwells_by_axis;
        uses_words |= self.leaves_arguments(&codes, &given);
        if !uses_words && codes.calls.is_none() {
            self.motion(&codes, &given, outcome)?;
        } else if let Some(motion) = codes.motion() {
            self.set_motion(motion);
        }
        if self.is_printer() {
            self.extrude(&codes, &given, outcome)?;
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

    /// Whether the words of axes may be the arguments of an M code that is not known: they pass on as they are.
    fn leaves_arguments(&mut self, codes: &Codes, given: &Given<'_>) -> bool {
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
        self.may_have_moved(&each(|axis| is_named(axis) || of_polar(axis)));
        self.notes
            .add(Note::MayMove(format!("M{code}")), given.line);
        true
    }

    /// # Errors
    /// Words that controls read in different ways.
    fn check_meaning(&self, codes: &Codes, given: &Given<'_>) -> Result<(), NcError> {
        if self.dialect != Dialect::Rs274 {
            return Ok(());
        }
        let is_absolute = codes
            .distance()
            .map_or(self.modal.absolute, |code| code == 900);
        if codes.in_machine && !is_absolute {
            return Err(given.refused(
                "G53 in G91, which LinuxCNC refuses and FANUC controls ignore: write G90 before",
            ));
        }
        self.check_incremental_letters(codes, given)?;
        let has_own_h = given.has(b'H') && codes.tool_length().is_none();
        if has_own_h && (codes.polar().is_some() || codes.work_offset().is_some()) {
            return Err(given.refused("H beside G15, G16 or G54 to G59, with which Okuma controls choose a work offset, machine coordinates or the length of a tool: programs of these controls are not followed"));
        }
        if has_own_h && matches!(codes.radius(), Some(410 | 420)) {
            return Err(given.refused("H beside G41 or G42, which older FANUC controls take for the number of the radius of the tool: write D"));
        }
        if has_own_h
            // Of G76 it is the angle of a thread.
            && codes.motion() != Some(760)
            && self.modal.length.is_some()
            && self.modal.length != given.whole(b'H')?
        {
            return Err(given.refused("H without G43 while the length of a tool is in force, which FANUC controls take for another length and LinuxCNC refuses: write G43 before it"));
        }
        for assignment in &given.block.assignments {
            let Parameter::Numbered(number) = assignment.parameter else {
                continue;
            };
            if matches!(number, 5161..=5390 | 5400..=5428) {
                let what = format!(
                    "a value for #{number}, which the control uses for its offsets, homes and places, or sets itself, is not followed: write G10 or the set-up"
                );
                return Err(given.refused(&what));
            }
        }
        Ok(())
    }

    /// The tool is of another length while coordinates are those of its centre point. With the rotary axes off zero controls differ in
    /// what X, Y and Z are then: they are not known until the program names them.
    fn has_other_centre_point(&mut self) {
        let is_off = |axis: usize| {
            self.machine_has(axis) && !(self.known[axis] && self.position[axis] == 0.0)
        };
        if (3..6).any(is_off) {
            self.known[..3].fill(false);
        }
    }

    /// What a block switches, besides its motion.
    fn switch(&mut self, codes: &Codes, given: &Given<'_>) -> Result<(), NcError> {
        let modal = &mut self.modal;
        match codes.feed() {
            Some(930) => modal.feed_mode = FeedMode::InverseTime,
            Some(940) => modal.feed_mode = FeedMode::PerMinute,
            Some(950) => modal.feed_mode = FeedMode::PerRevolution,
            _ => {}
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
        let modal = &mut self.modal;
        match codes.plane() {
            Some(170) => modal.plane = Plane::Xy,
            Some(180) => modal.plane = Plane::Zx,
            Some(190) => modal.plane = Plane::Yz,
            _ => {}
        }
        match codes.units() {
            Some(200) => modal.unit_mm = 25.4,
            Some(210) => modal.unit_mm = 1.0,
            _ => {}
        }
        match codes.diameter() {
            Some(70) => modal.diameter = true,
            Some(80) => modal.diameter = false,
            _ => {}
        }
        match codes.radius() {
            Some(400) => modal.radius = None,
            Some(code) => modal.radius = Some(code),
            None => {}
        }
        match codes.distance() {
            Some(900) => modal.absolute = true,
            Some(910) => modal.absolute = false,
            _ => {}
        }
        match codes.centre() {
            Some(901) => modal.centre_absolute = true,
            Some(911) => modal.centre_absolute = false,
            _ => {}
        }
        match codes.comes_back() {
            Some(980) => (modal.comes_back, modal.says_return) = (true, true),
            Some(990) => (modal.comes_back, modal.says_return) = (false, true),
            _ => {}
        }
        if let Some(code) = codes.tool_length() {
            self.tool_length(code, given)?;
            self.update_tool()?;
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
                "M430 after M428, which switches LinuxCNC to kinematics of its user that are not known here: write M429 before",
            ));
        }
        match codes.centre_point {
            Some(true) => self.switch_centre_point(CentrePoint::Switched, given)?,
            Some(false) => self.modal.centre_point = CentrePoint::Off,
            None => {}
        }
        if let Some(code) = codes.work_offset() {
            self.modal.system = self.system_of(code, codes, given)?;
        }
        match codes.rotation() {
            Some(680) => self.rotation(given)?,
            Some(690) => (self.modal.rotation, self.modal.rotation_is_new) = (None, false),
            _ => {}
        }
        if codes.tool_length().is_some()
            || codes.centre_point.is_some()
            || codes.work_offset().is_some()
            || codes.rotation().is_some()
        {
            self.update_frame();
        }
        Ok(())
    }
}

fn refused(refusal: Refusal, block: &Block, line: usize, control: Option<Control>) -> NcError {
    match refusal {
        Refusal::Fault(fault) => NcError::Block { line, fault },
        Refusal::Unknown(UnknownCode(code)) => match why_refused(code, control) {
            Some(why) => NcError::NotCompensated {
                line,
                what: format!("{} is not followed: {why}", text(code)),
            },
            None => NcError::UnknownCode {
                line,
                code: text(code),
            },
        },
        Refusal::NoCode(place) => match block.words.get(place) {
            Some(word) if word.value.is_none() => NcError::OnlyAtMachine {
                line,
                word: char::from(word.letter),
            },
            word => NcError::NotCompensated {
                line,
                what: format!(
                    "{} with a number that is no code",
                    word.map_or('G', |word| char::from(word.letter))
                ),
            },
        },
    }
}
