//! `volcomp error`: the volumetric error at positions.

use serde_json::{Value, json};
use volcomp_kinematics::{Form, State};
use volcomp_model::{Machine, Temperatures};

use super::{Answer, micrometres, microradians, table, table_text, thermal_note};
use crate::{
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
    /// Form of the model: exact, htm or twist
    #[arg(long, default_value_t = Form::Exact)]
    model: Form,
}

struct Row {
    position_um: [f64; 3],
    rotation_urad: [f64; 3],
    outside_range: Vec<String>,
    outside_travel: Vec<String>,
}

pub(crate) fn run(arguments: &Arguments) -> Result<Answer, Failure> {
    let (machine, temperatures) = arguments.machine.read()?;
    let states = arguments.points.states(&machine, &arguments.approach)?;
    let row = |state: &State| evaluate(&machine, state, arguments.model, &temperatures);
    let (json, rows) = states.evaluate(row, Row::json);
    Ok(Answer {
        json,
        text: text(&rows),
        notes: thermal_note(&machine, &temperatures).into_iter().collect(),
    })
}

fn evaluate(machine: &Machine, state: &State, form: Form, temperatures: &Temperatures) -> Row {
    let error = machine.error_at(state, form, temperatures);
    Row {
        position_um: micrometres(&error.position_mm),
        rotation_urad: microradians(&error.rotation_rad),
        outside_range: machine
            .outside_range(state)
            .iter()
            .map(ToString::to_string)
            .collect(),
        outside_travel: machine
            .outside_travel(state)
            .iter()
            .map(ToString::to_string)
            .collect(),
    }
}

impl Row {
    fn json(&self) -> Value {
        json!({
            "position_um": self.position_um,
            "rotation_urad": self.rotation_urad,
            "outside_range": self.outside_range,
            "outside_travel": self.outside_travel,
        })
    }
}

fn text(rows: &[Row]) -> String {
    let mut table = table(&[
        "",
        "X um",
        "Y um",
        "Z um",
        "A urad",
        "B urad",
        "C urad",
        "outside range",
    ]);
    for (index, row) in rows.iter().enumerate() {
        let mut cells = vec![(index + 1).to_string()];
        let numbers = row.position_um.iter().chain(&row.rotation_urad);
        cells.extend(numbers.map(|value| format!("{value:.3}")));
        cells.push(row.outside_range.join(" "));
        table.add_row(cells);
    }
    table_text(&table)
}
