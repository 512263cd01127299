use std::{collections::BTreeSet, fmt::Write, path::PathBuf};

use csv::WriterBuilder;
use rayon::prelude::*;
use schemars::JsonSchema;
use serde::Serialize;
use volcomp_calibrate::Ensemble;
use volcomp_document::{Column, CsvTable};
use volcomp_kinematics::{CorrectionOptions, State, correct};
use volcomp_model::{Machine, MachineErrors};
use volcomp_vocabulary::{AxisKind, AxisName, MAX_AXES};

use super::{
    Answer, ByAxis, in_degrees, machine_notes, micro, micrometres, microradians,
    uncertainty::{NotCounted, UncertaintyArguments, words},
};
use crate::{
    arguments::{ApproachArguments, MachineArguments, PointArguments, axis},
    failure::Failure,
    listing::{Listing, Outside, Row, joined, outside, outside_note},
    output::OutputFile,
    table::{fixed, folded, table, table_text},
};

/// Show the correction at a position, to be added to the command
///
/// Corrections are in µm for linear and µrad for rotary axes. The corrected position, in mm and deg, is the command with
/// the correction added.
#[derive(clap::Args)]
#[command(after_help = "\
Examples:
  volcomp correct -m five-axis.toml --at X=100,Y=50,B=30,C=45
  volcomp correct -m gantry.toml --points points.csv -o corrected.csv")]
pub(crate) struct CorrectArguments {
    #[command(flatten)]
    machine: MachineArguments,
    #[command(flatten)]
    points: PointArguments,
    #[command(flatten)]
    approach: ApproachArguments,
    /// Axes that the correction may move [default: `correct` in the machine file, else one linear axis of each direction and all rotary axes]
    #[arg(long, alias = "correct", value_delimiter = ',')]
    axes: Vec<String>,
    /// CSV file with the columns of --points, corrected positions (mm, deg) and corrections (µm, µrad)
    #[arg(long, short)]
    output: Option<PathBuf>,
    #[command(flatten)]
    uncertainty: UncertaintyArguments,
}

/// The correction at one commanded position.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct CorrectionAt {
    /// The correction to be added to the command: µm for linear axes, µrad for rotary axes.
    correction: ByAxis,
    /// The standard uncertainty (k = 1) of the correction: µm for linear axes, µrad for rotary axes; only with
    /// `--uncertainty`.
    #[serde(skip_serializing_if = "Option::is_none")]
    uncertainty: Option<ByAxis>,
    /// Errors that the observations do not determine and the uncertainty does not include, sorted
    /// by their effect on the tool; only with `--uncertainty`.
    #[serde(skip_serializing_if = "Option::is_none")]
    not_counted: Option<Vec<NotCounted>>,
    /// Residual error of the tool tip after correction, in workpiece axes, µm.
    residual_um: [f64; 3],
    /// Residual error of the tool axis after correction, in workpiece axes, µrad.
    residual_axis_urad: [f64; 3],
    /// Number of Newton steps.
    iterations: usize,
    /// Whether the correctable part of the error fell below 1e-5 µm and 1e-4 µrad.
    converged: bool,
    /// Whether a tilt component of the tool axis cannot be corrected: near a singular pose, or with
    /// fewer than two rotary axes.
    singular: bool,
    /// Whether the pose is within about 6° of a singular pose of two rotary axes. Rotary
    /// corrections there exceed ten times the error of the tool axis, or leave one tilt component
    /// uncorrected.
    near_singular: bool,
    /// The commanded position, mm or deg.
    command: ByAxis,
    /// The commanded position plus the correction, mm or deg.
    corrected: ByAxis,
    #[serde(flatten)]
    outside: Outside,
}

