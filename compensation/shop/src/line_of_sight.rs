//! The readings of a perfect instrument along a line on a machine with errors.

use volcomp_calibrate::Setup;
use volcomp_kinematics::{
    Chain, ErrorSource, Pose, Side, State, actual_pose,
    nalgebra::{Matrix3, Vector3},
    vector_from_rotation,
};
use volcomp_metrology::{MotionKind, Rides};
use volcomp_model::{Machine, ModelError};
use volcomp_vocabulary::{AxisKind, Direction};

/// A measured line laid through a machine: the tool side relative to the workpiece side at the
/// measured point, from the whole chain with every error in it.
#[derive(Clone, Debug)]
pub struct LineOfSight<'a> {
    chain: &'a Chain,
    setup: &'a Setup,
    /// The held axes, the measured one at 0.
    held: State,
    axis: usize,
    /// The measured point m, mm in MCS with the measured axis at 0.
    point_mcs: Vector3<f64>,
}

impl<'a> LineOfSight<'a> {
    /// The line of a set-up on a machine.
    ///
    /// # Errors
    /// An axis that the machine does not have, coordinates that are not finite.
    pub fn new(machine: &'a Machine, setup: &'a Setup) -> Result<Self, ModelError> {
        let axis = machine.index_of(setup.error.axis)?;
        let names = machine.axes().iter().map(|axis| axis.name);
        let coordinates: Vec<_> = names.zip(setup.at.iter().copied()).collect();
        let held = machine.state(&coordinates)?;
        let chain = machine.chain();
        Ok(Self {
            chain,
            setup,
            held,
            axis,
            point_mcs: setup
                .point_mcs
                .map_or_else(|| carried_point(chain, axis, &held), Vector3::from),
        })
    }

    /// The ideal command for a coordinate of the measured axis (mm or deg), approached in a direction.
    pub fn state(&self, coordinate: f64, direction: Direction) -> State {
        let mut state = self.held;
        state.q[self.axis] = match self.chain.joints()[self.axis].kind {
            AxisKind::Linear => coordinate,
            AxisKind::Rotary => coordinate.to_radians(),
        };
        state.approach[self.axis] = Some(direction);
        state
    }

    /// The reading at a target when `command` is commanded for it, µm or µrad, in the sign of the
    /// error; positioning along the axis (ISO 230-2).
    pub fn reading(&self, errors: &impl ErrorSource, target: &State, command: &State) -> f64 {
        let [workpiece, tool] = self.sides(target);
        let measured = self.measured_point_mcs(target);
        let on_tool = tool.inverse().transform_point(&measured);
        let actual = actual_pose(self.chain, errors, command);
        let ideal = workpiece * tool;
        let to_mcs: Matrix3<f64> = workpiece.rotation.transpose();
        let name = self.setup.error;
        let (motion, micro) = if name.component.is_angular() {
            let turned = actual.rotation * ideal.rotation.transpose();
            (to_mcs * vector_from_rotation(&turned), 1e6)
        } else {
            let moved = actual.transform_point(&on_tool) - ideal.transform_point(&on_tool);
            (to_mcs * moved, 1e3)
        };
        micro
            * match MotionKind::of(name) {
                MotionKind::Positioning => motion.dot(&self.chain.joints()[self.axis].direction),
                _ => motion[name.component.mcs_index()],
            }
    }

    /// Where the measured point is: it moves with the component that it stands on.
    fn measured_point_mcs(&self, state: &State) -> Vector3<f64> {
        let joint = &self.chain.joints()[self.axis];
        let moves = match (joint.side, self.setup.rides) {
            (Side::Tool, Rides::Carriage) => 1.0,
            (Side::Workpiece, Rides::Carriage) => -1.0,
            (_, Rides::Other) => 0.0,
        };
        match joint.kind {
            AxisKind::Linear => self.point_mcs + joint.direction * (moves * state.q[self.axis]),
            AxisKind::Rotary => self.point_mcs,
        }
    }

    /// The ideal poses of the workpiece side (MCS in workpiece axes) and of the tool side (tool in
    /// MCS).
    fn sides(&self, state: &State) -> [Pose; 2] {
        let mut sides = [Pose::identity(), Pose::identity()];
        for (joint, &q) in self.chain.joints().iter().zip(&state.q) {
            let side = &mut sides[usize::from(joint.side == Side::Tool)];
            *side = *side * joint.motion(q);
        }
        sides
    }
}

/// The axis's own point where the held axes have carried it, MCS.
fn carried_point(chain: &Chain, axis: usize, held: &State) -> Vector3<f64> {
    let joints = chain.joints();
    let side = joints[axis].side;
    let chained = joints.iter().zip(&held.q).enumerate();
    let carriers = chained.filter(|(index, (joint, _))| {
        joint.side == side && (*index < axis) == (side == Side::Tool) && *index != axis
    });
    let pose = carriers.fold(Pose::identity(), |pose, (_, (joint, &q))| {
        pose * joint.motion(q)
    });
    match side {
        Side::Tool => pose.transform_point(&joints[axis].point_mm),
        Side::Workpiece => pose.inverse().transform_point(&joints[axis].point_mm),
    }
}
