mod field;
#[cfg(feature = "parquet")]
mod parquet;

use std::{fmt::Write, path::PathBuf, str::FromStr};

use rayon::prelude::*;
use schemars::JsonSchema;
use serde::Serialize;
use volcomp_calibrate::Ensemble;
use volcomp_kinematics::{Form, State, nalgebra::Vector3};
use volcomp_model::{
    ErrorField, Lengths, Machine, MapGrid, RigidSums, Temperatures, Tolerance, UNCERTAINTY_POSES,
    VolumetricError, poses_of_all_axes, volumetric,
};
use volcomp_report::{State as Drawn, Volume, map_picture, volume};
use volcomp_vocabulary::AxisName;

use self::field::{Field, Node, TextFormat};
use super::{
    Answer, ByAxis, fixed, machine_notes,
    uncertainty::{NotCounted, UncertaintyArguments, all_over, words},
};
use crate::{
    arguments::{MachineArguments, OthersArguments},
    compensation::{Compensated, Compensation, CompensationArguments, ErrorAt, errors, errors_by},
    failure::Failure,
    output::{self, PlotArguments},
    table::folded,
};

/// Map the volumetric error on a grid over the travels of X, Y and Z
///
/// Values are actual tip minus ideal tip. They include constants that no part shows, such as an EXX of 5 µm over the
/// whole travel.
///
/// The volumetric error over poses of all axes is that of `report` for this tool, independent of the grid: 4,096 fixed
/// poses, after one best-fit rigid-body alignment of the workpiece; coordinate ascent from the worst poses and the
/// corners finds the largest error of the tip and tilt of the tool axis. The grid shows little of rotary axis errors: at
/// one rotary pose a location error moves the workpiece as a rigid body.
#[derive(clap::Args)]
#[command(after_help = "\
Examples:
  volcomp map -m gantry.toml -o map.vti
  volcomp map -m calibrated.toml --grid 5x5x5 --truth truth.toml")]
pub(crate) struct MapArguments {
    #[command(flatten)]
    machine: MachineArguments,
    /// Nodes along X, Y and Z
    #[arg(long, default_value = "11x11x11")]
    grid: String,
    #[command(flatten)]
    others: OthersArguments,
    /// File for the field: .csv, .vti (VTK image data), .vtr (VTK rectilinear grid), or .parquet in builds with this
    /// feature
    #[arg(long, short)]
    output: Option<PathBuf>,
    #[command(flatten)]
    plot: PlotArguments,
    /// Form of the model: compiled (curves within 1 nm and 1 nrad, errors to first order), or as for `error` [default:
    /// compiled; with a correction exact, curves within 0.01 nm]
    #[arg(long)]
    model: Option<Model>,
    /// As --model exact
    #[arg(long, conflicts_with = "model")]
    exact: bool,
    #[command(flatten)]
    compensation: CompensationArguments,
    #[command(flatten)]
    uncertainty: UncertaintyArguments,
}

