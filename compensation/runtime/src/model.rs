//! The machine model that a cycle evaluates. State: the lags of its thermal terms.

mod largest_move;

use std::{ops::Deref, time::Duration};

use volcomp_guard::{MAX_SENSORS, PositionLimits, SensorReport};
use volcomp_kinematics::{Correctors, Pose, State, nalgebra::Vector3, skew_part};
use volcomp_model::{Axis, CompiledMachine, Fading, Machine, ModelError, ThermalState, Tolerance};
use volcomp_port::Description;
use volcomp_vocabulary::{AxisName, Displacement, Mm, PerAxis, Rad, is_within};

use crate::{report::ToolError, settings::Rapid};

pub use largest_move::LargestMove;

/// Maximum distance of a plausible position outside the travel, mm or °. End switches and reference points are within
/// this distance.
const OVERTRAVEL_MM_OR_DEG: f64 = 5.0;
/// Number of sampled positions over the travel of a rotary axis, both ends included.
const TRAVEL_SAMPLES: u32 = 25;

/// Range of valid positions of an axis, mm or rad; `None` for an axis without ends.
fn position_range(axis: &Axis) -> Option<[f64; 2]> {
    let [low, high] = axis.travel;
    let ends = [low - OVERTRAVEL_MM_OR_DEG, high + OVERTRAVEL_MM_OR_DEG];
    let end = |end| Displacement::from_coordinate(axis.name.kind(), end).mm_or_rad();
    axis.has_ends().then(|| ends.map(end))
}

/// Correction by a model at a state.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ModelCorrection {
    /// Correction to add to the command, in machine order: mm for linear, rad for rotary axes.
    pub delta: PerAxis<f64>,
    /// Whether two rotary axes could correct the direction of the tool axis, but part of it is not
    /// corrected because the pose is within about 1° of a singular one.
    pub singular: bool,
    /// Whether the pose is within about 6° of a singular one: rotary corrections are more than ten times the error of the tool axis, or omitted.
    pub near_singular: bool,
}

/// Parts of a coupled correction by a model at a state, in machine order. For any rotary corrections δ_r on the axes, the matching
/// linear corrections are `position` + Σ `follow[r]`·δ_r.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CoupledCorrection {
    /// Linear corrections of the position error if no rotary axis moves, mm; zero for all other axes.
    pub position: PerAxis<f64>,
    /// Rotary corrections of the direction of the tool axis, rad; zero for all other axes.
    pub rotary: PerAxis<f64>,
    /// Movement of the linear axes per rotation of each rotary axis, correcting or not, that keeps
    /// the tool tip in place, mm/rad.
    pub follow: PerAxis<PerAxis<f64>>,
    /// See [`ModelCorrection::singular`].
    pub singular: bool,
    /// See [`ModelCorrection::near_singular`].
    pub near_singular: bool,
    /// Whether two linear axes are nearly parallel: see [`Reasons::LINEAR_NEAR_SINGULAR`](volcomp_guard::Reasons::LINEAR_NEAR_SINGULAR).
    pub linear_near_singular: bool,
}

/// A compiled machine with its thermal terms.
#[derive(Clone)]
pub struct Model {
    /// Name in the machine file.
    pub name: String,
    /// Checksum of the machine file's content.
    pub hash: String,
    /// Text of the machine file, serialised from the machine.
    pub text: String,
    /// The axes in machine order.
    pub axes: Vec<AxisName>,
    /// Lower and upper end of travel of each axis, in machine order.
    pub travel: Vec<[Displacement; 2]>,
    /// Whether coordinates of each axis are reduced to its travel by whole periods.
    goes_round: Vec<bool>,
    /// Range of valid positions of each axis, mm and rad, in machine order; `None`: any position is valid.
    ranges: PerAxis<Option<[f64; 2]>>,
    /// Nodes of the curves along each axis, where the slope of the model may change abruptly, mm and rad, ascending.
    nodes: Vec<Vec<f64>>,
    /// Positions along each axis at which the curves must be sampled to find their extremes: the nodes, and positions between them.
    places: Vec<Vec<f64>>,
    grids: Vec<largest_move::GridNodes>,
    /// Whether errors depend on the direction of approach, by axis.
    reverses: Vec<bool>,
    /// Longest lever from the axis line of each rotary axis to the tool tip over the work space, mm.
    levers_mm: PerAxis<f64>,
    compiled: CompiledMachine,
    only_thermal: CompiledMachine,
    thermal: ThermalState,
}

