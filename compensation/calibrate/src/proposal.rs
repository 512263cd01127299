//! What one file of a folder is proposed as, by what its header, its ending and its name say.

use std::path::Path;

use volcomp_metrology::{Measurement, Metadata, Quantity, axis_named};
use volcomp_model::{Axis, Machine};
use volcomp_vocabulary::{AxisName, Component, ErrorName};

use crate::{
    checks::{beyond_travel, other_machine},
    draft::Proposed,
    draft_keys::Told,
    hints::Hints,
};

/// A log of which nobody said which channel is what.
pub(crate) fn of_log(name: String, path: &Path, machine: &Machine, channels: &str) -> Proposed {
    let hints = Hints::of(path, &Metadata::default(), machine);
    let told = Told {
        is_log: true,
        ..told(&hints, machine)
    };
    let mut found = proposed(name, hints.only_error(), told);
    found.said.push(format!("a log of the channels {channels}"));
    found.said.extend(hints.contradictions);
    found
}

/// What a file with readings is proposed as, or why it fits nothing.
pub(crate) fn of_measurement(
    name: &str,
    path: &Path,
    measurement: &Measurement,
    machine: &Machine,
) -> Result<Proposed, String> {
    let hints = Hints::of(path, &measurement.metadata, machine);
    let stated = measurement.metadata.axis.as_deref().and_then(axis_named);
    if let Some(axis) = stated.filter(|axis| machine.axis(*axis).is_none()) {
        return Err(format!(
            "it states axis {axis}, which the machine does not have"
        ));
    }
    let axis = stated.or(hints.axis);
    let mut said = vec![facts(measurement)];
    let mut candidates = match axis {
        Some(axis) => candidates(axis, measurement.quantity),
        None => Vec::new(),
    };
    let error = match hints.only_error() {
        Some(hinted) if stated.is_some_and(|axis| axis != hinted.axis) => {
            said.push(format!(
                "CONTRADICTION: the file states axis {}, its name or title says {hinted}",
                stated.map_or(String::new(), |axis| axis.to_string())
            ));
            None
        }
        Some(hinted) => {
            let fits = crate::proposal::candidates(hinted.axis, measurement.quantity);
            let is_angular_method = measurement.quantity == Some(Quantity::Angle)
                && !hinted.component.is_angular()
                && !hinted.axis.is_rotary()
                && hinted.component.mcs_index() != hinted.axis.mcs_index();
            // Lengths under the name of a straightness: some programs write these as .rtl, too.
            let is_length = measurement.quantity == Some(Quantity::Positioning)
                && !hinted.component.is_angular();
            if fits.contains(&hinted) || is_angular_method || is_length {
                Some(hinted)
            } else {
                candidates = fits;
                said.push(format!(
                    "CONTRADICTION: the name or title says {hinted}, the kind of file does not measure it"
                ));
                None
            }
        }
        None if hints.errors.len() > 1 => {
            let names: Vec<String> = hints.errors.iter().map(ToString::to_string).collect();
            said.push(format!(
                "CONTRADICTION: name and title say {}",
                names.join(" and ")
            ));
            None
        }
        None => match candidates[..] {
            [only] => Some(only),
            _ => None,
        },
    };
    check_targets(measurement, error.map(|error| error.axis).or(axis), machine)?;
    if error.is_none() && !candidates.is_empty() {
        let names: Vec<String> = candidates.iter().map(ToString::to_string).collect();
        said.push(format!("error: one of {}", names.join(", ")));
    } else if error.is_none() {
        let fits = axes_that_reach(measurement, machine);
        said.push(format!("the targets are within the travel of {fits}"));
    }
    said.extend(hints.contradictions.iter().cloned());
    let told = Told {
        axis,
        quantity: measurement.quantity,
        format: measurement.format,
        unit: measurement.unit,
        asks_unit: measurement.unit.is_none(),
        ..told(&hints, machine)
    };
    let mut found = proposed(name.to_owned(), error, told);
    found.said = said;
    Ok(found)
}

