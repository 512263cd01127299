//! Decodes the tables `[[location]]`, `[[squareness]]` and `[[observation]]` and the key `unknown` of a calibration
//! file.
//!
//! A squareness may be determined by diagonals.

use std::path::{Path, PathBuf};

use volcomp_document::{InputError, Section, Value, read_text};
use volcomp_identify::{
    Kind, MachinePose, NumberKind, Observation, Observations, Quantity, Row, RowReading, Unknown,
    standard_uncertainty_um,
};
use volcomp_kinematics::nalgebra::Vector3;
use volcomp_kinematics::{
    ErrorMotion, Joint, Pose, Side, State, rotation_about_axis, rotation_from_vector,
    vector_from_rotation,
};
use volcomp_metrology::{
    DeviationUnit, Mapping, Measurement, MetrologyError, read_file_with, squareness_parts,
};
use volcomp_model::{Axis, Machine, Source};
use volcomp_vocabulary::{AxisKind, AxisName, Component, Direction, Displacement, ErrorName, Urad};

use crate::calibration_file::{
    Diagonals, Line, Location, Squareness, SquarenessSource, decode_errors, decode_sign, is_square,
    partner_of, reference_of, set_coordinates, square_of, tilt_of,
};
use crate::checks::{NEVER_ABOVE, refuse_value};
use crate::error::CalibrateError;

pub(crate) fn decode_location(
    section: &Section<'_>,
    machine: &Machine,
    reference_axes: [AxisName; 2],
) -> Result<Vec<Location>, InputError> {
    section.allow(&[
        "error",
        "errors",
        "value_um",
        "value_urad",
        "values_um",
        "values_urad",
        "uncertainty_um",
        "uncertainty_urad",
        "sign",
    ])?;
    let errors = decode_location_errors(section, machine, reference_axes)?;
    let one = section.get("error").is_some();
    let Some(first) = errors.first().copied() else {
        // This case does not occur: there is at least one error.
        return Ok(Vec::new());
    };
    let kind = first.component.kind();
    let unit = first.component.unit();
    let (own, other) = match kind {
        AxisKind::Linear => ("um", "urad"),
        AxisKind::Rotary => ("urad", "um"),
    };
    for wrong in ["value", "values", "uncertainty"].map(|key| format!("{key}_{other}")) {
        if let Some(value) = section.get(&wrong) {
            return Err(value
                .error(format!("{first} is in {unit}, expected the key with the ending _{own}")));
        }
    }
    let key = if one { "value" } else { "values" };
    let unexpected = format!("{}_{own}", if one { "values" } else { "value" });
    if let Some(value) = section.get(&unexpected) {
        return Err(value.error(format!(
            "expected `{key}_{own}` beside `{}`",
            if one { "error" } else { "errors" }
        )));
    }
    let stated = section.require(&format!("{key}_{own}"))?;
    let values = if one { vec![stated.number()?] } else { stated.numbers()? };
    if values.len() != errors.len() {
        return Err(stated.error(format!(
            "found {} values, expected {}: one for each of `errors`",
            values.len(),
            errors.len()
        )));
    }
    for value in &values {
        refuse_value(&stated, kind, *value)?;
    }
    let sign = decode_sign(section)?;
    let uncertainty = section
        .get(&format!("uncertainty_{own}"))
        .map_or(Ok(0.0), |value| standard_uncertainty(&value))?;
    let location =
        |(error, value): (ErrorName, f64)| Location { error, value: sign * value, uncertainty };
    Ok(errors.into_iter().zip(values).map(location).collect())
}

/// Decodes the location errors that a table `[[location]]` names, by `error` or by `errors`: all lengths or all angles.
///
/// # Errors
/// A name that is not a location error, an error without effect, the tilt of a reference axis, lengths and angles
/// together.
pub fn decode_location_errors(
    section: &Section<'_>,
    machine: &Machine,
    reference_axes: [AxisName; 2],
) -> Result<Vec<ErrorName>, InputError> {
    let missing = || section.error("key `error` or `errors` is missing");
    let errors = decode_errors(section, machine, missing, |name, error| {
        check(name, error, machine, reference_axes)
    })?;
    let Some(first) = errors.first() else {
        return Ok(errors); // there is at least one
    };
    let kind = first.component.kind();
    match errors.iter().find(|error| error.component.kind() != kind) {
        Some(other) => Err(section.error(format!(
            "found {first} and {other}, a length and an angle, expected errors of one unit: give each kind its own table"
        ))),
        None => Ok(errors),
    }
}

