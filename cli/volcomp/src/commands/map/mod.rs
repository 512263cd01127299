//! `volcomp map`: the error on a grid over the travels, and its uncertainty.

mod field;
#[cfg(feature = "parquet")]
mod parquet;

use std::{fmt::Write, path::PathBuf, str::FromStr};

use rayon::prelude::*;
use serde_json::{Map, Value, json};
use volcomp_calibrate::{CalibrationFile, calibrate};
use volcomp_kinematics::{Form, State, volumetric_error};
use volcomp_model::{Ensemble, Machine, MapGrid, Temperatures, Tolerance};

use self::field::{Field, TextFormat};
use super::{Answer, thermal_note};
use crate::{failure::Failure, points::MachineArguments, progress};

/// Nodes that one core takes at a time.
const CHUNK: usize = 4096;

/// The volumetric map: the error on a grid over the travels of X, Y and Z
#[derive(clap::Args)]
pub(crate) struct Arguments {
    #[command(flatten)]
    machine: MachineArguments,
    /// Nodes along X, Y and Z: 21x21x21
    #[arg(long)]
    grid: String,
    /// File for the field: .csv, .vti (VTK image data), .vtr (VTK rectilinear grid), .parquet
    #[arg(long, short)]
    output: Option<PathBuf>,
    /// Form of the model: exact, htm, twist, or compiled: first order, for maps of many nodes
    #[arg(long, default_value = "exact")]
    model: Model,
    /// Calibration file whose readings are drawn again and again: adds the standard uncertainty (k = 1)
    #[arg(long, value_name = "CALIBRATION")]
    uncertainty: Option<PathBuf>,
    /// How often they are drawn
    #[arg(long, default_value_t = 200, requires = "uncertainty", value_parser = clap::value_parser!(u64).range(2..=100_000))]
    trials: u64,
    /// Seed of the draws: the same gives the same digits on any number of cores
    #[arg(long, default_value_t = 1, requires = "uncertainty")]
    seed: u64,
}

/// How the error at a node is computed.
#[derive(Clone, Copy, Debug)]
enum Model {
    Form(Form),
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
                .map_err(|_| "unknown model form, expected exact, htm, twist or compiled"),
        }
    }
}

/// One node of the map: mm and rad, in workpiece axes.
#[derive(Clone, Copy)]
struct Node {
    at_mm: [f64; 3],
    error: [f64; 6],
    /// Standard uncertainty.
    uncertainty: Option<[f64; 6]>,
}

impl Node {
    fn in_file_units(&self) -> [f64; 6] {
        in_file_units(&self.error)
    }

    fn uncertainty_in_file_units(&self) -> [f64; 6] {
        in_file_units(&self.uncertainty.unwrap_or_default())
    }
}

/// mm and rad in um and urad.
fn in_file_units(six: &[f64; 6]) -> [f64; 6] {
    let [x, y, z, a, b, c] = six;
    [x * 1e3, y * 1e3, z * 1e3, a * 1e6, b * 1e6, c * 1e6]
}

type ErrorAt<'a> = Box<dyn Fn(&State) -> [f64; 6] + Sync + 'a>;

impl Model {
    fn errors<'a>(
        self,
        machine: &'a Machine,
        temperatures: &Temperatures,
    ) -> Result<ErrorAt<'a>, Failure> {
        match self {
            Self::Form(form) => {
                let source = machine.source(temperatures);
                Ok(Box::new(move |state| {
                    let found = volumetric_error(machine.chain(), &source, state, form);
                    let (p, r) = (found.position_mm, found.rotation_rad);
                    [p.x, p.y, p.z, r.x, r.y, r.z]
                }))
            }
            Self::Compiled => {
                let compiled = machine.compile_at(Tolerance::default(), temperatures)?;
                Ok(Box::new(move |state| compiled.evaluate(state).into_six()))
            }
        }
    }
}

