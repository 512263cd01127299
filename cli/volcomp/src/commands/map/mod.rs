//! `volcomp map`: the error on a grid over the travels, and its uncertainty.

mod field;
mod model;
mod node;
#[cfg(feature = "parquet")]
mod parquet;
mod rigid;
mod work;

use std::{fmt::Write, path::PathBuf};

use schemars::JsonSchema;
use serde::Serialize;
use volcomp_kinematics::Form;
use volcomp_model::MapGrid;

use self::{
    field::Field,
    model::Model,
    node::Node,
    rigid::{AllAxes, Beside, all_axes},
    work::{Found, Largest, Work},
};
use super::{
    Answer, ByAxis, fixed, machine_notes,
    not_counted::{NotCounted, all_over, words},
    uncertainty::UncertaintyArguments,
};
use crate::{
    compensation::{Compensated, Compensation, CompensationArguments},
    failure::Failure,
    points::{MachineArguments, OthersArguments},
    table::folded,
};

/// The volumetric map: the error on a grid over the travels of X, Y and Z
///
/// Other axes stand at 0, or where --at says. The compiled machine is used unless --exact or another --model is given: its curves are
/// within 1 nm and 1 nrad of the machine file's, and products of two errors are neglected. The figures of the grid are followed by the
/// volumetric error over poses of all axes, after one best-fit rigid-body alignment of the workpiece: it is that of `report` for this tool, does not depend on
/// the grid, and with --uncertainty has its uncertainty. Ctrl-C leaves no unfinished file.
#[derive(clap::Args)]
pub(crate) struct Arguments {
    #[command(flatten)]
    machine: MachineArguments,
    /// Nodes along X, Y and Z: 21x21x21
    #[arg(long)]
    grid: String,
    #[command(flatten)]
    others: OthersArguments,
    /// File for the field: .csv, .vti (VTK image data), .vtr (VTK rectilinear grid), .parquet
    #[arg(long, short)]
    output: Option<PathBuf>,
    /// Form of the model: compiled, exact (rigid transforms), htm (small-angle matrices) or twist (first order)
    /// [default: compiled; exact with a correction]
    #[arg(long)]
    model: Option<Model>,
    /// The exact form of the model, as --model exact
    #[arg(long, conflicts_with = "model")]
    exact: bool,
    #[command(flatten)]
    compensation: CompensationArguments,
    #[command(flatten)]
    uncertainty: UncertaintyArguments,
}

/// The document of `volcomp map`.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct Map {
    /// Nodes along the axes of the grid, in the order X, Y, Z.
    counts: Vec<usize>,
    /// Number of nodes.
    nodes: usize,
    /// Form of the model: exact, htm, twist or compiled.
    model: String,
    /// How far a curve of the compiled machine may be from its source, nm and nrad; only with the compiled form.
    #[serde(skip_serializing_if = "Option::is_none")]
    tolerance_nm: Option<f64>,
    /// Length of the largest position error, µm.
    largest_um: f64,
    /// Where the largest position error is, mm.
    at: ByAxis,
    /// The position error there, in workpiece axes, µm.
    position_um: [f64; 3],
    /// The rotation error there, in workpiece axes, µrad.
    rotation_urad: [f64; 3],
    /// Root of the mean square of the length of the position error over all nodes, µm.
    rms_um: f64,
    /// The same after alignment of the workpiece (three shifts and three small rotations by least squares): where the workpiece lies
    /// is a convention and no error, µm.
    form_rms_um: f64,
    /// Length of the largest position error after alignment, µm.
    form_max_um: f64,
    /// The volumetric error over poses of all axes.
    all_axes: AllAxes,
    /// The largest standard uncertainty; only with `--uncertainty`.
    #[serde(skip_serializing_if = "Option::is_none")]
    uncertainty: Option<Uncertainty>,
    /// How the correction was applied; only with `--compensated`, `--truth` or `--resolution`.
    #[serde(skip_serializing_if = "Option::is_none")]
    compensated: Option<Compensated>,
    /// The file with the field; only with `--output`.
    #[serde(skip_serializing_if = "Option::is_none")]
    file: Option<String>,
}

/// The node with the largest standard uncertainty (k = 1) of the position error.
#[derive(Debug, Serialize, JsonSchema)]
struct Uncertainty {
    /// Number of Monte Carlo samples.
    trials: u64,
    /// Seed of the samples.
    seed: u64,
    /// Length of the standard uncertainty of the position error, µm.
    largest_um: f64,
    /// Where it is, mm.
    at: ByAxis,
    /// Standard uncertainty of the position error there, µm.
    position_um: [f64; 3],
    /// Standard uncertainty of the rotation error there, µrad.
    rotation_urad: [f64; 3],
    /// The errors that the observations do not determine, which no uncertainty here counts, the one that moves the tool most first.
    not_counted: Vec<NotCounted>,
}

