//! Correction of a machine at a position, the maximum length of an unsplit straight motion, and the bounds on corrected coordinates.

use std::sync::Arc;

use volcomp_model::{
    Machine, Temperatures, Thermal, Tolerance,
    curve::ErrorCurve,
    evaluator::{CompiledMachine, Evaluation, Neglected, Slides},
    kinematics::{Correctors, Form, State, actual_point_mm},
    vocabulary::{
        AxisKind, AxisName, Component, Coordinate, CorrectionLimit, Direction, Displacement,
        ErrorName, MAX_AXES, TURNED_AFTER, TURNED_AFTER_ROTARY, bounds::LARGEST_CORRECTION,
        is_within,
    },
};

use crate::{
    NcError,
    coordinates::{Axes, AxisPlaces, Frame, each, is_rotary, name_of, with_tool},
    error::BoundViolation,
};

/// Maximum fraction of the tolerance that a one- or two-step correction may neglect; beyond it the
/// exact correction is computed.
const NEGLECTED: f64 = 0.05;

const MAX_TOOLS: usize = 64;

/// Amounts to add to the axes at a position to bring the tool to its nominal position, mm and deg.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Correction {
    pub(crate) delta: Axes,
    /// Motion of the linear axes per deg of A, B and C, mm/deg, that keeps the tip in place; `None` if no rotary axis is corrected.
    pub(crate) follow: Option<[Axes; 3]>,
}

impl Correction {
    /// The correction with the rounded values `rotary` of the rotary axes, which the linear axes compensate.
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
}

/// The correction of a machine. State: the active tool, and the direction from which each axis approaches.
#[derive(Clone, Debug)]
pub struct Corrector {
    pub(crate) machine: Arc<Machine>,
    pub(crate) temperatures: Temperatures,
    /// Machines of all tools used so far; `tool` is the active one.
    tools: Vec<Arc<MachineWithTool>>,
    pub(crate) tool: Arc<MachineWithTool>,
    pub(crate) places: AxisPlaces,
    pub(crate) corrects: Axes<bool>,
    travels: Axes<[f64; 2]>,
    pub(crate) only_linear: bool,
    pub(crate) bidirectional: bool,
    /// Direction of approach of each axis; `None` while unknown: the mean of both directions is then corrected.
    pub(crate) approach: Axes<Option<Direction>>,
    pub(crate) arrives_from_unknown: Axes<bool>,
    pub(crate) has_directions: Axes<bool>,
    pub(crate) play: Arc<Play>,
    /// Reverse travel after which an axis is treated as reversed, mm and deg.
    pub(crate) turned_after: Axes<f64>,
    pub(crate) furthest: Axes<f64>,
    /// End of the last motion that was written with its correction, machine coordinates; NaN before the first one.
    pub(crate) moved_to: Axes,
    pub(crate) split_beyond_mm: f64,
    /// Incremented by every change, except of the position, that affects the correction.
    pub(crate) version: u64,
}

#[derive(Clone, Debug, Default)]
pub(crate) struct CorrectionCache {
    places: [CachedCorrection; 2],
    last: usize,
}

#[derive(Clone, Debug, Default)]
struct CachedCorrection {
    at: Axes,
    /// [`Corrector::version`] for which the entry was computed; `None` while the entry is empty.
    pub(crate) version: Option<u64>,
    correction: Correction,
}

