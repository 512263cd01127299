//! Generates the row files of the volumetric instruments, and the file of observations that names them.

mod bars;
mod diagonals;
mod distances;
mod points;
mod spheres;

use std::fmt::Write;

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use volcomp_document::{csv_cell, toml_string};
use volcomp_identify::Approach;
use volcomp_kinematics::{
    State,
    nalgebra::{Matrix3, Vector3},
};
use volcomp_model::Machine;
use volcomp_vocabulary::{Direction, Displacement, MAX_AXES};

use crate::{
    error::{ObservationError, ShopError},
    observation::{Poses, Setting, ShopObservation},
    poses::FreeAxes,
    shop::{CALIBRATED, Shop},
};

/// Number of the first random stream of observations, separate from those of lines.
const FIRST_STREAM: u64 = 1 << 32;

/// Number of the first random stream of approach directions, separate from the streams of readings.
const FIRST_SIDES: u64 = 1 << 48;

struct Made {
    files: Vec<(String, String)>,
    tables: String,
}

impl Shop {
    pub(crate) fn observe(
        &self,
        mut done: impl FnMut(),
    ) -> Result<Vec<(String, String)>, ShopError> {
        let mut files = Vec::new();
        if self.observations.is_empty() {
            return Ok(files);
        }
        let unknown: Vec<String> = self
            .unknown
            .iter()
            .map(|unknown| format!("    {},\n", unknown.to_toml(false)))
            .collect();
        // The observations start from the errors that the lines determine, and identify the others.
        let machine = if self.has_calibration() { CALIBRATED } else { "machine.toml" };
        let mut text = String::new();
        if machine == CALIBRATED {
            let _ = writeln!(text, "# Made by: volcomp calibrate calibration.toml -o {CALIBRATED}");
        }
        let _ = write!(text, "machine = \"{machine}\"\nunknown = [\n{}]\n", unknown.concat());
        let numbers = sphere_numbers(&self.observations);
        for ((index, observation), spheres) in self.observations.iter().enumerate().zip(numbers) {
            let mut random = ChaCha8Rng::seed_from_u64(self.seed);
            random.set_stream(FIRST_STREAM + index as u64);
            let made = Observer::new(&self.truth, observation, spheres, random)
                .and_then(Observer::observe)
                .map_err(|source| ShopError::Observation {
                    name: observation.name.clone(),
                    source: Box::new(source),
                })?;
            files.extend(made.files);
            text.push_str(&made.tables);
            done();
        }
        files.push(("observations.toml".to_owned(), text));
        Ok(files)
    }
}

/// Numbers of the spheres of each observation, from 1, for their names S1, S2, …, which must be unique in the file of observations.
/// Spheres at the same position are one sphere.
fn sphere_numbers(observations: &[ShopObservation]) -> Vec<Vec<usize>> {
    let mut places: Vec<[f64; 3]> = Vec::new();
    let mut number = |centre: &[f64; 3]| {
        let known = places.iter().position(|place| place == centre);
        known.unwrap_or_else(|| {
            places.push(*centre);
            places.len() - 1
        }) + 1
    };
    observations
        .iter()
        .map(|observation| match &observation.setting {
            Setting::Sphere { centres, .. } => centres.iter().map(&mut number).collect(),
            _ => Vec::new(),
        })
        .collect()
}

struct Observer<'a> {
    truth: &'a Machine,
    what: &'a ShopObservation,
    /// Numbers of the spheres of this observation, from 1.
    spheres: Vec<usize>,
    tools: Tools<'a>,
    free_axes: FreeAxes,
    random: ChaCha8Rng,
    approach: Approach,
    /// Random generator for the approach directions of the axes before the first row.
    sides: ChaCha8Rng,
}

/// Names of the tools, which are used in turn from pose to pose, with the machine that has each tool; the name is empty for the tool in the spindle.
struct Tools<'a>(Vec<(&'a str, Machine)>);

impl Tools<'_> {
    fn at(&self, pose: usize) -> &(&str, Machine) {
        &self.0[pose % self.0.len()]
    }

    fn machine(&self, pose: usize) -> &Machine {
        &self.at(pose).1
    }

    /// Cell of the tool in a row, with a trailing comma; empty if no tool is named.
    fn cell(&self, pose: usize) -> String {
        match self.at(pose).0 {
            "" => String::new(),
            tool => format!("{},", csv_cell(tool)),
        }
    }
}

impl<'a> Observer<'a> {
    fn new(
        truth: &'a Machine,
        what: &'a ShopObservation,
        spheres: Vec<usize>,
        random: ChaCha8Rng,
    ) -> Result<Self, ObservationError> {
        let mut machines = Vec::new();
        for tool in &what.tools {
            let mut machine = truth.clone();
            machine.select_tool(tool)?;
            machines.push((tool.as_str(), machine));
        }
        if machines.is_empty() {
            machines.push(("", truth.clone()));
        }
        // Rejects missing axes and coordinates that are not finite.
        truth.state(&what.at)?;
        let mut sides = random.clone();
        sides.set_stream(FIRST_SIDES + random.get_stream());
        Ok(Self {
            truth,
            what,
            spheres,
            tools: Tools(machines),
            free_axes: FreeAxes::new(truth, &what.at),
            random,
            approach: from_one_side(&mut sides),
            sides,
        })
    }

