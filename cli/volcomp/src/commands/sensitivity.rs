use std::{
    fmt::Write,
    path::{Path, PathBuf},
};

use schemars::JsonSchema;
use serde::Serialize;
use volcomp_kinematics::ChainError;
use volcomp_model::{Axis, Machine, Temperatures};
use volcomp_report::effects_picture;
use volcomp_sensitivity::{
    DEPENDENT_BELOW, Effect, ErrorTerm, Poses, Sensitivity, effects_of_with_progress,
    sensitivity_with_progress, terms,
};
use volcomp_vocabulary::{AxisName, Displacement};

use super::{Answer, fixed, table, table_text};
use crate::{
    arguments::{GeometryArguments, states_of},
    failure::Failure,
    output::{self, PlotArguments},
    table::{HEAD, folded},
};

/// Show the effect of each error over many positions, and the errors that cannot be distinguished
#[derive(clap::Args)]
#[command(after_help = "\
Examples:
  volcomp sensitivity -m blade-mill.toml --assembly
  volcomp --json sensitivity -m gantry.toml --points points.csv")]
pub(crate) struct SensitivityArguments {
    #[command(flatten)]
    machine: GeometryArguments,
    /// Nodes over the travel of each axis, or over one turn of a rotary axis: 1 to 1000
    #[arg(long, default_value_t = 5, value_parser = clap::value_parser!(u16).range(1..=1000))]
    grid: u16,
    /// CSV file of positions, as for `error`, instead of a grid
    #[arg(long, value_name = "FILE", conflicts_with = "grid")]
    points: Option<PathBuf>,
    /// Include six assembly errors per axis, and location errors only if the machine file states them
    #[arg(long)]
    assembly: bool,
    /// Use the error values of the machine file, largest first, instead of 1 µm or 1 µrad; without thermal terms
    #[arg(long)]
    values: bool,
    #[command(flatten)]
    plot: PlotArguments,
}

/// The document of `volcomp sensitivity`: the effect of each error over many positions.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct Effects {
    #[serde(flatten)]
    found: Sensitivity,
    /// Whether the effects are those of the values in the machine file, largest first (`--values`),
    /// instead of 1 µm or 1 µrad of each error.
    values: bool,
    /// The errors grouped by `motions`.
    groups: Vec<Vec<ErrorTerm>>,
    /// A column is treated as a combination of others if the remaining share of it is below this
    /// value.
    tolerance: f64,
}

/// The error terms of a machine. With `assembly` they include six assembly errors per axis, and only the location
/// errors that the machine file states.
pub(super) fn errors_of(machine: &Machine, assembly: bool) -> Vec<ErrorTerm> {
    let stated: Vec<_> = machine.locations().keys().copied().collect();
    terms(machine.chain(), assembly, &stated)
}

pub(crate) fn run(arguments: &SensitivityArguments) -> Result<Answer, Failure> {
    let file = arguments.machine.machine.as_path();
    let mut inputs = vec![(file, "--machine")];
    let points = arguments.points.as_deref();
    inputs.extend(points.map(|points| (points, "--points")));
    let plot = arguments.plot.open(&inputs)?;
    let machine = arguments.machine.read()?;
    let (poses, note) = if let Some(path) = &arguments.points {
        let (states, note) = states_of(&machine, path)?;
        (Poses::List(states), note)
    } else {
        let count = usize::from(arguments.grid);
        let poses = grid(&machine, count).map_err(Failure::input)?;
        (poses, too_few(&machine, count))
    };
    let errors = errors_of(&machine, arguments.assembly);
    let bar = output::bar(0, "positions");
    let told = |done: usize, of: usize| {
        bar.set_length(of as u64);
        bar.set_position(done as u64);
    };
    let mut found = sensitivity_with_progress(machine.chain(), &errors, &poses, told)
        .map_err(Failure::input)?;
    let mut notes = machine.notes();
    notes.extend(note);
    if arguments.values {
        found.errors = by_values(&machine, &errors, &poses, told)?;
        if found.errors.iter().all(is_zero) {
            notes.push("the machine file gives no error that moves the tool".to_owned());
        }
    }
    bar.finish_and_clear();
    if let Some(plot) = plot {
        plot.write(&picture(file, &found, arguments.values))?;
    }
    let text = text(&machine, &found, arguments.values);
    let document = Effects {
        groups: (found.motions.iter().map(|motion| motion.terms.clone())).collect(),
        values: arguments.values,
        tolerance: DEPENDENT_BELOW,
        found,
    };
    Answer::new(&document, text, notes)
}