pub(crate) fn run(arguments: &CorrectArguments, json: bool) -> Result<Answer, Failure> {
    let (machine, temperatures) = arguments.machine.read()?;
    let mut positions = arguments.points.positions(&machine, &arguments.approach)?;
    let options = options(&machine, &arguments.axes)?;
    let mut file = match &arguments.output {
        Some(path) => {
            let mut inputs = vec![(arguments.machine.machine.as_path(), "--machine")];
            inputs.extend(arguments.points.points.as_deref().map(|p| (p, "--points")));
            Some(OutputFile::open_beside(path, &inputs)?)
        }
        None => None,
    };
    let mut uncertain = Vec::new();
    let ensemble = match arguments.uncertainty.read(&machine, &mut uncertain)? {
        Some(measured) => {
            let from = &arguments.uncertainty;
            Some(from.ensemble(&measured, &machine, &mut uncertain)?)
        }
        None => None,
    };
    let (ensemble, open) = ensemble.unzip();
    let head = positions.head().cloned();
    let columns = Columns::new(&machine, head.as_ref(), ensemble.is_some());
    if let Some(file) = &mut file {
        file.append(&columns.csv([columns.header()])?)?;
    }
    let source = machine.source(&temperatures);
    let row = |state: &State| CorrectionAt {
        uncertainty: ensemble
            .as_ref()
            .map(|ensemble| uncertainty(ensemble, &machine, state, &options)),
        not_counted: open.as_ref().map(|open| open.at(&[*state])),
        ..evaluate(&machine, &source, state, &options)
    };
    let rotary = movable_rotary(&machine, &options);
    let is_list = head.is_some();
    let mut listing = Listing::new(json, is_list, header(&machine, ensemble.is_some()));
    let (mut only, mut not_converged, mut worst) = (None, 0, Vec::new());
    loop {
        let batch = positions.next_batch(&machine)?;
        if batch.states.is_empty() {
            break;
        }
        let rows: Vec<CorrectionAt> = batch.states.par_iter().map(row).collect();
        if let Some(file) = &mut file {
            file.append(&columns.csv(columns.records(batch.table.as_ref(), &rows))?)?;
        }
        listing.extend(&rows, |row| remark(row, rotary))?;
        not_converged += rows.iter().filter(|row| !row.converged).count();
        keep_worst(&mut worst, &rows);
        only = rows.into_iter().next();
    }
    if let Some(file) = file {
        file.finish()?;
    }
    let count = listing.rows();
    let notes = [
        positions.note(count),
        outside_note(listing.outside()),
        one_rotary_note(&machine, &options),
        not_converged_note(not_converged, count),
        arguments.output.as_ref().and(columns.replaced_note()),
    ];
    let mut notes: Vec<String> = notes.into_iter().flatten().collect();
    notes.extend(machine_notes(&machine, &temperatures));
    notes.extend(uncertain);
    if let Some(row) = only.filter(|_| count == 1 && !json) {
        return Ok(Answer::of_text(one(&row, rotary), notes));
    }
    if count == 0 {
        listing = Listing::new(json, is_list, header(&machine, false));
    }
    let mut text = words(&worst, "at one of these positions");
    if !text.is_empty() {
        text = folded(&text, "");
    }
    Ok(Answer::listed(listing, text, notes))
}

fn options(machine: &Machine, letters: &[String]) -> Result<CorrectionOptions, Failure> {
    let mut options = machine.correction_options();
    if letters.is_empty() {
        return Ok(options);
    }
    let mut names: Vec<AxisName> = Vec::new();
    for letter in letters {
        let name = axis("--axes", letter.trim())?;
        if names.contains(&name) {
            return Err(Failure::Input(format!(
                "--axes: axis {name} appears twice, expected axis letters, each once: X,Y,Z"
            )));
        }
        machine.index_of(name)?;
        names.push(name);
    }
    // This cannot overflow, because each axis occurs once.
    options.correct = Some(names.into_iter().collect());
    Ok(options)
}