/// Result of `volcomp map`: the volumetric error over the grid and over poses of all axes.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct Map {
    /// Nodes along the axes of the grid, in the order X, Y, Z.
    counts: Vec<usize>,
    /// Number of nodes of the whole grid.
    nodes: usize,
    /// Form of the model: exact, htm, twist or compiled.
    model: String,
    /// Maximum deviation of a curve of the compiled machine from its source, nm and nrad; only with
    /// the compiled form.
    #[serde(skip_serializing_if = "Option::is_none")]
    tolerance_nm: Option<f64>,
    /// Length of the largest position error, µm.
    largest_um: f64,
    /// Node with the largest position error, mm.
    at: ByAxis,
    /// Position error at `at`, in workpiece axes, µm.
    position_um: [f64; 3],
    /// Rotation error at `at`, in workpiece axes, µrad.
    rotation_urad: [f64; 3],
    /// Root mean square length of the position error over all nodes, µm.
    rms_um: f64,
    /// Root mean square length of the position error after best-fit alignment of the workpiece
    /// (three shifts, three small rotations), µm. The location of the workpiece is a convention and
    /// not an error.
    form_rms_um: f64,
    /// Length of the largest position error after alignment, µm.
    form_max_um: f64,
    /// The volumetric error over poses of all axes.
    all_axes: AllAxes,
    /// The largest standard uncertainty; only with `--uncertainty`.
    #[serde(skip_serializing_if = "Option::is_none")]
    uncertainty: Option<Uncertainty>,
    /// Settings of the correction; only with `--compensated`, `--truth` or `--resolution`.
    #[serde(skip_serializing_if = "Option::is_none")]
    compensated: Option<Compensated>,
    /// Path of the file with the field; only with `--output`.
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
    /// Largest standard uncertainty of the position error (length) over all nodes, µm.
    largest_um: f64,
    /// Node with the largest standard uncertainty, mm.
    at: ByAxis,
    /// Standard uncertainty of the position error at `at`, µm.
    position_um: [f64; 3],
    /// Standard uncertainty of the rotation error at `at`, µrad.
    rotation_urad: [f64; 3],
    /// Errors that the observations do not determine and the uncertainties do not include, sorted
    /// by their effect on the tool.
    not_counted: Vec<NotCounted>,
}

