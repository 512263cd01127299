//! The correction of a machine at a place, and how far a straight way may go before it must be split.

use std::sync::Arc;

use volcomp_model::{
    Machine, Temperatures, Tolerance,
    curve::ErrorCurve,
    evaluator::CompiledMachine,
    kinematics::{Form, State, actual_pose},
    vocabulary::{AxisKind, Direction, MAX_AXES},
};

use crate::{
    NcError,
    carriage::Carriages,
    coordinates::{Axes, AxisPlaces, is_rotary, name_of},
    play::Play,
    tip::with_tool,
    turns::{Turn, side_of},
};

/// Curves are compiled to 1 nm.
const COMPILED_TO_NM: f64 = 1.0;
/// What a correction of one step or two may neglect, as a part of the tolerance; beyond it the exact one is taken.
const NEGLECTED: f64 = 0.05;
/// Tools whose machines are kept.
const MOST_TOOLS: usize = 64;

/// The machine with a tool in its spindle.
#[derive(Clone, Debug)]
struct Tooled {
    /// What the control adds to the coordinates for the tool.
    offset: Axes,
    machine: Machine,
    compiled: CompiledMachine,
    /// Ways of each axis, mm and deg, with which no straight line has to be split, where the axis moves alone.
    unsplit: Axes,
    /// The longest lever, mm, and the most by which the error changes for each mm of the linear axes.
    reach_mm: f64,
    steepness: f64,
}

/// What is to be added to the axes at a place so that the tool is where it belongs, mm and deg.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Correction {
    pub(crate) delta: Axes,
    /// How the linear axes follow each of A, B and C, mm for each deg, so that the tip stays where it is. `None`: no
    /// rotary axis corrects.
    follow: Option<[Axes; 3]>,
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
    tool: Arc<Tooled>,
    places: AxisPlaces,
    corrects: Axes<bool>,
    travels: Axes<[f64; 2]>,
    only_linear: bool,
    bidirectional: bool,
    approach: Axes<Option<Direction>>,
    play: Arc<Play>,
    /// Travel against its direction after which each axis counts as turned, mm and deg.
    turned_after: Axes<f64>,
    /// The furthest place of each axis in its direction.
    furthest: Axes<f64>,
    split_beyond_mm: f64,
    /// Changes with all that the correction of a place depends on besides the place.
    version: u64,
}

/// The corrections of the last two places. State.
#[derive(Clone, Debug, Default)]
pub(crate) struct Seen {
    places: [Option<(Axes, u64, Correction)>; 2],
    last: usize,
}