fn evaluate(
    machine: &Machine,
    source: &MachineErrors<'_>,
    state: &State,
    options: &CorrectionOptions,
) -> CorrectionAt {
    let found = correct(machine.chain(), source, state, options);
    let joints = machine.chain().joints().iter().enumerate();
    let by_axis = |value: &dyn Fn(usize, AxisKind) -> f64| {
        let values = joints.clone().map(|(index, joint)| (joint.name, value(index, joint.kind)));
        values.collect()
    };
    CorrectionAt {
        uncertainty: None,
        not_counted: None,
        correction: by_axis(&|index, kind| micro(kind, found.delta[index])),
        residual_um: micrometres(&found.residual_mm),
        residual_axis_urad: microradians(&found.residual_axis),
        iterations: found.iterations,
        converged: found.converged,
        singular: found.tool_axis_partial,
        near_singular: found.near_singular,
        command: machine.coordinates(state),
        corrected: by_axis(&|index, kind| in_degrees(kind, state.q[index] + found.delta[index])),
        outside: outside(machine, state),
    }
}

/// The standard uncertainty (k = 1) of the correction of each axis, µm or µrad: the spread over the Monte Carlo
/// samples, each corrected exactly.
fn uncertainty(
    ensemble: &Ensemble,
    machine: &Machine,
    state: &State,
    options: &CorrectionOptions,
) -> ByAxis {
    let spread = ensemble.uncertainty_of(|drawn| {
        let found = correct(drawn.chain(), drawn, state, options);
        std::array::from_fn::<f64, MAX_AXES, _>(|index| found.delta[index])
    });
    let joints = machine.chain().joints().iter().zip(spread);
    joints.map(|(joint, spread)| (joint.name, micro(joint.kind, spread))).collect()
}

/// Note that a single rotary axis cannot fully correct the tool axis; `None` unless exactly one rotary axis may move.
fn one_rotary_note(machine: &Machine, options: &CorrectionOptions) -> Option<String> {
    (movable_rotary(machine, options) == 1).then(|| {
        "one rotary axis may move: the tool axis is corrected in one direction only".to_owned()
    })
}

/// Note with the number `open` of positions at which the solver did not converge; `None` if the number is 0.
fn not_converged_note(open: usize, count: usize) -> Option<String> {
    (open > 0).then(|| {
        format!(
            "{open} of {count} corrections did not converge: what they leave is in the residual; check the errors of the machine file near these positions"
        )
    })
}

fn movable_rotary(machine: &Machine, options: &CorrectionOptions) -> usize {
    options.correctors(machine.chain()).rotary().len()
}

fn norm(v: &[f64; 3]) -> f64 {
    v.iter().map(|x| x * x).sum::<f64>().sqrt()
}

/// A single correction as text. `rotary` is the number of rotary axes that may move.
fn one(row: &CorrectionAt, rotary: usize) -> String {
    let mut header = vec!["axis", "command", "correction", "corrected", ""];
    if row.uncertainty.is_some() {
        header.push("u");
    }
    let mut axes = table(&header);
    for (&name, correction) in &row.correction {
        let number = |values: &ByAxis, digits| {
            let value = values.get(&name).copied().unwrap_or(0.0);
            fixed(value, digits)
        };
        let mut cells = vec![
            name.to_string(),
            number(&row.command, 4),
            format!("{} {}", fixed(*correction, 3), name.kind().micro_symbol()),
            number(&row.corrected, 6),
            name.kind().coordinate_unit().to_owned(),
        ];
        if let Some(uncertainty) = &row.uncertainty {
            let symbol = name.kind().micro_symbol();
            cells.push(format!("{} {symbol}", number(uncertainty, 3)));
        }
        axes.add_row(cells);
    }
    let mut text = table_text(&axes);
    let _ = write!(
        text,
        "\nresidual {} µm, tool axis {} µrad{}",
        fixed(norm(&row.residual_um), 3),
        fixed(norm(&row.residual_axis_urad), 3),
        if is_singular(row, rotary) {
            " (singular: not fully correctable here)"
        } else if row.near_singular {
            " (near a singular pose: large rotary corrections)"
        } else {
            ""
        }
    );
    text.push('\n');
    let outside = row.outside.words();
    let not_counted = words(row.not_counted.as_deref().unwrap_or_default(), "here");
    for sentence in [outside, not_counted] {
        if !sentence.is_empty() {
            text += &folded(&sentence, "");
        }
    }
    text
}

