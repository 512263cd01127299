//! Abbe's principle on a measured line: the contribution of the tilts of its axis to its readings.

use volcomp_kinematics::{ErrorSource, Joint, Side, State, nalgebra::Vector3};
use volcomp_metrology::{CarriedSide, MotionKind, Rides, Travel, abbe_um, lever_mm};
use volcomp_model::{Machine, ModelError, Temperatures};
use volcomp_vocabulary::{AxisKind, Direction, Displacement};

use crate::{calibration_file::Line, profile::Profile};

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
pub(crate) fn measured_point(line: &Line, machine: &Machine) -> Result<Vector3<f64>, ModelError> {
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
pub(crate) fn held_state(line: &Line, machine: &Machine) -> Result<State, ModelError> {
    let names = machine.axes().iter().map(|axis| axis.name);
    let coordinates: Vec<_> = names.zip(line.setup.at.iter().copied()).collect();
    machine.state(&coordinates)
}