impl MapArguments {
    /// The form of the model. A correction is only applied in the exact form.
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

pub(crate) fn run(arguments: &MapArguments) -> Result<Answer, Failure> {
    let counts = parse_grid(&arguments.grid)?;
    let model = arguments.model()?;
    let output = arguments.output.as_deref();
    let mut others_than_plot = vec![(arguments.machine.machine.as_path(), "--machine")];
    others_than_plot.extend(output.map(|output| (output, "--output")));
    let plot = arguments.plot.open(&others_than_plot)?;
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
            if arguments.model.is_some() || arguments.exact {
                Box::new(|state| compensation.exact_residual(state))
            } else {
                Box::new(|state| compensation.residual(state))
            }
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
    // Evaluate exactly even for a compiled map, so that the value equals that of the report to the last digit.
    let exact = (model == Model::Compiled).then(|| errors(&machine, &temperatures));
    let errors = exact.as_ref().unwrap_or(&work.errors);
    let curves = vec![&machine, compensation.actual()];
    let (all_axes, volumetric) = all_axes(&machine, curves, errors, ensemble.as_ref())?;
    if let Some(plot) = plot {
        let svg =
            picture(arguments, [&machine, compensation.actual()], (errors, volumetric), &others)?;
        plot.write(&svg)?;
    }
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

/// The maps of the report, after alignment of the workpiece over poses of all axes.
fn picture(
    arguments: &MapArguments,
    [machine, actual]: [&Machine; 2],
    (errors, found): (&ErrorAt<'_>, VolumetricError),
    others: &[(AxisName, f64)],
) -> Result<String, Failure> {
    let field = ErrorField { tool: "", machine, curves: vec![machine, actual], errors };
    let (title, state) = if arguments.compensation.is_asked_for() {
        ("Volumetric error after correction", Drawn::TruthCorrected)
    } else {
        ("Volumetric error", Drawn::Found)
    };
    let found = volume([machine, actual], others, (state, &[field], found), None)?;
    let Some(found) = found else {
        return Err(Failure::in_file(
            &arguments.machine.machine,
            "a machine with fewer than two of the axes X, Y and Z, expected two for --plot",
        ));
    };
    let size = &found.before.found;
    let [max, rms] = [size.form_max_um, size.form_rms_um].map(|um| fixed(um, 3));
    let lines = [
        arguments.machine.machine.display().to_string(),
        format!("tip over poses of all axes, workpiece aligned: largest {max} µm, RMS {rms} µm"),
        standing(&found),
    ];
    Ok(map_picture(title, &lines, &found))
}

/// The positions of the axes that do not move on the planes; empty if all axes move.
fn standing(found: &Volume) -> String {
    let at = found
        .standing
        .iter()
        .map(|(axis, at)| format!("{axis} = {at}{}", if axis.is_rotary() { "°" } else { " mm" }));
    let at: Vec<String> = at.collect();
    if at.is_empty() {
        return String::new();
    }
    format!("planes of X, Y and Z at {}", at.join(", "))
}

fn document(
    arguments: &MapArguments,
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

fn text(arguments: &MapArguments, map: &Map, compensation: &Compensation<'_>) -> String {
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
        let _ = writeln!(
            text,
            "  standard uncertainty: root mean square {rms} µm, largest {largest} µm\n    of the whole rotation {turn} µrad; the largest at {}",
            pose_text(&u.at)
        );
    }
    text
}

fn pose_text(at: &ByAxis) -> String {
    let at = at.iter().map(|(name, q)| format!("{name}={}", fixed(*q, 3)));
    at.collect::<Vec<_>>().join(" ")
}

fn describe(text: &mut String, what: &str, length_um: f64, [x, y, z]: [f64; 3], at: &ByAxis) {
    let at = at.iter().map(|(name, place)| format!("{name}={place}"));
    let at: Vec<String> = at.collect();
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
    let counts: Option<Vec<usize>> =
        text.split(['x', 'X', '×', ',']).map(|count| count.trim().parse().ok()).collect();
    counts
        .and_then(|counts| <[usize; 3]>::try_from(counts).ok())
        .filter(|counts| {
            let product =
                counts.iter().try_fold(1_usize, |product, &count| product.checked_mul(count));
            product.is_some_and(|product| (1..=10_000_000_000).contains(&product))
        })
        .ok_or_else(|| {
            Failure::Input(format!(
                "--grid: found `{text}`, expected three counts of nodes from 1: 21x21x21"
            ))
        })
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Model {
    /// The chain with the curves of the machine file.
    Form(Form),
    /// The compiled machine: curves as piecewise cubics, errors to first order.
    Compiled,
}

impl FromStr for Model {
    type Err = &'static str;

    fn from_str(name: &str) -> Result<Self, Self::Err> {
        match name {
            "compiled" => Ok(Self::Compiled),
            _ => name
                .parse()
                .map(Self::Form)
                .map_err(|_| "unknown model form, expected compiled, exact, htm or twist"),
        }
    }
}

impl Model {
    fn name(self) -> String {
        match self {
            Self::Form(form) => form.to_string(),
            Self::Compiled => "compiled".to_owned(),
        }
    }

    /// Maximum deviation of a compiled curve from its source, nm and nrad.
    fn tolerance_nm(self) -> Option<f64> {
        (self == Self::Compiled).then(|| Tolerance::default().linear_mm * 1e6)
    }

    /// The error at a state as a function: position (mm) and rotation (rad) in workpiece axes.
    fn errors<'a>(
        self,
        machine: &'a Machine,
        temperatures: &Temperatures,
    ) -> Result<ErrorAt<'a>, Failure> {
        match self {
            Self::Form(form) => {
                Ok(errors_by(machine, Box::new(machine.source(temperatures)), form))
            }
            Self::Compiled => {
                let compiled = machine.compile_at(Tolerance::default(), temperatures)?;
                Ok(Box::new(move |state| compiled.evaluate(state).into_six()))
            }
        }
    }
}

/// Number of nodes in a unit of parallel work.
const CHUNK: usize = 4096;

/// The inputs of the computation of a node.
struct Work<'a> {
    machine: &'a Machine,
    errors: ErrorAt<'a>,
    ensemble: Option<&'a Ensemble>,
    grid: &'a MapGrid,
}

impl Work<'_> {
    /// One pass over all nodes: computed in chunks on all cores, and written in order.
    fn go_through(&self, pass: usize, field: &mut Field, found: &mut Found) -> Result<(), Failure> {
        let bar = output::bar(self.grid.len(), "nodes");
        let format = field.text_format().map(|(format, _)| format);
        let count = self.grid.len();
        // A node with an uncertainty takes as long as hundreds without, so its chunks are smaller.
        let size = if self.ensemble.is_some() { CHUNK / 64 } else { CHUNK };
        let at_once = size * 4 * rayon::current_num_threads();
        for from in (0..count).step_by(at_once) {
            let starts: Vec<usize> = (from..count.min(from + at_once)).step_by(size).collect();
            let chunks: Vec<Chunk> = starts
                .into_par_iter()
                .map(|start| self.chunk(start..count.min(start + size), pass, format))
                .collect();
            for chunk in &chunks {
                field.write(&chunk.nodes, &chunk.text)?;
                found.largest.take(&chunk.largest);
                if pass == 0 {
                    found.sums.merge(&chunk.sums);
                    found.lengths.merge(&chunk.lengths);
                }
                bar.inc(chunk.nodes.len() as u64);
            }
        }
        bar.finish_and_clear();
        Ok(())
    }