/// Decodes a standard uncertainty, 0 or more (µm, µrad, µm/m). A value larger than any error of a machine tool is rejected.
pub(crate) fn standard_uncertainty(value: &Value<'_>) -> Result<f64, InputError> {
    let found = value.number()?;
    if found < 0.0 {
        return Err(
            value.error(format!("found {found}, expected a standard uncertainty of 0 or more"))
        );
    }
    if found > NEVER_ABOVE {
        return Err(value.error(format!(
            "found a standard uncertainty of {found}, expected at most {NEVER_ABOVE}: no machine tool is wrong by more, so it would say that nothing is known. Check its unit, or leave out what is not known"
        )));
    }
    Ok(found)
}

/// Rejects a name that is not a location error, an error without effect, and the tilt of a reference axis, which is zero by definition.
fn check(
    name: &Value<'_>,
    error: ErrorName,
    machine: &Machine,
    reference_axes: [AxisName; 2],
) -> Result<(), InputError> {
    if !error.location {
        return Err(name.error(format!(
            "found {error}, expected a location error E?0N; error motions have their own table [[measurement]]"
        )));
    }
    let joint = machine.index_of(error.axis).ok();
    let joint = joint.and_then(|index| machine.chain().joints().get(index));
    if let Some(reason) = joint.and_then(|joint| joint.no_effect(error.component)) {
        return Err(name.error(format!("{error} {reason}")));
    }
    if is_square(error) && reference_of(reference_axes, error) == error.axis {
        let other = ErrorName::location(error.component, partner_of(error));
        return Err(name.error(format!(
            "{error} is 0 by definition, because {} is a reference axis: expected {other}, which is then minus the value of {error}, or other `reference_axes`",
            error.axis
        )));
    }
    Ok(())
}

const SOURCES: [&str; 5] =
    ["value_urad", "reference_angle_urad", "optical_square_urad", "beam_angle_deg", "diagonals"];
/// Maximum deviation of two reference beams from a right angle, deg.
const FAR_FROM_SQUARE_DEG: f64 = 1.0;

/// Decodes the squareness errors of a table. Diagonals of the table are appended to `sets`.
pub(crate) fn decode_squareness(
    section: &Section<'_>,
    machine: &Machine,
    reference_axes: [AxisName; 2],
    folder: &Path,
    sets: &mut Vec<Diagonals>,
) -> Result<Vec<Squareness>, CalibrateError> {
    let own = ["error", "errors", "from", "beams", "uncertainty_um"];
    section.allow(&[&own[..], &SOURCES].concat())?;
    let missing = || section.error("key `error` is missing");
    let errors =
        decode_errors(section, machine, missing, |name, error| check_parts(section, name, error))?;
    let stated: Vec<Value<'_>> = SOURCES.iter().filter_map(|key| section.get(key)).collect();
    if let [first, second, ..] = &stated[..] {
        let message =
            format!("found {} and {} together, expected one of them", last(first), last(second));
        return Err(second.error(message).into());
    }
    let only_with = |key: &str, with: &[&str]| match section.get(key) {
        Some(value) if with.iter().all(|key| section.get(key).is_none()) => {
            let expected = with.join("` or `");
            Err(value.error(format!("expected only with `{expected}`")))
        }
        _ => Ok(()),
    };
    only_with("beams", &["optical_square_urad", "beam_angle_deg"])?;
    only_with("uncertainty_um", &["diagonals"])?;
    only_with("errors", &["diagonals"])?;
    if let Some(value) = section.get("diagonals") {
        let uncertainty_um = section.get("uncertainty_um").map_or(Ok(1.0), |value| {
            standard_uncertainty_um(value.positive()?).map_err(|why| value.error(why))
        })?;
        let names = errors.clone();
        let place = (machine, reference_axes);
        sets.push(decode_diagonals(&value, names, uncertainty_um, place, folder)?);
        let source = SquarenessSource::Diagonals;
        return Ok(errors.into_iter().map(|error| Squareness { error, source }).collect());
    }
    let [error] = errors[..] else {
        // `errors` is valid with diagonals only.
        return Ok(Vec::new());
    };
    let number = |key: &str| {
        let Some(value) = section.get(key) else {
            return Ok(None);
        };
        let found = value.number()?;
        refuse_value(&value, AxisKind::Rotary, found)?;
        Ok::<_, InputError>(Some(found))
    };
    let source = if let Some(value) = number("value_urad")? {
        SquarenessSource::Value(Urad(value))
    } else {
        let opposite = opposite_beams(section, error)?;
        let reference = if let Some(square) = number("optical_square_urad")? {
            if opposite { -square } else { square }
        } else if let Some(value) = section.get("beam_angle_deg") {
            let angle = value.number()?;
            if (angle - 90.0).abs() > FAR_FROM_SQUARE_DEG {
                return Err(value
                    .error(format!("found {angle} deg, expected an angle between 89 and 91 deg"))
                    .into());
            }
            let over = (angle - 90.0).to_radians() * 1e6;
            if opposite { -over } else { over }
        } else {
            number("reference_angle_urad")?.unwrap_or_default()
        };
        SquarenessSource::Slopes { reference_angle: Urad(reference) }
    };
    Ok(vec![Squareness { error, source }])
}

