//! `volcomp correct`: what must be added to a command.

use std::fmt::Write;

use std::path::PathBuf;

use volcomp_document::CsvTable;
use volcomp_kinematics::{CorrectionOptions, State};
use volcomp_model::{Machine, Temperatures};
use volcomp_vocabulary::{AxisKind, AxisName};

use super::{
    Answer,
    error::{outside, outside_note},
    fixed, in_degrees, micro, micrometres, microradians, table, table_text, thermal_note,
};
use crate::{
    answers::position::CorrectionAt,
    failure::Failure,
    output::OutputFile,
    points::{ApproachArguments, MachineArguments, PointArguments, States},
};

/// The correction at a position: what must be added to the command
///
/// Corrections are in µm for linear and in µrad for rotary axes. The corrected position, in mm and deg, is the command
/// with the correction added.
#[derive(clap::Args)]
pub(crate) struct Arguments {
    #[command(flatten)]
    machine: MachineArguments,
    #[command(flatten)]
    points: PointArguments,
    #[command(flatten)]
    approach: ApproachArguments,
    /// The axes that may move to correct: X,Y,Z; default: what the machine file says, else one axis of each direction
    #[arg(long, alias = "correct", value_delimiter = ',')]
    axes: Vec<String>,
    /// CSV file for the positions, corrected positions and corrections, with every column of --points
    #[arg(long, short)]
    output: Option<PathBuf>,
}

pub(crate) fn run(arguments: &Arguments) -> Result<Answer, Failure> {
    let (machine, temperatures) = arguments.machine.read()?;
    let states = arguments.points.states(&machine, &arguments.approach)?;
    let options = options(&machine, &arguments.axes)?;
    let file = match &arguments.output {
        Some(path) => Some(OutputFile::open(path)?),
        None => None,
    };
    let row = |state: &State| evaluate(&machine, state, &temperatures, &options);
    let rows: Vec<CorrectionAt> = states.states().iter().map(row).collect();
    if let Some(mut file) = file {
        file.append(csv(&machine, &states, &rows).as_bytes())?;
        file.finish()?;
    }
    let rotary = movable_rotary(&machine, &options);
    let text = text(&machine, &rows, rotary);
    let notes = [
        thermal_note(&machine, &temperatures),
        outside_note(rows.iter().map(|row| &row.outside)),
        one_rotary_note(&machine, &options),
        not_converged_note(&rows),
    ];
    let notes = notes.into_iter().flatten().collect();
    Answer::new(&states.document(rows), text, notes)
}

fn options(machine: &Machine, letters: &[String]) -> Result<CorrectionOptions, Failure> {
    let mut options = machine.correction_options();
    if letters.is_empty() {
        return Ok(options);
    }
    let mut names: Vec<AxisName> = Vec::new();
    for letter in letters {
        let name = letter.trim().parse().ok();
        let name = name.filter(|name| !names.contains(name)).ok_or_else(|| {
            Failure::Input(format!(
                "--axes: found `{letter}`, expected axis letters, each once: X,Y,Z"
            ))
        })?;
        machine.index_of(name)?;
        names.push(name);
    }
    // Each letter once: never more than there are.
    options.correct = Some(names.into_iter().collect());
    Ok(options)
}

fn evaluate(
    machine: &Machine,
    state: &State,
    temperatures: &Temperatures,
    options: &CorrectionOptions,
) -> CorrectionAt {
    let found = machine.correction_at(state, temperatures, options);
    let joints = machine.chain().joints().iter().enumerate();
    let by_axis = |value: &dyn Fn(usize, AxisKind) -> f64| {
        let values = joints
            .clone()
            .map(|(index, joint)| (joint.name, value(index, joint.kind)));
        values.collect()
    };
    CorrectionAt {
        correction: by_axis(&|index, kind| micro(kind, found.delta[index])),
        residual_um: micrometres(&found.residual_mm),
        residual_axis_urad: microradians(&found.residual_axis),
        iterations: found.iterations,
        converged: found.converged,
        singular: found.tool_axis_partial,
        near_singular: found.near_singular,
        command: by_axis(&|index, kind| in_degrees(kind, state.q[index])),
        corrected: by_axis(&|index, kind| in_degrees(kind, state.q[index] + found.delta[index])),
        outside: outside(machine, state),
    }
}

