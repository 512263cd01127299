//! Notes on the errors that a calibration did not measure.

use volcomp_model::Machine;
use volcomp_sensitivity::{ErrorTerm, Poses, sensitivity};
use volcomp_vocabulary::{AxisKind, Component, Displacement, ErrorName};

use crate::{
    calibration_file::CalibrationFile,
    fitted_curve::FittedCurve,
    location_file::{is_square, square_of},
    squares::{partner_of, reference_of},
    stages::Stages,
};

/// Nodes on a rotary axis at which the effect of an error is looked at. On a linear axis the largest effect is at an end,
/// because a displacement that grows with the coordinate is never longer between two places than at both.
const ROTARY_NODES: usize = 9;
/// The size of an error whose effect is told, µm or µrad.
const EXAMPLE: f64 = 10.0;

/// Notes on the errors that were not measured, and whether the machine file had them: error motions by axis, then
/// location errors, those of squareness among them, each with what it can do.
pub(crate) fn not_measured(file: &CalibrationFile, stages: &Stages) -> Vec<String> {
    let machine = &stages.machine;
    let unknown: Vec<ErrorName> = unknown(file).collect();
    let mut notes = Vec::new();
    for axis in machine.axes() {
        let names = Component::ALL.map(|component| ErrorName::motion(component, axis.name));
        let not_measured = names.into_iter().filter(|name| {
            let fitted = |curve: &FittedCurve| curve.error == *name;
            let found = stages.measured.contains(name) || unknown.contains(name);
            !found && !stages.curves.iter().any(fitted)
        });
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
    let names = locations_not_measured(file, machine);
    let effects = largest_effects(machine, &names);
    for (name, effect) in names.into_iter().zip(effects) {
        let (unit, stated) = (name.component.symbol(), machine.locations().get(&name));
        let moves = |size: f64| {
            effect.map_or_else(String::new, |effect| {
                let most = size.abs() * effect;
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
            None => format!(
                "{name} was not measured and is taken as 0{}",
                moves(EXAMPLE)
            ),
        });
    }
    notes
}

/// The errors that are to be found from observations.
fn unknown(file: &CalibrationFile) -> impl Iterator<Item = ErrorName> {
    let observations = file.observations.iter();
    observations.flat_map(|o| o.unknown.iter().map(|unknown| unknown.error))
}

/// The location errors that move something and that no table of the file states: of the two tilts that make a
/// squareness the one that is not zero by definition, and the other where the machine file has it all the same.
fn locations_not_measured(file: &CalibrationFile, machine: &Machine) -> Vec<ErrorName> {
    let mut names = Vec::new();
    for joint in machine.chain().joints() {
        for component in Component::ALL {
            let name = ErrorName::location(component, joint.name);
            if joint.no_effect(component).is_some() {
                continue;
            }
            if is_square(name) {
                let is_reference = reference_of(file.reference_axes, name) == name.axis;
                let is_none = is_reference || machine.axis(partner_of(name)).is_none();
                let kept = machine.locations().get(&name);
                if is_none && kept.is_none_or(|value| *value == 0.0) {
                    continue;
                }
            }
            let square = square_of(name);
            let mut locations = file.locations.iter();
            let stated = locations.any(|location| square_of(location.error) == square)
                || file.squareness.iter().any(|entry| entry.error == square)
                || unknown(file).any(|error| square_of(error) == square);
            if !stated {
                names.push(name);
            }
        }
    }
    names
}

/// The largest displacement of the tool over the travels for 1 µm or 1 µrad of each error, µm; to first order, with the
/// tool of the machine file.
fn largest_effects(machine: &Machine, names: &[ErrorName]) -> Vec<Option<f64>> {
    let terms: Vec<ErrorTerm> = names.iter().copied().map(ErrorTerm::Named).collect();
    let nodes = machine.axes().iter().map(|axis| {
        let kind = axis.name.kind();
        let count = match kind {
            AxisKind::Linear => 2,
            AxisKind::Rotary => ROTARY_NODES,
        };
        let [low, high] = axis.travel;
        let node = |place: usize| {
            let at = low + (high - low) * place as f64 / (count - 1) as f64;
            Displacement::from_coordinate(kind, at).mm_or_rad()
        };
        (0..count).map(node).collect()
    });
    let poses = Poses::Grid(nodes.collect());
    match sensitivity(machine.chain(), &terms, &poses) {
        Ok(found) => {
            let effects = found.errors.iter();
            effects.map(|e| Some(e.position_max_um)).collect()
        }
        // No names, or more poses than can be looked at: nothing is told.
        Err(_) => vec![None; names.len()],
    }
}
