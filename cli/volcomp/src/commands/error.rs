//! `volcomp error`: the volumetric error at positions.

use volcomp_kinematics::{Form, State};
use volcomp_model::{Machine, Temperatures};

use super::{Answer, fixed, micrometres, microradians, table, table_text, thermal_note};
use crate::{
    answers::position::{ErrorAt, Outside},
    failure::Failure,
    points::{ApproachArguments, MachineArguments, PointArguments},
};

/// The volumetric error at a position: actual minus ideal, in workpiece axes
#[derive(clap::Args)]
pub(crate) struct Arguments {
    #[command(flatten)]
    machine: MachineArguments,
    #[command(flatten)]
    points: PointArguments,
    #[command(flatten)]
    approach: ApproachArguments,
    /// Form of the model: exact (rigid transforms), htm (small-angle matrices) or twist (first order)
    #[arg(long, default_value_t = Form::Exact)]
    model: Form,
}

pub(crate) fn run(arguments: &Arguments) -> Result<Answer, Failure> {
    let (machine, temperatures) = arguments.machine.read()?;
    let states = arguments.points.states(&machine, &arguments.approach)?;
    let row = |state: &State| evaluate(&machine, state, arguments.model, &temperatures);
    let rows: Vec<ErrorAt> = states.states().iter().map(row).collect();
    let text = text(&rows);
    let notes = [
        thermal_note(&machine, &temperatures),
        outside_note(rows.iter().map(|row| &row.outside)),
    ];
    let notes = notes.into_iter().flatten().collect();
    Answer::new(&states.document(rows), text, notes)
}

fn evaluate(machine: &Machine, state: &State, form: Form, temperatures: &Temperatures) -> ErrorAt {
    let error = machine.error_at(state, form, temperatures);
    ErrorAt {
        position_um: micrometres(&error.position_mm),
        rotation_urad: microradians(&error.rotation_rad),
        outside: outside(machine, state),
    }
}

/// The error motions and axes that are outside the range of the model at a state.
pub(super) fn outside(machine: &Machine, state: &State) -> Outside {
    let mut outside_travel = machine.outside_travel(state);
    outside_travel.sort_unstable();
    Outside {
        outside_range: machine.outside_range(state),
        outside_travel,
    }
}

impl Outside {
    /// `travel Z, range EZY EZZ`, empty where everything is covered.
    pub(super) fn words(&self) -> String {
        let parts = [
            ("travel", joined(&self.outside_travel)),
            ("range", joined(&self.outside_range)),
        ];
        let said = parts.into_iter().filter(|(_, names)| !names.is_empty());
        let said: Vec<String> = said.map(|(of, names)| format!("{of} {names}")).collect();
        said.join(", ")
    }
}

/// Says that there are positions which the model does not cover.
pub(super) fn outside_note<'a>(outside: impl Iterator<Item = &'a Outside>) -> Option<String> {
    let count = outside.filter(|o| !o.words().is_empty()).count();
    let positions = match count {
        0 => return None,
        1 => "one position lies".to_owned(),
        more => format!("{more} positions lie"),
    };
    Some(format!(
        "{positions} beyond an axis's travel or an error's measured range:\n  the errors there are those at the end of the range"
    ))
}

fn joined<T: ToString>(names: &[T]) -> String {
    let names: Vec<String> = names.iter().map(ToString::to_string).collect();
    names.join(" ")
}

fn text(rows: &[ErrorAt]) -> String {
    let mut header = vec!["", "X µm", "Y µm", "Z µm", "A µrad", "B µrad", "C µrad"];
    let covered = rows.iter().all(|row| row.outside.words().is_empty());
    if !covered {
        header.push("outside");
    }
    let mut table = table(&header);
    for (index, row) in rows.iter().enumerate() {
        let mut cells = vec![(index + 1).to_string()];
        let numbers = row.position_um.iter().chain(&row.rotation_urad);
        cells.extend(numbers.map(|value| fixed(*value, 3)));
        if !covered {
            cells.push(row.outside.words());
        }
        table.add_row(cells);
    }
    table_text(&table)
}
