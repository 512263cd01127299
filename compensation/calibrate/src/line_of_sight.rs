//! Readings of a perfect instrument along a line of a machine with errors.
//!
//! They include the Abbe error, the contributions of axes other than the measured axis, and the poses of the artefacts.
//! The machine coordinate system is not accessible to an instrument, so artefacts are aligned to the axes.

use core::f64::consts::{FRAC_PI_2, PI};

use volcomp_curve::{Curve, ErrorCurve, Field};
use volcomp_kinematics::nalgebra::{Matrix3, Vector3};
use volcomp_kinematics::{
    Chain, ErrorMotion, ErrorSource, Joint, Pose, Side, State, actual_pose, vector_from_rotation,
};
use volcomp_metrology::{CarriedSide, MotionKind, ReferenceLine, Rides, Travel, abbe_um, lever_mm};
use volcomp_model::{Machine, ModelError, Temperatures};
use volcomp_vocabulary::{
    AxisKind, AxisName, Component, Direction, Displacement, ErrorName, MAX_AXES, Urad,
};

use crate::calibration_file::{CalibrationFile, Line, Setup, measured, set_square};
use crate::profile::Profile;

/// Removes the Abbe error: δ = δ_measured − ε × lever, with the tilts ε of the measured axis on the machine `tilted`.
pub(crate) fn without_abbe<'a>(
    mut profile: Profile<'a>,
    tilted: &Machine,
) -> Result<Profile<'a>, ModelError> {
    let lever = Lever::new(profile.line, tilted)?;
    for (branch, direction) in profile.points.iter_mut().zip(Direction::BOTH) {
        for (target, value) in branch {
            let tilts = tilts_urad(profile.line, tilted, *target, direction)?;
            *value -= lever.abbe_um(tilts, *target);
        }
    }
    Ok(profile)
}

/// Lever arm of a measured line in the frame of the component that carries the axis: MCS at machine
/// zero, moved by the held axes to their positions in the test.
pub(crate) struct Lever {
    point: [f64; 3],
    rides: Rides,
    joint: Joint,
    /// Weights that convert a displacement into a reading: for positioning the direction of the axis, for other errors
    /// the direction of the error's component.
    sense: Vector3<f64>,
}

impl Lever {
    pub(crate) fn new(line: &Line, machine: &Machine) -> Result<Self, ModelError> {
        let setup = &line.setup;
        let index = machine.index_of(setup.error.axis)?;
        let joint = machine.chain().joints()[index];
        let mut component = Vector3::zeros();
        component[setup.error.component.mcs_index()] = 1.0;
        Ok(Self {
            // A set-up that states no point measured the point of the axis. If that point is on the other side of the
            // joint, the lever arm still changes with the travel.
            point: measured_point(line, machine)?.into(),
            // A rotary axis does not move its own point, so the lever arm is constant.
            rides: match joint.kind {
                AxisKind::Linear => setup.rides,
                AxisKind::Rotary => Rides::Carriage,
            },
            joint,
            sense: match MotionKind::of(setup.error) {
                MotionKind::Positioning => joint.direction,
                _ => component,
            },
        })
    }

    /// Lever arm m − c, mm along the axes of the frame; includes the travel if the point is on the other side of the joint.
    fn at_mm(&self, position_mm: f64) -> [f64; 3] {
        let travel = Travel {
            side: match self.joint.side {
                Side::Tool => CarriedSide::Tool,
                Side::Workpiece => CarriedSide::Workpiece,
            },
            direction_mcs: self.joint.direction.into(),
            position_mm,
        };
        lever_mm(self.point, self.joint.point_mm.into(), self.rides, travel)
    }

    /// Abbe error that the tilts of the axis (µrad) add to a reading at a position (mm), µm.
    fn abbe_um(&self, tilts_urad: [f64; 3], position_mm: f64) -> f64 {
        let added = abbe_um(tilts_urad, self.at_mm(position_mm));
        self.sense.dot(&Vector3::from(added))
    }

    /// Reading that 1 mrad of each tilt adds at a position, µm: A, B, C. It equals the lever arm in mm, with its sign.
    pub(crate) fn um_of_mrad(&self, position_mm: f64) -> [f64; 3] {
        std::array::from_fn(|about| {
            let mut tilt = [0.0; 3];
            tilt[about] = 1e3;
            self.abbe_um(tilt, position_mm)
        })
    }

