//! `volcomp correct`: what must be added to a command.

use serde_json::{Map, Value, json};
use volcomp_kinematics::{CorrectionOptions, State};
use volcomp_model::{Machine, Temperatures};
use volcomp_vocabulary::AxisName;

use super::{Answer, micro, micrometres, microradians, table, table_text, thermal_note};
use crate::{
    failure::Failure,
    points::{ApproachArguments, MachineArguments, PointArguments},
};

/// The correction at a position: what must be added to the command (um, urad)
#[derive(clap::Args)]
pub(crate) struct Arguments {
    #[command(flatten)]
    machine: MachineArguments,
    #[command(flatten)]
    points: PointArguments,
    #[command(flatten)]
    approach: ApproachArguments,
    /// The axes that the correction may move, instead of those that the machine file names: X,Y,Z
    #[arg(long, value_delimiter = ',')]
    correct: Vec<char>,
}

struct Row {
    correction: Vec<(AxisName, f64)>,
    residual_um: [f64; 3],
    residual_axis_urad: [f64; 3],
    iterations: usize,
    singular: bool,
}

pub(crate) fn run(arguments: &Arguments) -> Result<Answer, Failure> {
    let (machine, temperatures) = arguments.machine.read()?;
    let states = arguments.points.states(&machine, &arguments.approach)?;
    let options = options(&machine, &arguments.correct)?;
    let row = |state: &State| evaluate(&machine, state, &temperatures, &options);
    let (json, rows) = states.evaluate(row, Row::json);
    Ok(Answer {
        json,
        text: text(&machine, &rows),
        notes: thermal_note(&machine, &temperatures).into_iter().collect(),
    })
}

fn options(machine: &Machine, letters: &[char]) -> Result<CorrectionOptions, Failure> {
    let mut options = CorrectionOptions::default();
    if letters.is_empty() {
        return Ok(options);
    }
    let mut names = Vec::new();
    for &letter in letters {
        let name = AxisName::from_letter(letter)
            .filter(|name| names.len() < 9 && !names.contains(name))
            .ok_or_else(|| {
                Failure::Input(format!(
                    "--correct: found `{letter}`, expected axis letters, each once: X,Y,Z"
                ))
            })?;
        machine.index_of(name)?;
        names.push(name);
    }
    options.correct = Some(names.into_iter().collect());
    Ok(options)
}

fn evaluate(
    machine: &Machine,
    state: &State,
    temperatures: &Temperatures,
    options: &CorrectionOptions,
) -> Row {
    let found = machine.correction_at(state, temperatures, options);
    let joints = machine.chain().joints();
    Row {
        correction: joints
            .iter()
            .zip(&found.delta)
            .map(|(joint, &delta)| (joint.name, micro(joint.kind, delta)))
            .collect(),
        residual_um: micrometres(&found.residual_mm),
        residual_axis_urad: microradians(&found.residual_axis),
        iterations: found.iterations,
        singular: found.singular,
    }
}

impl Row {
    fn json(&self) -> Value {
        let correction: Map<String, Value> = self
            .correction
            .iter()
            .map(|(name, value)| (name.to_string(), json!(value)))
            .collect();
        json!({
            "correction": correction,
            "residual_um": self.residual_um,
            "residual_axis_urad": self.residual_axis_urad,
            "iterations": self.iterations,
            "singular": self.singular,
        })
    }
}

fn text(machine: &Machine, rows: &[Row]) -> String {
    let mut header = vec![String::new()];
    header.extend(machine.chain().joints().iter().map(|joint| {
        let unit = if micro(joint.kind, 1.0) > 1e4 {
            "urad"
        } else {
            "um"
        };
        format!("{} {unit}", joint.name)
    }));
    header.extend(["left um", "left urad", ""].map(str::to_owned));
    let mut table = table(&header.iter().map(String::as_str).collect::<Vec<_>>());
    let norm = |v: &[f64; 3]| v.iter().map(|x| x * x).sum::<f64>().sqrt();
    for (index, row) in rows.iter().enumerate() {
        let mut cells = vec![(index + 1).to_string()];
        cells.extend(
            row.correction
                .iter()
                .map(|(_, value)| format!("{value:.3}")),
        );
        cells.push(format!("{:.3}", norm(&row.residual_um)));
        cells.push(format!("{:.3}", norm(&row.residual_axis_urad)));
        cells.push(
            if row.singular {
                "tool axis not fully correctable"
            } else {
                ""
            }
            .to_owned(),
        );
        table.add_row(cells);
    }
    table_text(&table)
}