impl Model {
    /// Compiles a machine and its thermal terms; `fading` states the times in which terms without a sensor fade.
    ///
    /// # Errors
    /// Curves that cannot be compiled, thermal terms of axes that do not exist.
    pub fn new(machine: &Machine, fading: Fading) -> Result<Self, ModelError> {
        let joints = machine.chain().joints();
        let mut without_errors = machine.clone();
        without_errors.clear_errors();
        let axes: Vec<AxisName> = joints.iter().map(|joint| joint.name).collect();
        let model = Self {
            name: machine.name.clone(),
            hash: machine.checksum(),
            text: machine.to_toml(),
            travel: machine
                .axes()
                .iter()
                .map(|axis| {
                    let kind = axis.name.kind();
                    let end = |end| Displacement::from_coordinate(kind, end);
                    axis.travel.map(end)
                })
                .collect(),
            goes_round: machine.axes().iter().map(|axis| axis.modulo.is_some()).collect(),
            ranges: PerAxis::from_fn(|index| machine.axes().get(index).and_then(position_range)),
            nodes: largest_move::in_mm_or_rad(machine, machine.nodes()),
            places: largest_move::in_mm_or_rad(machine, machine.places()),
            grids: largest_move::grids(machine),
            reverses: largest_move::reverses(machine),
            axes,
            levers_mm: PerAxis::ZERO,
            compiled: machine.compile(Tolerance::default())?,
            only_thermal: without_errors.compile(Tolerance::default())?,
            thermal: ThermalState::new(machine, fading)?,
        };
        Ok(Self { levers_mm: model.longest_levers(), ..model })
    }

    /// The structure code, such as `w X' b Y Z t`.
    pub fn structure(&self) -> String {
        self.compiled.chain().structure().to_string()
    }

    /// Index of an axis in machine order; `None` if the machine lacks it.
    pub fn index_of(&self, name: AxisName) -> Option<usize> {
        self.axes.iter().position(|known| *known == name)
    }

    /// Whether an axis can be at a position: within its travel or, with `modulo`, anywhere, because the coordinate is reduced to the
    /// travel.
    pub fn is_within_travel(&self, index: usize, position: Displacement) -> bool {
        let travel = self.travel.get(index);
        self.goes_round.get(index) == Some(&true)
            || travel.is_some_and(|travel| {
                is_within(travel.map(Displacement::mm_or_deg), position.mm_or_deg())
            })
    }

    pub(crate) fn position_limits(&self, index: usize, rapid: &Rapid) -> PositionLimits {
        let (kind, range) = (self.axes[index].kind(), self.ranges[index]);
        PositionLimits {
            range,
            turn: range.is_none().then_some(core::f64::consts::TAU),
            speed: rapid.per_s(kind).mm_or_rad(),
        }
    }

    /// Period of the coordinates of the axis at this index, rad; `None` if they do not wrap.
    pub fn turn_of(&self, index: usize) -> Option<f64> {
        (self.goes_round.get(index) == Some(&true)).then_some(core::f64::consts::TAU)
    }

    /// Whether a curve may bend between two positions (mm, rad) of the axis at this index: at a node, or outside its travel.
    pub(crate) fn may_bend_between(&self, index: usize, from: f64, to: f64) -> bool {
        let (Some(nodes), Some(travel)) = (self.nodes.get(index), self.travel.get(index)) else {
            return false;
        };
        let (low, high) = (from.min(to), from.max(to));
        let [first, last] = travel.map(Displacement::mm_or_rad);
        let next = nodes.partition_point(|node| *node < low);
        low < first || high > last || nodes.get(next).is_some_and(|node| *node <= high)
    }