fn picture(file: &Path, found: &Sensitivity, values: bool) -> String {
    let shown: Vec<&Effect> =
        (found.errors.iter()).filter(|effect| !(values && is_zero(effect))).collect();
    let rows = |of: fn(&Effect) -> [f64; 2]| {
        let row = |effect: &&Effect| {
            let [rms, max] = of(effect);
            (effect.term.to_string(), rms, max)
        };
        shown.iter().map(row).collect()
    };
    let title = if values {
        "Effect of the errors of the machine file"
    } else {
        "Effect of 1 µm or 1 µrad of each error"
    };
    let lines = [file.display().to_string(), format!("over {} positions", found.poses)];
    effects_picture(
        title,
        &lines,
        rows(|of| [of.position_rms_um, of.position_max_um]),
        rows(|of| [of.orientation_rms_urad, of.orientation_max_urad]),
    )
}

/// The effects of the error values of the machine file, sorted by displacement, largest first.
fn by_values(
    machine: &Machine,
    errors: &[ErrorTerm],
    poses: &Poses,
    told: impl Fn(usize, usize) + Sync,
) -> Result<Vec<Effect>, Failure> {
    let temperatures = Temperatures::default();
    let source = machine.source(&temperatures);
    let mut found = effects_of_with_progress(machine.chain(), &source, errors, poses, told)
        .map_err(Failure::input)?;
    found.sort_by(|a, b| {
        let by_position = b.position_rms_um.total_cmp(&a.position_rms_um);
        by_position.then(b.orientation_rms_urad.total_cmp(&a.orientation_rms_urad))
    });
    Ok(found)
}

fn is_zero(effect: &Effect) -> bool {
    effect.position_max_um == 0.0 && effect.orientation_max_urad == 0.0
}

/// Evenly spaced nodes over all poses of each axis, as in `Axis::nodes`. Both ends of a full turn are the same pose, so
/// only one is a node.
fn grid(machine: &Machine, count: usize) -> Result<Poses, ChainError> {
    let inside = |axis: &Axis| {
        let end = |end: f64| Displacement::from_coordinate(axis.name.kind(), end).mm_or_rad();
        let [low, high] = axis.all_poses().map(end);
        // A single node is in the middle.
        let step = if axis.turns_round() && count > 1 { (high - low) / count as f64 } else { 0.0 };
        (axis.name, [low, high - step])
    };
    Poses::over(machine.chain(), machine.axes().iter().map(inside), count)
}

/// Note if an axis with a full turn has too few nodes to resolve a run-out of one wave per turn; otherwise `None`.
fn too_few(machine: &Machine, count: usize) -> Option<String> {
    const LEAST: usize = 3;
    let mut turning = machine.axes().iter().filter(|axis| axis.turns_round());
    let axis = turning.next().filter(|_| count < LEAST)?;
    Some(format!(
        "--grid {count}: {} turns all the way round, and fewer than {LEAST} nodes may miss what goes through one wave in a turn",
        axis.name
    ))
}

