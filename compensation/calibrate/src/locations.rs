//! What the location errors of a rotary axis add to readings that are taken against the commanded pose.

use volcomp_kinematics::{
    ErrorMotion, Joint, Pose, Side, rotation_about_axis, rotation_from_vector,
};
use volcomp_model::{Machine, ModelError};
use volcomp_vocabulary::{AxisKind, Urad};

use crate::{
    calibration_file::CalibrationFile, location_file::is_square, others::OtherErrors,
    profile::Profile, set_up::SetUp, squares::set_square,
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

/// A profile of a rotary axis without what its location errors and the errors of the other axes add; unchanged for a linear
/// axis, and where the readings were taken against the axis itself.
pub(crate) fn without_others<'a>(
    mut profile: Profile<'a>,
    machine: &Machine,
    set_up: &SetUp,
) -> Result<Profile<'a>, ModelError> {
    let line = profile.line;
    if !line.holds_location || line.setup.error.axis.kind() == AxisKind::Linear {
        return Ok(profile);
    }
    let others = OtherErrors::new(line, machine, set_up)?;
    for branch in &mut profile.points {
        let added = others.readings(branch.iter().map(|(target, _)| *target))?;
        for ((_, value), added) in branch.iter_mut().zip(added) {
            *value -= added;
        }
    }
    Ok(profile)
}
