//! Axes, errors and directions in words.

use volcomp_kinematics::{Joint, MotionFrame, Side, along_machine_axis, nalgebra::Vector3};
use volcomp_vocabulary::{AxisKind, Component, ErrorName};

const LETTERS: [&str; 3] = ["X", "Y", "Z"];

/// A direction in MCS: `+X`, or its three numbers where it lies along none of X, Y, Z.
pub(super) fn direction(u: &Vector3<f64>) -> String {
    match along_machine_axis(u) {
        Some((place, is_positive)) => {
            let sign = if is_positive { '+' } else { '−' };
            format!("{sign}{}", LETTERS[place])
        }
        None => format!("[{:.4}, {:.4}, {:.4}]", u.x, u.y, u.z),
    }
}

/// A description of a positive motion of an axis, as seen from the workpiece and in the workshop.
pub(super) fn motion(joint: &Joint) -> String {
    let name = joint.name;
    let (to, back) = (direction(&joint.direction), direction(&-joint.direction));
    let errors = match joint.motion_frame {
        MotionFrame::Fixed => "",
        MotionFrame::Turning => "; its error motions turn with it",
    };
    match (joint.kind, joint.side) {
        (AxisKind::Linear, Side::Workpiece) => format!(
            "+{name}: the tool moves to {to} seen from the workpiece; the table moves to {back}"
        ),
        (AxisKind::Linear, Side::Tool) => format!("+{name}: the tool moves to {to}"),
        (AxisKind::Rotary, Side::Workpiece) => format!(
            "+{name}: the tool turns right-handed about {to} seen from the workpiece; the table turns right-handed about {back}{errors}"
        ),
        (AxisKind::Rotary, Side::Tool) => {
            format!("+{name}: the tool turns right-handed about {to}{errors}")
        }
    }
}

/// A warning about the signs of the errors of an axis that does not count along its letter's direction: errors are
/// along and about the axes of MCS whatever the direction of the axis. `None` where both agree.
pub(super) fn signs(joint: &Joint) -> Option<String> {
    let (name, along) = (joint.name, joint.name.mcs_index());
    let found = along_machine_axis(&joint.direction);
    if found == Some((along, true)) {
        return None;
    }
    let letter = LETTERS[along];
    let component = Component::ALL.into_iter().find(|component| {
        component.mcs_index() == along && component.is_angular() == name.is_rotary()
    })?;
    let positioning = ErrorName::motion(component, name);
    let too_far = match joint.kind {
        AxisKind::Linear => "goes too far",
        AxisKind::Rotary => "turns too far",
    };
    Some(if found == Some((along, false)) {
        format!(
            "{name} counts against {letter} of the machine, its errors do not: where {name} {too_far} (a positive \
             deviation), {positioning} is negative"
        )
    } else {
        format!(
            "{name} lies aslant, its errors are along and about X, Y and Z of the machine: where {name} {too_far}, \
             more components than {positioning} change"
        )
    })
}

/// An error by what it is, in the words of the conventions: `straightness deviation of X in Y`, `pitch of X`. Pitch
/// and yaw are those of a horizontal axis; a vertical one has tilts.
pub(super) fn meaning(error: ErrorName) -> String {
    let axis = error.axis;
    let along = LETTERS[error.component.mcs_index()];
    let own = error.component.mcs_index() == axis.mcs_index();
    match (error.location, axis.kind(), error.component.is_angular()) {
        (true, AxisKind::Linear, _) => match (error.component, axis.letter()) {
            (Component::EC, 'Y') => "squareness of Y to X".to_owned(),
            (Component::EB, 'Z') => "squareness of Z to X".to_owned(),
            (Component::EA, 'Z') => "squareness of Z to Y".to_owned(),
            _ => format!("tilt of the line of {axis} about {along}"),
        },
        (true, AxisKind::Rotary, false) => format!("shift of the line of {axis} along {along}"),
        (true, AxisKind::Rotary, true) => format!("tilt of the line of {axis} about {along}"),
        (false, AxisKind::Linear, false) if own => format!("positioning deviation of {axis}"),
        (false, AxisKind::Linear, false) => format!("straightness deviation of {axis} in {along}"),
        (false, AxisKind::Linear, true) if own => format!("roll of {axis}"),
        (false, AxisKind::Linear, true) => match (axis.mcs_index(), error.component) {
            (0 | 1, Component::EC) => format!("yaw of {axis}"),
            (0, Component::EB) | (1, Component::EA) => format!("pitch of {axis}"),
            _ => format!("tilt of {axis} about {along}"),
        },
        (false, AxisKind::Rotary, false) if own => format!("axial motion of {axis}"),
        (false, AxisKind::Rotary, false) => format!("radial motion of {axis} along {along}"),
        (false, AxisKind::Rotary, true) if own => {
            format!("angular positioning deviation of {axis}")
        }
        (false, AxisKind::Rotary, true) => format!("tilt of {axis} about {along}"),
    }
}
