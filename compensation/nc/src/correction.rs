//! The correction of a machine at a place, and how far a straight way may go before it must be split.

use std::sync::Arc;

use volcomp_model::{
    Machine, Temperatures,
    curve::ErrorCurve,
    evaluator::Evaluation,
    kinematics::{Correctors, Form, State, actual_pose},
    vocabulary::{AxisKind, AxisName, Direction, MAX_AXES},
};

use crate::{
    NcError,
    coordinates::{Axes, AxisPlaces, Frame, name_of},
    play::Play,
    tooled::Tooled,
};

/// What a correction of one step or two may neglect, as a part of the tolerance; beyond it the exact one is taken.
const NEGLECTED: f64 = 0.05;
/// Tools whose machines are kept.
const MOST_TOOLS: usize = 64;

/// What is to be added to the axes at a place so that the tool is where it belongs, mm and deg.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Correction {
    pub(crate) delta: Axes,
    /// How the linear axes follow each of A, B and C, mm for each deg, so that the tip stays where it is. `None`: no
    /// rotary axis corrects.
    pub(crate) follow: Option<[Axes; 3]>,
}

impl Correction {
    /// The same where the rotary axes take other shares than theirs: rounded ones.
    pub(crate) fn with_rotary(&self, rotary: &Axes) -> Axes {
        let mut delta = self.delta;
        let Some(follow) = &self.follow else {
            return delta;
        };
        for (axis, row) in (3..6).zip(follow) {
            let more = rotary[axis] - self.delta[axis];
            delta[axis] = rotary[axis];
            for (delta, follow) in delta.iter_mut().zip(row) {
                *delta += follow * more;
            }
        }
        delta
    }

    /// Whether rotary axes have a part in it.
    pub(crate) fn is_coupled(&self) -> bool {
        self.follow.is_some()
    }
}

/// The correction of a machine. State: the tool in the spindle, and from which side each axis comes.
#[derive(Clone, Debug)]
pub struct Corrector {
    machine: Arc<Machine>,
    temperatures: Temperatures,
    /// With each tool that was in the spindle, and which of them is.
    tools: Vec<Arc<Tooled>>,
    pub(crate) tool: Arc<Tooled>,
    pub(crate) places: AxisPlaces,
    pub(crate) corrects: Axes<bool>,
    travels: Axes<[f64; 2]>,
    only_linear: bool,
    pub(crate) bidirectional: bool,
    pub(crate) approach: Axes<Option<Direction>>,
    pub(crate) play: Arc<Play>,
    /// Travel against its direction after which each axis counts as turned, mm and deg.
    pub(crate) turned_after: Axes<f64>,
    /// The furthest place of each axis in its direction.
    pub(crate) furthest: Axes<f64>,
    pub(crate) split_beyond_mm: f64,
    /// Changes with all that the correction of a place depends on besides the place.
    pub(crate) version: u64,
}

/// The corrections of the last two places. State.
#[derive(Clone, Debug, Default)]
pub(crate) struct Seen {
    places: [SeenAt; 2],
    last: usize,
}

/// The correction at one place.
#[derive(Clone, Debug, Default)]
struct SeenAt {
    at: Axes,
    /// Of the corrector; `None`: it was nowhere yet.
    pub(crate) version: Option<u64>,
    correction: Correction,
}

impl Seen {
    /// The correction at these coordinates.
    pub(crate) fn at(&mut self, corrector: &Corrector, at: &Axes) -> &Correction {
        let is_it = |seen: &SeenAt| seen.version == Some(corrector.version) && seen.at == *at;
        if !is_it(&self.places[self.last]) {
            self.last = 1 - self.last;
            if !is_it(&self.places[self.last]) {
                let place = &mut self.places[self.last];
                place.at = *at;
                place.version = Some(corrector.version);
                place.correction = corrector.at(at);
            }
        }
        &self.places[self.last].correction
    }
}

impl Corrector {
    /// For a machine at these temperatures. Straight lines are split where the correction would be further than
    /// `tolerance_mm` from where it belongs.
    ///
    /// # Errors
    /// A machine whose curves cannot be compiled.
    pub fn new(
        machine: &Machine,
        temperatures: &Temperatures,
        tolerance_mm: f64,
    ) -> Result<Self, NcError> {
        let places = AxisPlaces::of(machine);
        let tool = Tooled::new(machine, &[0.0; 9], temperatures, tolerance_mm, &places)?;
        let correctors = tool.compiled.correctors();
        let mut corrects = [false; MAX_AXES];
        let mut travels = [[f64::NEG_INFINITY, f64::INFINITY]; MAX_AXES];
        for axis in 0..MAX_AXES {
            if let Some(place) = places.of_axis(axis) {
                corrects[axis] =
                    correctors.linear().contains(&place) || correctors.rotary().contains(&place);
            }
            if let Some(axis_of_machine) = name_of(axis).and_then(|name| machine.axis(name)) {
                travels[axis] = axis_of_machine.travel;
            }
        }
        let joints = machine.chain().joints();
        let tool = Arc::new(tool);
        let play = Play::of(machine, &places);
        Ok(Self {
            machine: Arc::new(machine.clone()),
            temperatures: temperatures.clone(),
            tools: vec![Arc::clone(&tool)],
            tool,
            only_linear: joints.iter().all(|joint| joint.kind == AxisKind::Linear),
            bidirectional: machine
                .errors()
                .any(|(_, curve)| !matches!(curve, ErrorCurve::Single(_))),
            places,
            corrects,
            travels,
            approach: [None; MAX_AXES],
            turned_after: std::array::from_fn(|axis| play.turned_after(axis)),
            play: Arc::new(play),
            furthest: [0.0; MAX_AXES],
            split_beyond_mm: tolerance_mm,
            version: 0,
        })
    }