pub(crate) fn run(arguments: &Arguments) -> Result<Answer, Failure> {
    let counts = parse_grid(&arguments.grid)?;
    let (machine, temperatures) = arguments.machine.read()?;
    let mut notes: Vec<String> = thermal_note(&machine, &temperatures).into_iter().collect();
    let calibration = match &arguments.uncertainty {
        Some(path) => Some(read_calibration(path, &machine, &mut notes)?),
        None => None,
    };
    let grid = MapGrid::over_travels(&machine, counts)?;
    let mut field = Field::open(arguments.output.as_deref(), &grid, calibration.is_some())?;
    let ensemble = match &calibration {
        Some(file) => Some(ensemble(file, arguments, &machine)?),
        None => None,
    };
    let work = Work {
        machine: &machine,
        errors: arguments.model.errors(&machine, &temperatures)?,
        ensemble: ensemble.as_ref(),
        grid: &grid,
    };
    let mut largest = Largest::default();
    for pass in 0..field.passes() {
        field.begin(pass)?;
        work.go_through(pass, &mut field, &mut largest)?;
    }
    field.finish()?;
    Ok(answer(arguments, &grid, &largest, notes))
}

/// What is needed for a node.
struct Work<'a> {
    machine: &'a Machine,
    errors: ErrorAt<'a>,
    ensemble: Option<&'a Ensemble>,
    grid: &'a MapGrid,
}

impl Work<'_> {
    /// Every node once: in chunks on all cores, written in order.
    fn go_through(
        &self,
        pass: usize,
        field: &mut Field,
        largest: &mut Largest,
    ) -> Result<(), Failure> {
        let bar = progress::bar(self.grid.len(), "nodes");
        let format = field.text_format().map(|(format, _)| format);
        let count = self.grid.len();
        let at_once = CHUNK * 4 * rayon::current_num_threads();
        for from in (0..count).step_by(at_once) {
            let starts: Vec<usize> = (from..count.min(from + at_once)).step_by(CHUNK).collect();
            let chunks: Vec<Chunk> = starts
                .into_par_iter()
                .map(|start| self.chunk(start..count.min(start + CHUNK), pass, format))
                .collect();
            for chunk in &chunks {
                field.write(&chunk.nodes, &chunk.text)?;
                largest.take(&chunk.largest);
                bar.inc(chunk.nodes.len() as u64);
            }
        }
        bar.finish_and_clear();
        Ok(())
    }

    fn chunk(
        &self,
        nodes: core::ops::Range<usize>,
        pass: usize,
        format: Option<TextFormat>,
    ) -> Chunk {
        let nodes: Vec<Node> = nodes.map(|index| self.node(index)).collect();
        let mut largest = Largest::default();
        for node in &nodes {
            largest.see(node);
        }
        let lines = |format: TextFormat| format.lines(pass, self.grid.axes.len(), &nodes);
        Chunk {
            text: format.map(lines).unwrap_or_default(),
            largest,
            nodes,
        }
    }

    fn node(&self, index: usize) -> Node {
        let (at_mm, state) = self.grid.node(self.machine, index);
        Node {
            at_mm,
            error: (self.errors)(&state),
            uncertainty: self.ensemble.map(|e| e.standard_uncertainty(&state)),
        }
    }
}

struct Chunk {
    nodes: Vec<Node>,
    text: String,
    largest: Largest,
}