    /// False if all axes are linear.
    pub fn has_rotary_axes(&self) -> bool {
        self.axes.iter().any(|name| name.is_rotary())
    }

    /// Names of the sensors that thermal terms use, in the order of [`step`](Self::step).
    pub fn sensors(&self) -> &[String] {
        self.thermal.sensors()
    }

    /// Advances the thermal terms by `dt_s` with the temperature (°C) of each sensor; `None`: missing. Returns whether a term lacks its
    /// sensor. Does not allocate.
    pub fn step(&mut self, dt_s: f64, degc: &[Option<f64>]) -> bool {
        self.thermal.step(dt_s, degc);
        self.put_thermal();
        self.thermal.is_degraded()
    }

    /// Whether temperatures are outside the range for which thermal terms were identified: see [`ThermalState::is_beyond_seen`].
    pub fn is_beyond_seen(&self) -> bool {
        self.thermal.is_beyond_seen()
    }

    /// Advances the thermal terms over a pause of the program: see [`ThermalState::stand`]. Does not allocate.
    pub fn stand(&mut self, stood_s: f64) {
        self.thermal.stand(stood_s);
    }

    /// Takes over the thermal lags of another model for terms with the same sensor. Does not allocate.
    pub fn carry_over(&mut self, from: &Self) {
        self.thermal.carry_over(&from.thermal);
        self.put_thermal();
    }

    fn put_thermal(&mut self) {
        self.thermal.apply(&mut self.compiled);
        self.thermal.apply(&mut self.only_thermal);
    }

    /// Whether a curve is evaluated outside its range at a state.
    pub fn is_outside_range(&self, state: &State) -> bool {
        !self.compiled.outside_range(state).is_empty()
    }

    /// Axes that correct if a controller writes only the axes `written`; all others are held.
    /// Does not allocate.
    pub fn correctors_among(&self, written: &[AxisName]) -> Correctors {
        self.compiled.correctors_among(written)
    }

    /// Correction by all axes that may correct: see [`correction_of`](Self::correction_of).
    pub fn correction(&self, state: &State) -> ModelCorrection {
        self.correction_of(state, self.compiled.correctors())
    }

    /// Correction at a state by the correcting axes while all others are held. It is solved to first order twice; the
    /// second solution, which is returned, uses the errors at the state corrected by the first. Does not allocate.
    pub fn correction_of(&self, state: &State, correctors: &Correctors) -> ModelCorrection {
        let first = self.compiled.first_order_of(state, correctors);
        let there = moved(state, &first.delta);
        let second = self.compiled.first_order_of(&there, correctors);
        let corrects_tool_axis = correctors.rotary().len() >= 2;
        ModelCorrection {
            delta: second.delta,
            singular: second.tool_axis_partial && corrects_tool_axis,
            near_singular: second.near_singular,
        }
    }

    /// Correction in parts. `applied` is the present correction on the axes (mm, rad), which limits and ramps may have reduced; the
    /// errors are evaluated at the position to which it leads. If the whole correction is applied, the sum of the parts equals
    /// [`correction_of`](Self::correction_of). Does not allocate.
    pub fn wanted(
        &self,
        state: &State,
        correctors: &Correctors,
        applied: &PerAxis<f64>,
    ) -> CoupledCorrection {
        self.wanted_by(false, state, correctors, applied)
    }

    /// [`wanted`](Self::wanted) for thermal terms alone (`true`) or for the whole model. Does not allocate.
    pub fn wanted_by(
        &self,
        only_thermal: bool,
        state: &State,
        correctors: &Correctors,
        applied: &PerAxis<f64>,
    ) -> CoupledCorrection {
        let compiled = if only_thermal { &self.only_thermal } else { &self.compiled };
        let parts = compiled.parts_of(&moved(state, applied), correctors);
        let corrects_tool_axis = correctors.rotary().len() >= 2;
        CoupledCorrection {
            position: parts.position,
            rotary: parts.rotary,
            follow: parts.follow,
            singular: parts.tool_axis_partial && corrects_tool_axis,
            near_singular: parts.near_singular,
            linear_near_singular: parts.linear_near_singular,
        }
    }