    /// Statistics after a common alignment of all nodes. Needs one further pass over the nodes.
    fn beside(&self, found: &Found) -> Beside {
        let motion = found.sums.motion();
        let count = self.grid.len();
        let mut left = Lengths::default();
        let at_once = CHUNK * 4 * rayon::current_num_threads();
        for from in (0..count).step_by(at_once) {
            let starts: Vec<usize> = (from..count.min(from + at_once)).step_by(CHUNK).collect();
            let of_chunk = |start: usize| {
                let mut left = Lengths::default();
                for index in start..count.min(start + CHUNK) {
                    let (_, state) = self.grid.node(self.machine, index);
                    let tip_mm = self.machine.chain().ideal_tip_mm(&state);
                    left.take(&motion.left_mm(&tip_mm, &position(&(self.errors)(&state))));
                }
                left
            };
            let chunks: Vec<Lengths> = starts.into_par_iter().map(of_chunk).collect();
            for chunk in &chunks {
                left.merge(chunk);
            }
        }
        Beside { as_they_are: found.lengths, left }
    }

    fn chunk(
        &self,
        nodes: core::ops::Range<usize>,
        pass: usize,
        format: Option<TextFormat>,
    ) -> Chunk {
        let states: Vec<([f64; 3], State)> =
            nodes.map(|index| self.grid.node(self.machine, index)).collect();
        let uncertainties = self.ensemble.map(|ensemble| {
            let states: Vec<State> = states.iter().map(|(_, state)| *state).collect();
            ensemble.standard_uncertainties(&states)
        });
        let node = |(index, (at_mm, state)): (usize, ([f64; 3], State))| Node {
            at_mm,
            tip_mm: self.machine.chain().ideal_tip_mm(&state),
            error: (self.errors)(&state),
            uncertainty: uncertainties.as_ref().map(|all| all[index]),
        };
        let nodes: Vec<Node> = states.into_iter().enumerate().map(node).collect();
        let mut largest = Largest::default();
        let (mut sums, mut lengths) = (RigidSums::default(), Lengths::default());
        for node in &nodes {
            largest.see(node);
            let error = position(&node.error);
            sums.take(&node.tip_mm, &error);
            lengths.take(&error);
        }
        let lines = |format: TextFormat| format.lines(pass, self.grid.axes.len(), &nodes);
        Chunk { text: format.map(lines).unwrap_or_default(), largest, sums, lengths, nodes }
    }
}

struct Chunk {
    nodes: Vec<Node>,
    text: String,
    largest: Largest,
    sums: RigidSums,
    lengths: Lengths,
}

#[derive(Default)]
struct Found {
    largest: Largest,
    sums: RigidSums,
    lengths: Lengths,
}