impl Arguments {
    /// The form of the model: a correction is applied in the exact form only.
    fn model(&self) -> Result<Model, Failure> {
        let exact = Model::Form(Form::Exact);
        match self.model.or(self.exact.then_some(exact)) {
            Some(model) if model != exact && self.compensation.is_asked_for() => {
                Err(Failure::Input(format!(
                    "--model: found {}, expected exact: a correction is applied in the exact form only",
                    model.name()
                )))
            }
            Some(model) => Ok(model),
            None if self.compensation.is_asked_for() => Ok(exact),
            None => Ok(Model::Compiled),
        }
    }
}

pub(crate) fn run(arguments: &Arguments) -> Result<Answer, Failure> {
    let counts = parse_grid(&arguments.grid)?;
    let model = arguments.model()?;
    let (machine, temperatures) = arguments.machine.read()?;
    let compensation = Compensation::new(&arguments.compensation, &machine, &temperatures)?;
    let mut notes = machine_notes(&machine, &temperatures);
    notes.extend(compensation.note());
    let others = arguments.others.read(&machine, &mut notes)?;
    let measured = arguments.uncertainty.read(&machine, &mut notes)?;
    let grid = MapGrid::over_travels(&machine, counts, &others)?;
    if grid.axes.is_empty() {
        return Err(Failure::in_file(
            &arguments.machine.machine,
            format_args!(
                "structure `{}`, expected one of the axes X, Y and Z for a map; for other axes: volcomp error --points",
                machine.chain().structure()
            ),
        ));
    }
    let mut field = Field::open(arguments.output.as_deref(), &grid, measured.is_some())?;
    let (ensemble, not_counted) = match &measured {
        Some(measured) => {
            let from = &arguments.uncertainty;
            let (ensemble, open) = from.ensemble(measured, &machine, &mut notes)?;
            (Some(ensemble), open.at(&all_over(&machine, &grid)?))
        }
        None => (None, Vec::new()),
    };
    let work = Work {
        machine: &machine,
        errors: if arguments.compensation.is_asked_for() {
            Box::new(|state| compensation.residual(state))
        } else {
            model.errors(&machine, &temperatures)?
        },
        ensemble: ensemble.as_ref(),
        grid: &grid,
    };
    let mut found = Found::default();
    for pass in 0..field.passes() {
        field.begin(pass)?;
        work.go_through(pass, &mut field, &mut found)?;
    }
    let beside = work.beside(&found);
    // Exact where the map is compiled: the figure is that of the report, to the last digit.
    let exact = match model {
        Model::Compiled => Some(Model::Form(Form::Exact).errors(&machine, &temperatures)?),
        Model::Form(_) => None,
    };
    let errors = exact.as_ref().unwrap_or(&work.errors);
    let all_axes = all_axes(&machine, errors, ensemble.as_ref())?;
    drop(work);
    field.finish()?;
    let document = document(
        arguments,
        model,
        &grid,
        (&found.largest, beside, not_counted),
        all_axes,
        &compensation,
    )?;
    let text = text(arguments, &document, &compensation);
    Answer::new(&document, text, notes)
}

fn document(
    arguments: &Arguments,
    model: Model,
    grid: &MapGrid,
    (largest, beside, not_counted): (&Largest, Beside, Vec<NotCounted>),
    all_axes: AllAxes,
    compensation: &Compensation<'_>,
) -> Result<Map, Failure> {
    let (length, node) = largest.error.ok_or_else(|| {
        Failure::Work("the map has no node with an error that is a number".to_owned())
    })?;
    let [x, y, z, a, b, c] = node.in_file_units();
    Ok(Map {
        counts: grid.nodes_mm.iter().map(Vec::len).collect(),
        nodes: grid.len(),
        model: model.name(),
        tolerance_nm: model.tolerance_nm(),
        largest_um: length * 1e3,
        at: place(grid, &node),
        position_um: [x, y, z],
        rotation_urad: [a, b, c],
        rms_um: 1e3 * beside.as_they_are.rms(),
        form_rms_um: 1e3 * beside.left.rms(),
        form_max_um: 1e3 * beside.left.max(),
        all_axes,
        uncertainty: largest.uncertainty.map(|(length, node)| {
            let [x, y, z, a, b, c] = node.uncertainty_in_file_units();
            Uncertainty {
                trials: arguments.uncertainty.trials,
                seed: arguments.uncertainty.seed,
                largest_um: length * 1e3,
                at: place(grid, &node),
                position_um: [x, y, z],
                rotation_urad: [a, b, c],
                not_counted,
            }
        }),
        compensated: compensation.document(),
        file: arguments.output.as_ref().map(|p| p.display().to_string()),
    })
}