/// Last part of the full key of a value.
fn last<'k>(value: &'k Value<'_>) -> &'k str {
    value.key().rsplit('.').next().unwrap_or_default()
}

/// Rejects an error that is not a squareness, and a `from` that does not name its two straightness errors.
fn check_parts(
    section: &Section<'_>,
    name: &Value<'_>,
    error: ErrorName,
) -> Result<(), InputError> {
    let parts = squareness_parts(error).map_err(|e| name.error(e.to_string()))?;
    let Some(from) = section.get("from") else {
        return Ok(());
    };
    let mut found = from.texts()?;
    let parts = parts.map(|part| part.to_string());
    let mut expected: Vec<&str> = parts.iter().map(String::as_str).collect();
    found.sort_unstable();
    expected.sort_unstable();
    if found == expected {
        return Ok(());
    }
    Err(from.error(format!("found {found:?}, expected {parts:?} for {error}")))
}

/// Whether exactly one of the two beams runs against its axis. The angle between the + directions is then 180° minus
/// the angle between the beams.
fn opposite_beams(section: &Section<'_>, error: ErrorName) -> Result<bool, InputError> {
    let Some(value) = section.get("beams") else {
        return Ok(false);
    };
    let axes = [error.axis, crate::calibration_file::partner_of(error)];
    let mut against = 0;
    let mut seen = Vec::new();
    for word in value.texts()? {
        let (sign, letter) = word.split_at(word.len().min(1));
        let axis = axes.into_iter().find(|axis| axis.to_string() == letter);
        match (sign, axis) {
            ("+" | "-", Some(axis)) if !seen.contains(&axis) => {
                against += usize::from(sign == "-");
                seen.push(axis);
            }
            _ => seen.clear(),
        }
    }
    if seen.len() == 2 {
        return Ok(against == 1);
    }
    let [first, second] = [axes[1], axes[0]];
    Err(value.error(format!(
        "found {:?}, expected the directions in which the light runs along {first} and {second}: [\"+{first}\", \"-{second}\"]",
        value.texts()?
    )))
}

/// Maximum distance of targets beyond the ends of a diagonal, as a fraction of its length: the overrun.
const BEYOND: f64 = 0.02;

fn decode_diagonals(
    value: &Value<'_>,
    errors: Vec<ErrorName>,
    uncertainty_um: f64,
    (machine, reference_axes): (&Machine, [AxisName; 2]),
    folder: &Path,
) -> Result<Diagonals, CalibrateError> {
    let mut found = Observations::of(machine.clone());
    let tilts = errors.iter().map(|error| tilt_of(*error, reference_axes).0);
    found.unknown.extend(tilts.map(Unknown::constant));
    let from_zero = |name: String| Quantity { unknown: true, ..Quantity::new(name, Some(0.0), 0) };
    let scale = from_zero("scale of the diagonals".to_owned());
    let scale = found.setup.add_number(NumberKind::Slope, scale);
    let items = value.items()?;
    if items.len() < 2 {
        return Err(value
            .error(format!(
                "found {} diagonals, expected two face diagonals or the four body diagonals",
                items.len()
            ))
            .into());
    }
    for item in items {
        let section = item.section()?;
        section.allow(&["file", "from", "to"])?;
        let file_value = section.require("file")?;
        let (file, readings) = read_measurement(&file_value, folder, None)?;
        if readings.unit == Some(DeviationUnit::Urad) {
            return Err(file_value.error("the file holds angles, expected lengths").into());
        }
        let [from, to] = ["from", "to"].map(|key| end(&section, key, machine));
        let (from, to) = (from?, to?);
        let offset = from_zero(format!("{}:offset", file.display()));
        let offset = found.setup.add_number(NumberKind::Offset, offset);
        found.observations.push(Observation {
            file: file.display().to_string(),
            kind: Kind::Line,
            judge: false,
            rows: rows(
                &file_value,
                machine,
                (&from, &to),
                (&readings, uncertainty_um),
                [offset, scale],
            )?,
        });
        found.files.push(file);
    }
    Ok(Diagonals { errors, sources: sources_of(folder, &found.files)?, observations: found })
}