    /// Correcting axes of a path: those of [`correctors_among`](Self::correctors_among) without rotary axes whose correction would
    /// increase the error of the tool. If the correcting linear axes do not span all directions, all rotary axes are excluded, because
    /// their movement of the tip cannot be compensated. A rotary axis is also excluded if half a step (`steps`, rad, in machine order)
    /// moves the tip by more than `most`. Does not allocate.
    pub fn correctors_of_path(
        &self,
        written: &[AxisName],
        steps: &PerAxis<f64>,
        most: Mm,
    ) -> Correctors {
        let mut correctors = self.correctors_among(written);
        let follows = correctors.linear().len() == 3;
        correctors.retain_rotary(|axis| {
            follows && self.rotary_step_error(axis, Rad(steps[axis])) <= most
        });
        correctors
    }

    /// Axes that follow a remaining correction on a rotary axis if the correcting axes cannot, because they have fewer
    /// than three linear directions: all axes that a controller writes, correcting or
    /// not. `None` if the correcting axes can follow, or no rotary axis is written. Does not
    /// allocate.
    pub(crate) fn followers(
        &self,
        written: &[AxisName],
        correctors: &Correctors,
    ) -> Option<Correctors> {
        let turns = written.iter().any(|name| name.is_rotary());
        (turns && correctors.linear().len() < 3)
            .then(|| Correctors::choose(self.compiled.chain(), written))
    }

    /// Correcting axes of a controller: see [`correctors_of_path`](Self::correctors_of_path).
    pub fn correctors_of(&self, controller: &Description, most: Mm) -> Correctors {
        let written: Vec<AxisName> = controller.axes.iter().map(|axis| axis.name).collect();
        let mut steps = PerAxis::ZERO;
        for axis in &controller.axes {
            if let Some(place) = self.index_of(axis.name) {
                steps[place] = axis.step();
            }
        }
        self.correctors_of_path(&written, &steps, most)
    }

    /// A pose (mm, rad in machine order) within the travels at which rotary axes turn two of the
    /// correcting linear axes nearly parallel; `None` if there is none at the 25 sampled positions
    /// of each rotary axis.
    pub fn linear_near_singular(&self, correctors: &Correctors) -> Option<PerAxis<f64>> {
        let rotary = (0..self.axes.len()).filter(|axis| self.axes[*axis].is_rotary());
        let rotary: Vec<(usize, u32)> = rotary.map(|axis| (axis, TRAVEL_SAMPLES)).collect();
        self.over_places(&rotary, |state| {
            let parts = self.compiled.parts_of(state, correctors);
            parts.linear_near_singular.then_some(state.q)
        })
    }

    /// Largest position error due to the resolution of a rotary correction: half a step times the longest lever arm from its axis line to
    /// the tool tip over the work space. `index` is in machine order; zero for a linear axis and for an invalid index. Lever arms are sampled
    /// at the ends of the linear travels, where they are longest, and at 25 positions of the other rotary axes. Does not allocate.
    pub fn rotary_step_error(&self, index: usize, step: Rad) -> Mm {
        let lever_mm = self.levers_mm.get(index).copied().unwrap_or(0.0);
        rotary_step_error(lever_mm, step)
    }

    /// Longest lever of each rotary axis over the work space, mm.
    fn longest_levers(&self) -> PerAxis<f64> {
        PerAxis::from_fn(|index| {
            let mut longest_mm = 0.0_f64;
            if self.axes.get(index).is_some_and(|axis| axis.is_rotary()) {
                let places = |axis: usize| {
                    if self.axes[axis].is_rotary() { TRAVEL_SAMPLES } else { 2 }
                };
                let carried: Vec<(usize, u32)> =
                    (index + 1..self.axes.len()).map(|axis| (axis, places(axis))).collect();
                let _: Option<()> = self.over_places(&carried, |state| {
                    let chain = self.compiled.chain();
                    longest_mm = longest_mm.max(chain.lever_mm(index, state));
                    None
                });
            }
            longest_mm
        })
    }

