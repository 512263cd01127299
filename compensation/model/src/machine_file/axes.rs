//! The structure, the axes, and the key `correct`.

use volcomp_document::{InputError, Section, Value};
use volcomp_kinematics::{MotionFrame, Structure};
use volcomp_vocabulary::{AxisKind, AxisName};

use crate::{axis::Axis, error::ModelError, machine::Machine};

pub(super) fn decode_structure(root: &Section<'_>) -> Result<Structure, InputError> {
    match (root.get("structure"), root.section("type")?) {
        (Some(value), None) => value
            .text()?
            .parse()
            .map_err(|e: volcomp_kinematics::StructureError| value.error(e.to_string())),
        (None, Some(section)) => {
            section.allow(&["translational", "rotary", "rotary_axes"])?;
            // `Structure` rejects numbers above 3.
            let number = |key: &str| section.whole_or(key, 0..=u8::MAX, 0);
            section.require("translational")?;
            let rotary_axes = section
                .get("rotary_axes")
                .map_or_else(|| Ok(Vec::new()), |v| v.items())?
                .iter()
                .map(decode_axis_name)
                .collect::<Result<Vec<_>, _>>()?;
            Structure::from_type(number("translational")?, number("rotary")?, &rotary_axes)
                .map_err(|e| section.error(e.to_string()))
        }
        (Some(value), Some(_)) => {
            Err(value.error("found structure and [type] together, expected one of them"))
        }
        (None, None) => Err(root.error("key `structure` (or table [type]) is missing")),
    }
}

fn decode_axis_name(value: &Value<'_>) -> Result<AxisName, InputError> {
    let text = value.text()?;
    text.parse().map_err(|_| {
        value.error(format!(
            "found \"{text}\", expected an axis letter: X Y Z A B C U V W"
        ))
    })
}

pub(super) fn decode_axes(
    root: &Section<'_>,
    structure: &Structure,
) -> Result<Vec<Axis>, InputError> {
    let section = root.require("axes")?.section()?;
    for (key, value) in section.values() {
        if key
            .parse()
            .map_or(true, |name| structure.index_of(name).is_none())
        {
            let upper = key.to_uppercase();
            let is_lower_case = upper != key && upper.parse::<AxisName>().is_ok();
            return Err(value.error(if is_lower_case {
                format!("found `{key}`, expected an upper-case letter: `{upper}`")
            } else {
                format!("the structure `{structure}` has no axis {key}")
            }));
        }
    }
    let decode =
        |&name: &AxisName| decode_axis(&section.require(&name.to_string())?.section()?, name);
    structure.axes().iter().map(decode).collect()
}

fn decode_axis(section: &Section<'_>, name: AxisName) -> Result<Axis, InputError> {
    section.allow(&["travel", "point", "direction", "modulo", "motion_frame"])?;
    let travel_value = section.require("travel")?;
    let travel: [f64; 2] = travel_value.vector()?;
    if travel[0] >= travel[1] {
        return Err(travel_value.error(format!(
            "found [{:?}, {:?}], expected the lower end below the upper end",
            travel[0], travel[1]
        )));
    }
    let modulo = section.optional("modulo", |value| {
        let period = value.number()?;
        if name.kind() == AxisKind::Rotary && period > 0.0 {
            return Ok(period);
        }
        Err(value.error(format!(
            "found {period:?} on axis {name}, expected a positive period in deg on a rotary axis"
        )))
    })?;
    let motion_frame = section.optional("motion_frame", |value| {
        let words = [
            ("fixed", MotionFrame::Fixed),
            ("turning", MotionFrame::Turning),
        ];
        let frame = value.one_of(&words)?;
        if name.kind() == AxisKind::Rotary {
            return Ok(frame);
        }
        Err(value.error(format!(
            "found a motion frame on axis {name}, whose error motions ride with its carriage, expected it on a rotary axis"
        )))
    })?;
    Ok(Axis {
        name,
        travel,
        modulo,
        direction: section.optional("direction", decode_direction)?,
        point_mm: section.optional("point", Value::vector)?,
        motion_frame: motion_frame.unwrap_or_default(),
    })
}

/// A direction of any non-zero length.
pub(super) fn decode_direction(value: &Value<'_>) -> Result<[f64; 3], InputError> {
    let direction = value.vector()?;
    if direction == [0.0; 3] {
        return Err(value.error("found a zero direction, expected a vector of any other length"));
    }
    Ok(direction)
}

/// The key `correct`; errors point at the single names.
pub(super) fn decode_correct(root: &Section<'_>, machine: &mut Machine) -> Result<(), InputError> {
    let Some(value) = root.get("correct") else {
        return Ok(());
    };
    let mut axes: Vec<AxisName> = Vec::new();
    for item in value.items()? {
        let axis = decode_axis_name(&item)?;
        axes.push(axis);
        match machine.set_correct(Some(&axes)) {
            Ok(()) => {}
            Err(ModelError::NoSuchAxis { structure, .. }) => {
                return Err(item.error(format!("the structure `{structure}` has no axis {axis}")));
            }
            Err(error) => return Err(item.error(error.to_string())),
        }
    }
    machine
        .set_correct(Some(&axes))
        .map_err(|e| value.error(e.to_string()))
}