/// The errors of a machine that are zero by definition, with X as the primary and Y as the secondary reference axis. Of
/// the six tilts of X, Y and Z only three differences have an effect.
fn zero_by_definition(machine: &Machine, found: &Sensitivity) -> Vec<String> {
    let pairs = [("EB0X", AxisName::Z), ("EC0X", AxisName::Y), ("EA0Y", AxisName::Z)];
    // Stated errors of the machine file are nevertheless not zero.
    let stated: Vec<String> = machine
        .locations()
        .iter()
        .filter(|(_, value)| **value != 0.0)
        .map(|(name, _)| name.to_string())
        .collect();
    let is_there = |name: &str| found.errors.iter().any(|e| e.term.to_string() == name);
    pairs
        .into_iter()
        .filter(|(name, partner)| is_there(name) && machine.axis(*partner).is_some())
        .filter(|(name, _)| !stated.iter().any(|stated| stated == name))
        .map(|(name, _)| name.to_owned())
        .collect()
}

fn text(machine: &Machine, found: &Sensitivity, values: bool) -> String {
    let mut effects = table(&["", "rms µm", "max µm", "rms µrad", "max µrad", "share %"]);
    let shown = found.errors.iter().filter(|e| !(values && is_zero(e)));
    for effect in shown {
        effects.add_row([
            effect.term.to_string(),
            fixed(effect.position_rms_um, 4),
            fixed(effect.position_max_um, 4),
            fixed(effect.orientation_rms_urad, 4),
            fixed(effect.orientation_max_urad, 4),
            fixed(effect.share * 100.0, 2),
        ]);
    }
    let of =
        if values { "the errors of the machine file" } else { "1 µm or 1 µrad of each error" };
    let mut text = format!(
        "{HEAD}Effect of {of} over {} positions{HEAD:#}\n{}",
        found.poses,
        table_text(&effects)
    );
    let zero: Vec<String> = found
        .errors
        .iter()
        .filter(|effect| values && is_zero(effect))
        .map(|effect| effect.term.to_string())
        .collect();
    if !zero.is_empty() {
        text += &folded(&format!("Zero or not stated: {}", zero.join(" ")), " ");
    }
    let _ = writeln!(text, "\n{HEAD}{} distinct motions{HEAD:#}", found.motions.len());
    for motion in &found.motions {
        let names: Vec<String> = motion.terms.iter().map(ToString::to_string).collect();
        text += &folded(&format!("{}: {}", motion.name, names.join(" ")), " ");
    }
    text += "\n";
    let (rank, errors) = (found.rank, found.errors.len());
    text += &folded(
        &format!(
            "Of these {} motions of {errors} errors, each taken as constant, position and orientation of the tool distinguish {rank} combinations.",
            found.motions.len()
        ),
        "",
    );
    let by_definition = zero_by_definition(machine, found);
    if !by_definition.is_empty() {
        let (names, left) = (by_definition.join(" "), errors - by_definition.len());
        text += &folded(
            &format!(
                "Against X and Y as reference axes {names} are zero by definition, which leaves {left} errors."
            ),
            "",
        );
    }
    let is_one_motion = |null: &&Vec<(ErrorTerm, f64)>| {
        let of_one = |motion: &volcomp_sensitivity::DistinctMotion| {
            null.iter().all(|(term, _)| motion.terms.contains(term))
        };
        found.motions.iter().any(of_one)
    };
    let mut nulls = found.indistinguishable.iter().filter(|null| !is_one_motion(null)).peekable();
    if nulls.peek().is_some() {
        text += "Besides errors of one motion, these together move it nowhere:\n";
    }
    let is_small = |(_, weight): &&(ErrorTerm, f64)| weight.abs() < 0.5e-4;
    let mut left_out = false;
    for null in nulls {
        left_out |= null.iter().any(|term| is_small(&term));
        let mut sum = String::new();
        let kept = null.iter().filter(|term| !is_small(term));
        for (place, (term, weight)) in kept.enumerate() {
            sum += match (place, *weight < 0.0) {
                (0, true) => "-",
                (0, false) => "",
                (_, true) => " - ",
                (_, false) => " + ",
            };
            let _ = write!(sum, "{} {}", fixed(weight.abs(), 4), term.coefficient());
        }
        text += &folded(&sum, " ");
    }
    if left_out {
        text += "Terms with a weight below 0.00005 are left out.\n";
    }
    text
}