/// Column headers of a table of corrections.
fn header(machine: &Machine, is_uncertain: bool) -> Vec<String> {
    let mut names: Vec<AxisName> = machine.axes().iter().map(|axis| axis.name).collect();
    names.sort_unstable();
    let head = |name: &AxisName| format!("{name} {}", name.kind().micro_symbol());
    let mut header: Vec<String> = names.iter().map(head).collect();
    if is_uncertain {
        header.extend(names.iter().map(|name| format!("u {}", head(name))));
    }
    header.extend(["residual µm", "axis µrad"].map(str::to_owned));
    header
}

impl Row for CorrectionAt {
    fn cells(&self) -> Vec<String> {
        let uncertainty = self.uncertainty.iter().flat_map(ByAxis::values);
        let numbers = self.correction.values().chain(uncertainty).copied();
        let residuals = [norm(&self.residual_um), norm(&self.residual_axis_urad)];
        numbers.chain(residuals).map(|value| fixed(value, 3)).collect()
    }

    fn outside(&self) -> &Outside {
        &self.outside
    }
}

/// The remark on a row of a table of corrections.
fn remark(row: &CorrectionAt, rotary: usize) -> String {
    let singular = if is_singular(row, rotary) {
        "singular, the tool axis is not fully correctable"
    } else if row.near_singular {
        "near singular, rotary corrections are large"
    } else {
        ""
    };
    let mut parts = vec![singular.to_owned(), row.outside.words()];
    parts.retain(|part| !part.is_empty());
    parts.join("; ")
}

/// Appends the errors that the uncertainties of `rows` do not include. Of each error only the position of its largest
/// effect on the tool is kept.
fn keep_worst(worst: &mut Vec<NotCounted>, rows: &[CorrectionAt]) {
    worst.extend(rows.iter().filter_map(|row| row.not_counted.clone()).flatten());
    worst.sort_by(|a, b| b.moves_um.total_cmp(&a.moves_um));
    let mut seen = BTreeSet::new();
    worst.retain(|of| seen.insert(of.unknown.clone()));
}

/// True if the tool axis cannot be fully corrected at this pose, but can at others.
fn is_singular(row: &CorrectionAt, rotary: usize) -> bool {
    row.singular && rotary >= 2
}

struct Columns<'t> {
    table: Option<&'t CsvTable>,
    carried: Vec<(Column, &'t str)>,
    replaced: Vec<&'t str>,
    axes: Vec<AxisName>,
    uncertain: bool,
}

impl<'t> Columns<'t> {
    fn new(machine: &Machine, table: Option<&'t CsvTable>, uncertain: bool) -> Self {
        let mut axes: Vec<AxisName> = machine.axes().iter().map(|axis| axis.name).collect();
        axes.sort_unstable();
        let written = written(&axes, uncertain);
        let read = table.map(CsvTable::columns).into_iter().flatten();
        let (replaced, carried): (Vec<_>, Vec<_>) =
            read.partition(|(_, name)| written.iter().any(|new| new.eq_ignore_ascii_case(name)));
        Self {
            table,
            carried,
            replaced: replaced.into_iter().map(|(_, name)| name).collect(),
            axes,
            uncertain,
        }
    }

    /// Note with the columns of the table that are not copied, because computed columns have the same names; `None` if
    /// all are copied.
    fn replaced_note(&self) -> Option<String> {
        (!self.replaced.is_empty()).then(|| {
            let names = self.replaced.join(", ");
            format!("columns of --points that are computed anew: {names}")
        })
    }

