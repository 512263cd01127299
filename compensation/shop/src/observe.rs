//! Generates the row files of the volumetric instruments, and the file of observations that names them.

use std::fmt::Write;

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use volcomp_document::{csv_cell, toml_string};
use volcomp_identify::Approach;
use volcomp_kinematics::State;
use volcomp_kinematics::nalgebra::{Matrix3, Rotation3, Vector3};
use volcomp_model::Machine;
use volcomp_vocabulary::{AxisKind, AxisName, Direction, Displacement, MAX_AXES};

use crate::error::{ObservationError, ShopError};
use crate::poses::{FreeAxes, Plan, actual_tip};
use crate::shop::{Bar, CALIBRATED, Poses, Reads, Setting, Shop, ShopObservation};

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

struct TrueBar {
    origin: Vector3<f64>,
    /// Matrix whose columns are the nominal directions along and across the bar.
    axes: Matrix3<f64>,
    along: Vector3<f64>,
    distances: Vec<f64>,
}

struct AtMark {
    pass: usize,
    mark: usize,
    state: State,
    read: Option<Vector3<f64>>,
}

impl Observer<'_> {
    /// Draws the actual bar on the table: tilted, with distances that deviate according to their calibration.
    fn true_bar(&mut self, bar: &Bar) -> Result<TrueBar, ObservationError> {
        let along = Vector3::from(bar.direction)
            .try_normalize(1e-12)
            .ok_or(ObservationError::NoDirection)?;
        let axes = across(&along);
        let tilt = 1e-6 * self.what.instrument.alignment.0;
        let tilted = Vector3::new(1.0, tilt * self.normal(), tilt * self.normal());
        let mut distances = Vec::new();
        for &distance in &bar.distances {
            let by = self.normal() * 1e-3 * bar.calibration.0;
            distances.push(if distance == 0.0 { 0.0 } else { distance + by });
        }
        Ok(TrueBar {
            origin: bar.origin.into(),
            axes,
            along: (axes * tilted).normalize(),
            distances,
        })
    }

    /// Measures the marks of a bar, forward and, if requested, back.
    fn along(
        &mut self,
        bar: &Bar,
        real: &TrueBar,
        reads: Reads,
    ) -> Result<Vec<AtMark>, ObservationError> {
        let passes = self.passes(bar.distances.len());
        let rows = passes.len() * bar.distances.len();
        let drift = self.direction();
        let mut found = Vec::with_capacity(rows);
        for (pass, marks) in passes.into_iter().enumerate() {
            for mark in marks {
                let nominal = real.origin + real.axes.column(0) * bar.distances[mark];
                let held = self.free_axes.ideal(self.tools.machine(pass), self.held()?, &nominal);
                let state = held.ok_or(ObservationError::NotReached { at: nominal.into() })?;
                let drifted = self.drift_mm(&drift, found.len(), rows);
                let place = real.origin + drifted + real.along * real.distances[mark];
                let (state, read) = self.at_centre(pass, state, &place, &real.axes, reads)?;
                found.push(AtMark { pass, mark, state, read });
            }
        }
        Ok(found)
    }

    /// Measures a step gauge. Its faces are recorded like balls that are read only along the bar. Lengths of one run share their first face,
    /// and all runs share the calibration.
    fn step_gauge(&mut self, bar: &Bar) -> Result<Made, ObservationError> {
        let real = self.true_bar(bar)?;
        let rows = self.along(bar, &real, Reads::Coordinates)?;
        Ok(self.row_of(bar, &real, &rows, "F", [",along_um", ",0"]))
    }

    fn ball_row(&mut self, bar: &Bar, reads: Reads) -> Result<Made, ObservationError> {
        let real = self.true_bar(bar)?;
        let rows = self.along(bar, &real, reads)?;
        let offsets = match reads {
            Reads::Coordinates => "",
            Reads::Offset => ",along_um,side1_um,side2_um",
        };
        Ok(self.row_of(bar, &real, &rows, "B", [offsets, ""]))
    }

    /// Creates the row files of a bar. `letter` names its balls or faces. `head` is the header of the offset columns, and `always` the constant
    /// reading in the last of them.
    fn row_of(
        &self,
        bar: &Bar,
        real: &TrueBar,
        rows: &[AtMark],
        letter: &str,
        [head, always]: [&str; 2],
    ) -> Made {
        let mut text = format!("{}{}ball{head}\n", self.axes_header(), self.tool_header());
        for AtMark { pass, mark, state, read } in rows {
            let (at, tool) = (self.coordinates(state), self.tools.cell(*pass));
            push_offset(&mut text, &format!("{at}{tool}{letter}{}{always}", mark + 1), *read);
        }
        let mut row = String::from("ball,distance_mm,uncertainty_um\n");
        for (mark, &distance) in bar.distances.iter().enumerate() {
            let uncertainty = if distance == 0.0 { 0.0 } else { bar.calibration.0 };
            let _ =
                writeln!(row, "{letter}{},{},{}", mark + 1, number(distance), number(uncertainty));
        }
        let name = &self.what.name;
        let (file, row_file) = (format!("{name}.csv"), format!("{name}-row.csv"));
        let mut tables = self.table("ball-row", &file, self.what.uncertainty_um());
        let side: Vec<String> = real.axes.column(1).iter().map(|x| number(*x)).collect();
        let _ = writeln!(tables, "row = {}\nside1 = [{}]", toml_string(&row_file), side.join(", "));
        Made { files: vec![(file, text), (row_file, row)], tables }
    }
}