/// The node with the largest position error, and the node with the largest uncertainty of the position error; of
/// equals, the first node.
#[derive(Clone, Copy, Default)]
struct Largest {
    error: Option<(f64, Node)>,
    uncertainty: Option<(f64, Node)>,
}

impl Largest {
    fn see(&mut self, node: &Node) {
        keep(&mut self.error, length(&node.error), node);
        if let Some(uncertainty) = &node.uncertainty {
            keep(&mut self.uncertainty, length(uncertainty), node);
        }
    }

    fn take(&mut self, other: &Self) {
        for (into, found) in
            [(&mut self.error, &other.error), (&mut self.uncertainty, &other.uncertainty)]
        {
            if let Some((length, node)) = found {
                keep(into, *length, node);
            }
        }
    }
}

fn keep(most: &mut Option<(f64, Node)>, length: f64, node: &Node) {
    if most.as_ref().is_none_or(|(before, _)| length > *before) {
        *most = Some((length, *node));
    }
}

fn length([x, y, z, ..]: &[f64; 6]) -> f64 {
    (x * x + y * y + z * z).sqrt()
}

/// Volumetric error over a fixed set of poses that covers the travels of all axes, rotary ones too.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct AllAxes {
    /// Number of poses evaluated.
    pub(crate) poses: usize,
    /// Root mean square length of the position error, µm.
    pub(crate) rms_um: f64,
    /// Length of the largest position error, µm.
    pub(crate) max_um: f64,
    /// Root mean square length of the position error after alignment of the workpiece, µm.
    pub(crate) form_rms_um: f64,
    /// Largest error of the tool tip after alignment, found by a search from the worst poses, µm.
    pub(crate) form_max_um: f64,
    /// Pose with `form_max_um`, mm and deg.
    pub(crate) at: ByAxis,
    /// Largest tilt of the tool axis after alignment, µrad.
    pub(crate) tilt_max_urad: f64,
    /// Root mean square of the rotation error, µrad.
    pub(crate) rms_urad: f64,
    /// Root mean square of the rotation error after alignment, µrad.
    pub(crate) form_rms_urad: f64,
    /// Root mean square of the tilt of the tool axis (the rotation error across it), µrad.
    pub(crate) tilt_rms_urad: f64,
    /// Root mean square of the tilt after alignment, µrad.
    pub(crate) form_tilt_rms_urad: f64,
    /// Root mean square of the rotation error about the tool axis, which has no effect on a
    /// rotating tool, µrad.
    pub(crate) about_tool_rms_urad: f64,
    /// Root mean square of the rotation error about the tool axis after alignment, µrad.
    pub(crate) form_about_tool_rms_urad: f64,
    /// Standard uncertainty of the errors over these poses; only with `--uncertainty`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) uncertainty: Option<AllAxesUncertainty>,
}

/// The standard uncertainty (k = 1) of the errors over poses of all axes.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct AllAxesUncertainty {
    /// Standard uncertainty of the position error (length of its three components), root mean
    /// square over the poses, µm.
    pub(crate) rms_um: f64,
    /// Largest standard uncertainty of the position error (length), µm.
    pub(crate) largest_um: f64,
    /// Pose with `largest_um`, mm and deg.
    pub(crate) at: ByAxis,
    /// Standard uncertainty of the rotation error (length of its three components), root mean
    /// square over the poses, µrad.
    pub(crate) rms_urad: f64,
    /// Largest standard uncertainty of the rotation error (length), µrad.
    pub(crate) largest_urad: f64,
}

/// Position errors before and after alignment, mm.
#[derive(Clone, Copy)]
struct Beside {
    as_they_are: Lengths,
    left: Lengths,
}

/// Lengths of rotations: total, across the tool axis (tilt), and about the tool axis. A rotation about the tool axis
/// has no effect on a rotating tool.
#[derive(Clone, Copy, Default)]
struct Turns {
    whole: Lengths,
    tilt: Lengths,
    about_tool: Lengths,
}

