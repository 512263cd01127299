//! Notes on the errors that a calibration did not measure.

use volcomp_model::Machine;
use volcomp_vocabulary::{AxisName, Component, ErrorName, Urad};

use crate::{fitted_curve::FittedCurve, squares::partner_of};

/// Notes on the errors that were not measured, and whether the machine file had them: error motions by axis, then
/// squareness errors.
pub(crate) fn not_measured(
    machine: &Machine,
    measured: &[ErrorName],
    curves: &[FittedCurve],
    squareness: &[(ErrorName, Urad)],
) -> Vec<String> {
    let mut notes = Vec::new();
    for axis in machine.axes() {
        let names = Component::ALL.map(|component| ErrorName::motion(component, axis.name));
        let not_measured = names.into_iter().filter(|name| {
            let fitted = |curve: &FittedCurve| curve.error == *name;
            !measured.contains(name) && !curves.iter().any(fitted)
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
    for name in [
        ErrorName::location(Component::EC, AxisName::Y),
        ErrorName::location(Component::EA, AxisName::Z),
        ErrorName::location(Component::EB, AxisName::Z),
    ] {
        let there = |axis| machine.axis(axis).is_some();
        let known = squareness.iter().any(|(known, _)| *known == name);
        if known || !there(name.axis) || !there(partner_of(name)) {
            continue;
        }
        notes.push(match machine.locations().get(&name) {
            Some(value) => format!(
                "squareness not measured, kept from the machine file: {name} = {value} µrad"
            ),
            None => format!("squareness not measured, taken as 0: {name}"),
        });
    }
    notes
}
