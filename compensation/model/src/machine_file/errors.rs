//! The tables `[errors]` and `[assembly]` of a machine file.

use std::collections::BTreeMap;

use volcomp_document::Section;
use volcomp_vocabulary::{AxisName, ErrorName, UnknownErrorName};

use crate::{
    curve_file::{CurveContext, decode_error_curve},
    error::ModelError,
    machine::Machine,
};

pub(super) fn decode_errors(root: &Section<'_>, machine: &mut Machine) -> Result<(), ModelError> {
    let Some(section) = root.section("errors")? else {
        return Ok(());
    };
    let mut seen: BTreeMap<ErrorName, String> = BTreeMap::new();
    for (key, value) in section.values() {
        let name: ErrorName = key.parse().map_err(|e: UnknownErrorName| {
            let upper = key.to_uppercase();
            value.error(match upper.parse::<ErrorName>() {
                Ok(_) => format!("found `{key}`, expected upper-case letters: `{upper}`"),
                Err(_) => e.to_string(),
            })
        })?;
        if let Some(other) = seen.insert(name, key.to_owned()) {
            return Err(value
                .error(format!("{key} is the same error as {other}"))
                .into());
        }
        let axis = machine
            .axis(name.axis)
            .ok_or_else(|| value.error(machine.lacks(name.axis)))?;
        let set = if name.location {
            if value.section().is_ok() {
                let message = "a location error is one number, never a curve";
                return Err(value.error(message).into());
            }
            let number = value.number()?;
            machine.set_location(name, number)
        } else {
            let context = CurveContext {
                axes: machine.axes(),
                travel: axis.travel,
            };
            let curve = decode_error_curve(&value, &context)?;
            machine.set_error(name, curve)
        };
        set.map_err(|e| match e {
            // The key of the value already names the error.
            ModelError::Refused { reason, .. } => value.error(reason.to_string()),
            other => value.error(other.to_string()),
        })?;
    }
    Ok(())
}

pub(super) fn decode_assembly(root: &Section<'_>, machine: &mut Machine) -> Result<(), ModelError> {
    let Some(section) = root.section("assembly")? else {
        return Ok(());
    };
    for (key, value) in section.values() {
        let six = value.vector::<6>()?;
        let name = key.parse::<AxisName>();
        name.ok()
            .filter(|&name| machine.axis(name).is_some())
            .ok_or_else(|| {
                let structure = machine.chain().structure();
                value.error(format!("the structure `{structure}` has no axis {key}"))
            })
            .map_err(ModelError::from)
            .and_then(|name| machine.set_assembly(name, six))?;
    }
    Ok(())
}
