//! Readings of a perfect instrument along a line on a machine with errors, and the contributions of axes other than the measured one.

use volcomp_kinematics::{
    Chain, ErrorMotion, ErrorSource, Pose, Side, State, actual_pose,
    nalgebra::{Matrix3, Vector3},
    vector_from_rotation,
};
use volcomp_metrology::{MotionKind, Rides};
use volcomp_model::{Machine, ModelError, Temperatures};
use volcomp_vocabulary::{AxisKind, Direction, Displacement};

use crate::{
    abbe::held_state, artefact_poses::ArtefactPoses, calibration_file::Line, profile::Profile,
    setup::Setup,
};

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