    /// The machine with the tool of its file.
    pub(crate) fn machine(&self) -> &Arc<Machine> {
        &self.machine
    }

    /// From now on the tool is in the spindle for which the control adds this offset. Whether it is another one than before.
    pub(crate) fn take_tool(&mut self, offset: &Axes) -> Result<bool, NcError> {
        if self.tool.offset == *offset {
            return Ok(false);
        }
        self.version += 1;
        if let Some(tool) = self.tools.iter().find(|tool| tool.offset == *offset) {
            self.tool = Arc::clone(tool);
            return Ok(true);
        }
        let (machine, temperatures) = (&self.machine, &self.temperatures);
        let tolerance_mm = self.split_beyond_mm;
        self.tool = Arc::new(Tooled::new(
            machine,
            offset,
            temperatures,
            tolerance_mm,
            &self.places,
        )?);
        if self.tools.len() < MOST_TOOLS {
            self.tools.push(Arc::clone(&self.tool));
        }
        Ok(true)
    }

    /// Whether the machine has the axis at a place, and corrects by it.
    #[inline]
    pub(crate) fn has(&self, axis: usize) -> bool {
        self.places.of_axis(axis).is_some()
    }

    /// The axes that the machine has.
    #[inline]
    pub(crate) fn axes(&self) -> impl Iterator<Item = usize> {
        self.places.axes_of_machine()
    }

    /// The temperatures that hold.
    pub(crate) fn temperatures(&self) -> &Temperatures {
        &self.temperatures
    }

    /// No axis is a rotary one.
    pub(crate) fn is_only_linear(&self) -> bool {
        self.only_linear
    }

    #[inline]
    pub(crate) fn corrects(&self, axis: usize) -> bool {
        self.corrects[axis]
    }

    pub(crate) fn is_bidirectional(&self) -> bool {
        self.bidirectional
    }

    #[inline]
    pub(crate) fn is_within_travel(&self, axis: usize, at: f64) -> bool {
        let [low, high] = self.travels[axis];
        let rounding = 1e-9 * (1.0 + at.abs());
        (low - rounding..=high + rounding).contains(&at) || self.goes_round_to(axis, at)
    }

    /// Whether an axis stands in its travel after whole periods of its `modulo`.
    fn goes_round_to(&self, axis: usize, at: f64) -> bool {
        let axis = name_of(axis).and_then(|name| self.machine.axis(name));
        axis.is_some_and(|axis| axis.modulo.is_some() && axis.may_stand_at(at))
    }

    /// How far a line may be from where it belongs before it is split, mm.
    pub(crate) fn split_beyond_mm(&self) -> f64 {
        self.split_beyond_mm
    }

    pub(crate) fn state(&self, at: &Axes) -> State {
        let mut state = self.places.state(at);
        if !self.bidirectional {
            return state;
        }
        for (axis, approach) in self.approach.iter().enumerate() {
            if let Some(place) = self.places.of_axis(axis) {
                state.approach[place] = *approach;
            }
        }
        state
    }

    /// Whether the carriage of any axis lags.
    pub(crate) fn has_play(&self) -> bool {
        self.play.any
    }

    /// How far the carriage of each axis lags at these coordinates from one direction to the other, mm or deg.
    pub(crate) fn lost(&self, at: &Axes) -> Axes {
        if !self.play.any {
            return [0.0; MAX_AXES];
        }
        let machine = &self.tool.machine;
        let coordinates = machine.curve_coordinates(&self.places.state(at));
        let coordinates = &coordinates[..machine.axes().len()];
        std::array::from_fn(|axis| self.play.lost(axis, coordinates))
    }

    /// The state of the model with the drives at a place and the carriages so far off them, mm or deg.
    fn carried(&self, at: &Axes, off: &Axes) -> State {
        if !self.play.any {
            return self.state(at);
        }
        let lost = self.lost(at);
        let (mut there, mut approach) = (*at, self.approach);
        for axis in (0..MAX_AXES).filter(|axis| lost[*axis] > 0.0) {
            // The flank that is nearer: its curves hold, and what is missing to it is a way of the axis.
            let off = off[axis];
            (approach[axis], there[axis]) = match off {
                0.0 => (None, at[axis]),
                _ if off < 0.0 => (Some(Direction::Positive), at[axis] + off + 0.5 * lost[axis]),
                _ => (Some(Direction::Negative), at[axis] + off - 0.5 * lost[axis]),
            };
        }
        let mut state = self.places.state(&there);
        for (axis, approach) in approach.into_iter().enumerate() {
            if let Some(place) = self.places.of_axis(axis) {
                state.approach[place] = approach;
            }
        }
        state
    }