impl Turns {
    fn take(&mut self, turn: &Vector3<f64>, tool_axis: &Vector3<f64>) {
        let about = tool_axis * tool_axis.dot(turn);
        self.whole.take(turn);
        self.tilt.take(&(turn - about));
        self.about_tool.take(&about);
    }
}

fn position([x, y, z, ..]: &[f64; 6]) -> Vector3<f64> {
    Vector3::new(*x, *y, *z)
}

/// The errors of the machine over poses of all axes, and their uncertainty if there is an ensemble.
fn all_axes(
    machine: &Machine,
    curves: Vec<&Machine>,
    errors: &ErrorAt<'_>,
    ensemble: Option<&Ensemble>,
) -> Result<(AllAxes, VolumetricError), Failure> {
    let field = ErrorField { tool: "", machine, curves, errors };
    let volumetric = volumetric(&[field])?;
    let motion = volumetric.alignment;
    let poses = poses_of_all_axes(machine)?;
    let found: Vec<[f64; 6]> = poses.par_iter().map(errors).collect();
    let chain = machine.chain();
    let tools = poses.iter().map(|pose| chain.ideal_pose(pose).rotation * chain.tool_axis());
    let [mut turns, mut turns_left] = [Turns::default(); 2];
    for (tool_axis, error) in tools.zip(&found) {
        let [.., a, b, c] = *error;
        let turn = Vector3::new(a, b, c);
        let tool_axis = &tool_axis;
        turns.take(&turn, tool_axis);
        turns_left.take(&motion.left_rad(&turn), tool_axis);
    }
    let all_axes = AllAxes {
        poses: volumetric.poses,
        rms_um: 1e3 * volumetric.rms_mm,
        max_um: 1e3 * volumetric.max_mm,
        form_rms_um: 1e3 * volumetric.position_rms_mm,
        form_max_um: 1e3 * volumetric.position.value,
        at: volumetric.position.at.clone().into_iter().collect(),
        tilt_max_urad: 1e6 * volumetric.tilt.value,
        rms_urad: 1e6 * turns.whole.rms(),
        form_rms_urad: 1e6 * turns_left.whole.rms(),
        tilt_rms_urad: 1e6 * turns.tilt.rms(),
        form_tilt_rms_urad: 1e6 * turns_left.tilt.rms(),
        about_tool_rms_urad: 1e6 * turns.about_tool.rms(),
        form_about_tool_rms_urad: 1e6 * turns_left.about_tool.rms(),
        uncertainty: ensemble.map(|ensemble| {
            uncertainty(machine, ensemble, &poses[..UNCERTAINTY_POSES.min(poses.len())])
        }),
    };
    Ok((all_axes, volumetric))
}

fn uncertainty(machine: &Machine, ensemble: &Ensemble, poses: &[State]) -> AllAxesUncertainty {
    let bar = output::bar(poses.len(), "poses");
    let of = |poses: &[State]| {
        let found = ensemble.standard_uncertainties(poses);
        bar.inc(poses.len() as u64);
        found
    };
    let found: Vec<[f64; 6]> = poses.par_chunks(CHUNK / 64).flat_map(of).collect();
    bar.finish_and_clear();
    let [mut lengths, mut turns] = [Lengths::default(); 2];
    let mut most: Option<(f64, &State)> = None;
    for (six, pose) in found.iter().zip(poses) {
        let [.., a, b, c] = *six;
        let length = position(six);
        lengths.take(&length);
        turns.take(&Vector3::new(a, b, c));
        if most.is_none_or(|(before, _)| length.norm() > before) {
            most = Some((length.norm(), pose));
        }
    }
    AllAxesUncertainty {
        rms_um: 1e3 * lengths.rms(),
        largest_um: 1e3 * lengths.max(),
        at: most.map_or_else(ByAxis::new, |(_, pose)| machine.coordinates(pose)),
        rms_urad: 1e6 * turns.rms(),
        largest_urad: 1e6 * turns.max(),
    }
}
