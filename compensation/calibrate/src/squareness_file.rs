//! The tables `[[squareness]]` of a calibration file.

use std::path::Path;

use volcomp_document::{InputError, Section, Value};
use volcomp_identify::standard_uncertainty_um;
use volcomp_metrology::squareness_parts;
use volcomp_model::Machine;
use volcomp_vocabulary::{AxisKind, AxisName, ErrorName, Urad};

use crate::{
    calibration_file::{Squareness, SquarenessSource},
    checks::refuse_value,
    diagonals::{Diagonals, decode_diagonals},
    error::CalibrateError,
    setup_file::decode_errors,
};

/// The keys of which a squareness has one at the most.
const SOURCES: [&str; 5] = [
    "value_urad",
    "reference_angle_urad",
    "optical_square_urad",
    "beam_angle_deg",
    "diagonals",
];
/// Two beams that are further from a right angle are no reference of it, deg.
const FAR_FROM_SQUARE_DEG: f64 = 1.0;

/// The squareness errors of one table; `sets` takes its diagonals, where it has some.
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
    let errors = decode_errors(section, machine, missing, |name, error| {
        check_parts(section, name, error)
    })?;
    let stated: Vec<Value<'_>> = SOURCES.iter().filter_map(|key| section.get(key)).collect();
    if let [first, second, ..] = &stated[..] {
        let message = format!(
            "found {} and {} together, expected one of them",
            last(first),
            last(second)
        );
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
        sets.push(decode_diagonals(
            &value,
            names,
            uncertainty_um,
            place,
            folder,
        )?);
        let source = SquarenessSource::Diagonals;
        return Ok(errors
            .into_iter()
            .map(|error| Squareness { error, source })
            .collect());
    }
    let [error] = errors[..] else {
        // `errors` stands with diagonals only.
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
                    .error(format!(
                        "found {angle} deg, expected an angle between 89 and 91 deg"
                    ))
                    .into());
            }
            let over = (angle - 90.0).to_radians() * 1e6;
            if opposite { -over } else { over }
        } else {
            number("reference_angle_urad")?.unwrap_or_default()
        };
        SquarenessSource::Slopes {
            reference_angle: Urad(reference),
        }
    };
    Ok(vec![Squareness { error, source }])
}

/// The last part of the key of a value.
fn last<'k>(value: &'k Value<'_>) -> &'k str {
    value.key().rsplit('.').next().unwrap_or_default()
}

/// Refuses an error that is no squareness, and a `from` that does not name its two straightness errors.
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

/// Whether just one of the two beams runs against its axis: then the angle between the light's directions is 180° less
/// the angle between the plus directions.
fn opposite_beams(section: &Section<'_>, error: ErrorName) -> Result<bool, InputError> {
    let Some(value) = section.get("beams") else {
        return Ok(false);
    };
    let axes = [error.axis, crate::squares::partner_of(error)];
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