/// What is said of a file that looks like one of another axis or machine.
pub(crate) fn out_of_place(
    of: &Proposed,
    measurement: &Measurement,
    machine: &Machine,
) -> Vec<String> {
    let axis = of.error.and_then(|error| machine.axis(error.axis));
    let beyond = axis.and_then(|axis| beyond_travel(measurement, axis));
    let said = [beyond, other_machine(measurement, machine)];
    said.into_iter().flatten().collect()
}

/// What names and texts say of where the axes stood.
fn told(hints: &Hints, machine: &Machine) -> Told {
    let place = |axis: &Axis| {
        let place = hints.places.get(&axis.name).copied();
        // A place where the axis cannot stand is no hint.
        let place = place.filter(|place| axis.check_coordinate(*place).is_ok());
        (axis.name, place)
    };
    Told {
        places: machine.axes().iter().map(place).collect(),
        axis: None,
        quantity: None,
        format: None,
        unit: None,
        asks_unit: false,
        is_log: false,
    }
}

fn proposed(file: String, error: Option<ErrorName>, told: Told) -> Proposed {
    let mut found = Proposed {
        files: vec![file],
        error,
        at: Vec::new(),
        keys: Vec::new(),
        said: Vec::new(),
        told,
    };
    found.follow();
    found
}

/// The errors of an axis that a kind of file may measure.
pub(crate) fn candidates(axis: AxisName, quantity: Option<Quantity>) -> Vec<ErrorName> {
    let errors = Component::ALL.map(|component| ErrorName::motion(component, axis));
    let is_own = |error: &ErrorName| error.component.mcs_index() == axis.mcs_index();
    let fits = |error: &ErrorName| match quantity {
        None => true,
        Some(Quantity::Angle) => error.component.is_angular(),
        Some(Quantity::Straightness) => !error.component.is_angular() && !is_own(error),
        Some(Quantity::Positioning) => {
            is_own(error) && error.component.is_angular() == axis.is_rotary()
        }
    };
    errors.into_iter().filter(fits).collect()
}

fn check_targets(
    measurement: &Measurement,
    axis: Option<AxisName>,
    machine: &Machine,
) -> Result<(), String> {
    let Some(axis) = axis.and_then(|name| machine.axis(name)) else {
        return match axis {
            Some(axis) => Err(format!(
                "it measures axis {axis}, which the machine does not have"
            )),
            None => Ok(()),
        };
    };
    let targets = measurement.targets();
    let (Some(first), Some(last)) = (targets.first(), targets.last()) else {
        return Err("it holds no targets".to_owned());
    };
    if targets.iter().any(|target| axis.may_stand_at(*target)) {
        return Ok(());
    }
    let [low, high] = axis.travel;
    let unit = axis.name.kind().coordinate_unit();
    Err(format!(
        "its targets from {first} to {last} {unit} are not within the travel of {}, {low} to {high} {unit}",
        axis.name
    ))
}

fn axes_that_reach(measurement: &Measurement, machine: &Machine) -> String {
    let targets = measurement.targets();
    let reach = machine
        .axes()
        .iter()
        .filter(|axis| targets.iter().all(|target| axis.may_stand_at(*target)));
    let names: Vec<String> = reach.map(|axis| axis.name.to_string()).collect();
    if names.is_empty() {
        "no axis".to_owned()
    } else {
        names.join(", ")
    }
}

/// What the file says of itself, in one line.
fn facts(measurement: &Measurement) -> String {
    let mut facts = Vec::new();
    facts.extend(
        measurement
            .format
            .map(|format| format.instrument().to_owned()),
    );
    let meta = &measurement.metadata;
    for (key, text) in [
        ("machine", &meta.machine),
        ("axis", &meta.axis),
        ("date", &meta.date),
        ("location", &meta.location),
        ("title", &meta.title),
    ] {
        facts.extend(text.as_ref().map(|text| format!("{key} {text}")));
    }
    let targets = measurement.targets();
    if let [first, .., last] = targets[..] {
        facts.push(format!("{} targets from {first} to {last}", targets.len()));
    }
    facts.join("; ")
}
