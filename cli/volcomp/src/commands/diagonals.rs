use std::{
    fmt::Write as _,
    path::{Path, PathBuf},
};

use schemars::JsonSchema;
use serde::Serialize;
use volcomp_kinematics::State;
use volcomp_model::{DIAGONAL_TARGETS, Diagonal, Machine, ModelError, diagonal_targets, diagonals};
use volcomp_report::{State as Machined, diagonals_picture};
use volcomp_vocabulary::{AxisName, Displacement};

use super::{Answer, fixed, machine_notes, one_line, rotary_note, table, table_text};
use crate::{
    arguments::{MachineArguments, OthersArguments},
    compensation::{Compensated, Compensation, CompensationArguments},
    failure::Failure,
    output::{OutputFile, PlotArguments},
};

const LINEAR: [AxisName; 3] = [AxisName::X, AxisName::Y, AxisName::Z];

/// Show the body diagonals of ISO 230-6: deviation along each, zero at its first target
#[derive(clap::Args)]
#[command(after_help = "\
Examples:
  volcomp diagonals -m gantry.toml
  volcomp diagonals -m calibrated.toml --truth truth.toml --resolution 1")]
pub(crate) struct DiagonalsArguments {
    #[command(flatten)]
    machine: MachineArguments,
    #[command(flatten)]
    compensation: CompensationArguments,
    /// Targets on a diagonal, both ends included: 2 to 100000
    #[arg(long, default_value_t = DIAGONAL_TARGETS, value_parser = clap::value_parser!(u32).range(2..=100_000))]
    points: u32,
    #[command(flatten)]
    others: OthersArguments,
    /// Write the targets to this CSV file, a program for focas-sim, with the diagonal as `line`
    #[arg(long, value_name = "FILE")]
    targets: Option<PathBuf>,
    /// Feed in that file, mm/min: 1 to 1000000
    #[arg(long, value_name = "MM_PER_MIN", default_value_t = 10_000, requires = "targets",
        value_parser = clap::value_parser!(u32).range(1..=1_000_000))]
    feed: u32,
    #[command(flatten)]
    plot: PlotArguments,
}

/// The document of `volcomp diagonals`: the letters are the directions of motion of X, Y and Z (P positive, N
/// negative).
#[derive(Debug, Serialize, JsonSchema)]
#[serde(rename_all = "UPPERCASE")]
pub(crate) struct Diagonals {
    ppp: Diagonal,
    npp: Diagonal,
    pnp: Diagonal,
    ppn: Diagonal,
    /// How the correction was applied; only with `--compensated`, `--truth` or `--resolution`.
    #[serde(rename = "compensated", skip_serializing_if = "Option::is_none")]
    compensated: Option<Compensated>,
}

pub(crate) fn run(arguments: &DiagonalsArguments) -> Result<Answer, Failure> {
    let mut others_than_plot = vec![(arguments.machine.machine.as_path(), "--machine")];
    let targets = arguments.targets.as_deref();
    others_than_plot.extend(targets.map(|targets| (targets, "--targets")));
    let plot = arguments.plot.open(&others_than_plot)?;
    let (machine, temperatures) = arguments.machine.read()?;
    let compensation = Compensation::new(&arguments.compensation, &machine, &temperatures)?;
    let actual = compensation.actual();
    let source = actual.source(&temperatures);
    let points = arguments.points as usize;
    let mut notes = machine_notes(&machine, &temperatures);
    notes.extend(compensation.note());
    notes.extend(rotary_note(&machine));
    let others = arguments.others.read(&machine, &mut notes)?;
    let command = |state: &State| compensation.command(state);
    if let Some(file) = &arguments.targets {
        let inputs = [(arguments.machine.machine.as_path(), "--machine")];
        let output = OutputFile::open_beside(file, &inputs)?;
        let text = program(actual, points, &others, arguments.feed)
            .map_err(|error| of_machine(&arguments.machine.machine, &machine, error))?;
        output.write_whole(text)?;
    }
    let found = diagonals(actual, &source, points, &others, command)
        .map_err(|error| of_machine(&arguments.machine.machine, &machine, error))?;
    let mut table = table(&["diagonal", "range µm", "at the end µm"]);
    for diagonal in &found {
        let last = diagonal.deviation_um.last().copied().unwrap_or(0.0);
        table.add_row([diagonal.name.to_owned(), fixed(diagonal.range_um, 3), fixed(last, 3)]);
    }
    if let Some(plot) = plot {
        plot.write(&picture(arguments, &machine, &found, &compensation))?;
    }
    let [ppp, npp, pnp, ppn] = found;
    let document = Diagonals { ppp, npp, pnp, ppn, compensated: compensation.document() };
    Answer::new(&document, table_text(&table) + &compensation.words(), notes)
}

fn picture(
    arguments: &DiagonalsArguments,
    machine: &Machine,
    found: &[Diagonal],
    compensation: &Compensation<'_>,
) -> String {
    let plotted = found.iter().map(|found| volcomp_report::Diagonal::of(machine, found));
    let (title, state) = if arguments.compensation.is_asked_for() {
        ("Body diagonals after correction, by the model", Machined::TruthCorrected)
    } else {
        ("Body diagonals of the machine, by the model", Machined::Found)
    };
    let of = volcomp_report::Diagonals {
        before: volcomp_report::OfState { state, found: plotted.collect() },
        after: None,
    };
    let file = arguments.machine.machine.display().to_string();
    let lines = [file, one_line(&compensation.words())];
    diagonals_picture(title, &lines, &of)
}

fn of_machine(file: &Path, machine: &Machine, error: ModelError) -> Failure {
    match error {
        ModelError::NoSuchAxis { axis, .. } if LINEAR.contains(&axis) => Failure::in_file(
            file,
            format_args!(
                "structure `{}`, expected the axes X, Y and Z for body diagonals",
                machine.chain().structure()
            ),
        ),
        other => other.into(),
    }
}

/// The targets as a program for a simulated control: one row per target, mm and deg.
fn program(
    machine: &Machine,
    points: usize,
    others: &[(AxisName, f64)],
    feed: u32,
) -> Result<String, ModelError> {
    let axes = AxisName::ALL.into_iter();
    let axes: Vec<(AxisName, usize)> =
        axes.filter_map(|name| Some((name, machine.index_of(name).ok()?))).collect();
    let mut text = "line".to_owned();
    for (name, _) in &axes {
        let _ = write!(text, ",{name}");
    }
    text += ",feed\n";
    let mut row = |line: &str, target: &State| {
        text += line;
        for (name, index) in &axes {
            let at = Displacement::new(name.kind(), target.q[*index]).mm_or_deg();
            let _ = write!(text, ",{}", (at * 1e6).round() / 1e6 + 0.0);
        }
        let _ = writeln!(text, ",{feed}");
    };
    // The program starts in the middle, so that the first move defines the direction from which each axis approaches
    // the first target.
    if let [(_, middle), ..] = diagonal_targets(machine, 3, others)?
        && let Some(middle) = middle.get(1)
    {
        row("", middle);
    }
    for (line, targets) in diagonal_targets(machine, points, others)? {
        for target in &targets {
            row(line, target);
        }
    }
    Ok(text)
}