impl Observer<'_> {
    pub(super) fn diagonals(&mut self, names: &[String]) -> Result<Made, ObservationError> {
        let mut made = Made { files: Vec::new(), tables: String::new() };
        for name in names {
            let (file, text, direction) = self.diagonal(name)?;
            let mut tables = self.table("line", &file, self.what.uncertainty_um());
            let [x, y, z] = direction.map(number).into();
            let slope =
                if self.what.instrument.alignment.0 > 0.0 { "slope = \"unknown\"\n" } else { "" };
            let _ = write!(tables, "direction = [{x}, {y}, {z}]\noffset = \"unknown\"\n{slope}");
            made.tables.push_str(&tables);
            made.files.push((file, text));
        }
        Ok(made)
    }

    fn diagonal(&mut self, name: &str) -> Result<(String, String, Vector3<f64>), ObservationError> {
        let targets = self.what.instrument.targets;
        let mut ends = [self.what.at.clone(), self.what.at.clone()];
        for (axis, sense) in [AxisName::X, AxisName::Y, AxisName::Z].into_iter().zip(name.chars()) {
            let travel = self.truth.axes()[self.truth.index_of(axis)?].travel;
            let [from, to] = if sense == 'N' { [travel[1], travel[0]] } else { travel };
            ends[0].push((axis, from));
            ends[1].push((axis, to));
        }
        let [from, to] = ends;
        let (from, to) = (self.truth.state(&from)?, self.truth.state(&to)?);
        let place = |target: usize| {
            let share = target as f64 / (targets.max(2) - 1) as f64;
            let mut state = from;
            for (q, end) in state.q.iter_mut().zip(&to.q) {
                *q += (end - *q) * share;
            }
            state
        };
        let tip = |state: &State| self.truth.chain().ideal_tip_mm(state);
        let way = tip(&to) - tip(&from);
        let along = way.try_normalize(1e-12).ok_or(ObservationError::NoDirection)?;
        let axes = across(&along);
        let first = tip(&from);
        let tilt = 1e-6 * self.what.instrument.alignment.0;
        let tilted = Vector3::new(1.0, tilt * self.normal(), tilt * self.normal());
        let sight = (axes * tilted).normalize();
        let passes = self.passes(targets);
        let rows = passes.len() * targets;
        let mut text = format!("{}deviation_um\n", self.axes_header());
        self.approach = from_one_side(&mut self.sides);
        for (row, target) in passes.into_iter().flatten().enumerate() {
            let mut state = place(target);
            self.approach.to(&mut state, self.truth);
            let actual = actual_tip(self.truth, &state, &Vector3::zeros());
            let nominal = way.norm() * target as f64 / (targets.max(2) - 1) as f64;
            let drift = self.drift_mm(&Vector3::x(), row, rows).x;
            let read = self.read(sight.dot(&(actual - first)) - nominal + drift);
            let at = self.coordinates(&state);
            push_row(&mut text, &at, &[1e3 * read]);
        }
        let file = format!("{}-{}.csv", self.what.name, name.to_lowercase());
        Ok((file, text, along))
    }
}

impl Observer<'_> {
    pub(super) fn distances(
        &mut self,
        poses: &Poses,
        point: Vector3<f64>,
        dead_length_mm: f64,
        radius_mm: Option<f64>,
    ) -> Result<Made, ObservationError> {
        let states = match (radius_mm, poses) {
            (None, _) | (_, Poses::Planned(_)) => self.everywhere(poses),
            (Some(radius), &Poses::Drawn(poses)) => self
                .free_axes
                .around(
                    poses,
                    |pose| self.tools.machine(pose),
                    |_, random| point + direction(random) * radius,
                    &mut self.random,
                )
                .map_err(|found| ObservationError::Reach {
                    what: format!("poses at {radius} mm from the point"),
                    at: point.into(),
                    found,
                    poses,
                })?,
        };
        let poses = states.len();
        let drift = self.direction();
        let mut text = format!("{}{}length_mm\n", self.axes_header(), self.tool_header());
        for (pose, mut state) in states.into_iter().enumerate() {
            self.approach.to(&mut state, self.truth);
            let tip = actual_tip(self.tools.machine(pose), &state, &Vector3::zeros());
            let point = point + self.drift_mm(&drift, pose, poses);
            let read = self.read((tip - point).norm() - dead_length_mm);
            let (at, tool) = (self.coordinates(&state), self.tools.cell(pose));
            push_row(&mut text, &format!("{at}{tool}"), &[read]);
        }
        let file = format!("{}.csv", self.what.name);
        let mut tables = self.table("distance", &file, self.what.uncertainty_um());
        tables.push_str("point = \"unknown\"\n");
        if dead_length_mm != 0.0 {
            tables.push_str("dead_length = \"unknown\"\n");
        }
        Ok(Made { files: vec![(file, text)], tables })
    }
}