    /// Largest reading that 1 mrad of each tilt would add at any of the positions, µm: A, B, C.
    pub(crate) fn um_by_mrad(&self, positions_mm: impl Iterator<Item = f64>) -> [f64; 3] {
        positions_mm.fold([0.0; 3], |largest, position_mm| {
            let here = self.um_of_mrad(position_mm);
            std::array::from_fn(|about| here[about].abs().max(largest[about]))
        })
    }
}

/// Measured point of a line in the frame that carries its axis, mm: MCS at machine zero, moved by the held axes to
/// their positions in the test. A line that states no point has the point of the axis.
fn measured_point(line: &Line, machine: &Machine) -> Result<Vector3<f64>, ModelError> {
    let index = machine.index_of(line.setup.error.axis)?;
    let own = machine.chain().joints()[index].point_mm;
    let Some(point_mcs) = line.setup.point_mcs else {
        return Ok(own);
    };
    let carried = machine.chain().carrier_pose(index, &held_state(line, machine)?);
    Ok(carried.inverse().transform_point(&Vector3::from(point_mcs)))
}

/// Tilts ε of the measured axis at a target, µrad, by the curves for the direction of approach.
fn tilts_urad(
    line: &Line,
    machine: &Machine,
    target: f64,
    direction: Direction,
) -> Result<[f64; 3], ModelError> {
    let index = machine.index_of(line.setup.error.axis)?;
    let mut state = held_state(line, machine)?;
    let kind = machine.chain().joints()[index].kind;
    state.q[index] = Displacement::from_coordinate(kind, target).mm_or_rad();
    state.approach[index] = Some(direction);
    let none = Temperatures::new();
    let error = machine.source(&none).error_motion(index, &state);
    Ok((error.angular_rad * 1e6).into())
}

/// State with the held axes at their positions in the test and the measured axis at 0.
fn held_state(line: &Line, machine: &Machine) -> Result<State, ModelError> {
    let names = machine.axes().iter().map(|axis| axis.name);
    let coordinates: Vec<_> = names.zip(line.setup.at.iter().copied()).collect();
    machine.state(&coordinates)
}

/// Number of targets of a straightness that was not measured.
const TARGETS: usize = 21;
/// Two unit directions are treated as parallel if the component of one normal to the other is at most this.
const PARALLEL_BELOW: f64 = 0.02;

/// Poses of the artefacts on the workpiece side and on the tool side, aligned so that the machine has no error with all
/// axes at `reference`.
///
/// An artefact on the workpiece side is aligned to the reference lines of the reference axes, at the position of the
/// tool tip at `reference`. The artefact or instrument in the tool is aligned to that artefact in this pose. Readings
/// therefore do not depend on the constants of error motions and the slopes of straightnesses, which are conventions.
#[derive(Clone, Copy, Debug)]
pub struct ArtefactPoses {
    /// Pose of the workpiece axes in the frame of the artefact on the workpiece side, mm.
    pub workpiece: Pose,
    /// Pose of the artefact on the tool side in tool axes, mm.
    pub tool: Pose,
}

impl ArtefactPoses {
    /// Poses on the machine of a calibration file before its lines are evaluated: the measured error motions and the
    /// squarenesses of the file are zero.
    pub(crate) fn before_lines(
        file: &CalibrationFile,
        known: &Machine,
    ) -> Result<Self, ModelError> {
        let mut machine = known.clone();
        for error in measured(file) {
            if machine.error(error).is_some() {
                machine.set_error(error, ErrorCurve::Single(Field::Curve(Curve::Constant(0.0))))?;
            }
        }
        for square in &file.squareness {
            set_square(&mut machine, file.reference_axes, square.error, Urad(0.0))?;
        }
        Ok(Self::of(&machine, &file.reference, file.reference_axes, |_| None))
    }

