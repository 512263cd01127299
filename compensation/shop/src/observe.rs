//! Makes the row files of the volumetric instruments and the file of observations that reads them.

use std::fmt::Write;

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use volcomp_kinematics::{
    State,
    nalgebra::{Matrix3, Rotation3, Vector3},
};
use volcomp_model::Machine;
use volcomp_vocabulary::{AxisName, Displacement};

use crate::{
    error::{ObservationError, ShopError},
    observation::{Bar, Reads, Setting, ShopObservation},
    poses::{Approach, Room, actual_tip},
    shop::Shop,
};

/// The random numbers of observations are others than those of lines.
const FIRST_STREAM: u64 = 1 << 32;

/// The body diagonals of ISO 230-6 by the directions of X, Y, Z.
pub(crate) const DIAGONALS: [&str; 4] = ["PPP", "NPP", "PNP", "PPN"];

/// What was made of one observation: row files, and its tables in the file of observations.
struct Made {
    files: Vec<(String, String)>,
    tables: String,
}

impl Shop {
    /// The row files of all observations and `observations.toml`; `done` is told of each.
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
            .map(|unknown| format!("    {},\n", unknown.to_toml()))
            .collect();
        let mut text = format!(
            "machine = \"machine.toml\"\nunknown = [\n{}]\n",
            unknown.concat()
        );
        for (index, observation) in self.observations.iter().enumerate() {
            let mut random = ChaCha8Rng::seed_from_u64(self.seed);
            random.set_stream(FIRST_STREAM + index as u64);
            let made = Observer::new(&self.truth, observation, random)
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

/// An instrument at the truth machine.
struct Observer<'a> {
    truth: &'a Machine,
    what: &'a ShopObservation,
    /// The machine with each tool; with its own where no tool is named.
    machines: Vec<(&'a str, Machine)>,
    room: Room,
    random: ChaCha8Rng,
    approach: Approach,
}

/// A bar as it really is.
struct TrueBar {
    origin: Vector3<f64>,
    /// Nominal directions along it and to its sides, as columns.
    axes: Matrix3<f64>,
    along: Vector3<f64>,
    distances: Vec<f64>,
}

/// What is written at a mark of a bar in a pass.
struct AtMark {
    pass: usize,
    mark: usize,
    state: State,
    read: Option<Vector3<f64>>,
}

impl<'a> Observer<'a> {
    fn new(
        truth: &'a Machine,
        what: &'a ShopObservation,
        random: ChaCha8Rng,
    ) -> Result<Self, ObservationError> {
        what.instrument.check()?;
        let mut machines = Vec::new();
        for tool in &what.tools {
            let mut machine = truth.clone();
            machine.select_tool(tool)?;
            machines.push((tool.as_str(), machine));
        }
        if machines.is_empty() {
            machines.push(("", truth.clone()));
        }
        // Refuses axes that are not there and numbers that are none.
        truth.state(&what.at)?;
        Ok(Self {
            truth,
            what,
            machines,
            room: Room::new(truth, &what.at),
            random,
            approach: Approach::default(),
        })
    }

    fn observe(mut self) -> Result<Made, ObservationError> {
        match self.what.setting.clone() {
            Setting::Points {
                poses,
                frame,
                target,
            } => Ok(self.points(poses, &frame, target)),
            Setting::Sphere {
                poses,
                centres,
                reads,
            } => self.spheres(poses, &centres, reads),
            Setting::Distance {
                poses,
                point,
                dead_length_mm,
                radius_mm,
            } => self.distances(poses, point.into(), dead_length_mm, radius_mm),
            Setting::StepGauge(bar) => self.step_gauge(&bar),
            Setting::BallRow { bar, reads } => self.ball_row(&bar, reads),
            Setting::Diagonals { names } => self.diagonals(&names),
        }
    }

    fn machine(&self, pose: usize) -> &Machine {
        &self.machines[pose % self.machines.len()].1
    }

    fn normal(&mut self) -> f64 {
        StandardNormal.sample(&mut self.random)
    }

    /// A direction that is drawn, all alike.
    fn direction(&mut self) -> Vector3<f64> {
        direction(&mut self.random)
    }

    /// A reading, mm: with noise, then rounded.
    fn read(&mut self, value_mm: f64) -> f64 {
        let length = self.what.instrument.length;
        let read = value_mm + 1e-3 * length.noise.0 * self.normal();
        let step = 1e-3 * length.resolution.0;
        if step > 0.0 {
            (read / step).round() * step
        } else {
            read
        }
    }

    /// The drift of the set-up at a row: from nothing at the first to all of it at the last.
    fn drift_mm(&self, direction: &Vector3<f64>, row: usize, rows: usize) -> Vector3<f64> {
        let share = row as f64 / rows.saturating_sub(1).max(1) as f64;
        direction * (1e-3 * self.what.instrument.length.drift.0 * share)
    }

    /// The header of the axes, with a comma at its end.
    fn axes_header(&self) -> String {
        let letters = self
            .truth
            .axes()
            .iter()
            .map(|axis| format!("{},", axis.name));
        letters.collect()
    }

    /// The coordinates, mm or deg, with a comma at their end.
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
        if self.what.tools.is_empty() {
            ""
        } else {
            "tool,"
        }
    }

    fn tool_cell(&self, pose: usize) -> String {
        match self.machines[pose % self.machines.len()].0 {
            "" => String::new(),
            tool => format!("{tool},"),
        }
    }

    /// The keys of a table that all kinds have.
    fn table(&self, kind: &str, file: &str, uncertainty_um: f64) -> String {
        let drift = if self.what.drifts() {
            "drift = 1\n"
        } else {
            ""
        };
        format!(
            "\n[[observation]]\nkind = \"{kind}\"\nfile = \"{file}\"\nuncertainty_um = {}\n{drift}",
            number(uncertainty_um)
        )
    }

    fn points(&mut self, poses: usize, frame: &[f64; 6], target: Option<[f64; 3]>) -> Made {
        let [a, b, c] = [frame[3], frame[4], frame[5]].map(f64::to_radians);
        let rotation = Rotation3::from_euler_angles(a, b, c);
        let place = Vector3::new(frame[0], frame[1], frame[2]);
        let offset = Vector3::from(target.unwrap_or_default());
        let states = self.room.everywhere(poses, &mut self.random);
        let middle = states
            .iter()
            .map(|state| self.truth.chain().ideal_tip_mm(state))
            .sum::<Vector3<f64>>()
            / poses.max(1) as f64;
        let (shift, turn) = (self.direction(), self.direction());
        let turn = turn * (1e-6 * self.what.instrument.angle.drift.0);
        let mut text = format!("{}{}x,y,z\n", self.axes_header(), self.tool_header());
        for (pose, mut state) in states.into_iter().enumerate() {
            self.approach.to(&mut state);
            let tip = actual_tip(self.machine(pose), &state, &offset);
            // A tracker that moves by +d sees everything moved by −d.
            let share = pose as f64 / poses.saturating_sub(1).max(1) as f64;
            let drifted = self.drift_mm(&shift, pose, poses) + turn.cross(&(tip - middle)) * share;
            let seen = rotation.inverse() * (tip - drifted - place);
            let read = seen.map(|x| self.read(x));
            let (at, tool) = (self.coordinates(&state), self.tool_cell(pose));
            push_row(&mut text, &format!("{at}{tool}"), read.as_slice());
        }
        let file = format!("{}.csv", self.what.name);
        let mut tables = self.table("points", &file, self.what.uncertainty_um());
        tables.push_str("frame = \"unknown\"\n");
        if target.is_some() {
            let tools = self.what.tools.iter();
            let by_tool: Vec<String> = tools
                .map(|tool| format!("{tool:?} = \"unknown\""))
                .collect();
            let targets = if by_tool.is_empty() {
                "\"unknown\"".to_owned()
            } else {
                format!("{{ {} }}", by_tool.join(", "))
            };
            // Writing to a String cannot fail.
            let _ = writeln!(tables, "target = {targets}");
        }
        Made {
            files: vec![(file, text)],
            tables,
        }
    }

    fn spheres(
        &mut self,
        poses: usize,
        centres: &[[f64; 3]],
        reads: Reads,
    ) -> Result<Made, ObservationError> {
        let offsets = match reads {
            Reads::Coordinates => "",
            Reads::Offset => ",dx_um,dy_um,dz_um",
        };
        let mut text = format!(
            "{}{}sphere{offsets}\n",
            self.axes_header(),
            self.tool_header()
        );
        for (number, centre) in centres.iter().enumerate() {
            let centre = Vector3::from(*centre);
            let drift = self.direction();
            let mut random = self.random.clone();
            let states = self
                .room
                .around(poses, |pose| self.machine(pose), |_, _| centre, &mut random)
                .map_err(|found| ObservationError::Reach {
                    what: format!("sphere S{}", number + 1),
                    at: centre.into(),
                    found,
                    poses,
                })?;
            self.random = random;
            for (pose, state) in states.into_iter().enumerate() {
                let centre = centre + self.drift_mm(&drift, pose, poses);
                let (state, read) =
                    self.at_centre(pose, state, &centre, &Matrix3::identity(), reads)?;
                let (at, tool) = (self.coordinates(&state), self.tool_cell(pose));
                let cells = format!("{at}{tool}S{}", number + 1);
                push_offset(&mut text, &cells, read);
            }
        }
        let file = format!("{}.csv", self.what.name);
        let tables = self.table("sphere", &file, self.what.uncertainty_um());
        Ok(Made {
            files: vec![(file, text)],
            tables,
        })
    }

    /// Goes to a centre from the pose at which it is nominally: the coordinates that are written, and the offset along
    /// `axes`, mm.
    fn at_centre(
        &mut self,
        pose: usize,
        mut state: State,
        centre: &Vector3<f64>,
        axes: &Matrix3<f64>,
        reads: Reads,
    ) -> Result<(State, Option<Vector3<f64>>), ObservationError> {
        self.approach.to(&mut state);
        match reads {
            Reads::Offset => {
                let tip = actual_tip(self.machine(pose), &state, &Vector3::zeros());
                let offset = axes.transpose() * (tip - centre);
                Ok((state, Some(offset.map(|x| self.read(x)))))
            }
            Reads::Coordinates => {
                let found = self.room.actual(self.machine(pose), state, centre);
                let mut state = found.ok_or(ObservationError::NotReached {
                    at: (*centre).into(),
                })?;
                let room = self.room.clone();
                room.shift_linear(&mut state, |q| self.read(q));
                Ok((state, None))
            }
        }
    }

    fn distances(
        &mut self,
        poses: usize,
        point: Vector3<f64>,
        dead_length_mm: f64,
        radius_mm: Option<f64>,
    ) -> Result<Made, ObservationError> {
        let mut random = self.random.clone();
        let states = match radius_mm {
            None => self.room.everywhere(poses, &mut random),
            Some(radius) => self
                .room
                .around(
                    poses,
                    |pose| self.machine(pose),
                    |_, random| point + direction(random) * radius,
                    &mut random,
                )
                .map_err(|found| ObservationError::Reach {
                    what: format!("poses at {radius} mm from the point"),
                    at: point.into(),
                    found,
                    poses,
                })?,
        };
        self.random = random;
        let drift = self.direction();
        let mut text = format!("{}{}length_mm\n", self.axes_header(), self.tool_header());
        for (pose, mut state) in states.into_iter().enumerate() {
            self.approach.to(&mut state);
            let tip = actual_tip(self.machine(pose), &state, &Vector3::zeros());
            let point = point + self.drift_mm(&drift, pose, poses);
            let read = self.read((tip - point).norm() - dead_length_mm);
            let (at, tool) = (self.coordinates(&state), self.tool_cell(pose));
            push_row(&mut text, &format!("{at}{tool}"), &[read]);
        }
        let file = format!("{}.csv", self.what.name);
        let mut tables = self.table("distance", &file, self.what.uncertainty_um());
        tables.push_str("point = \"unknown\"\n");
        if dead_length_mm != 0.0 {
            tables.push_str("dead_length = \"unknown\"\n");
        }
        Ok(Made {
            files: vec![(file, text)],
            tables,
        })
    }

    /// The bar as it was put on the table: tilted, its distances known within their calibration.
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

    /// Goes over the marks of a bar, forth and back if asked.
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
                let held = self.room.ideal(self.machine(pass), self.held()?, &nominal);
                let state = held.ok_or(ObservationError::NotReached { at: nominal.into() })?;
                let drifted = self.drift_mm(&drift, found.len(), rows);
                let place = real.origin + drifted + real.along * real.distances[mark];
                let (state, read) = self.at_centre(pass, state, &place, &real.axes, reads)?;
                found.push(AtMark {
                    pass,
                    mark,
                    state,
                    read,
                });
            }
        }
        Ok(found)
    }

    /// The marks of every pass in their order.
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

    /// The axes as they are held.
    fn held(&self) -> Result<State, ObservationError> {
        Ok(self.truth.state(&self.what.at)?)
    }

    fn step_gauge(&mut self, bar: &Bar) -> Result<Made, ObservationError> {
        let real = self.true_bar(bar)?;
        let rows = self.along(bar, &real, Reads::Coordinates)?;
        let mut text = format!(
            "pose,{}{}from,to,length_mm\n",
            self.axes_header(),
            self.tool_header()
        );
        let mut pairs = String::new();
        let blank = ",".repeat(self.truth.axes().len() + usize::from(!self.what.tools.is_empty()));
        let name = |pass: usize, mark: usize| format!("{}-{}", pass + 1, mark + 1);
        for AtMark {
            pass, mark, state, ..
        } in rows
        {
            let (at, tool) = (self.coordinates(&state), self.tool_cell(pass));
            let _ = writeln!(text, "{},{at}{tool},,", name(pass, mark));
            // From the first face of the bar, whichever came first.
            if mark > 0 {
                let length = (bar.distances[mark] - bar.distances[0]).abs();
                let (from, to) = (name(pass, 0), name(pass, mark));
                let _ = writeln!(pairs, ",{blank}{from},{to},{}", number(length));
            }
        }
        text.push_str(&pairs);
        let file = format!("{}.csv", self.what.name);
        // Each length has two contacts.
        let contact = self.what.uncertainty_um();
        let uncertainty = (contact * 2.0_f64.sqrt()).hypot(bar.calibration.0);
        let tables = self.table("distance", &file, uncertainty);
        Ok(Made {
            files: vec![(file, text)],
            tables,
        })
    }

    fn ball_row(&mut self, bar: &Bar, reads: Reads) -> Result<Made, ObservationError> {
        let real = self.true_bar(bar)?;
        let rows = self.along(bar, &real, reads)?;
        let offsets = match reads {
            Reads::Coordinates => "",
            Reads::Offset => ",along_um,side1_um,side2_um",
        };
        let mut text = format!(
            "{}{}ball{offsets}\n",
            self.axes_header(),
            self.tool_header()
        );
        for AtMark {
            pass,
            mark,
            state,
            read,
        } in rows
        {
            let (at, tool) = (self.coordinates(&state), self.tool_cell(pass));
            push_offset(&mut text, &format!("{at}{tool}B{}", mark + 1), read);
        }
        let mut row = String::from("ball,distance_mm,uncertainty_um\n");
        for (mark, &distance) in bar.distances.iter().enumerate() {
            let uncertainty = if distance == 0.0 {
                0.0
            } else {
                bar.calibration.0
            };
            let _ = writeln!(
                row,
                "B{},{},{}",
                mark + 1,
                number(distance),
                number(uncertainty)
            );
        }
        let name = &self.what.name;
        let (file, row_file) = (format!("{name}.csv"), format!("{name}-row.csv"));
        let mut tables = self.table("ball-row", &file, self.what.uncertainty_um());
        let side: Vec<String> = real.axes.column(1).iter().map(|x| number(*x)).collect();
        let _ = writeln!(
            tables,
            "row = \"{row_file}\"\nside1 = [{}]",
            side.join(", ")
        );
        Ok(Made {
            files: vec![(file, text), (row_file, row)],
            tables,
        })
    }

    fn diagonals(&mut self, names: &[String]) -> Result<Made, ObservationError> {
        let mut made = Made {
            files: Vec::new(),
            tables: String::new(),
        };
        for name in names {
            let (file, text, direction) = self.diagonal(name)?;
            let mut tables = self.table("line", &file, self.what.uncertainty_um());
            let [x, y, z] = direction.map(number).into();
            let slope = if self.what.instrument.alignment.0 > 0.0 {
                "slope = \"unknown\"\n"
            } else {
                ""
            };
            let _ = write!(
                tables,
                "direction = [{x}, {y}, {z}]\noffset = \"unknown\"\n{slope}"
            );
            made.tables.push_str(&tables);
            made.files.push((file, text));
        }
        Ok(made)
    }

    /// One body diagonal: its file and its direction.
    fn diagonal(&mut self, name: &str) -> Result<(String, String, Vector3<f64>), ObservationError> {
        let targets = self.what.instrument.targets;
        let mut ends = [self.what.at.clone(), self.what.at.clone()];
        for (axis, sense) in [AxisName::X, AxisName::Y, AxisName::Z]
            .into_iter()
            .zip(name.chars())
        {
            let travel = self.truth.axes()[self.truth.index_of(axis)?].travel;
            let [from, to] = if sense == 'N' {
                [travel[1], travel[0]]
            } else {
                travel
            };
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
        let along = way
            .try_normalize(1e-12)
            .ok_or(ObservationError::NoDirection)?;
        let axes = across(&along);
        let first = tip(&from);
        let tilt = 1e-6 * self.what.instrument.alignment.0;
        let tilted = Vector3::new(1.0, tilt * self.normal(), tilt * self.normal());
        let sight = (axes * tilted).normalize();
        let passes = self.passes(targets);
        let rows = passes.len() * targets;
        let mut text = format!("{}deviation_um\n", self.axes_header());
        self.approach = Approach::default();
        for (row, target) in passes.into_iter().flatten().enumerate() {
            let mut state = place(target);
            self.approach.to(&mut state);
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

/// A direction that is drawn, all alike.
fn direction(random: &mut ChaCha8Rng) -> Vector3<f64> {
    let [x, y, z] = [(); 3].map(|()| StandardNormal.sample(random));
    Vector3::<f64>::new(x, y, z)
        .try_normalize(1e-12)
        .unwrap_or_else(Vector3::x)
}

/// A direction and two across it, as columns.
fn across(along: &Vector3<f64>) -> Matrix3<f64> {
    let side = Vector3::ith(along.iamin(), 1.0);
    let side1 = (side - along * along.dot(&side)).normalize();
    Matrix3::from_columns(&[*along, side1, along.cross(&side1)])
}

/// A row of cells that end with a comma, and numbers.
fn push_row(text: &mut String, cells: &str, numbers: &[f64]) {
    let numbers: Vec<String> = numbers.iter().map(|x| number(*x)).collect();
    // Writing to a String cannot fail.
    let _ = writeln!(text, "{cells}{}", numbers.join(","));
}

/// A row with the offset that was read, µm, if one was.
fn push_offset(text: &mut String, cells: &str, read_mm: Option<Vector3<f64>>) {
    match read_mm {
        Some(offset) => push_row(text, &format!("{cells},"), (offset * 1e3).as_slice()),
        None => {
            let _ = writeln!(text, "{cells}");
        }
    }
}

/// A number with at most six digits behind the point.
fn number(x: f64) -> String {
    let text = format!("{x:.6}");
    let text = text.trim_end_matches('0').trim_end_matches('.');
    if text == "-0" {
        "0".to_owned()
    } else {
        text.to_owned()
    }
}
