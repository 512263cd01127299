//! Signs that a new model belongs to another machine than the active model.

use volcomp_model::{Axis, Machine};
use volcomp_vocabulary::AxisName;

/// Signs that a model belongs to another machine, one sentence each. Error curves are not compared here.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Differences {
    /// Why the new model cannot be activated on this machine; `None` if there is no such reason.
    pub refusal: Option<String>,
    /// Differences that an operator must confirm, however small the change of the correction.
    pub to_confirm: Vec<String>,
}

/// Compares a model with the model that it replaces. `before` is the name of the replaced model in the sentences, such
/// as "the active model". A different structure needs confirmation but is not refused, because the earlier model may
/// have been wrong (GUARD rule 13 covers structures as well).
pub(crate) fn differences(new: &Machine, in_force: &Machine, before: &str) -> Differences {
    let letters = |machine: &Machine| {
        let mut letters: Vec<AxisName> = machine.axes().iter().map(|axis| axis.name).collect();
        letters.sort_unstable();
        letters
    };
    let (axes, axes_in_force) = (letters(new), letters(in_force));
    let refusal = (axes != axes_in_force).then(|| {
        format!(
            "This model has the axes {}, {before} has {}: it belongs to another machine and cannot be activated here.",
            listed(&axes),
            listed(&axes_in_force)
        )
    });
    let mut to_confirm = Vec::new();
    if new.name != in_force.name {
        to_confirm.push(format!(
            "This model is of {}, {before} is of {}.",
            called(&new.name),
            called(&in_force.name)
        ));
    }
    let structures = [new, in_force].map(|machine| machine.chain().structure().to_string());
    let [structure, in_force_structure] = &structures;
    if structure != in_force_structure {
        to_confirm.push(format!(
            "The structure is {structure} in this model, {in_force_structure} in {before}."
        ));
    }
    for axis in new.axes() {
        let same = |other: &&Axis| other.name == axis.name;
        if let Some(other) = in_force.axes().iter().find(same)
            && other.travel != axis.travel
        {
            to_confirm.push(format!(
                "{} travels {} in this model, {} in {before}.",
                axis.name,
                travel(axis),
                travel(other)
            ));
        }
    }
    Differences { refusal, to_confirm }
}

/// Name of the replaced model in the sentences, for a reload or an activation.
pub(crate) const ACTIVE: &str = "the active model";

fn called(name: &str) -> String {
    match name {
        "" => "a machine without a name".to_owned(),
        name => format!("“{name}”"),
    }
}

fn travel(axis: &Axis) -> String {
    let [low, high] = axis.travel.map(|end| end.to_string().replace('-', "−"));
    format!("from {low} to {high} {}", axis.name.kind().coordinate_unit())
}

/// The names as text: "X, Y and Z".
fn listed(axes: &[AxisName]) -> String {
    let names: Vec<String> = axes.iter().map(ToString::to_string).collect();
    match &names[..] {
        [] => "none".to_owned(),
        [only] => only.clone(),
        [first @ .., last] => format!("{} and {last}", first.join(", ")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn machine(text: &str) -> Machine {
        Machine::parse(text, "m").expect("right")
    }

    const SMALL: &str = "name = \"gantry-3000\"\nstructure = \"w b X Y t\"\naxes.X.travel = [0.0, 3000.0]\naxes.Y.travel = [-1.5, 400.0]\n[errors]\nEXX = 3.0\n";

    #[test]
    fn other_errors_alone_are_no_difference() {
        let other = machine(&SMALL.replace("3.0\n", "9.0\n"));
        let found = differences(&other, &machine(SMALL), ACTIVE);
        assert_eq!(found, Differences::default());
    }

    #[test]
    fn each_difference_is_a_sentence() {
        let other = SMALL
            .replace("gantry-3000", "gantry-8000")
            .replace("w b X Y t", "w X' b Y t")
            .replace("3000.0", "8000.0");
        let found = differences(&machine(&other), &machine(SMALL), ACTIVE);
        assert_eq!(found.refusal, None);
        assert_eq!(
            found.to_confirm,
            [
                "This model is of “gantry-8000”, the active model is of “gantry-3000”.",
                "The structure is w X' b Y t in this model, w b X Y t in the active model.",
                "X travels from 0 to 8000 mm in this model, from 0 to 3000 mm in the active model.",
            ]
        );
    }

    #[test]
    fn other_axes_are_another_machine() {
        let more = SMALL
            .replace("X Y t", "X Y Z t")
            .replace("axes.Y", "axes.Z.travel = [0.0, 1.0]\naxes.Y");
        let found = differences(&machine(&more), &machine(SMALL), ACTIVE);
        let refusal = found.refusal.expect("a reason");
        assert!(
            refusal.contains("the axes X, Y and Z, the active model has X and Y:"),
            "{refusal}"
        );
    }
}