    /// Poses with the axes at `reference` (mm or deg, in machine order; an axis without a value is at 0) along the
    /// reference lines of two axes. The reference line of a straightness is fitted at the targets (mm) that `targets`
    /// returns; for `None`, at 21 targets over the travel.
    pub fn of(
        machine: &Machine,
        reference: &[f64],
        reference_axes: [AxisName; 2],
        targets: impl Fn(ErrorName) -> Option<Vec<f64>>,
    ) -> Self {
        let zero = state_at(machine, reference);
        let errors = ReferenceLines::of(machine, zero, targets);
        let chain = machine.chain();
        let tip = chain.tool_tip_mm();
        let (actual, ideal) = (actual_pose(chain, &errors, &zero), chain.ideal_pose(&zero));
        let others = [AxisName::X, AxisName::Y, AxisName::Z].into_iter();
        let others = others.filter(|axis| !reference_axes.contains(axis));
        let directions = reference_axes.into_iter().chain(others).filter_map(|name| {
            let mut moved = zero;
            moved.q[machine.index_of(name).ok()?] += 1.0;
            let to = chain.ideal_pose(&moved).transform_point(&tip);
            let actual_to = actual_pose(chain, &errors, &moved).transform_point(&tip);
            Some([to - ideal.transform_point(&tip), actual_to - actual.transform_point(&tip)])
        });
        // On a machine with fewer than two linear axes, axes of the tool replace them.
        let of_tool =
            (0..3).map(|k| [&ideal, &actual].map(|pose| pose.rotation.column(k).into_owned()));
        let turned = Pose::about_point(turn(directions.chain(of_tool)), Vector3::zeros());
        let there = (turned * actual).transform_point(&tip);
        let workpiece = Pose::from_translation(ideal.transform_point(&tip) - there) * turned;
        Self { workpiece, tool: (workpiece * actual).inverse() * ideal }
    }
}

/// Location of the line of a rotary axis (mm, rad) relative to the nominal line, in MCS at machine zero, as an
/// instrument measures it: set up as in [`ArtefactPoses::of`] with all axes at `reference`, relative to the tool tip,
/// along the reference lines of the reference axes. `[[location]]` of a calibration file states this value.
///
/// # Errors
///
/// An axis that the machine does not have.
pub fn location_seen(
    machine: &Machine,
    axis: AxisName,
    reference: &[f64],
    reference_axes: [AxisName; 2],
    targets: impl Fn(ErrorName) -> Option<Vec<f64>>,
) -> Result<ErrorMotion, ModelError> {
    let index = machine.index_of(axis)?;
    let seen = ArtefactPoses::of(machine, reference, reference_axes, &targets).workpiece;
    let zero = state_at(machine, reference);
    let errors = ReferenceLines::of(machine, zero, &targets);
    let chain = machine.chain();
    let joint = &chain.joints()[index];
    let before = chain.joints()[..index].iter().zip(&zero.q);
    let before = before.fold(Pose::identity(), |pose, (joint, q)| pose * joint.motion(*q));
    let to_axis = before.inverse() * seen;
    // Rotation of the axis alone as seen from the workpiece, in the frame in which the axis is
    // stated at machine zero.
    let turned_by = |angle_rad: f64| {
        let mut turned = zero;
        turned.q[index] += angle_rad;
        let pose = |state: &State| actual_pose(chain, &errors, state);
        to_axis * pose(&turned) * pose(&zero).inverse() * to_axis.inverse()
    };
    // The rotation vector of a quarter turn has the direction of the axis. Half a turn moves a point to the opposite
    // side of the axis.
    let direction = vector_from_rotation(&turned_by(FRAC_PI_2).rotation) / FRAC_PI_2;
    let point = joint.point_mm;
    Ok(ErrorMotion {
        linear_mm: 0.5 * (turned_by(PI).transform_point(&point) - point),
        angular_rad: joint.direction.cross(&direction),
    })
}

/// Command at coordinates in mm or deg; an axis without a value is at 0.
fn state_at(machine: &Machine, reference: &[f64]) -> State {
    let mut state = State::default();
    for ((axis, q), at) in machine.axes().iter().zip(&mut state.q).zip(reference) {
        *q = Displacement::from_coordinate(axis.name.kind(), *at).mm_or_rad();
    }
    state
}

fn over([low, high]: [f64; 2]) -> Vec<f64> {
    let share = |target: usize| target as f64 / (TARGETS - 1) as f64;
    (0..TARGETS).map(|target| low + (high - low) * share(target)).collect()
}

/// Rotation from the actual directions of two axes to their nominal directions: exact for the first axis, and in the
/// plane of both for the second. `directions` are pairs of nominal and actual direction, in order of priority.
fn turn(directions: impl Iterator<Item = [Vector3<f64>; 2]>) -> Matrix3<f64> {
    let mut frames = [Matrix3::identity(); 2];
    let mut found = 0;
    for pair in directions {
        let across = |place: usize| {
            let first: Vector3<f64> = frames[place].column(0).into();
            match found {
                0 => pair[place],
                _ => pair[place] - first * first.dot(&pair[place]),
            }
        };
        let across = [across(0), across(1)];
        if across[0].norm() < PARALLEL_BELOW {
            continue;
        }
        for (frame, across) in frames.iter_mut().zip(across) {
            frame.set_column(found, &across.normalize());
        }
        found += 1;
        if found == 2 {
            break;
        }
    }
    let [nominal, actual] = frames.map(|mut frame| {
        let third = frame.column(0).cross(&frame.column(1));
        frame.set_column(2, &third);
        frame
    });
    nominal * actual.transpose()
}

