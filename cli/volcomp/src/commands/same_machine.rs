//! Checks that measurements belong to a machine file: the same name, and the same errors by value.

use std::{collections::BTreeSet, path::Path};

use volcomp_model::Machine;
use volcomp_vocabulary::{Component, Direction, ErrorName, MAX_AXES};

/// Differences below this are ignored, µm and µrad: below measurement resolution, and caused by rounding in other program versions.
const NO_MATTER: f64 = 0.05;
/// Number of positions along each axis at which curves are compared, in addition to the curves' own
/// positions.
const PLACES: u32 = 41;
const MOST_NAMED: usize = 6;

pub(super) fn notes(file: &Path, found: &Machine, machine: &Machine) -> Vec<String> {
    let mut notes = Vec::new();
    if found.name != machine.name {
        notes.push(format!(
            "{} is of the machine {:?}, --machine is {:?}: is the uncertainty that of another machine?",
            file.display(),
            found.name,
            machine.name
        ));
    }
    notes.extend(other_places(file, found, machine));
    notes.extend(other_assembly(file, found, machine));
    notes.extend(other_thermal(file, found, machine));
    let mut differences = differences(found, machine);
    if differences.is_empty() {
        return notes;
    }
    differences.sort_by(|a, b| b.1.total_cmp(&a.1));
    let more = differences.len().saturating_sub(MOST_NAMED);
    let named: Vec<String> = (differences.iter().take(MOST_NAMED))
        .map(|(name, by)| format!("{name} by {by:.2} {}", name.component.symbol()))
        .collect();
    let more = if more > 0 { format!(" and {more} more") } else { String::new() };
    notes.push(format!(
        "--machine was not made from {}, whose measurements give other errors: at most {}{more}; the uncertainty is that of the errors which that file gives",
        file.display(),
        named.join(", ")
    ));
    notes
}

/// A note if errors of an axis refer to another point, which changes the lever of tilts, or if a
/// travel differs.
fn other_places(file: &Path, found: &Machine, machine: &Machine) -> Option<String> {
    let joints = found.chain().joints().iter().zip(machine.chain().joints());
    let points = joints.filter(|(a, b)| a.point_mm != b.point_mm);
    let points = points.map(|(joint, _)| format!("point of {}", joint.name));
    let axes = found.axes().iter().zip(machine.axes());
    let travels = axes.filter(|(a, b)| a.travel != b.travel);
    let travels = travels.map(|(axis, _)| format!("travel of {}", axis.name));
    let others: Vec<String> = points.chain(travels).collect();
    (!others.is_empty()).then(|| {
        format!(
            "{}: its machine is another one than --machine ({}): the uncertainty is that of the machine of that file",
            file.display(),
            others.join(", ")
        )
    })
}

fn other_assembly(file: &Path, found: &Machine, machine: &Machine) -> Option<String> {
    let axes = machine.axes().iter().enumerate();
    let differences = axes.flat_map(|(index, axis)| {
        let [a, b] = [found, machine].map(|of| of.assembly(index));
        let by = a.into_iter().zip(b).map(|(a, b)| (a - b).abs());
        by.zip(Component::ALL).map(move |(by, component)| (axis.name, component, by))
    });
    let matters = differences.filter(|(.., by)| *by > NO_MATTER);
    let (name, component, by) = matters.max_by(|a, b| a.2.total_cmp(&b.2))?;
    Some(format!(
        "{}: its machine has other [assembly] errors than --machine ({component:?} of {name} by {by:.2} {}): the uncertainty is that of the errors which that file gives",
        file.display(),
        component.symbol()
    ))
}

/// A note if the thermal terms differ: the measurements then contain another thermal effect.
fn other_thermal(file: &Path, found: &Machine, machine: &Machine) -> Option<String> {
    let terms = |of: &Machine| {
        let thermal = of.thermal();
        let any = !thermal.expansion.is_empty() || !thermal.drift.is_empty();
        any.then(|| thermal.clone())
    };
    (terms(found) != terms(machine)).then(|| {
        format!(
            "{}: its machine has other [thermal] terms than --machine: the uncertainty is that of the terms of that file",
            file.display()
        )
    })
}

/// The errors whose values differ, with the largest difference, µm or µrad.
fn differences(found: &Machine, machine: &Machine) -> Vec<(ErrorName, f64)> {
    let names: BTreeSet<ErrorName> = [found, machine]
        .into_iter()
        .flat_map(|of| {
            let motions = of.errors().map(|(name, _)| name);
            motions.chain(of.locations().keys().copied())
        })
        .collect();
    let places = [found, machine].map(Machine::places);
    let by = |name: ErrorName| {
        let difference = if name.location {
            let [a, b] = [found, machine].map(|of| of.locations().get(&name).copied());
            (a.unwrap_or(0.0) - b.unwrap_or(0.0)).abs()
        } else {
            of_curves(name, [found, machine], &places)
        };
        (name, difference)
    };
    // NaN is treated as a difference.
    let matters = |(_, by): &(ErrorName, f64)| by.is_nan() || *by > NO_MATTER;
    names.into_iter().map(by).filter(matters).collect()
}

/// The largest difference of two curves over the travel, for approach from both directions. The other axes, on which a grid may depend, are at their
/// ends and in the middle. `places` are those of each machine ([`Machine::places`]).
fn of_curves(name: ErrorName, machines: [&Machine; 2], places: &[Vec<Vec<f64>>; 2]) -> f64 {
    let [_, machine] = machines;
    let Ok(own) = machine.index_of(name.axis) else {
        return 0.0; // both have the same axes
    };
    let curves = machines.map(|of| of.error(name));
    let at = |of_travel: f64, others: f64| {
        let mut coordinates = [0.0; MAX_AXES];
        for (index, (place, axis)) in coordinates.iter_mut().zip(machine.axes()).enumerate() {
            let [low, high] = axis.travel;
            let share = if index == own { of_travel } else { others };
            *place = low + (high - low) * share;
        }
        coordinates
    };
    let [low, high] = machine.axes()[own].travel;
    let even = (0..PLACES).map(|step| f64::from(step) / f64::from(PLACES - 1));
    let of_curves = places.iter().flat_map(|of| &of[own]);
    let of_curves = of_curves.map(|place| (place - low) / (high - low));
    let mut largest = 0.0_f64;
    for of_travel in even.chain(of_curves) {
        for others in [0.0, 0.5, 1.0] {
            let coordinates = at(of_travel, others);
            for branch in [Direction::Positive, Direction::Negative] {
                let [a, b] = curves.map(|curve| {
                    curve.map_or(0.0, |curve| curve.value(own, &coordinates, Some(branch)))
                });
                let by = (a - b).abs();
                if by.is_nan() {
                    return by;
                }
                largest = largest.max(by);
            }
        }
    }
    largest
}
