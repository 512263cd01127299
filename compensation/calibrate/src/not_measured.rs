use volcomp_identify::Observations;
use volcomp_model::Machine;
use volcomp_sensitivity::{ErrorTerm, Poses, sensitivity};
use volcomp_vocabulary::{AxisKind, AxisName, Component, Displacement, ErrorName};

use crate::{
    calibration_file::CalibrationFile,
    fitted::Fitted,
    squareness::{is_square, partner_of, reference_of, square_of},
    stages::Stages,
};

/// Number of nodes on a rotary axis at which the effect of an error is evaluated. On a linear axis the two ends suffice, because a displacement that
/// is linear in the coordinate is largest at one of them.
const ROTARY_NODES: usize = 8;
/// Size of the error whose effect is stated, µm or µrad.
const EXAMPLE: f64 = 10.0;

pub(crate) fn not_measured(file: &CalibrationFile, stages: &Stages) -> Vec<String> {
    let unknown: Vec<ErrorName> = file.observations.iter().flat_map(unknown).collect();
    let is_measured = |name: ErrorName| {
        let fitted = |fitted: &Fitted| fitted.error == name;
        stages.measured.contains(&name)
            || unknown.contains(&name)
            || stages.fitted.iter().any(fitted)
    };
    let is_stated = |square: ErrorName| {
        let mut locations = file.locations.iter();
        locations.any(|location| square_of(location.error) == square)
            || file.squareness.iter().any(|entry| entry.error == square)
            || unknown.iter().any(|error| square_of(*error) == square)
    };
    notes(&stages.machine, file.reference_axes, &is_measured, &is_stated)
}

/// Notes on the errors of a machine that are not unknowns of the observations, worded as for a calibration.
pub fn not_observed(observations: &Observations) -> Vec<String> {
    let unknown: Vec<ErrorName> = unknown(observations).collect();
    let is_measured = |name: ErrorName| unknown.contains(&name);
    let is_stated = |square: ErrorName| unknown.iter().any(|error| square_of(*error) == square);
    let axes = [AxisName::X, AxisName::Y];
    notes(&observations.machine, axes, &is_measured, &is_stated)
}

/// Notes on the errors for which a machine file has no value, worded as for a calibration.
pub fn not_stated(machine: &Machine) -> Vec<String> {
    let stated: Vec<ErrorName> = machine.locations().keys().copied().collect();
    let is_measured = |name: ErrorName| machine.error(name).is_some();
    let is_stated = |square: ErrorName| stated.iter().any(|error| square_of(*error) == square);
    let axes = [AxisName::X, AxisName::Y];
    notes(machine, axes, &is_measured, &is_stated)
}

/// Number of errors of a machine without a known value, which are treated as 0.
pub fn errors_without_value(machine: &Machine) -> usize {
    let motions = machine.axes().iter().flat_map(|axis| {
        let names = Component::ALL.map(|component| ErrorName::motion(component, axis.name));
        names.into_iter().filter(|name| machine.error(*name).is_none())
    });
    let is_stated = |square: ErrorName| {
        let mut stated = machine.locations().keys();
        stated.any(|error| square_of(*error) == square)
    };
    let axes = [AxisName::X, AxisName::Y];
    motions.count() + locations_not_measured(machine, axes, &is_stated).len()
}

/// Notes on the errors that were not measured: error motions by axis, then location errors including squareness, each with its possible effect, and
/// whether the machine file has a value.
fn notes(
    machine: &Machine,
    reference_axes: [AxisName; 2],
    is_measured: &dyn Fn(ErrorName) -> bool,
    is_stated: &dyn Fn(ErrorName) -> bool,
) -> Vec<String> {
    let mut notes = Vec::new();
    for axis in machine.axes() {
        let names = Component::ALL.map(|component| ErrorName::motion(component, axis.name));
        let not_measured = names.into_iter().filter(|name| !is_measured(*name));
        let (kept, missing): (Vec<_>, Vec<_>) =
            not_measured.partition(|name| machine.error(*name).is_some());
        for (what, names) in [
            ("not measured, taken as 0", missing),
            ("not measured, kept from the machine file", kept),
        ] {
            let names: Vec<String> = names.iter().map(ErrorName::to_string).collect();
            if !names.is_empty() {
                notes.push(format!("{what}: {}", names.join(" ")));
            }
        }
    }
    let names = locations_not_measured(machine, reference_axes, is_stated);
    let effects = largest_effects(machine, &names);
    for (name, effect) in names.into_iter().zip(effects) {
        let (unit, stated) = (name.component.symbol(), machine.locations().get(&name));
        let moves = |size: f64| {
            effect.map_or_else(String::new, |effect| {
                let most = size.abs() * effect;
                let size = (10.0 * size).round() / 10.0;
                format!(
                    ": {size} {unit} of it move the tool by up to {most:.1} µm within the travel"
                )
            })
        };
        notes.push(match stated {
            Some(value) => format!(
                "{name} was not measured and is kept from the machine file{}",
                moves(*value)
            ),
            None => format!("{name} was not measured and is taken as 0{}", moves(EXAMPLE)),
        });
    }
    notes
}

fn unknown(observations: &Observations) -> impl Iterator<Item = ErrorName> {
    observations.unknown.iter().map(|unknown| unknown.error)
}

/// Location errors that have an effect and are not stated. Of the two tilts that form a squareness, the tilt that is
/// not zero by definition is listed; the other tilt is listed only if the machine file states it.
fn locations_not_measured(
    machine: &Machine,
    reference_axes: [AxisName; 2],
    is_stated: &dyn Fn(ErrorName) -> bool,
) -> Vec<ErrorName> {
    let mut names = Vec::new();
    for joint in machine.chain().joints() {
        for component in Component::ALL {
            let name = ErrorName::location(component, joint.name);
            if joint.no_effect(component).is_some() {
                continue;
            }
            if is_square(name) {
                let is_reference = reference_of(reference_axes, name) == name.axis;
                let is_none = is_reference || machine.axis(partner_of(name)).is_none();
                let kept = machine.locations().get(&name);
                if is_none && kept.is_none_or(|value| *value == 0.0) {
                    continue;
                }
            }
            if !is_stated(square_of(name)) {
                names.push(name);
            }
        }
    }
    names
}

/// Largest displacement of the tool over the travels for 1 µm or 1 µrad of each error, µm: first order, with the tool of the machine file.
fn largest_effects(machine: &Machine, names: &[ErrorName]) -> Vec<Option<f64>> {
    let terms: Vec<ErrorTerm> = names.iter().copied().map(ErrorTerm::Named).collect();
    let nodes = machine.axes().iter().map(|axis| {
        let kind = axis.name.kind();
        let count = match kind {
            AxisKind::Linear => 2,
            AxisKind::Rotary => ROTARY_NODES,
        };
        let nodes = axis.nodes(count).into_iter();
        nodes.map(|at| Displacement::from_coordinate(kind, at).mm_or_rad()).collect()
    });
    let poses = Poses::Grid(nodes.collect());
    match sensitivity(machine.chain(), &terms, &poses) {
        Ok(found) => {
            let effects = found.errors.iter();
            effects.map(|e| Some(e.position_max_um)).collect()
        }
        // The list of names is empty, or there are too many poses.
        Err(_) => vec![None; names.len()],
    }
}