/// The errors of a machine whose axes move along their reference lines: the errors at the reference state `zero`, and
/// from there only the slopes of the straightnesses.
struct ReferenceLines {
    zero: State,
    motions: [ErrorMotion; MAX_AXES],
    locations: [ErrorMotion; MAX_AXES],
    assemblies: [ErrorMotion; MAX_AXES],
    /// Slopes of the straightnesses, mm/mm.
    slopes: [Vector3<f64>; MAX_AXES],
}

impl ReferenceLines {
    fn of(machine: &Machine, zero: State, targets: impl Fn(ErrorName) -> Option<Vec<f64>>) -> Self {
        let none = Temperatures::new();
        let source = machine.source(&none);
        let mut lines = Self {
            zero,
            motions: [ErrorMotion::ZERO; MAX_AXES],
            locations: [ErrorMotion::ZERO; MAX_AXES],
            assemblies: [ErrorMotion::ZERO; MAX_AXES],
            slopes: [Vector3::zeros(); MAX_AXES],
        };
        for (index, axis) in machine.axes().iter().enumerate() {
            lines.motions[index] = source.error_motion(index, &zero);
            lines.locations[index] = source.location(index);
            lines.assemblies[index] = source.assembly(index);
            for component in Component::ALL {
                let error = ErrorName::motion(component, axis.name);
                if MotionKind::of(error) != MotionKind::Straightness {
                    continue;
                }
                let k = component.mcs_index();
                let point = |target: f64| {
                    let mut state = zero;
                    state.q[index] = target;
                    (target, source.error_motion(index, &state).linear_mm[k] * 1e3)
                };
                let targets = targets(error).unwrap_or_else(|| over(axis.travel)).into_iter();
                let points: Vec<(f64, f64)> = targets.map(point).collect();
                // A travel of zero length has no line.
                if let Ok(line) = ReferenceLine::least_squares(&points) {
                    lines.motions[index].linear_mm[k] = line.value_um(zero.q[index]) * 1e-3;
                    lines.slopes[index][k] = line.slope_um_per_mm * 1e-3;
                }
            }
        }
        lines
    }
}

impl ErrorSource for ReferenceLines {
    fn error_motion(&self, axis: usize, state: &State) -> ErrorMotion {
        let mut motion = self.motions[axis];
        motion.linear_mm += self.slopes[axis] * (state.q[axis] - self.zero.q[axis]);
        motion
    }

    fn location(&self, axis: usize) -> ErrorMotion {
        self.locations[axis]
    }

    fn assembly(&self, axis: usize) -> ErrorMotion {
        self.assemblies[axis]
    }
}

/// A measured line on a machine: the pose of the tool side relative to the workpiece side at the
/// measured point, computed from the whole chain with every error.
#[derive(Clone, Debug)]
pub struct LineOfSight<'a> {
    machine: &'a Machine,
    chain: &'a Chain,
    setup: &'a Setup,
    /// State with the held axes at their positions in the test and the measured axis at 0.
    held: State,
    axis: usize,
    /// Frame of the measured axis in MCS, as moved by the held axes.
    carried: Pose,
    /// The measured point m, mm in MCS with the measured axis at 0.
    point_mcs: Vector3<f64>,
    /// Poses of the artefacts on the workpiece side and on the tool side.
    artefacts: [Pose; 2],
}

impl<'a> LineOfSight<'a> {
    /// Creates the line of a set-up on a machine.
    ///
    /// # Errors
    /// An axis that the machine does not have, or coordinates that are not finite.
    pub fn new(machine: &'a Machine, setup: &'a Setup) -> Result<Self, ModelError> {
        let axis = machine.index_of(setup.error.axis)?;
        let names = machine.axes().iter().map(|axis| axis.name);
        let coordinates: Vec<_> = names.zip(setup.at.iter().copied()).collect();
        let held = machine.state(&coordinates)?;
        let chain = machine.chain();
        let carried = chain.carrier_pose(axis, &held);
        let own_point = carried.transform_point(&chain.joints()[axis].point_mm);
        Ok(Self {
            machine,
            chain,
            setup,
            held,
            axis,
            carried,
            point_mcs: setup.point_mcs.map_or(own_point, Vector3::from),
            artefacts: [Pose::identity(); 2],
        })
    }