impl Seen {
    /// The correction at these coordinates.
    pub(crate) fn at(&mut self, corrector: &Corrector, at: &Axes) -> &Correction {
        let is_it = |seen: &Option<(Axes, u64, Correction)>| {
            (seen.as_ref())
                .is_some_and(|(place, version, _)| place == at && *version == corrector.version)
        };
        if !is_it(&self.places[self.last]) {
            self.last = 1 - self.last;
            if !is_it(&self.places[self.last]) {
                self.places[self.last] = None;
            }
        }
        let anew = || (*at, corrector.version, corrector.at(at));
        &self.places[self.last].get_or_insert_with(anew).2
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
        let tool = tooled(machine, &[0.0; 9], temperatures, tolerance_mm, &places)?;
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
        self.tool = Arc::new(tooled(
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
    pub(crate) fn has(&self, axis: usize) -> bool {
        self.places.of_axis(axis).is_some()
    }

    /// The temperatures that hold.
    pub(crate) fn temperatures(&self) -> &Temperatures {
        &self.temperatures
    }

    /// No axis is a rotary one.
    pub(crate) fn is_only_linear(&self) -> bool {
        self.only_linear
    }

    pub(crate) fn corrects(&self, axis: usize) -> bool {
        self.corrects[axis]
    }

    pub(crate) fn is_bidirectional(&self) -> bool {
        self.bidirectional
    }

    pub(crate) fn is_within_travel(&self, axis: usize, at: f64) -> bool {
        let [low, high] = self.travels[axis];
        let rounding = 1e-9 * (1.0 + at.abs());
        (low - rounding..=high + rounding).contains(&at)
    }

    /// How far a line may be from where it belongs before it is split, mm.
    pub(crate) fn split_beyond_mm(&self) -> f64 {
        self.split_beyond_mm
    }

    fn state(&self, at: &Axes) -> State {
        let mut state = self.places.state(at);
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

    /// The state of the model with the drives at a place and the carriages where they are.
    fn carried(&self, at: &Axes, carriages: &Carriages) -> State {
        if !self.play.any {
            return self.state(at);
        }
        let lost = self.lost(at);
        let (mut there, mut approach) = (*at, self.approach);
        for axis in (0..MAX_AXES).filter(|axis| lost[*axis] > 0.0) {
            // The flank that is nearer: its curves hold, and what is missing to it is a way of the axis.
            let off = carriages.off[axis];
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

    /// From which side the axes come, to be put back.
    pub(crate) fn sides(&self) -> (Axes<Option<Direction>>, Axes) {
        (self.approach, self.furthest)
    }

    pub(crate) fn put_back(&mut self, (approach, furthest): (Axes<Option<Direction>>, Axes)) {
        self.version += u64::from(self.approach != approach);
        (self.approach, self.furthest) = (approach, furthest);
    }

    /// The axes begin here, with no direction yet.
    pub(crate) fn begins(&mut self, at: &Axes) {
        self.approach = [None; MAX_AXES];
        let more = self.without_play(at);
        self.furthest = std::array::from_fn(|axis| at[axis] + more[axis]);
    }

    /// Whether the carriage of an axis lags somewhere.
    pub(crate) fn lags(&self, axis: usize) -> bool {
        self.play.has(axis)
    }

    /// From which side an axis comes, and its furthest place.
    pub(crate) fn side(&self, axis: usize) -> (Option<Direction>, f64) {
        (self.approach[axis], self.furthest[axis])
    }

    /// The axes have been so far, each in its direction.
    pub(crate) fn reaches(&mut self, furthest: &Axes) {
        for axis in 0..MAX_AXES {
            if self.has(axis) {
                self.furthest[axis] = furthest[axis];
            }
        }
    }

    /// Rotary axes are where they were, which has another number now, deg.
    pub(crate) fn wraps(&mut self, by: &Axes) {
        for (furthest, by) in self.furthest.iter_mut().zip(by) {
            *furthest += by;
        }
    }

    /// An axis turns.
    pub(crate) fn turn(&mut self, turn: &Turn) {
        if self.approach[turn.axis] != Some(turn.side) {
            self.version += 1;
        }
        self.approach[turn.axis] = Some(turn.side);
        self.furthest[turn.axis] = turn.furthest;
    }

    /// What is added to the axes at a place besides their play: the carriage of an axis that lags goes with it, and where that turns, the
    /// play is to be taken up. 0 for the others, whose direction is that of the command without its correction.
    pub(crate) fn without_play(&self, at: &Axes) -> Axes {
        if !self.play.any {
            return [0.0; MAX_AXES];
        }
        let (delta, lost) = (self.at(at).delta, self.lost(at));
        std::array::from_fn(|axis| {
            if !self.lags(axis) || !self.corrects[axis] {
                return 0.0;
            }
            match self.approach[axis] {
                Some(Direction::Positive) => delta[axis] - 0.5 * lost[axis],
                Some(Direction::Negative) => delta[axis] + 0.5 * lost[axis],
                None => delta[axis],
            }
        })
    }

    /// The axes go to this place: from now on they come from that side. Whether one of them turns.
    pub(crate) fn goes(&mut self, to: &Axes) -> bool {
        if !self.bidirectional {
            return false;
        }
        let before = self.approach;
        let more = self.without_play(to);
        for axis in 0..MAX_AXES {
            let after = self.turned_after[axis];
            let here = to[axis] + more[axis];
            let way = here - self.furthest[axis];
            let on = match self.approach[axis] {
                Some(Direction::Positive) => way > 0.0 || way < -after,
                Some(Direction::Negative) => way < 0.0 || way > after,
                None => way.abs() > after,
            };
            if on && way != 0.0 {
                self.furthest[axis] = here;
                self.approach[axis] = Some(side_of(way));
            }
        }
        let turns = self.approach != before;
        self.version += u64::from(turns);
        turns
    }

    /// The correction at these coordinates of the axes (mm, deg).
    pub(crate) fn at(&self, at: &Axes) -> Correction {
        let state = self.state(at);
        let Tooled {
            machine, compiled, ..
        } = &*self.tool;
        if self.only_linear {
            // The errors are those where the axes go to.
            let mut there = state;
            for (q, delta) in there.q.iter_mut().zip(&compiled.first_order(&state).delta) {
                *q += delta;
            }
            let delta = compiled.first_order(&there).delta;
            return Correction {
                delta: self.places.axes(&delta),
                follow: None,
            };
        }
        let mut parts = compiled.parts_of(&state, compiled.correctors());
        let mut delta = parts.delta();
        let most_mm = NEGLECTED * self.split_beyond_mm;
        let mut neglected_mm = compiled.neglected_mm(&delta);
        if neglected_mm > most_mm {
            // The errors are those where the axes go to.
            let first = delta;
            let mut there = state;
            for (q, delta) in there.q.iter_mut().zip(&first) {
                *q += delta;
            }
            parts = compiled.parts_of(&there, compiled.correctors());
            delta = parts.delta();
            neglected_mm = compiled.neglected_there_mm(&first, &delta);
        }
        if neglected_mm > most_mm {
            let options = machine.correction_options();
            let exact = machine.correction_at(&state, &self.temperatures, &options);
            if exact.converged {
                delta = exact.delta;
            }
        }
        let follow = std::array::from_fn(|rotary| match self.places.of_axis(3 + rotary) {
            // For each rad as the model has it, for each deg here; only linear axes follow.
            Some(place) => self
                .places
                .axes(&parts.follow[place])
                .map(|mm| mm * 1.0_f64.to_radians()),
            None => [0.0; 9],
        });
        Correction {
            delta: self.places.axes(&delta),
            follow: (!compiled.correctors().rotary().is_empty()).then_some(follow),
        }
    }

    /// Where the tip of the ideal machine is, mm from the workpiece origin in workpiece axes.
    pub(crate) fn ideal_tip_mm(&self, at: &Axes) -> [f64; 3] {
        let chain = self.tool.machine.chain();
        chain.ideal_tip_mm(&self.places.state(at)).into()
    }

    /// Where a point of the tool is, `above_mm` above its tip along its axis, by the exact model; mm from the workpiece origin in
    /// workpiece axes.
    pub(crate) fn on_tool_mm(&self, at: &Axes, carriages: &Carriages, above_mm: f64) -> [f64; 3] {
        let chain = self.tool.machine.chain();
        let point = chain.tool_tip_mm() + chain.tool_axis() * above_mm;
        let source = self.tool.machine.source(&self.temperatures);
        let pose = actual_pose(chain, &source, &self.carried(at, carriages));
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
    pub(crate) fn actual_tip_mm(&self, at: &Axes, carriages: &Carriages) -> [f64; 3] {
        let (machine, temperatures) = (&self.tool.machine, &self.temperatures);
        let state = self.carried(at, carriages);
        let error = machine.error_at(&state, Form::Exact, temperatures);
        (machine.chain().ideal_tip_mm(&state) + error.position_mm).into()
    }

    /// Whether the correction on the way between two places is nowhere further than the tolerance from the straight line
    /// between those at its ends: by the derivatives of the curves. `bulge_mm` is how far the axes may be from the straight
    /// way, `coupled_mm` what rotary corrections add ([`coupled_mm`](Self::coupled_mm)).
    pub(crate) fn is_straight(
        &self,
        from: &Axes,
        to: &Axes,
        bulge_mm: f64,
        coupled_mm: f64,
    ) -> bool {
        let mut share = 0.0;
        for axis in 0..MAX_AXES {
            let way = (to[axis] - from[axis]).abs();
            if way > 0.0 && self.has(axis) {
                share += way / self.tool.unsplit[axis];
            }
        }
        bulge_mm == 0.0 && coupled_mm == 0.0 && share <= 1.0
            || self.bound_mm(from, to, bulge_mm) + coupled_mm <= self.split_beyond_mm
    }

    /// A bound (mm) of the distance between the correction on the way and the straight line between those at its ends.
    pub(crate) fn bound_mm(&self, from: &Axes, to: &Axes, bulge_mm: f64) -> f64 {
        let [from, to] = [from, to].map(|at| self.state(at));
        self.tool.compiled.chord_bound_mm(&from, &to) + bulge_mm * self.tool.steepness
    }

    /// A bound (mm) of what the tip is off on the way since the corrections of rotary axes change along it, while the linear axes
    /// follow them as they have to at its two ends: the product of two changes, and the bend of the levers. Near a singular
    /// pose the corrections of rotary axes are many times the errors.
    pub(crate) fn coupled_mm(&self, seen: &mut Seen, from: &Axes, to: &Axes) -> f64 {
        if self.tool.compiled.correctors().rotary().is_empty() {
            return 0.0;
        }
        let reach_mm = self.tool.reach_mm;
        let way_mm: f64 = (0..9)
            .filter(|axis| !is_rotary(*axis) && self.has(*axis))
            .map(|axis| (to[axis] - from[axis]).abs())
            .sum();
        let rotary = (3..6).filter(|axis| self.has(*axis));
        let turned: f64 = rotary
            .clone()
            .map(|axis| (to[axis] - from[axis]).abs().to_radians())
            .sum();
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

    /// How far the linear axes may be from their straight way (mm) while the centre point of the tool goes straight and the
    /// rotary axes turn by `turned` rad: by the second derivative of a turning lever.
    pub(crate) fn bulge_mm(&self, turned: f64, way_mm: f64) -> f64 {
        let reach_mm = self.tool.reach_mm;
        0.125 * turned * (turned * reach_mm + 2.0 * way_mm)
    }
}

/// The machine with a tool, compiled.
fn tooled(
    machine: &Machine,
    offset: &Axes,
    temperatures: &Temperatures,
    tolerance_mm: f64,
    places: &AxisPlaces,
) -> Result<Tooled, NcError> {
    let machine = with_tool(machine, offset)?;
    let compiled = machine.compile_at(Tolerance::from_nm(COMPILED_TO_NM), temperatures)?;
    let ways = compiled.short_ways(tolerance_mm);
    let unsplit = std::array::from_fn(|axis| match places.of_axis(axis) {
        Some(place) if is_rotary(axis) => ways[place].to_degrees(),
        Some(place) => ways[place],
        None => f64::INFINITY,
    });
    Ok(Tooled {
        offset: *offset,
        reach_mm: compiled.reach_mm(),
        steepness: compiled.steepness(),
        machine,
        compiled,
        unsplit,
    })
}
