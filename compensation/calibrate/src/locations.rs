//! What the location errors of a rotary axis add to readings that are taken against the commanded pose.

use volcomp_kinematics::{
    ErrorMotion, ErrorSource, Joint, Pose, Side, nalgebra::Vector3, rotation_about_axis,
    rotation_from_vector, vector_from_rotation,
};
use volcomp_metrology::MotionKind;
use volcomp_model::{Machine, ModelError, Temperatures};
use volcomp_vocabulary::{AxisKind, Displacement, Urad};

use crate::{
    abbe::measured_point, calibration_file::CalibrationFile, location_file::is_square,
    profile::Profile, squares::set_square,
};

/// The machine of a calibration file with the location errors that the file states. The tilt of a squareness states all
/// of it: what the machine file had for the other axis of the pair goes.
pub(crate) fn located(file: &CalibrationFile) -> Result<Machine, ModelError> {
    let mut machine = file.machine.clone();
    for location in &file.locations {
        if is_square(location.error) {
            let value = Urad(location.value);
            set_square(&mut machine, file.reference_axes, location.error, value)?;
        } else {
            machine.set_location(location.error, location.value)?;
        }
    }
    Ok(machine)
}

/// How far a rotary axis at the angle `q_rad` stands from the commanded pose because its line lies elsewhere, in the frame
/// that carries it: M·M_ideal⁻¹ on the tool side, M_ideal⁻¹·M on the workpiece side, where the axis turns the other way
/// as the bed sees it. The identity for a linear axis, and at 0.
pub(crate) fn displaced(joint: &Joint, location: &ErrorMotion, q_rad: f64) -> Pose {
    if joint.kind == AxisKind::Linear {
        return Pose::identity();
    }
    let direction = rotation_from_vector(&location.angular_rad) * joint.direction;
    let actual = Pose::about_point(
        rotation_about_axis(&direction, q_rad),
        joint.point_mm + location.linear_mm,
    );
    let back = joint.motion(q_rad).inverse();
    match joint.side {
        Side::Tool => actual * back,
        Side::Workpiece => back * actual,
    }
}

/// A profile of a rotary axis without what its location errors add; unchanged for a linear axis, and where the readings
/// were taken against the axis itself.
pub(crate) fn without_location<'a>(
    mut profile: Profile<'a>,
    machine: &Machine,
) -> Result<Profile<'a>, ModelError> {
    let line = profile.line;
    let error = line.setup.error;
    let index = machine.index_of(error.axis)?;
    let joint = machine.chain().joints()[index];
    if !line.holds_location || joint.kind == AxisKind::Linear {
        return Ok(profile);
    }
    let none = Temperatures::new();
    let location = machine.source(&none).location(index);
    let point = measured_point(line, machine)?;
    for (target, value) in profile.points.iter_mut().flatten() {
        let q_rad = Displacement::from_coordinate(joint.kind, *target).mm_or_rad();
        *value -= reading(&displaced(&joint, &location, q_rad), &joint, error, &point);
    }
    Ok(profile)
}

/// What an instrument that measures `error` at a point (mm in the frame that carries the axis) reads of a displacement, µm
/// or µrad.
fn reading(
    displaced: &Pose,
    joint: &Joint,
    error: volcomp_vocabulary::ErrorName,
    point_mm: &Vector3<f64>,
) -> f64 {
    let (motion, micro) = if error.component.is_angular() {
        (vector_from_rotation(&displaced.rotation), 1e6)
    } else {
        (displaced.transform_point(point_mm) - point_mm, 1e3)
    };
    micro
        * match MotionKind::of(error) {
            MotionKind::Positioning => motion.dot(&joint.direction),
            _ => motion[error.component.mcs_index()],
        }
}