/// With a single rotary axis the tool axis is never wholly corrected, which is said once.
fn one_rotary_note(machine: &Machine, options: &CorrectionOptions) -> Option<String> {
    (movable_rotary(machine, options) == 1).then(|| {
        "one rotary axis may move: the tool axis is corrected in one direction only".to_owned()
    })
}

/// Names the positions whose correction the solver did not bring to an end.
fn not_converged_note(rows: &[CorrectionAt]) -> Option<String> {
    let open = rows.iter().filter(|row| !row.converged).count();
    (open > 0).then(|| {
        format!(
            "{open} of {} corrections did not converge: what they leave is in the residual; check the errors of the machine file near these positions",
            rows.len()
        )
    })
}

/// How many rotary axes may move to correct.
fn movable_rotary(machine: &Machine, options: &CorrectionOptions) -> usize {
    let may_move = |name: &AxisName| options.correct.as_ref().is_none_or(|c| c.contains(name));
    let axes = machine.axes().iter().map(|axis| axis.name);
    axes.filter(|name| name.is_rotary() && may_move(name))
        .count()
}

/// The text for people: an axis a line for one position, a position a line for many.
fn text(machine: &Machine, rows: &[CorrectionAt], rotary: usize) -> String {
    match rows {
        [row] => one(row, rotary),
        _ => many(machine, rows, rotary),
    }
}

fn one(row: &CorrectionAt, rotary: usize) -> String {
    let mut axes = table(&["axis", "command", "correction", "corrected", ""]);
    for (&name, correction) in &row.correction.0 {
        let number = |values: &crate::answers::ByAxis, digits| {
            let value = values.0.get(&name).copied().unwrap_or(0.0);
            fixed(value, digits)
        };
        let unit = name.kind().coordinate_unit();
        axes.add_row([
            name.to_string(),
            number(&row.command, 4),
            format!("{} {}", fixed(*correction, 3), name.kind().micro_symbol()),
            number(&row.corrected, 6),
            unit.to_owned(),
        ]);
    }
    let mut text = table_text(&axes);
    // Writing to a string never fails.
    let _ = write!(
        text,
        "\nresidual {:.3} µm, tool axis {:.3} µrad{}",
        norm(&row.residual_um),
        norm(&row.residual_axis_urad),
        if is_singular(row, rotary) {
            " (singular: not fully correctable here)"
        } else if row.near_singular {
            " (near a singular pose: large rotary corrections)"
        } else {
            ""
        }
    );
    let outside = row.outside.words();
    if !outside.is_empty() {
        let _ = write!(text, "\noutside {outside}");
    }
    text + "\n"
}

fn many(machine: &Machine, rows: &[CorrectionAt], rotary: usize) -> String {
    let has_remarks = rows
        .iter()
        .any(|row| row.near_singular || !row.outside.words().is_empty());
    let mut names: Vec<AxisName> = machine.axes().iter().map(|axis| axis.name).collect();
    names.sort_unstable();
    let mut header = vec![String::new()];
    header.extend(
        names
            .iter()
            .map(|name| format!("{name} {}", name.kind().micro_symbol())),
    );
    header.extend(["residual µm", "µrad"].map(str::to_owned));
    if has_remarks {
        header.push("outside".to_owned());
    }
    let mut table = table(&header.iter().map(String::as_str).collect::<Vec<_>>());
    for (index, row) in rows.iter().enumerate() {
        let mut cells = vec![(index + 1).to_string()];
        cells.extend(row.correction.0.values().map(|value| fixed(*value, 3)));
        cells.push(format!("{:.3}", norm(&row.residual_um)));
        cells.push(format!("{:.3}", norm(&row.residual_axis_urad)));
        if has_remarks {
            let singular = if is_singular(row, rotary) {
                Some("singular")
            } else {
                row.near_singular.then_some("near singular")
            };
            let said = singular
                .map(str::to_owned)
                .into_iter()
                .chain([row.outside.words()]);
            let said: Vec<String> = said.filter(|word| !word.is_empty()).collect();
            cells.push(said.join(", "));
        }
        table.add_row(cells);
    }
    table_text(&table)
}

