//! `volcomp correct`: what must be added to a command.

mod file;
mod text;

use std::path::PathBuf;

use schemars::JsonSchema;
use serde::Serialize;
use volcomp_kinematics::{CorrectionOptions, State, correct};
use volcomp_model::{Ensemble, Machine, Temperatures};
use volcomp_vocabulary::{AxisKind, AxisName, MAX_AXES};

use super::{
    Answer, ByAxis, in_degrees, machine_notes, micro, micrometres, microradians,
    not_counted::NotCounted,
    outside::{Outside, outside, outside_note},
    uncertainty::UncertaintyArguments,
};
use crate::{
    failure::Failure,
    output::OutputFile,
    points::{ApproachArguments, MachineArguments, PointArguments, axis},
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
    /// CSV file for the positions, corrected positions (mm, deg) and corrections (µm, µrad), with every column of
    /// --points; columns of an earlier correction are replaced
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
    /// The errors that the observations do not determine, which the uncertainty does not count, the one that moves the tool most
    /// first; only with `--uncertainty`.
    #[serde(skip_serializing_if = "Option::is_none")]
    not_counted: Option<Vec<NotCounted>>,
    /// Error of the tool tip that the correction leaves, in workpiece axes, µm.
    residual_um: [f64; 3],
    /// Error of the tool axis that the correction leaves, in workpiece axes, µrad.
    residual_axis_urad: [f64; 3],
    /// How many Newton steps were taken.
    iterations: usize,
    /// Whether these steps brought what the axes can correct below 1e-5 µm and 1e-4 µrad.
    converged: bool,
    /// Whether a direction of the tool axis cannot be corrected: near a singular pose, or with fewer than two
    /// rotary axes.
    singular: bool,
    /// Whether the pose is within about 6° of a singular one of two rotary axes, where rotary corrections are more
    /// than ten times the error of the tool axis, or leave a direction of it out.
    near_singular: bool,
    /// The commanded position, mm or deg.
    command: ByAxis,
    /// The command with the correction added, mm or deg.
    corrected: ByAxis,
    #[serde(flatten)]
    outside: Outside,
}

pub(crate) fn run(arguments: &Arguments) -> Result<Answer, Failure> {
    let (machine, temperatures) = arguments.machine.read()?;
    let states = arguments.points.states(&machine, &arguments.approach)?;
    let options = options(&machine, &arguments.axes)?;
    let file = match &arguments.output {
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
    let columns = file::Columns::new(&machine, states.table(), ensemble.is_some());
    let row = |state: &State| CorrectionAt {
        uncertainty: ensemble
            .as_ref()
            .map(|ensemble| uncertainty(ensemble, &machine, state, &options)),
        not_counted: open.as_ref().map(|open| open.at(&[*state])),
        ..evaluate(&machine, state, &temperatures, &options)
    };
    let rows: Vec<CorrectionAt> = states.states().iter().map(row).collect();
    if let Some(mut file) = file {
        file.append(&columns.csv(&rows)?)?;
        file.finish()?;
    }
    let rotary = movable_rotary(&machine, &options);
    let text = text::text(&machine, &rows, rotary);
    let notes = [
        states.note(),
        outside_note(rows.iter().map(|row| &row.outside)),
        one_rotary_note(&machine, &options),
        not_converged_note(&rows),
        arguments.output.as_ref().and(columns.replaced_note()),
    ];
    let mut notes: Vec<String> = notes.into_iter().flatten().collect();
    notes.extend(machine_notes(&machine, &temperatures));
    notes.extend(uncertain);
    Answer::new(&states.document(rows), text, notes)
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
                "--axes: axis {name} stands twice, expected axis letters, each once: X,Y,Z"
            )));
        }
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

/// The standard uncertainty of the correction of each axis, µm or µrad: the spread over the drawn machines, each of which
/// is corrected exactly.
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
    joints
        .map(|(joint, spread)| (joint.name, micro(joint.kind, spread)))
        .collect()
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
    options.correctors(machine.chain()).rotary().len()
}

/// The length of a vector.
fn norm(v: &[f64; 3]) -> f64 {
    v.iter().map(|x| x * x).sum::<f64>().sqrt()
}