/// Standard uncertainty (k = 1) of the target position on the tool if measured with a ruler, mm.
const RULER_MM: f64 = 1.0;

impl Observer<'_> {
    pub(super) fn points(
        &mut self,
        poses: &Poses,
        frame: &[f64; 6],
        target: Option<[f64; 3]>,
    ) -> Made {
        let [a, b, c] = [frame[3], frame[4], frame[5]].map(f64::to_radians);
        let rotation = Rotation3::from_euler_angles(a, b, c);
        let place = Vector3::new(frame[0], frame[1], frame[2]);
        let offset = Vector3::from(target.unwrap_or_default());
        let states = self.everywhere(poses);
        let poses = states.len();
        let middle =
            states.iter().map(|state| self.truth.chain().ideal_tip_mm(state)).sum::<Vector3<f64>>()
                / poses.max(1) as f64;
        let (shift, turn) = (self.direction(), self.direction());
        let turn = turn * (1e-6 * self.what.instrument.angle.drift.0);
        let mut text = format!("{}{}x,y,z\n", self.axes_header(), self.tool_header());
        for (pose, mut state) in states.into_iter().enumerate() {
            self.approach.to(&mut state, self.truth);
            let tip = actual_tip(self.tools.machine(pose), &state, &offset);
            // A tracker that is displaced by +d measures every point displaced by −d.
            let share = pose as f64 / poses.saturating_sub(1).max(1) as f64;
            let drifted = self.drift_mm(&shift, pose, poses) + turn.cross(&(tip - middle)) * share;
            let seen = rotation.inverse() * (tip - drifted - place);
            let read = seen.map(|x| self.read(x));
            let (at, tool) = (self.coordinates(&state), self.tools.cell(pose));
            push_row(&mut text, &format!("{at}{tool}"), read.as_slice());
        }
        let file = format!("{}.csv", self.what.name);
        let mut tables = self.table("points", &file, self.what.uncertainty_um());
        tables.push_str("frame = \"unknown\"\n");
        if target.is_some() {
            let is_found = self.tells_targets();
            let what = self.what;
            let mut of_tool = || {
                if is_found {
                    return "\"unknown\"".to_owned();
                }
                let by_ruler = target.unwrap_or_default().map(|x| {
                    let read = x + RULER_MM * self.normal();
                    number((10.0 * read).round() / 10.0)
                });
                format!("[{}]", by_ruler.join(", "))
            };
            let by_tool: Vec<String> = what
                .tools
                .iter()
                .map(|tool| format!("{} = {}", toml_string(tool), of_tool()))
                .collect();
            let targets = if by_tool.is_empty() {
                of_tool()
            } else {
                format!("{{ {} }}", by_tool.join(", "))
            };
            let _ = writeln!(tables, "target = {targets}");
            if !is_found {
                let _ = writeln!(tables, "target_within_mm = {}", number(RULER_MM));
            }
        }
        Made { files: vec![(file, text)], tables }
    }

    /// Whether a tracker determines the target position on the tool, which requires two rotary axes.
    fn tells_targets(&self) -> bool {
        let rotary = self.truth.axes().iter();
        let rotary = rotary.filter(|axis| axis.name.kind() == AxisKind::Rotary);
        rotary.count() >= 2
    }
}

/// Maximum distance of the commanded tip from a sphere, mm: the range of an R-test is one or two millimetres.
const NEAR_MM: f64 = 2.0;

