//! Keys `unknown` and `[[observation]]` of a calibration file: errors to be identified from observations of the whole
//! machine, in addition to the errors that lines and instruments measure directly.

use std::path::Path;

use volcomp_document::{InputError, Section, Value, read_text};
use volcomp_identify::{Observations, Unknown};
use volcomp_kinematics::{
    ErrorMotion, Joint, Pose, Side, rotation_about_axis, rotation_from_vector, vector_from_rotation,
};
use volcomp_model::{Axis, Machine};
use volcomp_vocabulary::{AxisKind, Component, Direction, Displacement, ErrorName};

use crate::{
    calibration_file::{Line, Location, Squareness},
    error::CalibrateError,
    squareness::square_of,
};

/// Relative size below which the effect of a location error on an error motion is neglected; the reference is its
/// effect on other error motions.
const NOTHING: f64 = 1e-6;

/// Errors that a calibration file states directly: lines, squareness and location errors.
pub(crate) struct Direct<'a> {
    pub(crate) measurements: &'a [Line],
    pub(crate) squareness: &'a [Squareness],
    pub(crate) locations: &'a [Location],
}

/// Unknowns and observations of a calibration file; `None` if it has none.
pub(crate) fn decode_observations(
    root: &Section<'_>,
    machine: &Machine,
    folder: &Path,
    direct: &Direct<'_>,
) -> Result<Option<Observations>, CalibrateError> {
    let has = |key: &str| root.get(key).is_some();
    if !has("unknown") && !has("observation") {
        for key in Observations::KEYS {
            if let Some(value) = root.get(key) {
                let message = "expected only together with `unknown` and [[observation]]";
                return Err(value.error(message).into());
            }
        }
        return Ok(None);
    }
    let found = Observations::of_section(root, machine, folder, &read_text)?;
    let items = root.require("unknown")?.items()?;
    for item in items {
        let name = match item.section() {
            Ok(section) => section.require("error")?,
            Err(_) => item.clone(),
        };
        let error = machine.decode_error(&name)?;
        let unknown = found.unknown.iter().find(|unknown| unknown.error == error);
        if let Some(unknown) = unknown {
            refuse_twice(&name, *unknown, direct)?;
            refuse_held(&name, error, machine, direct)?;
        }
    }
    Ok(Some(found))
}

/// Rejects an unknown that is also stated directly. A reversal value may be an unknown if the lines ran in one
/// direction only.
fn refuse_twice(name: &Value<'_>, unknown: Unknown, direct: &Direct<'_>) -> Result<(), InputError> {
    let error = unknown.error;
    let square = square_of(error);
    let lines = direct.measurements.iter();
    let both = |line: &&Line| {
        let readings = &line.readings;
        Direction::BOTH.iter().all(|direction| readings.has(*direction))
    };
    let line = lines
        .filter(|line| line.setup.error == error)
        .find(|line| unknown.basis.is_some() || both(line));
    let stated = if let Some(line) = line {
        format!("[[measurement]] with {}", line.file.display())
    } else if direct.locations.iter().any(|l| square_of(l.error) == square) {
        "[[location]]".to_owned()
    } else if direct.squareness.iter().any(|s| s.error == square) {
        "[[squareness]]".to_owned()
    } else {
        return Ok(());
    };
    Err(name
        .error(format!("{error} is unknown here and measured by {stated}: expected one of them")))
}

/// Rejects a location error of a rotary axis as an unknown if every error motion to which the location error
/// contributes was measured along a line that contains its contribution: no observation can separate the two.
fn refuse_held(
    name: &Value<'_>,
    error: ErrorName,
    machine: &Machine,
    direct: &Direct<'_>,
) -> Result<(), InputError> {
    let index = machine.index_of(error.axis).ok();
    let joint = index.and_then(|index| machine.chain().joints().get(index));
    let (Some(joint), Some(axis)) = (joint, machine.axis(error.axis)) else {
        return Ok(());
    };
    if !error.location || joint.kind == AxisKind::Linear {
        return Ok(());
    }
    let parts = parts_of(joint, error.component, axis);
    let holding = |motion: &ErrorName| {
        let lines = direct.measurements.iter();
        let mut lines = lines.filter(|line| line.setup.error == *motion && line.holds_location);
        lines.next().map(|line| line.file.display().to_string())
    };
    let files: Option<Vec<String>> = parts.iter().map(holding).collect();
    match files {
        Some(files) if !files.is_empty() => {
            let motions: Vec<String> = parts.iter().map(ErrorName::to_string).collect();
            Err(name.error(format!(
                "{error} is unknown here, and the lines of {} ({}) hold it, because they were taken against the commanded pose: the two cannot be separated. Leave it out, or state `holds_location = false` where the instrument was centred on the axis",
                motions.join(" and "),
                files.join(", ")
            )))
        }
        _ => Ok(()),
    }
}

/// Error motions to which a location error of a rotary axis contributes, at the point of the axis
/// over its travel.
fn parts_of(joint: &Joint, component: Component, axis: &Axis) -> Vec<ErrorName> {
    const NODES: usize = 8;
    const SIZE: f64 = 1.0;
    let mut six = [0.0; 6];
    six[component.index()] = SIZE;
    let location = ErrorMotion::from_um_urad(six);
    let mut largest = [0.0_f64; 6];
    for at in axis.nodes(NODES) {
        let q_rad = Displacement::from_coordinate(joint.kind, at).mm_or_rad();
        let pose = displaced(joint, &location, q_rad);
        let moved = (pose.transform_point(&joint.point_mm) - joint.point_mm) * 1e3;
        let turned = vector_from_rotation(&pose.rotation) * 1e6;
        let parts = moved.iter().chain(turned.iter());
        for (largest, part) in largest.iter_mut().zip(parts) {
            *largest = largest.max(part.abs());
        }
    }
    let most = largest.iter().copied().fold(0.0, f64::max);
    let named = Component::ALL.into_iter().zip(largest);
    named
        .filter(|(_, part)| *part > NOTHING.max(1e-3 * most))
        .map(|(component, _)| ErrorName::motion(component, joint.name))
        .collect()
}

/// Displacement of a rotary axis at the angle `q_rad` from the commanded pose, caused by the location of its line, in
/// the frame that carries it: M·M_ideal⁻¹ on the tool side; M_ideal⁻¹·M on the workpiece side, where the axis rotates
/// in the opposite sense as seen from the bed. Identity for a linear axis and for an angle of 0.
fn displaced(joint: &Joint, location: &ErrorMotion, q_rad: f64) -> Pose {
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