/// The nodes with the largest error and the largest uncertainty, of equals the first.
#[derive(Default)]
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
        for (into, found) in [
            (&mut self.error, &other.error),
            (&mut self.uncertainty, &other.uncertainty),
        ] {
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

/// Of the position, mm.
fn length([x, y, z, ..]: &[f64; 6]) -> f64 {
    (x * x + y * y + z * z).sqrt()
}

fn read_calibration(
    path: &std::path::Path,
    machine: &Machine,
    notes: &mut Vec<String>,
) -> Result<CalibrationFile, Failure> {
    let file = CalibrationFile::read(path)?;
    let (found, expected) = (
        file.machine.chain().structure(),
        machine.chain().structure(),
    );
    if found != expected {
        return Err(Failure::Input(format!(
            "{}: found the structure `{found}`, expected `{expected}` of --machine",
            path.display()
        )));
    }
    let single: Vec<String> = file
        .without_scatter()
        .map(|line| line.file.display().to_string())
        .collect();
    if !single.is_empty() {
        notes.push(format!(
            "one run only, no scatter known: {}; state reading_um or reading_urad in [uncertainty]",
            single.join(", ")
        ));
    }
    Ok(file)
}

/// Calibrations of readings drawn again, with the tool of the map.
fn ensemble(
    file: &CalibrationFile,
    arguments: &Arguments,
    mapped: &Machine,
) -> Result<Ensemble, Failure> {
    let bar = progress::bar(0, "calibrations drawn");
    bar.set_length(arguments.trials);
    let trial = |trial: u64| {
        let mut machine = calibrate(&file.varied(arguments.seed, trial), |_, _| {})?.machine;
        machine.use_tool_of(mapped)?;
        let compiled = machine.compile(Tolerance::from_nm(10.0))?;
        bar.inc(1);
        Ok::<_, Failure>(compiled)
    };
    let trials = (0..arguments.trials).into_par_iter().map(trial);
    let machines = trials.collect::<Result<Vec<_>, _>>()?;
    bar.finish_and_clear();
    // At least two trials, all of one structure: clap and `read_calibration` see to it.
    Ensemble::new(machines)
        .ok_or_else(|| Failure::Work("the drawn calibrations differ in structure".to_owned()))
}

fn answer(arguments: &Arguments, grid: &MapGrid, largest: &Largest, notes: Vec<String>) -> Answer {
    let counts: Vec<usize> = grid.nodes_mm.iter().map(Vec::len).collect();
    let mut json = json!({ "counts": counts, "nodes": grid.len() });
    let mut text = format!("{} nodes\n", grid.len());
    if let Some((length, node)) = &largest.error {
        let six = node.in_file_units();
        describe(&mut text, "largest error", *length, &six, grid, node);
        json["largest_um"] = json!(length * 1e3);
        json["at"] = place(grid, node);
        json["position_um"] = json!(six[..3]);
        json["rotation_urad"] = json!(six[3..]);
    }
    if let Some((length, node)) = &largest.uncertainty {
        let six = node.uncertainty_in_file_units();
        let what = "largest standard uncertainty";
        describe(&mut text, what, *length, &six, grid, node);
        json["uncertainty"] = json!({
            "trials": arguments.trials,
            "seed": arguments.seed,
            "largest_um": length * 1e3,
            "at": place(grid, node),
            "position_um": six[..3],
            "rotation_urad": six[3..],
        });
    }
    if let Some(path) = &arguments.output {
        json["file"] = json!(path.display().to_string());
    }
    Answer { json, text, notes }
}

fn place(grid: &MapGrid, node: &Node) -> Value {
    let named = grid.axes.iter().zip(node.at_mm);
    let at: Map<String, Value> = named
        .map(|(name, place)| (name.to_string(), json!(place)))
        .collect();
    Value::Object(at)
}

fn describe(
    text: &mut String,
    what: &str,
    length_mm: f64,
    six: &[f64; 6],
    grid: &MapGrid,
    node: &Node,
) {
    let named = grid.axes.iter().zip(node.at_mm);
    let at: Vec<String> = named
        .map(|(name, place)| format!("{name}={place}"))
        .collect();
    let _ = writeln!(
        text,
        "{what} {:.3} um [{:.3}, {:.3}, {:.3}] at {}",
        length_mm * 1e3,
        six[0],
        six[1],
        six[2],
        at.join(" ")
    ); // writing to a String cannot fail
}

fn parse_grid(text: &str) -> Result<[usize; 3], Failure> {
    let counts: Option<Vec<usize>> = text.split('x').map(|count| count.parse().ok()).collect();
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