fn place(grid: &MapGrid, node: &Node) -> ByAxis {
    let on_grid = grid.axes.iter().copied().zip(node.at_mm);
    on_grid.chain(grid.others.iter().copied()).collect()
}

fn text(arguments: &Arguments, map: &Map, compensation: &Compensation<'_>) -> String {
    let counts: Vec<String> = map.counts.iter().map(ToString::to_string).collect();
    let mut text = format!("{} nodes ({})\n", map.nodes, counts.join(" x "));
    let error = if arguments.compensation.is_asked_for() {
        "largest remaining error"
    } else {
        "largest error"
    };
    describe(&mut text, error, map.largest_um, map.position_um, &map.at);
    let um = [map.rms_um, map.form_rms_um, map.form_max_um].map(|um| fixed(um, 3));
    let [rms, form, most] = um;
    // Writing to a String cannot fail.
    let _ = writeln!(
        text,
        "root mean square {rms} µm; after alignment of the workpiece\n  root mean square {form} µm, largest {most} µm"
    );
    text += &over_all_axes(&map.all_axes);
    if let Some(u) = &map.uncertainty {
        let what = "largest standard uncertainty";
        describe(&mut text, what, u.largest_um, u.position_um, &u.at);
        let not_counted = words(&u.not_counted, "somewhere in the map");
        if !not_counted.is_empty() {
            text += &folded(&not_counted, "  ");
        }
    }
    // Writing to a String cannot fail.
    let _ = match map.tolerance_nm {
        Some(nm) => writeln!(
            text,
            "compiled machine: curves within {nm} nm and {nm} nrad, errors to first order\n\
             (--exact: all orders)"
        ),
        None => writeln!(text, "form of the model: {}", map.model),
    };
    if let Some(file) = &map.file {
        let _ = writeln!(text, "field in {file}");
    }
    text + &compensation.words()
}

fn over_all_axes(of: &AllAxes) -> String {
    let um = [of.rms_um, of.max_um, of.form_rms_um, of.form_max_um].map(|um| fixed(um, 3));
    let [rms, max, form, most] = um;
    let urad = [
        of.tilt_rms_urad,
        of.form_tilt_rms_urad,
        of.about_tool_rms_urad,
        of.form_about_tool_rms_urad,
    ];
    let tilt_max = fixed(of.tilt_max_urad, 3);
    let [tilt, tilt_left, about, about_left] = urad.map(|urad| fixed(urad, 3));
    let mut text = format!(
        "volumetric error over {} poses of all axes:\n  root mean square {rms} µm, largest {max} µm\n  after alignment of the workpiece {form} µm, largest {most} µm\n    at {}\n  tilt of the tool axis {tilt} µrad, after alignment {tilt_left} µrad,\n    largest {tilt_max} µrad\n  rotation about it {about} µrad, after alignment {about_left} µrad\n",
        of.poses,
        pose_text(&of.at)
    );
    if let Some(u) = &of.uncertainty {
        let [rms, largest, turn] = [u.rms_um, u.largest_um, u.rms_urad].map(|size| fixed(size, 3));
        // Writing to a String cannot fail.
        let _ = writeln!(
            text,
            "  standard uncertainty: root mean square {rms} µm, largest {largest} µm\n    of the whole rotation {turn} µrad; the largest at {}",
            pose_text(&u.at)
        );
    }
    text
}

fn pose_text(at: &ByAxis) -> String {
    let at = at
        .iter()
        .map(|(name, q)| format!("{name}={}", fixed(*q, 3)));
    at.collect::<Vec<_>>().join(" ")
}

fn describe(text: &mut String, what: &str, length_um: f64, [x, y, z]: [f64; 3], at: &ByAxis) {
    let at = at.iter().map(|(name, place)| format!("{name}={place}"));
    let at: Vec<String> = at.collect();
    // Writing to a String cannot fail.
    let _ = writeln!(
        text,
        "{what} {} µm [{}, {}, {}]\n  at {}",
        fixed(length_um, 3),
        fixed(x, 3),
        fixed(y, 3),
        fixed(z, 3),
        at.join(" ")
    );
}

fn parse_grid(text: &str) -> Result<[usize; 3], Failure> {
    let counts: Option<Vec<usize>> = text
        .split(['x', 'X', '×', ','])
        .map(|count| count.trim().parse().ok())
        .collect();
    counts
        .and_then(|counts| <[usize; 3]>::try_from(counts).ok())
        .filter(|counts| {
            let product = counts
                .iter()
                .try_fold(1_usize, |product, &count| product.checked_mul(count));
            product.is_some_and(|product| (1..=10_000_000_000).contains(&product))
        })
        .ok_or_else(|| {
            Failure::Input(format!(
                "--grid: found `{text}`, expected three counts of nodes from 1: 21x21x21"
            ))
        })
}
