//! `volcomp diagonals`: the body diagonals of ISO 230-6 on the model.

use serde_json::{Map, Value, json};
use volcomp_kinematics::{CorrectionOptions, State};
use volcomp_model::{corrected, diagonals};

use super::{Answer, table, table_text, thermal_note};
use crate::{failure::Failure, points::MachineArguments};

/// The body diagonals of ISO 230-6: deviation along each, zero at its first target
#[derive(clap::Args)]
pub(crate) struct Arguments {
    #[command(flatten)]
    machine: MachineArguments,
    /// With the correction applied
    #[arg(long)]
    compensated: bool,
    /// Targets on a diagonal, both ends included
    #[arg(long, default_value_t = 20, value_parser = clap::value_parser!(u32).range(2..=100_000))]
    points: u32,
}

pub(crate) fn run(arguments: &Arguments) -> Result<Answer, Failure> {
    let (machine, temperatures) = arguments.machine.read()?;
    let source = machine.source(&temperatures);
    let options = CorrectionOptions::default();
    let command = |state: &State| {
        if arguments.compensated {
            corrected(
                state,
                &machine.correction_at(state, &temperatures, &options).delta,
            )
        } else {
            *state
        }
    };
    let points = arguments.points as usize;
    let found = diagonals(&machine, &source, points, command).map_err(|_| {
        Failure::Input(format!(
            "{}: structure `{}`, expected the axes X, Y and Z for body diagonals",
            arguments.machine.machine.display(),
            machine.chain().structure()
        ))
    })?;
    let mut json = Map::new();
    let mut table = table(&["diagonal", "range um", "at the end um"]);
    for diagonal in &found {
        let last = diagonal.deviation_um.last().copied().unwrap_or(0.0);
        table.add_row([
            diagonal.name.to_owned(),
            format!("{:.3}", diagonal.range_um),
            format!("{last:.3}"),
        ]);
        json.insert(
            diagonal.name.to_owned(),
            json!({ "deviation_um": diagonal.deviation_um, "range_um": diagonal.range_um }),
        );
    }
    Ok(Answer {
        json: Value::Object(json),
        text: table_text(&table),
        notes: thermal_note(&machine, &temperatures).into_iter().collect(),
    })
}