impl CorrectionCache {
    pub(crate) fn at(&mut self, corrector: &Corrector, at: &Axes) -> &Correction {
        let is_it =
            |seen: &CachedCorrection| seen.version == Some(corrector.version) && seen.at == *at;
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

/// Factor on the tolerance that leaves room for rounding.
const ROUNDING_MARGIN: f64 = 1.0 - 1e-9;

const COMPILED_TO_NM: f64 = 1.0;

#[derive(Clone, Debug)]
pub(crate) struct MachineWithTool {
    pub(crate) offset: Axes,
    pub(crate) machine: Machine,
    compiled: CompiledMachine,
    slides: Option<Slides>,
    neglected: Neglected,
    /// Maximum unsplit travel of each axis if it moves alone, mm and deg.
    unsplit: Axes,
    /// Longest lever, mm.
    reach_mm: f64,
    /// Maximum change of the error per mm of travel of a linear axis.
    steepness: f64,
}

impl MachineWithTool {
    pub(crate) fn new(
        machine: &Machine,
        offset: &Axes,
        temperatures: &Temperatures,
        tolerance_mm: f64,
        places: &AxisPlaces,
    ) -> Result<Self, NcError> {
        let machine = with_tool(machine, offset)?;
        let compiled = machine.compile_at(Tolerance::from_nm(COMPILED_TO_NM), temperatures)?;
        let ways = compiled.short_ways(tolerance_mm);
        let unsplit = std::array::from_fn(|axis| match places.of_axis(axis) {
            Some(place) if is_rotary(axis) => ways[place].to_degrees(),
            Some(place) => ways[place],
            None => f64::INFINITY,
        });
        Ok(Self {
            offset: *offset,
            reach_mm: compiled.reach_mm(),
            steepness: compiled.steepness(),
            slides: compiled.slides(),
            neglected: compiled.neglected(),
            machine,
            compiled,
            unsplit,
        })
    }

    /// Correction of a state: one- or two-step if that neglects at most `most_mm`, otherwise exact.
    pub(crate) fn correction(
        &self,
        state: &State,
        places: &AxisPlaces,
        temperatures: &Temperatures,
        most_mm: f64,
    ) -> Correction {
        let Self { machine, compiled, .. } = self;
        if let Some(slides) = &self.slides {
            // The errors are evaluated at the corrected position.
            return Correction {
                delta: places.axes(&slides.two_steps(compiled, state)),
                follow: None,
            };
        }
        let mut parts = compiled.parts_of(state, compiled.correctors());
        let mut delta = parts.delta();
        let mut neglected_mm = self.neglected.mm(&delta);
        if neglected_mm > most_mm {
            // The errors are evaluated at the corrected position.
            let first = delta;
            let mut there = *state;
            for (q, delta) in there.q.iter_mut().zip(&first) {
                *q += delta;
            }
            parts = compiled.parts_of(&there, compiled.correctors());
            delta = parts.delta();
            neglected_mm = self.neglected.there_mm(&first, &delta);
        }
        if neglected_mm > most_mm {
            let options = machine.correction_options();
            delta = machine.correction_at(state, temperatures, &options).delta;
        }
        let rotary = compiled.correctors().rotary();
        let follow = (!rotary.is_empty()).then(|| {
            std::array::from_fn(|rotary| match places.of_axis(3 + rotary) {
                // From mm/rad to mm/deg; only linear axes follow.
                Some(place) => places.linear_axes(&parts.follow[place], 1.0_f64.to_radians()),
                None => [0.0; 9],
            })
        });
        Correction { delta: places.axes(&delta), follow }
    }
}

/// Number of sample points for the backlash along the travel of an axis.
const NODES: u32 = 33;

/// Minimum reverse travel, mm and deg, after which an axis with backlash counts as reversed. A smaller travel may be
/// rounding of words. The resulting error of the carriage is at most this travel.
const LEAST: [f64; 2] = [5e-4, 1e-5];

/// Bidirectional curves of an axis along its own direction, each with its component along the axis.
#[derive(Clone, Debug)]
struct AxialCurves {
    place: usize,
    curves: Vec<(ErrorCurve, f64)>,
    /// mm or deg per unit of the curves.
    scale: f64,
}

/// Backlash of the axes: when a drive reverses, its carriage does not move at first.
///
/// The reversal value has a sign. If the carriage lags, its position is lower after positive than after negative motion. This is lost motion: after a
/// reversal the carriage rests until the backlash is crossed. With the opposite sign the carriage leads, as with overcompensated backlash, and the
/// error has one value for each direction.
#[derive(Clone, Debug, Default)]
pub(crate) struct Play {
    /// `Some` for axes with backlash anywhere in their travel.
    axes: Axes<Option<AxialCurves>>,
    pub(crate) any: bool,
}

impl Play {
    pub(crate) fn of(machine: &Machine, places: &AxisPlaces) -> Self {
        let axes: Axes<Option<AxialCurves>> = std::array::from_fn(|axis| {
            let own = own(machine, axis, places)?;
            let travel = machine.axis(name_of(axis)?)?.travel;
            own.is_anywhere(travel, machine.axes().len()).then_some(own)
        });
        Self { any: axes.iter().any(Option::is_some), axes }
    }

    pub(crate) fn has(&self, axis: usize) -> bool {
        self.axes[axis].is_some()
    }

    /// Lost motion of an axis at these coordinates, in the order of the model's chain, mm or deg; 0 without backlash.
    pub(crate) fn lost_motion(&self, axis: usize, coordinates: &[f64]) -> f64 {
        let own = self.axes[axis].as_ref();
        own.map_or(0.0, |own| own.lost_motion(coordinates))
    }

    /// Reverse travel after which an axis is treated as reversed, mm or deg.
    pub(crate) fn turned_after(&self, axis: usize) -> f64 {
        match (self.has(axis), is_rotary(axis)) {
            (true, rotary) => LEAST[usize::from(rotary)],
            (false, true) => TURNED_AFTER_ROTARY.0,
            (false, false) => TURNED_AFTER.0,
        }
    }
}

impl AxialCurves {
    fn lost_motion(&self, coordinates: &[f64]) -> f64 {
        let along = self.curves.iter().map(|(curve, share)| {
            let value = |of: Direction| curve.value(self.place, coordinates, Some(of));
            share
                * match curve {
                    // The mean of both directions cancels in their difference.
                    ErrorCurve::Reversal { reversal, .. } => -reversal,
                    _ => value(Direction::Negative) - value(Direction::Positive),
                }
        });
        let lost: f64 = along.sum();
        self.scale * lost.max(0.0)
    }

    fn is_anywhere(&self, [low, high]: [f64; 2], axes: usize) -> bool {
        let mut coordinates = vec![0.0; axes];
        (0..NODES).any(|node| {
            coordinates[self.place] = low + (high - low) * f64::from(node) / f64::from(NODES - 1);
            self.lost_motion(&coordinates) > 0.0
        })
    }
}

/// Distance, mm, from an end of travel within which the largest correction may leave the travel.
const NEAR_MM: f64 = LARGEST_CORRECTION.0;

/// Bounds on the coordinates of each axis of the machine.
///
/// State: the first corrected coordinate out of bounds in the current line. Such a line is not written.
#[derive(Clone, Debug)]
pub(crate) struct Bounds {
    limit: CorrectionLimit,
    /// Limit of the displacement of the tool by all axes together, if rotary axes are corrected.
    at_tool: Option<CorrectionLimit>,
    axes: Axes<Option<AxisName>>,
    /// Travel, mm and deg; infinite for an axis without limits.
    travels: Axes<[f64; 2]>,
    pub(crate) violated: Option<BoundViolation>,
}

impl Bounds {
    pub(crate) fn new(corrector: &Corrector, limit: CorrectionLimit) -> Self {
        let machine = &corrector.machine;
        let axis = |axis: usize| name_of(axis).and_then(|name| machine.axis(name));
        // Near a singular pose a small error of the tool axis turns a rotary axis far, and the linear axes follow it. Therefore the
        // displacement of the tool is limited instead.
        let rotary_corrects = (0..9).any(|axis| is_rotary(axis) && corrector.corrects[axis]);
        Self {
            limit: if rotary_corrects { CorrectionLimit::LARGEST } else { limit },
            at_tool: rotary_corrects.then_some(limit),
            axes: each(|of| axis(of).map(|axis| axis.name)),
            travels: each(|of| match axis(of) {
                Some(axis) if axis.has_ends() => axis.travel,
                _ => [f64::NEG_INFINITY, f64::INFINITY],
            }),
            violated: None,
        }
    }

    /// Violation of a bound by the correction `by`, mm and deg; travels are checked only for `known` axes.
    pub(crate) fn violation(
        &self,
        known: &Axes<bool>,
        at: &Axes,
        by: &Axes,
    ) -> Option<BoundViolation> {
        for (axis, name) in self.axes.iter().enumerate() {
            let (Some(name), true) = (*name, by[axis] != 0.0) else {
                continue;
            };
            let coordinate = |at: f64| Displacement::from_coordinate(name.kind(), at);
            let correction = coordinate(by[axis]);
            if !self.limit.allows(correction) {
                return Some(BoundViolation::BeyondLimit {
                    axis: name,
                    found: correction,
                    limit: self.limit.of(name.kind()),
                });
            }
            let (travel, from, to) = (self.travels[axis], at[axis], at[axis] + by[axis]);
            if known[axis] && is_within(travel, from) && !is_within(travel, to) {
                return Some(BoundViolation::LeavesTravel {
                    axis: name,
                    from: Coordinate(coordinate(from)),
                    to: Coordinate(coordinate(to)),
                    travel: travel.map(|end| Coordinate(coordinate(end))),
                });
            }
        }
        None
    }

    /// Violation of the bound on the displacement of the tool. `most_mm` is an upper bound of the displacement;
    /// `moves_mm`, the exact value, is computed only if the upper bound exceeds the limit.
    pub(crate) fn violation_at_tool(
        &self,
        most_mm: impl FnOnce() -> f64,
        moves_mm: impl FnOnce() -> f64,
    ) -> Option<BoundViolation> {
        let limit = self.at_tool?;
        if limit.allows(Displacement::from_coordinate(AxisKind::Linear, most_mm())) {
            return None;
        }
        let found = Displacement::from_coordinate(AxisKind::Linear, moves_mm());
        (!limit.allows(found))
            .then(|| BoundViolation::ToolBeyondLimit { found, limit: limit.of(AxisKind::Linear) })
    }

    /// True if a linear axis is so close to an end of travel that a permitted correction may leave the travel; false
    /// for a rotary axis.
    pub(crate) fn is_near_end(&self, axis: usize, at: f64) -> bool {
        let near = |end: &f64| (at - end).abs() <= NEAR_MM;
        !is_rotary(axis) && self.travels[axis].iter().any(near)
    }
}

impl Corrector {
    /// A corrector for a machine at these temperatures. Straight motions are split where interpolating the correction between their ends
    /// would deviate by more than `tolerance_mm`.
    ///
    /// # Errors
    /// The curves of the machine cannot be compiled.
    pub fn new(
        machine: &Machine,
        temperatures: &Temperatures,
        tolerance_mm: f64,
    ) -> Result<Self, NcError> {
        let places = AxisPlaces::of(machine);
        let tool = MachineWithTool::new(machine, &[0.0; 9], temperatures, tolerance_mm, &places)?;
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
        let has_directions = std::array::from_fn(|axis| {
            name_of(axis).is_some_and(|name| machine.has_directions(name))
        });
        Ok(Self {
            machine: Arc::new(machine.clone()),
            temperatures: temperatures.clone(),
            tools: vec![Arc::clone(&tool)],
            tool,
            only_linear: joints.iter().all(|joint| joint.kind == AxisKind::Linear),
            bidirectional: has_directions.contains(&true),
            places,
            corrects,
            travels,
            approach: [None; MAX_AXES],
            arrives_from_unknown: [false; MAX_AXES],
            has_directions,
            turned_after: std::array::from_fn(|axis| play.turned_after(axis)),
            play: Arc::new(play),
            furthest: [0.0; MAX_AXES],
            moved_to: [f64::NAN; MAX_AXES],
            split_beyond_mm: tolerance_mm,
            version: 0,
        })
    }

    /// A corrector for `machine` without its errors, which corrects nothing.
    pub(crate) fn without_errors(
        machine: &Machine,
        temperatures: &Temperatures,
    ) -> Result<Self, NcError> {
        let mut ideal = machine.clone();
        ideal.clear_errors();
        ideal.set_thermal(Thermal::default())?;
        Ok(Self { corrects: [false; MAX_AXES], ..Self::new(&ideal, temperatures, 1.0)? })
    }

    /// Activates the tool with this tool offset; returns true if the tool changed.
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
        self.tool = Arc::new(MachineWithTool::new(
            machine,
            offset,
            temperatures,
            tolerance_mm,
            &self.places,
        )?);
        if self.tools.len() < MAX_TOOLS {
            self.tools.push(Arc::clone(&self.tool));
        }
        Ok(true)
    }

    #[inline]
    pub(crate) fn has(&self, axis: usize) -> bool {
        self.places.of_axis(axis).is_some()
    }

    #[inline]
    pub(crate) fn axes(&self) -> impl Iterator<Item = usize> {
        self.places.axes_of_machine()
    }

    #[inline]
    pub(crate) fn is_within_travel(&self, axis: usize, at: f64) -> bool {
        let [low, high] = self.travels[axis];
        let rounding = 1e-9 * (1.0 + at.abs());
        (low - rounding..=high + rounding).contains(&at) || self.goes_round_to(axis, at)
    }

    /// True if the coordinate `at` of an axis with `modulo`, reduced by whole periods, is within the travel.
    fn goes_round_to(&self, axis: usize, at: f64) -> bool {
        let axis = name_of(axis).and_then(|name| self.machine.axis(name));
        axis.is_some_and(|axis| axis.modulo.is_some() && axis.may_stand_at(at))
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

    /// Lost motion of each axis at these coordinates, mm or deg.
    pub(crate) fn lost_motion(&self, at: &Axes) -> Axes {
        if !self.play.any {
            return [0.0; MAX_AXES];
        }
        let machine = &self.tool.machine;
        let coordinates = machine.curve_coordinates(&self.places.state(at));
        let coordinates = &coordinates[..machine.axes().len()];
        std::array::from_fn(|axis| self.play.lost_motion(axis, coordinates))
    }

    /// State of the model with the drives at `at` and the carriages displaced by `off`, mm or deg.
    fn carried(&self, at: &Axes, off: &Axes) -> State {
        if !self.play.any {
            return self.state(at);
        }
        let lost = self.lost_motion(at);
        let (mut there, mut approach) = (*at, self.approach);
        for axis in (0..MAX_AXES).filter(|axis| lost[*axis] > 0.0) {
            // Evaluate the curves of the flank nearer to the carriage; the remaining distance counts as travel of the
            // axis.
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

    /// Correction at these axis coordinates (mm, deg).
    pub(crate) fn at(&self, at: &Axes) -> Correction {
        if !self.corrects.contains(&true) {
            return Correction::default();
        }
        let state = self.state(at);
        let most_mm = NEGLECTED * self.split_beyond_mm;
        self.tool.correction(&state, &self.places, &self.temperatures, most_mm)
    }

    /// Error of the machine at the zero of a work offset, in the coordinates of that offset: the amounts to add to its X, Y and Z, mm, for
    /// axes that are corrected. Rotary axes are not corrected; mean of both directions of approach.
    pub(crate) fn off_at_zero_mm(&self, of_offset: &Frame) -> [f64; 3] {
        let MachineWithTool { compiled, machine, .. } = &*self.tool;
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

    /// Offsets of X, Y and Z (corrected axes only) against a tip error in workpiece axes, and the part of the error that they correct, in
    /// workpiece axes; mm. `None` for a machine with rotary axes, where they depend on the position.
    pub(crate) fn offsets_against_mm(&self, error_mm: [f64; 3]) -> Option<[[f64; 3]; 2]> {
        let slides = self.tool.slides.as_ref()?;
        let error = Evaluation { position_mm: error_mm, ..Evaluation::default() };
        let [x, y, z, ..] = self.places.axes(&slides.delta(&error));
        let mut by = [0.0; MAX_AXES];
        by[..3].copy_from_slice(&[x, y, z]);
        let [from, to] = [&[0.0; MAX_AXES], &by].map(|at| self.ideal_tip_mm(at));
        Some([[x, y, z], std::array::from_fn(|i| from[i] - to[i])])
    }

    /// Tip error at a position by the exact model, mean of both directions of approach; mm in workpiece axes.
    pub(crate) fn tip_error_mm(&self, at: &Axes) -> [f64; 3] {
        let state = self.places.state(at);
        let machine = &self.tool.machine;
        let error = machine.error_at(&state, Form::Exact, &self.temperatures);
        error.position_mm.into()
    }

    /// Tip position of the ideal machine, mm from the workpiece origin in workpiece axes.
    pub(crate) fn ideal_tip_mm(&self, at: &Axes) -> [f64; 3] {
        let chain = self.tool.machine.chain();
        chain.ideal_tip_mm(&self.places.state(at)).into()
    }

    /// Upper bound of the displacement of the tip by this correction, mm, computed without the pose; infinite outside
    /// the travels of the linear axes.
    pub(crate) fn moves_at_most_mm(&self, at: &Axes, by: &Axes) -> f64 {
        let mut most_mm = 0.0;
        for axis in self.axes() {
            let [low, high] = self.travels[axis];
            most_mm += match by[axis].abs() {
                by if is_rotary(axis) => by.to_radians() * self.tool.reach_mm,
                by if (low..=high).contains(&at[axis]) => by,
                _ => f64::INFINITY,
            };
        }
        // The correction may leave the travels, by far less than a thousandth of the reach.
        1.001 * most_mm
    }

    /// Position of the point `above_mm` above the tip along the tool axis, in the exact form with the compiled curves; mm from the workpiece
    /// origin in workpiece axes.
    pub(crate) fn on_tool_mm(&self, at: &Axes, off: &Axes, above_mm: f64) -> [f64; 3] {
        let chain = self.tool.machine.chain();
        let point = chain.tool_tip_mm() + chain.tool_axis() * above_mm;
        let state = self.carried(at, off);
        let actual = actual_point_mm(chain, &self.tool.compiled, &state, &point);
        (actual - chain.workpiece_origin_mm()).into()
    }

    /// Position of the point `above_mm` above the tip along the tool axis, on the ideal machine; mm from the workpiece
    /// origin in workpiece axes.
    pub(crate) fn ideal_on_tool_mm(&self, at: &Axes, above_mm: f64) -> [f64; 3] {
        let chain = self.tool.machine.chain();
        let point = chain.tool_tip_mm() + chain.tool_axis() * above_mm;
        let pose = chain.ideal_pose(&self.places.state(at));
        (pose.transform_point(&point) - chain.workpiece_origin_mm()).into()
    }

    /// Tip position with the errors, in the exact form with the compiled curves, mm from the workpiece origin in workpiece axes.
    pub(crate) fn actual_tip_mm(&self, at: &Axes, off: &Axes) -> [f64; 3] {
        self.on_tool_mm(at, off, 0.0)
    }

    /// True if a straight motion in a frame may be written as one line. `ends` are machine coordinates, `in_program` program coordinates.
    #[inline]
    pub(crate) fn is_straight_in(
        &self,
        frame: &Frame,
        seen: &mut CorrectionCache,
        [from, to]: [&Axes; 2],
        in_program: [&Axes; 2],
    ) -> bool {
        let bulge_mm = self.bulge_in_frame_mm(frame, in_program[0], in_program[1]);
        // With tool centre point control, rotary corrections do not move the tip.
        let coupled_mm = if frame.tip.is_some() { 0.0 } else { self.coupled_mm(seen, from, to) };
        self.is_straight(from, to, bulge_mm, coupled_mm)
    }

    /// True if the correction between two positions deviates from linear interpolation between its ends by no more than the tolerance, by
    /// the derivatives of the curves. `bulge_mm` is the maximum deviation of the axes from the straight motion, `coupled_mm` the
    /// contribution of rotary corrections ([`coupled_mm`](Self::coupled_mm)).
    fn is_straight(&self, from: &Axes, to: &Axes, bulge_mm: f64, coupled_mm: f64) -> bool {
        let mut share = 0.0;
        for axis in self.places.axes_of_machine() {
            let way = (to[axis] - from[axis]).abs();
            if way > 0.0 {
                share += way / self.tool.unsplit[axis];
            }
        }
        let off_mm = bulge_mm * self.tool.steepness + coupled_mm;
        if share <= 1.0 {
            // For fractions up to 1 the bound grows at most linearly: if this cheap bound is within the tolerance, so
            // is the tighter one.
            let is_near =
                share * self.split_beyond_mm + off_mm <= ROUNDING_MARGIN * self.split_beyond_mm;
            if is_near || bulge_mm == 0.0 && coupled_mm == 0.0 {
                return true;
            }
        }
        self.bound_mm(from, to, bulge_mm) + coupled_mm <= self.split_beyond_mm
    }

    /// Upper bound (mm) on the distance between the correction along the motion and the linear interpolation between its ends.
    pub(crate) fn bound_mm(&self, from: &Axes, to: &Axes, bulge_mm: f64) -> f64 {
        let [from, to] = [from, to].map(|at| self.state(at));
        self.tool.compiled.chord_bound_mm(&from, &to) + bulge_mm * self.tool.steepness
    }

    /// Upper bound (mm) on the tip deviation by rotary corrections that change along the motion, while the linear axes follow them exactly
    /// only at both ends: the product of two changes, plus the curvature of the levers. Near a singular pose rotary corrections are many
    /// times the errors.
    fn coupled_mm(&self, seen: &mut CorrectionCache, from: &Axes, to: &Axes) -> f64 {
        if self.tool.compiled.correctors().rotary().is_empty() {
            return 0.0;
        }
        let reach_mm = self.tool.reach_mm;
        let way_mm: f64 = (0..9)
            .filter(|axis| !is_rotary(*axis) && self.has(*axis))
            .map(|axis| (to[axis] - from[axis]).abs())
            .sum();
        let rotary = (3..6).filter(|axis| self.has(*axis));
        let turned: f64 =
            rotary.clone().map(|axis| (to[axis] - from[axis]).abs().to_radians()).sum();
        let [before, after] = [from, to].map(|at| seen.at(self, at).delta);
        let (mut change, mut largest) = (0.0, 0.0);
        for axis in rotary {
            change += (after[axis] - before[axis]).abs().to_radians();
            largest += before[axis].abs().max(after[axis].abs()).to_radians();
        }
        let lever_change = way_mm + turned * reach_mm;
        let lever_bend = turned * (2.0 * way_mm + turned * reach_mm);
        0.25 * lever_change * change + 0.125 * lever_bend * largest
    }

    /// Maximum deviation of the linear axes from a straight path while the tool centre point moves
    /// in a straight line between two program positions, mm.
    #[inline]
    pub(crate) fn bulge_in_frame_mm(&self, frame: &Frame, from: &Axes, to: &Axes) -> f64 {
        let Some(tip) = &frame.tip else {
            return 0.0;
        };
        let turned = tip.tip.turned(from, to);
        let way: f64 = (0..3).map(|axis| (to[axis] - from[axis]).powi(2)).sum();
        self.bulge_mm(turned, way.sqrt())
    }

    /// Maximum deviation of the linear axes from a straight path, mm, while the tool centre point
    /// moves in a straight line and the rotary axes turn by `turned` rad. It follows from the
    /// second derivative of a turning lever.
    pub(crate) fn bulge_mm(&self, turned: f64, way_mm: f64) -> f64 {
        let reach_mm = self.tool.reach_mm;
        0.125 * turned * (turned * reach_mm + 2.0 * way_mm)
    }
}

/// Bidirectional curves of an axis along its own direction.
fn own(machine: &Machine, axis: usize, places: &AxisPlaces) -> Option<AxialCurves> {
    const LINEAR: [Component; 3] = [Component::EX, Component::EY, Component::EZ];
    const ANGULAR: [Component; 3] = [Component::EA, Component::EB, Component::EC];
    let (name, place) = (name_of(axis)?, places.of_axis(axis)?);
    let direction = machine.chain().joints()[place].direction;
    let components = if is_rotary(axis) { ANGULAR } else { LINEAR };
    let curves = components.into_iter().zip(direction.iter());
    let curves = curves.filter_map(|(component, share)| {
        let curve = machine.error(ErrorName::motion(component, name))?;
        let counts = *share != 0.0 && curve.has_directions();
        counts.then(|| (curve.clone(), *share))
    });
    let curves: Vec<_> = curves.collect();
    (!curves.is_empty()).then_some(AxialCurves {
        place,
        curves,
        scale: if is_rotary(axis) { 1e-6_f64.to_degrees() } else { 1e-3 },
    })
}

#[cfg(test)]
mod tests {
    use rand::{RngExt as _, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    use super::*;

    const MACHINE: &str = "name = \"m\"\nstructure = \"w C' X' b Y Z t\"\naxes.X.travel = [0, 600]\naxes.Y.travel = [0, 400]\naxes.Z.travel = [-500, 0]\naxes.C.travel = [-100, 100]\n[tool]\ngauge = [0, 0, 0]\nlength = 100\n[errors]\nEXX = { mls = { nodes = [[0, 0], [150, 3.2], [300, 7.1], [450, -2], [600, 4]], order = 2, support = 0.8 } }\nECY = { mean = { mls = { nodes = [[0, 0], [100, 8], [200, -5], [300, 2], [400, 9]], order = 1, support = 0.6 } }, reversal = 3 }\nEYZ = { table = [[-500, 9], [-120, 2], [0, 0]], interpolation = \"linear\" }\nEAC = { poly = [0.0, 0.3, 0.002] }\nEB0Z = 40\n";

    /// The virtual machine against the exact model, also outside the travels: four curves off by 1 nm or nrad, at levers of up to 1 m.
    #[test]
    fn tabulated_curves_are_within_a_few_nanometres() {
        let machine = Machine::parse(MACHINE, "m.toml").expect("a good machine");
        let none = Temperatures::new();
        let mut corrector = Corrector::new(&machine, &none, 0.001).expect("compiles");
        let mut draw = ChaCha8Rng::seed_from_u64(3);
        for side in [None, Some(Direction::Positive), Some(Direction::Negative)] {
            corrector.approach = [side; MAX_AXES];
            for _ in 0..500 {
                let mut at = [0.0; MAX_AXES];
                at[0] = draw.random_range(-20.0..620.0);
                at[1] = draw.random_range(-20.0..420.0);
                at[2] = draw.random_range(-520.0..20.0);
                at[5] = draw.random_range(-105.0..105.0);
                let state = corrector.state(&at);
                let error = machine.error_at(&state, Form::Exact, &none).position_mm;
                let (found, ideal) =
                    (corrector.actual_tip_mm(&at, &[0.0; 9]), corrector.ideal_tip_mm(&at));
                for i in 0..3 {
                    let off_nm = 1e6 * (found[i] - ideal[i] - error[i]);
                    assert!(off_nm.abs() < 8.0, "{off_nm} nm at {at:?}");
                }
            }
        }
    }
}