/// Whether the tool axis cannot be corrected at a pose where other poses of the machine can.
fn is_singular(row: &CorrectionAt, rotary: usize) -> bool {
    row.singular && rotary >= 2
}

fn norm(v: &[f64; 3]) -> f64 {
    v.iter().map(|x| x * x).sum::<f64>().sqrt()
}

/// Every row with its columns as they were read, then corrected positions, corrections and what they leave. The
/// separator and the decimal mark are those of the file that was read.
fn csv(machine: &Machine, states: &States, rows: &[CorrectionAt]) -> String {
    let table = match states {
        States::Many(file) => Some(&file.table),
        States::One(_) => None,
    };
    let separator = table.map_or(',', CsvTable::separator);
    let decimal_comma = table.is_some_and(CsvTable::has_decimal_comma);
    let number = |value: f64| {
        // No number is left as -0.
        let text = format!("{:.9}", value + 0.0);
        let text = text.trim_end_matches('0').trim_end_matches('.');
        if decimal_comma {
            text.replace('.', ",")
        } else {
            text.to_owned()
        }
    };
    let mut names: Vec<AxisName> = machine.axes().iter().map(|axis| axis.name).collect();
    names.sort_unstable();
    let mut header: Vec<String> = match table {
        Some(table) => table.names().map(|(_, name)| name.to_owned()).collect(),
        None => names.iter().map(ToString::to_string).collect(),
    };
    let unit = |n: &AxisName| n.kind().coordinate_unit();
    let micro = |n: &AxisName| n.kind().micro_unit();
    header.extend(names.iter().map(|n| format!("{n}_corrected_{}", unit(n))));
    header.extend(names.iter().map(|n| format!("{n}_correction_{}", micro(n))));
    header.extend(
        [
            "residual_um",
            "residual_axis_urad",
            "singular",
            "outside_range",
            "outside_travel",
        ]
        .map(str::to_owned),
    );
    let mut lines = vec![line(&header, separator)];
    let mut read = table.map(CsvTable::rows);
    for row in rows {
        let mut cells: Vec<String> = match (table, read.as_mut().and_then(Iterator::next)) {
            (Some(table), Some(read)) => {
                let columns = table.names();
                columns
                    .map(|(column, _)| read.cell(column).text().to_owned())
                    .collect()
            }
            _ => row.command.0.values().map(|v| number(*v)).collect(),
        };
        cells.extend(row.corrected.0.values().map(|v| number(*v)));
        cells.extend(row.correction.0.values().map(|v| number(*v)));
        cells.push(number(norm(&row.residual_um)));
        cells.push(number(norm(&row.residual_axis_urad)));
        cells.push(row.singular.to_string());
        let joined = |names: Vec<String>| names.join(" ");
        cells.push(joined(
            row.outside
                .outside_range
                .iter()
                .map(ToString::to_string)
                .collect(),
        ));
        cells.push(joined(
            row.outside
                .outside_travel
                .iter()
                .map(ToString::to_string)
                .collect(),
        ));
        lines.push(line(&cells, separator));
    }
    lines.concat()
}

/// One line of CSV; a cell with a separator, a quote or a line break stands in quotes.
fn line(cells: &[String], separator: char) -> String {
    let quoted = cells.iter().map(|cell| {
        if cell.contains([separator, '"', '\n', '\r']) {
            format!("\"{}\"", cell.replace('"', "\"\""))
        } else {
            cell.clone()
        }
    });
    quoted.collect::<Vec<_>>().join(&separator.to_string()) + "\n"
}