impl Observer<'_> {
    pub(super) fn spheres(
        &mut self,
        poses: &Poses,
        centres: &[[f64; 3]],
        reads: Reads,
    ) -> Result<Made, ObservationError> {
        let offsets = match reads {
            Reads::Coordinates => "",
            Reads::Offset => ",dx_um,dy_um,dz_um",
        };
        let mut text = format!("{}{}sphere{offsets}\n", self.axes_header(), self.tool_header());
        match poses {
            &Poses::Drawn(poses) => {
                for (sphere, centre) in centres.iter().enumerate() {
                    let drift = self.direction();
                    let states = self.around(sphere, (*centre).into(), poses)?;
                    for (pose, state) in states.into_iter().enumerate() {
                        let centre = Vector3::from(*centre) + self.drift_mm(&drift, pose, poses);
                        text.push_str(&self.at_sphere(pose, state, sphere, &centre, reads)?);
                    }
                }
            }
            Poses::Planned(plan) => {
                let drifts: Vec<_> = centres.iter().map(|_| self.direction()).collect();
                let states = self.free_axes.planned(self.truth, plan);
                let rows = states.len();
                for (pose, (state, planned)) in states.into_iter().zip(&plan.poses).enumerate() {
                    let sphere = planned.sphere;
                    let (Some(centre), Some(drift)) = (centres.get(sphere), drifts.get(sphere))
                    else {
                        return Err(ObservationError::NoSphere {
                            found: sphere + 1,
                            most: centres.len(),
                        });
                    };
                    let centre = Vector3::from(*centre);
                    let state = self.to_sphere(pose, state, sphere, &centre, plan)?;
                    let centre = centre + self.drift_mm(drift, pose, rows);
                    text.push_str(&self.at_sphere(pose, state, sphere, &centre, reads)?);
                }
            }
        }
        let file = format!("{}.csv", self.what.name);
        let tables = self.table("sphere", &file, self.what.uncertainty_um());
        Ok(Made { files: vec![(file, text)], tables })
    }

    fn around(
        &mut self,
        sphere: usize,
        centre: Vector3<f64>,
        poses: usize,
    ) -> Result<Vec<State>, ObservationError> {
        let tools = &self.tools;
        self.free_axes
            .around(poses, |pose| tools.machine(pose), |_, _| centre, &mut self.random)
            .map_err(|found| ObservationError::Reach {
                what: format!("sphere S{}", sphere + 1),
                at: centre.into(),
                found,
                poses,
            })
    }

    /// State of a planned pose with the ideal tip at the sphere. If the plan commands no linear axes, these are solved for; otherwise the commanded
    /// tip must be near the sphere.
    fn to_sphere(
        &self,
        pose: usize,
        state: State,
        sphere: usize,
        centre: &Vector3<f64>,
        plan: &Plan,
    ) -> Result<State, ObservationError> {
        let machine = self.tools.machine(pose);
        if plan.is_rotary() {
            let found = self.free_axes.ideal(machine, state, centre);
            return found.ok_or_else(|| ObservationError::PlannedReach {
                pose: pose + 1,
                sphere: sphere + 1,
                at: (*centre).into(),
            });
        }
        let apart_mm = (machine.chain().ideal_tip_mm(&state) - centre).norm();
        if apart_mm > NEAR_MM {
            return Err(ObservationError::PlannedApart {
                pose: pose + 1,
                sphere: sphere + 1,
                apart_mm,
                most_mm: NEAR_MM,
            });
        }
        Ok(state)
    }

    fn at_sphere(
        &mut self,
        pose: usize,
        state: State,
        sphere: usize,
        centre: &Vector3<f64>,
        reads: Reads,
    ) -> Result<String, ObservationError> {
        let (state, read) = self.at_centre(pose, state, centre, &Matrix3::identity(), reads)?;
        let (at, tool) = (self.coordinates(&state), self.tools.cell(pose));
        let mut row = String::new();
        let number = self.spheres.get(sphere).copied().unwrap_or(sphere + 1);
        push_offset(&mut row, &format!("{at}{tool}S{number}"), read);
        Ok(row)
    }

    /// Measures a centre, starting from the nominal pose. Returns the recorded coordinates, and the offset along `axes`, mm.
    fn at_centre(
        &mut self,
        pose: usize,
        mut state: State,
        centre: &Vector3<f64>,
        axes: &Matrix3<f64>,
        reads: Reads,
    ) -> Result<(State, Option<Vector3<f64>>), ObservationError> {
        match reads {
            Reads::Offset => {
                self.approach.to(&mut state, self.truth);
                let tip = actual_tip(self.tools.machine(pose), &state, &Vector3::zeros());
                let offset = axes.transpose() * (tip - centre);
                Ok((state, Some(offset.map(|x| self.read(x)))))
            }
            Reads::Coordinates => {
                let machine = self.tools.machine(pose);
                let found = |state| {
                    let found = self.free_axes.actual(machine, state, centre);
                    found.ok_or(ObservationError::NotReached { at: (*centre).into() })
                };
                // The approach direction follows from the actual motion, so that it agrees with the recorded coordinates.
                let mut state = found(state)?;
                self.approach.to(&mut state, self.truth);
                let mut state = found(state)?;
                let free_axes = self.free_axes.clone();
                free_axes.shift_linear(&mut state, |q| self.read(q));
                Ok((state, None))
            }
        }
    }
}
