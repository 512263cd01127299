//! The tables `[[location]]` of a calibration file: where an axis lies, as an instrument gave it.

use volcomp_document::{InputError, Section, Value};
use volcomp_model::Machine;
use volcomp_vocabulary::{AxisKind, AxisName, Component, ErrorName};

use crate::{
    calibration_file::Location,
    checks::{NEVER_ABOVE, refuse_value},
    setup_file::{decode_errors, decode_sign},
    squares::{partner_of, reference_of},
};

/// The location errors that one table states.
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
        // There is at least one.
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
            return Err(value.error(format!(
                "{first} is in {unit}, expected the key with the ending _{own}"
            )));
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
    let values = if one {
        vec![stated.number()?]
    } else {
        stated.numbers()?
    };
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
    let location = |(error, value): (ErrorName, f64)| Location {
        error,
        value: sign * value,
        uncertainty,
    };
    Ok(errors.into_iter().zip(values).map(location).collect())
}

/// The location errors that a table `[[location]]` names, by `error` or by `errors`: all lengths or all angles.
///
/// # Errors
/// What is no location error, what moves nothing, the tilt of a reference axis, lengths and angles together.
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

/// A standard uncertainty, 0 or more (µm, µrad, µm/m). One that is larger than any error of a machine says nothing, and a correction with
/// its band would be none.
pub(crate) fn standard_uncertainty(value: &Value<'_>) -> Result<f64, InputError> {
    let found = value.number()?;
    if found < 0.0 {
        return Err(value.error(format!(
            "found {found}, expected a standard uncertainty of 0 or more"
        )));
    }
    if found > NEVER_ABOVE {
        return Err(value.error(format!(
            "found a standard uncertainty of {found}, expected at most {NEVER_ABOVE}: no machine tool is wrong by more, so it would say that nothing is known. Check its unit, or leave out what is not known"
        )));
    }
    Ok(found)
}

/// Refuses what is no location error, what moves nothing, and the tilt of a reference axis, which is zero by definition.
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

/// Whether a location error is one of the tilts of X, Y and Z that make their squareness.
pub fn is_square(error: ErrorName) -> bool {
    volcomp_metrology::opening(error).is_some()
}

/// The name of the squareness that a tilt of X, Y or Z belongs to, so that both tilts of a pair have one name: `EC0X`
/// and `EC0Y` are `EC0Y`. Every other error is itself.
pub(crate) fn square_of(error: ErrorName) -> ErrorName {
    if !is_square(error) {
        return error;
    }
    let axis = match error.component {
        Component::EC => AxisName::Y,
        _ => AxisName::Z,
    };
    ErrorName::location(error.component, axis)
}