    fn observe(mut self) -> Result<Made, ObservationError> {
        match self.what.setting.clone() {
            Setting::Points { poses, frame, target } => Ok(self.points(&poses, &frame, target)),
            Setting::Sphere { poses, centres, reads } => self.spheres(&poses, &centres, reads),
            Setting::Distance { poses, point, dead_length_mm, radius_mm } => {
                self.distances(&poses, point.into(), dead_length_mm, radius_mm)
            }
            Setting::StepGauge(bar) => self.step_gauge(&bar),
            Setting::BallRow { bar, reads } => self.ball_row(&bar, reads),
            Setting::Diagonals { names } => self.diagonals(&names),
        }
    }

    fn everywhere(&mut self, poses: &Poses) -> Vec<State> {
        match poses {
            Poses::Drawn(count) => self.free_axes.everywhere(*count, &mut self.random),
            Poses::Planned(plan) => self.free_axes.planned(self.truth, plan),
        }
    }

    fn normal(&mut self) -> f64 {
        StandardNormal.sample(&mut self.random)
    }

    fn direction(&mut self) -> Vector3<f64> {
        direction(&mut self.random)
    }

    /// Adds noise to a value and rounds it to the resolution, mm.
    fn read(&mut self, value_mm: f64) -> f64 {
        let length = self.what.instrument.length;
        let read = value_mm + 1e-3 * length.noise.0 * self.normal();
        let step = 1e-3 * length.resolution.0;
        if step > 0.0 { (read / step).round() * step } else { read }
    }

    /// Drift of the set-up at a row, mm: zero at the first row, complete at the last.
    fn drift_mm(&self, direction: &Vector3<f64>, row: usize, rows: usize) -> Vector3<f64> {
        let share = row as f64 / rows.saturating_sub(1).max(1) as f64;
        direction * (1e-3 * self.what.instrument.length.drift.0 * share)
    }

    /// Column names of the axes, each with a trailing comma.
    fn axes_header(&self) -> String {
        let letters = self.truth.axes().iter().map(|axis| format!("{},", axis.name));
        letters.collect()
    }

    /// Cells of the coordinates, mm or deg, each with a trailing comma.
    fn coordinates(&self, state: &State) -> String {
        let axes = self.truth.axes().iter().zip(&state.q);
        axes.fold(String::new(), |mut text, (axis, &q)| {
            let at = Displacement::new(axis.name.kind(), q).mm_or_deg();
            text.push_str(&number(at));
            text.push(',');
            text
        })
    }

    fn tool_header(&self) -> &'static str {
        if self.what.tools.is_empty() { "" } else { "tool," }
    }

    fn table(&self, kind: &str, file: &str, uncertainty_um: f64) -> String {
        let drift = if self.what.drifts() { "drift = 1\n" } else { "" };
        format!(
            "\n[[observation]]\nkind = \"{kind}\"\nfile = {}\nuncertainty_um = {}\n{drift}",
            toml_string(file),
            number(uncertainty_um)
        )
    }

    /// Indices of the marks in each pass, in the order in which they are measured.
    fn passes(&self, marks: usize) -> Vec<Vec<usize>> {
        let instrument = &self.what.instrument;
        let mut passes = Vec::new();
        for _ in 0..instrument.runs {
            passes.push((0..marks).collect());
            if instrument.both_directions {
                passes.push((0..marks).rev().collect());
            }
        }
        passes
    }

    fn held(&self) -> Result<State, ObservationError> {
        Ok(self.truth.state(&self.what.at)?)
    }
}

/// Random direction of approach for each axis before the first row; it is not recorded in the files.
fn from_one_side(random: &mut ChaCha8Rng) -> Approach {
    let side = |()| Direction::of(random.random_range(-1.0..1.0));
    Approach::from_sides([(); MAX_AXES].map(side))
}

/// Random unit vector, uniformly distributed.
fn direction(random: &mut ChaCha8Rng) -> Vector3<f64> {
    let [x, y, z] = [(); 3].map(|()| StandardNormal.sample(random));
    Vector3::<f64>::new(x, y, z).try_normalize(1e-12).unwrap_or_else(Vector3::x)
}

/// Matrix whose columns are a unit direction and two unit directions normal to it.
fn across(along: &Vector3<f64>) -> Matrix3<f64> {
    let side = Vector3::ith(along.iamin(), 1.0);
    let side1 = (side - along * along.dot(&side)).normalize();
    Matrix3::from_columns(&[*along, side1, along.cross(&side1)])
}

/// Appends a row: `cells`, which end with a comma, then numbers.
fn push_row(text: &mut String, cells: &str, numbers: &[f64]) {
    let numbers: Vec<String> = numbers.iter().map(|x| number(*x)).collect();
    let _ = writeln!(text, "{cells}{}", numbers.join(","));
}

fn push_offset(text: &mut String, cells: &str, read_mm: Option<Vector3<f64>>) {
    match read_mm {
        Some(offset) => push_row(text, &format!("{cells},"), (offset * 1e3).as_slice()),
        None => {
            let _ = writeln!(text, "{cells}");
        }
    }
}

fn number(x: f64) -> String {
    let text = format!("{x:.6}");
    let text = text.trim_end_matches('0').trim_end_matches('.');
    if text == "-0" { "0".to_owned() } else { text.to_owned() }
}