    /// Samples the given number of positions of each of these axes over its travel, with all others at 0, until `find` returns a result.
    fn over_places<T>(
        &self,
        axes: &[(usize, u32)],
        mut find: impl FnMut(&State) -> Option<T>,
    ) -> Option<T> {
        let mut place = vec![0_u32; axes.len()];
        loop {
            let mut state = State::default();
            for (&(axis, count), &at) in axes.iter().zip(&place) {
                let [from, to] = self.travel[axis].map(Displacement::mm_or_rad);
                state.q[axis] = from + (to - from) * f64::from(at) / f64::from(count - 1);
            }
            if let Some(found) = find(&state) {
                return Some(found);
            }
            // Next position, the first axis fastest.
            let goes_on = place.iter_mut().zip(axes).any(|(at, &(_, count))| {
                *at = (*at + 1) % count;
                *at != 0
            });
            if !goes_on {
                return None;
            }
        }
    }

    /// Errors of the tool at a state, in workpiece axes: without correction, and with `correction` (mm, rad) added to the command. The
    /// latter is the movement of the ideal tool by the correction, plus the error of the machine at the resulting position. Does not
    /// allocate.
    pub fn errors(&self, state: &State, correction: &PerAxis<f64>) -> [ToolError; 2] {
        let there = moved(state, correction);
        let chain = self.compiled.chain();
        let commanded = chain.ideal_pose(state);
        let reached = chain.ideal_pose(&there);
        [
            self.error_against(&commanded, &commanded, state),
            self.error_against(&commanded, &reached, &there),
        ]
    }

    /// Error relative to the ideal pose `commanded` if the axes are at `state`, whose ideal pose is `reached`.
    fn error_against(&self, commanded: &Pose, reached: &Pose, state: &State) -> ToolError {
        let chain = self.compiled.chain();
        let (tip, axis) = (chain.tool_tip_mm(), chain.tool_axis());
        let error = self.compiled.evaluate(state);
        let rotation = Vector3::from(error.rotation_rad);
        let moved = reached.transform_point(&tip) - commanded.transform_point(&tip);
        let turned = (reached.rotation - commanded.rotation) * axis;
        let tilted = rotation.cross(&(reached.rotation * axis));
        let turn = skew_part(&(reached.rotation * commanded.rotation.transpose()));
        ToolError {
            position_mm: (moved + Vector3::from(error.position_mm)).into(),
            rotation_rad: (turn + rotation).into(),
            axis_rad: (turned + tilted).into(),
        }
    }

    /// Returns the model in the steady state at these temperatures (°C, by sensor name).
    #[must_use]
    pub fn warmed(&self, degc: impl Fn(&str) -> Option<f64>) -> Self {
        let mut warm = self.clone();
        warm.begin(degc);
        warm
    }

    /// Returns the model as a replacement of a running one. It takes over the lagged temperatures of the terms that
    /// both models have; the other terms start at these temperatures (°C, by sensor name).
    #[must_use]
    pub fn in_place_of(&self, running: &Self, degc: impl Fn(&str) -> Option<f64>) -> Self {
        let mut taken = self.clone();
        taken.carry_over(running);
        taken.begin(degc);
        taken
    }

    fn begin(&mut self, degc: impl Fn(&str) -> Option<f64>) {
        let degc: Vec<Option<f64>> = self.sensors().iter().map(|name| degc(name)).collect();
        self.step(0.0, &degc);
    }
}

/// A state with a correction (mm, rad) added to the command.
fn moved(state: &State, delta: &PerAxis<f64>) -> State {
    let mut there = *state;
    for (q, delta) in there.q.iter_mut().zip(delta) {
        *q += delta;
    }
    there
}