    /// Replaces the artefacts aligned to the workpiece and tool axes by artefacts that were set up on the machine.
    #[must_use]
    pub fn with_artefacts(mut self, artefacts: &ArtefactPoses) -> Self {
        self.artefacts = [artefacts.workpiece, artefacts.tool];
        self
    }

    /// Index of the measured axis.
    pub fn axis(&self) -> usize {
        self.axis
    }

    /// Ideal command for a coordinate of the measured axis (mm or deg), approached in a direction.
    pub fn state(&self, coordinate: f64, direction: Direction) -> State {
        let mut state = self.held;
        let kind = self.chain.joints()[self.axis].kind;
        state.q[self.axis] = Displacement::from_coordinate(kind, coordinate).mm_or_rad();
        state.approach[self.axis] = Some(direction);
        state
    }

    /// Reading at `target` with the machine commanded to `command`, µm or µrad, in the sign of the error. Positioning
    /// is along the axis (ISO 230-2); other errors are along or about the axes of the frame in which the errors of the
    /// axis are stated.
    pub fn reading(&self, errors: &impl ErrorSource, target: &State, command: &State) -> f64 {
        let [workpiece, tool] = self.sides(target);
        let measured = self.measured_point_mcs(target);
        let on_tool = tool.inverse().transform_point(&measured);
        let actual = self.actual(errors, command);
        let ideal = workpiece * tool;
        let to_frame = self.to_frame(&workpiece);
        let name = self.setup.error;
        let (motion, micro) = if name.component.is_angular() {
            let turned = actual.rotation * ideal.rotation.transpose();
            (to_frame * vector_from_rotation(&turned), 1e6)
        } else {
            let moved = actual.transform_point(&on_tool) - ideal.transform_point(&on_tool);
            (to_frame * moved, 1e3)
        };
        micro
            * match MotionKind::of(name) {
                MotionKind::Positioning => motion.dot(&self.chain.joints()[self.axis].direction),
                _ => motion[name.component.mcs_index()],
            }
    }

    /// Slope of a straightness due to the rotation of a reference on the tool side, µrad. The slope is 0 for all other
    /// errors, and for a straightness with the measured point on the tool side and the reference on the workpiece side.
    pub fn reference_slope_urad(&self, errors: &impl ErrorSource) -> f64 {
        let name = self.setup.error;
        let joint = &self.chain.joints()[self.axis];
        if MotionKind::of(name) != MotionKind::Straightness
            || self.setup.point_is_on_tool_side(joint.side)
        {
            return 0.0;
        }
        let [workpiece, _] = self.sides(&self.held);
        let turn = self.to_frame(&workpiece) * self.reference_turn(errors);
        turn.cross(&joint.direction)[name.component.mcs_index()] * 1e6
    }

    /// Rotation of a straightness reference on the tool side relative to the workpiece, rad in workpiece axes. The reference was aligned to the
    /// workpiece with the linear axes at 0 (or at the end of travel nearest to 0) and the rotary axes at their held positions. The result includes the
    /// rotation of the tool by the errors in that state.
    fn reference_turn(&self, errors: &impl ErrorSource) -> Vector3<f64> {
        let mut aligned = self.held;
        for (axis, q) in self.machine.axes().iter().zip(&mut aligned.q) {
            if axis.name.kind() == AxisKind::Linear {
                *q = axis.nearest_zero();
            }
        }
        let ideal = self.chain.ideal_pose(&aligned);
        let actual = self.actual(errors, &aligned);
        vector_from_rotation(&(actual.rotation * ideal.rotation.transpose()))
    }

    /// Pose of the artefact on the tool side in the frame of the artefact on the workpiece side, with the errors.
    fn actual(&self, errors: &impl ErrorSource, command: &State) -> Pose {
        let [workpiece, tool] = self.artefacts;
        workpiece * actual_pose(self.chain, errors, command) * tool
    }

    /// Rotation from workpiece axes to the frame in which the errors of the axis are stated: the instrument is aligned
    /// along the axis as rotated by the held axes. `workpiece` is the ideal pose of the workpiece side.
    fn to_frame(&self, workpiece: &Pose) -> Matrix3<f64> {
        self.carried.rotation.transpose() * workpiece.rotation.transpose()
    }