    /// Travel against its direction after which an axis counts as turned, mm or deg.
    pub(crate) fn turned_after(&self, axis: usize) -> f64 {
        self.turned_after[axis]
    }

    /// The correction at these coordinates of the axes (mm, deg).
    pub(crate) fn at(&self, at: &Axes) -> Correction {
        let state = self.state(at);
        let most_mm = NEGLECTED * self.split_beyond_mm;
        self.tool
            .correction(&state, &self.places, &self.temperatures, most_mm)
    }

    /// Error of the machine at the zero of a work offset, in the coordinates of that offset: the sum to add to its X, Y and Z, mm, as far as they
    /// correct. Rotary axes are not corrected; mean of both directions of approach.
    pub(crate) fn off_at_zero_mm(&self, of_offset: &Frame) -> [f64; 3] {
        let Tooled {
            compiled, machine, ..
        } = &*self.tool;
        let zero = of_offset.to_machine(&[0.0; MAX_AXES]);
        let mut linear = [AxisName::X, AxisName::Y, AxisName::Z].to_vec();
        linear.retain(|name| {
            let place = machine.index_of(*name);
            place.is_ok_and(|place| compiled.correctors().contains(place))
        });
        let linear = Correctors::choose(machine.chain(), &linear);
        let parts = compiled.parts_of(&self.places.state(&zero), &linear);
        let off = self.places.linear_axes(&parts.delta(), -1.0);
        let [x, y, z, ..] = of_offset.moved_in_program(&zero, &off);
        [x, y, z]
    }

    /// Offsets of X, Y and Z, as far as they correct, against an error of the tip in workpiece axes; and the part of the error that they correct, in
    /// workpiece axes; mm. `None` for a machine with rotary axes, where they depend on the position.
    pub(crate) fn offsets_against_mm(&self, error_mm: [f64; 3]) -> Option<[[f64; 3]; 2]> {
        let slides = self.tool.slides()?;
        let error = Evaluation {
            position_mm: error_mm,
            ..Evaluation::default()
        };
        let [x, y, z, ..] = self.places.axes(&slides.delta(&error));
        let mut by = [0.0; MAX_AXES];
        by[..3].copy_from_slice(&[x, y, z]);
        let [from, to] = [&[0.0; MAX_AXES], &by].map(|at| self.ideal_tip_mm(at));
        Some([[x, y, z], std::array::from_fn(|i| from[i] - to[i])])
    }

    /// The error of the tip at a place in the mean of both directions of approach, by the exact model; mm in workpiece axes.
    pub(crate) fn tip_error_mm(&self, at: &Axes) -> [f64; 3] {
        let state = self.places.state(at);
        let machine = &self.tool.machine;
        let error = machine.error_at(&state, Form::Exact, &self.temperatures);
        error.position_mm.into()
    }

    /// Where the tip of the ideal machine is, mm from the workpiece origin in workpiece axes.
    pub(crate) fn ideal_tip_mm(&self, at: &Axes) -> [f64; 3] {
        let chain = self.tool.machine.chain();
        chain.ideal_tip_mm(&self.places.state(at)).into()
    }

    /// Where a point of the tool is, `above_mm` above its tip along its axis, by the exact model; mm from the workpiece origin in
    /// workpiece axes.
    pub(crate) fn on_tool_mm(&self, at: &Axes, off: &Axes, above_mm: f64) -> [f64; 3] {
        let chain = self.tool.machine.chain();
        let point = chain.tool_tip_mm() + chain.tool_axis() * above_mm;
        let source = self.tool.machine.source(&self.temperatures);
        let pose = actual_pose(chain, &source, &self.carried(at, off));
        (pose.transform_point(&point) - chain.workpiece_origin_mm()).into()
    }

    /// Where it is on the ideal machine.
    pub(crate) fn ideal_on_tool_mm(&self, at: &Axes, above_mm: f64) -> [f64; 3] {
        let chain = self.tool.machine.chain();
        let point = chain.tool_tip_mm() + chain.tool_axis() * above_mm;
        let pose = chain.ideal_pose(&self.places.state(at));
        (pose.transform_point(&point) - chain.workpiece_origin_mm()).into()
    }

    /// Where the tip is with the errors, by the exact model, mm from the workpiece origin in workpiece axes.
    pub(crate) fn actual_tip_mm(&self, at: &Axes, off: &Axes) -> [f64; 3] {
        let (machine, temperatures) = (&self.tool.machine, &self.temperatures);
        let state = self.carried(at, off);
        let error = machine.error_at(&state, Form::Exact, temperatures);
        (machine.chain().ideal_tip_mm(&state) + error.position_mm).into()
    }
}