/// Largest position error of a rotary correction due to its resolution: half a step times the lever arm, which is the distance of the tool
/// tip from the axis line.
pub fn rotary_step_error(lever_mm: f64, step: Rad) -> Mm {
    Mm(0.5 * step.0.abs() * lever_mm)
}

/// A model, and the index of the temperature of each of its sensors among those of a cycle.
pub struct Replacement {
    model: Box<Model>,
    places: Vec<Option<usize>>,
    degc: Vec<Option<f64>>,
}

impl Replacement {
    /// Assigns the sensors of a model to the temperatures with these names.
    pub fn new(model: Box<Model>, names: &[String]) -> Self {
        let wanted = model.sensors();
        let places = wanted.iter().map(|wanted| names.iter().position(|name| name == wanted));
        Self { places: places.collect(), degc: vec![None; wanted.len()], model }
    }

    /// Takes over the thermal lags of the replaced model. Does not allocate.
    pub(crate) fn carry_over(&mut self, from: &Self) {
        self.model.carry_over(&from.model);
    }

    /// Advances the thermal terms by `dt` with the temperatures of a cycle, after the program was paused for `stood`. Returns whether a
    /// term lacks its sensor. Does not allocate.
    pub(crate) fn warm(
        &mut self,
        dt: Duration,
        stood: Duration,
        sensors: &[SensorReport; MAX_SENSORS],
    ) -> bool {
        for (degc, place) in self.degc.iter_mut().zip(&self.places) {
            *degc = place.and_then(|place| sensors.get(place)).and_then(|sensor| sensor.degc);
        }
        self.model.stand(stood.as_secs_f64());
        self.model.step(dt.as_secs_f64(), &self.degc)
    }
}

impl Deref for Replacement {
    type Target = Model;

    fn deref(&self) -> &Model {
        &self.model
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn models_are_compared_warm_too() {
        let model = |um_per_m_k: f64| {
            let text = format!(
                "structure = \"w X' b Y Z t\"\n[axes.X]\ntravel = [0.0, 1000.0]\n[axes.Y]\ntravel = [0.0, 1.0]\n[axes.Z]\ntravel = [0.0, 1.0]\n[[thermal.expansion]]\nerror = \"EXX\"\nsensor = \"scale\"\num_per_m_k = {um_per_m_k}\n"
            );
            let machine = Machine::parse(&text, "m").expect("valid");
            Model::new(&machine, Fading::default()).expect("compiles")
        };
        let (old, new) = (model(10.0), model(20.0));
        let none = LargestMove { linear: Mm(0.0), rotary: Rad(0.0) };
        assert_eq!(old.largest_move(&new, []), none);
        let warm = |model: &Model| model.warmed(|_| Some(25.0));
        let LargestMove { linear, rotary } = warm(&old).largest_move(&warm(&new), []);
        assert!((linear.0 - 0.05).abs() < 1e-5 && rotary == Rad(0.0), "{linear}");
    }

    /// With A held, Z corrects the part that A would correct.
    #[test]
    fn models_are_compared_by_the_written_axes() {
        let model = |urad: f64| {
            let text = format!(
                "structure = \"w A' b X Y Z t\"\n[axes.X]\ntravel = [0.0, 1.0]\n[axes.Y]\ntravel = [0.0, 200.0]\n[axes.Z]\ntravel = [0.0, 1.0]\n[axes.A]\ntravel = [-1.0, 1.0]\n[errors]\nEAA = {urad}\n"
            );
            let machine = Machine::parse(&text, "m").expect("valid");
            Model::new(&machine, Fading::default()).expect("compiles")
        };
        let (old, new) = (model(0.0), model(400.0));
        assert!(old.largest_move(&new, []).linear < Mm(0.02));
        let written = [AxisName::X, AxisName::Y, AxisName::Z];
        let way = [&old, &new].map(|model| model.correctors_among(&written));
        let moved = old.largest_move(&new, [way]).linear;
        assert!((moved - Mm(0.08)).abs() < Mm(1e-3), "{moved}");
    }
}