    /// Rows of the output file as text.
    fn csv(&self, rows: impl IntoIterator<Item = Vec<String>>) -> Result<Vec<u8>, Failure> {
        // The separators `,`, `;` and tab are one byte each.
        let separator = self.table.map_or(',', CsvTable::separator);
        let mut writer = WriterBuilder::new()
            .delimiter(u8::try_from(separator).unwrap_or(b','))
            .from_writer(Vec::new());
        let failed = |e: csv::Error| Failure::Work(format!("the CSV file: {e}"));
        for row in rows {
            writer.write_record(row).map_err(failed)?;
        }
        let written = writer.into_inner();
        written.map_err(|e| Failure::Work(format!("the CSV file: {}", e.error())))
    }

    /// One row per correction, preceded by the cells that are copied from its row of the table.
    fn records(
        &self,
        table: Option<&CsvTable>,
        corrections: &[CorrectionAt],
    ) -> impl Iterator<Item = Vec<String>> {
        let mut read = table.map(CsvTable::rows);
        corrections.iter().map(move |correction| {
            let row = read.as_mut().and_then(Iterator::next);
            let mut cells: Vec<String> = match row {
                Some(row) => {
                    let carried = self.carried.iter();
                    carried.map(|(column, _)| row.cell(*column).text().to_owned()).collect()
                }
                None => self.numbers(correction.command.values()),
            };
            cells.extend(self.numbers(correction.corrected.values()));
            cells.extend(self.numbers(correction.correction.values()));
            if let Some(uncertainty) = &correction.uncertainty {
                cells.extend(self.numbers(uncertainty.values()));
            }
            if let Some(not_counted) = &correction.not_counted {
                let told: Vec<String> = not_counted.iter().map(|of| self.told(of)).collect();
                cells.push(told.join(" / "));
            }
            cells.push(self.number(norm(&correction.residual_um)));
            cells.push(self.number(norm(&correction.residual_axis_urad)));
            cells.push(correction.singular.to_string());
            cells.push(joined(&correction.outside.outside_range));
            cells.push(joined(&correction.outside.outside_travel));
            cells
        })
    }

    fn header(&self) -> Vec<String> {
        let mut header: Vec<String> = if self.table.is_some() {
            let names = self.carried.iter().map(|(_, name)| (*name).to_owned());
            names.collect()
        } else {
            let axes = self.axes.iter();
            axes.map(|axis| format!("{axis}_{}", axis.kind().coordinate_unit())).collect()
        };
        header.extend(written(&self.axes, self.uncertain));
        header
    }

    fn numbers<'a>(&self, values: impl Iterator<Item = &'a f64>) -> Vec<String> {
        values.map(|value| self.number(*value)).collect()
    }

    /// States the effect on the tool of an error that the uncertainty does not include.
    fn told(&self, of: &NotCounted) -> String {
        format!(
            "{} {} um per {} {}",
            of.unknown,
            self.number((of.moves_um * 1e3).round() / 1e3),
            of.size,
            of.unit
        )
    }

    fn number(&self, value: f64) -> String {
        let text = fixed(value, 9);
        let text = if text.contains('e') {
            text.as_str()
        } else {
            text.trim_end_matches('0').trim_end_matches('.')
        };
        if self.table.is_some_and(CsvTable::has_decimal_comma) {
            text.replace('.', ",")
        } else {
            text.to_owned()
        }
    }
}

fn written(axes: &[AxisName], uncertain: bool) -> Vec<String> {
    let corrected =
        axes.iter().map(|axis| format!("{axis}_corrected_{}", axis.kind().coordinate_unit()));
    let correction = axes.iter().map(|axis| {
        let unit = axis.kind().micro_unit();
        format!("{axis}_correction_{unit}")
    });
    let uncertainty = axes.iter().filter(|_| uncertain).map(|axis| {
        let unit = axis.kind().micro_unit();
        format!("{axis}_u_correction_{unit}")
    });
    let not_counted = uncertain.then(|| "u_not_counted".to_owned());
    let others =
        ["residual_um", "residual_axis_urad", "singular", "outside_range", "outside_travel"];
    corrected
        .chain(correction)
        .chain(uncertainty)
        .chain(not_counted)
        .chain(others.map(str::to_owned))
        .collect()
}
