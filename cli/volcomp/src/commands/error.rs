use schemars::JsonSchema;
use serde::Serialize;
use volcomp_kinematics::{Form, State};
use volcomp_model::{Machine, Temperatures};

use super::{
    Answer, ByAxis, fixed, machine_notes, micrometres, microradians,
    outside::{Outside, outside, outside_note, remarks},
    table, table_text,
};
use crate::{
    failure::Failure,
    points::{ApproachArguments, MachineArguments, PointArguments},
};

/// Show the volumetric error at a position: actual minus ideal, in workpiece axes
#[derive(clap::Args)]
#[command(after_help = "\
Examples:
  volcomp error -m gantry.toml --at X=1000,Y=500,Z=-50
  volcomp error -m gantry.toml --points points.csv --temperature scale_x=22.5")]
pub(crate) struct ErrorArguments {
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

/// The volumetric error at one position, in workpiece axes.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct ErrorAt {
    /// The position, mm and deg.
    at: ByAxis,
    /// Actual minus ideal tool tip along X, Y and Z, µm.
    position_um: [f64; 3],
    /// Rotation of the tool about X, Y and Z, µrad.
    rotation_urad: [f64; 3],
    #[serde(flatten)]
    outside: Outside,
}

pub(crate) fn run(arguments: &ErrorArguments) -> Result<Answer, Failure> {
    let (machine, temperatures) = arguments.machine.read()?;
    let states = arguments.points.states(&machine, &arguments.approach)?;
    let row = |state: &State| evaluate(&machine, state, arguments.model, &temperatures);
    let rows: Vec<ErrorAt> = states.states().iter().map(row).collect();
    let text = text(&rows);
    let notes = [
        states.note(),
        outside_note(rows.iter().map(|row| &row.outside)),
    ];
    let mut notes: Vec<String> = notes.into_iter().flatten().collect();
    notes.extend(machine_notes(&machine, &temperatures));
    Answer::new(&states.document(rows), text, notes)
}

fn evaluate(machine: &Machine, state: &State, form: Form, temperatures: &Temperatures) -> ErrorAt {
    let error = machine.error_at(state, form, temperatures);
    ErrorAt {
        at: machine.coordinates(state),
        position_um: micrometres(&error.position_mm),
        rotation_urad: microradians(&error.rotation_rad),
        outside: outside(machine, state),
    }
}

fn text(rows: &[ErrorAt]) -> String {
    let mut table = table(&["", "X µm", "Y µm", "Z µm", "A µrad", "B µrad", "C µrad"]);
    for (index, row) in rows.iter().enumerate() {
        let mut cells = vec![(index + 1).to_string()];
        let numbers = row.position_um.iter().chain(&row.rotation_urad);
        cells.extend(numbers.map(|value| fixed(*value, 3)));
        table.add_row(cells);
    }
    table_text(&table) + &remarks(rows.iter().map(|row| row.outside.words()))
}