    /// Position of the measured point, mm in MCS. The point moves with the carriage if the set-up states so.
    fn measured_point_mcs(&self, state: &State) -> Vector3<f64> {
        let joint = &self.chain.joints()[self.axis];
        let moves = match (joint.side, self.setup.rides) {
            (Side::Tool, Rides::Carriage) => 1.0,
            (Side::Workpiece, Rides::Carriage) => -1.0,
            (_, Rides::Other) => 0.0,
        };
        match joint.kind {
            AxisKind::Linear => {
                let direction = self.carried.rotation * joint.direction;
                self.point_mcs + direction * (moves * state.q[self.axis])
            }
            AxisKind::Rotary => self.point_mcs,
        }
    }

    /// Ideal poses of the workpiece side (MCS in workpiece axes) and of the tool side (tool in MCS).
    fn sides(&self, state: &State) -> [Pose; 2] {
        let mut sides = [Pose::identity(), Pose::identity()];
        for (joint, &q) in self.chain.joints().iter().zip(&state.q) {
            let side = &mut sides[usize::from(joint.side == Side::Tool)];
            *side = *side * joint.motion(q);
        }
        sides
    }
}

/// The errors of a machine whose measured axis has no error motion, while the errors of the other axes keep their values at the held positions. A
/// linear axis moves ideally; the line of a rotary axis keeps its location.
struct HeldOthers<S> {
    of: S,
    own: usize,
    kind: AxisKind,
    held: State,
}

impl<S: ErrorSource> ErrorSource for HeldOthers<S> {
    fn error_motion(&self, axis: usize, _: &State) -> ErrorMotion {
        if axis == self.own {
            return ErrorMotion::ZERO;
        }
        self.of.error_motion(axis, &self.held)
    }

    fn location(&self, axis: usize) -> ErrorMotion {
        if axis == self.own && self.kind == AxisKind::Linear {
            return ErrorMotion::ZERO;
        }
        self.of.location(axis)
    }

    fn assembly(&self, axis: usize) -> ErrorMotion {
        self.of.assembly(axis)
    }
}

/// Readings of a perfect instrument along a line of a machine whose measured axis has no error motion: the contributions of the other errors.
pub(crate) struct OtherErrors<'a> {
    machine: &'a Machine,
    sight: LineOfSight<'a>,
    line: &'a Line,
}

impl<'a> OtherErrors<'a> {
    pub(crate) fn new(
        line: &'a Line,
        machine: &'a Machine,
        artefacts: &ArtefactPoses,
    ) -> Result<Self, ModelError> {
        Ok(Self {
            machine,
            sight: LineOfSight::new(machine, &line.setup)?.with_artefacts(artefacts),
            line,
        })
    }

    /// Readings at targets, µm or µrad; the readings of a linear axis are a straight line.
    pub(crate) fn readings(
        &self,
        targets: impl Iterator<Item = f64>,
    ) -> Result<Vec<f64>, ModelError> {
        let none = Temperatures::new();
        let own = self.sight.axis();
        let others = HeldOthers {
            of: self.machine.source(&none),
            own,
            kind: self.machine.chain().joints()[own].kind,
            held: held_state(self.line, self.machine)?,
        };
        let reading = |target| {
            let state = self.sight.state(target, Direction::Positive);
            self.sight.reading(&others, &state, &state)
        };
        Ok(targets.map(reading).collect())
    }

    /// Slope due to the reference of a straightness, µrad, see [`LineOfSight::reference_slope_urad`].
    pub(crate) fn reference_slope_urad(&self) -> f64 {
        let none = Temperatures::new();
        self.sight.reference_slope_urad(&self.machine.source(&none))
    }
}

/// Profile of a rotary axis without the contributions of its location errors and of the errors of
/// the other axes. Profiles of a linear axis, and readings taken relative to the axis itself, are
/// unchanged.
pub(crate) fn without_others<'a>(
    mut profile: Profile<'a>,
    machine: &Machine,
    artefacts: &ArtefactPoses,
) -> Result<Profile<'a>, ModelError> {
    let line = profile.line;
    if !line.holds_location || line.setup.error.axis.kind() == AxisKind::Linear {
        return Ok(profile);
    }
    let others = OtherErrors::new(line, machine, artefacts)?;
    for branch in &mut profile.points {
        let added = others.readings(branch.iter().map(|(target, _)| *target))?;
        for ((_, value), added) in branch.iter_mut().zip(added) {
            *value -= added;
        }
    }
    Ok(profile)
}
