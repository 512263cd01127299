//! Checks that measurements belong to a machine file: the machine has the same name, and its errors have the same
//! values.

use std::path::Path;

use volcomp_model::Machine;
use volcomp_vocabulary::Component;

/// Differences below this are ignored, µm and µrad. They are below measurement resolution, and rounding in other
/// program versions causes them.
const NO_MATTER: f64 = 0.05;
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
    let mut differences = machine.differences(found);
    // NaN counts as a difference.
    differences.retain(|(_, by)| by.is_nan() || *by > NO_MATTER);
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

/// Note if errors of an axis refer to another point, which changes the lever of tilts, or if a travel differs;
/// otherwise `None`.
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

/// Note if the thermal terms differ, because the measurements then contain another thermal effect; otherwise `None`.
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