/// Decodes the start or end of a diagonal, mm or deg by index of the axis.
fn end(section: &Section<'_>, key: &str, machine: &Machine) -> Result<Vec<f64>, InputError> {
    let mut coordinates = vec![0.0; machine.axes().len()];
    let value = section.require(key)?;
    set_coordinates(&mut coordinates, &value.section()?, machine)?;
    Ok(coordinates)
}

/// One row per mean reading of a diagonal, with its standard uncertainty, µm. `offset` and `scale`
/// are indices into the numbers of the set-up.
fn rows(
    file: &Value<'_>,
    machine: &Machine,
    (from, to): (&[f64], &[f64]),
    (readings, uncertainty_um): (&Measurement, f64),
    [offset, scale]: [usize; 2],
) -> Result<Vec<Row>, CalibrateError> {
    let names = || machine.axes().iter().map(|axis| axis.name);
    for ((name, from), to) in names().zip(from).zip(to) {
        if name.is_rotary() && from != to {
            let message = format!(
                "{name} turns along this diagonal, expected the same angle in `from` and `to`"
            );
            return Err(file.error(message).into());
        }
    }
    let state_at = |share: f64| -> Result<State, CalibrateError> {
        let between = from.iter().zip(to).map(|(from, to)| from + share * (to - from));
        let coordinates: Vec<(AxisName, f64)> = names().zip(between).collect();
        Ok(machine.state(&coordinates)?)
    };
    let chain = machine.chain();
    let way: Vector3<f64> =
        chain.ideal_tip_mm(&state_at(1.0)?) - chain.ideal_tip_mm(&state_at(0.0)?);
    let length = way.norm();
    let Some(direction) = way.try_normalize(1e-9) else {
        return Err(file
            .error("`from` and `to` are the same place, expected the ends of a diagonal")
            .into());
    };
    let targets = readings.targets();
    let (first, last) = (targets.first().copied(), targets.last().copied());
    let (first, last) = (first.unwrap_or_default(), last.unwrap_or_default());
    if first < -BEYOND * length || last > (1.0 + BEYOND) * length {
        return Err(file
            .error(format!(
                "found targets from {first} to {last} mm, expected distances from the beginning of the diagonal, 0 to {length:.1} mm"
            ))
            .into());
    }
    let both = Direction::BOTH.iter().all(|direction| readings.has(*direction));
    let forward = readings.has(Direction::Positive);
    let mut rows = Vec::new();
    for (target, mean_um) in readings.mean_curve() {
        let mut state = state_at(target / length)?;
        for (approach, (from, to)) in state.approach.iter_mut().zip(from.iter().zip(to)) {
            // With readings in both directions each row is their mean. Without an approach, the model uses the mean of
            // both branches.
            if !both && from != to {
                *approach = Some(if (to > from) == forward {
                    Direction::Positive
                } else {
                    Direction::Negative
                });
            }
        }
        rows.push(Row {
            line: 0,
            pose: MachinePose { state, tip_mm: chain.tool_tip_mm() },
            reading: RowReading::Line {
                direction,
                offset,
                slope: scale,
                deviation_mm: Displacement::from_micro(
                    volcomp_vocabulary::AxisKind::Linear,
                    mean_um,
                )
                .mm_or_rad(),
            },
            run: None,
            time: 0.0,
            uncertainty_mm: uncertainty_um * 1e-3,
        });
    }
    Ok(rows)
}

/// Reads the measurement file that a value names.
pub(crate) fn read_measurement(
    value: &Value<'_>,
    folder: &Path,
    mapping: Option<&Mapping>,
) -> Result<(PathBuf, Measurement), CalibrateError> {
    let file = folder.join(value.text()?);
    let readings = read_file_with(&file, mapping).map_err(|error| match error {
        // Such a file name is an error of the calibration file, so the message refers to the calibration file.
        MetrologyError::Unreadable { .. }
        | MetrologyError::Directory { .. }
        | MetrologyError::Extension { .. }
        | MetrologyError::TooLarge { .. } => value.error(error.to_string()).into(),
        inside => CalibrateError::from(inside),
    })?;
    readings.check_directions()?;
    Ok((file, readings))
}

pub(crate) fn sources_of(folder: &Path, paths: &[PathBuf]) -> Result<Vec<Source>, CalibrateError> {
    let read = |path: &PathBuf| {
        let name = path.strip_prefix(folder).unwrap_or(path);
        let read = Source::read(&name.display().to_string(), path);
        read.map_err(|source| CalibrateError::Hash { file: path.clone(), source })
    };
    paths.iter().map(read).collect()
}

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
