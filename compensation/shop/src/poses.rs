//! Poses at which a machine is observed, from a file of planned commands or at random.
//!
//! The axes can also be moved so that the actual tip is at a given point.

use std::path::{Path, PathBuf};

use rand::{Rng, RngExt};
use volcomp_document::{Column, CsvTable, InputError, Value, quoted, read_text};
use volcomp_kinematics::nalgebra::Vector3;
use volcomp_kinematics::{REACHED_WITHIN_MM, State, actual_pose};
use volcomp_model::{Machine, Temperatures, axis_of_head};
use volcomp_vocabulary::{AxisKind, AxisName, Displacement};

pub(crate) const MOST_POSES: usize = 100_000;

/// Commanded poses, in order.
#[derive(Clone, Debug, PartialEq)]
pub struct Plan {
    /// Axes with a column in the plan. All other axes are at the coordinates in the observation's `at`, by default 0.
    /// If spheres are probed and the plan commands only rotary axes, the free linear axes move to the sphere.
    pub axes: Vec<AxisName>,
    /// The poses in the order of the file.
    pub poses: Vec<PlannedPose>,
}

impl Plan {
    /// Whether the plan commands rotary axes only, so that the linear axes follow to the sphere.
    pub(crate) fn is_rotary(&self) -> bool {
        self.axes.iter().all(|axis| axis.is_rotary())
    }
}

#[derive(Clone, Debug, PartialEq)]
pub struct PlannedPose {
    /// Coordinates of the plan's axes, mm or deg, in the order of [`Plan::axes`].
    pub at: Vec<f64>,
    /// Index of the sphere, from 0; unused without spheres.
    pub sphere: usize,
}

/// Reads a plan: a CSV table with a column for each commanded axis, and a column `sphere` (S1, S2, …) if there are several spheres. `spheres` is
/// their number. The path is relative to the shop file.
pub(crate) fn read_plan(
    value: &Value<'_>,
    machine: &Machine,
    held: &[(AxisName, f64)],
    spheres: usize,
) -> Result<(PathBuf, Plan), InputError> {
    let name = value.text()?;
    let shop_file = value.error("").file;
    let folder = Path::new(&shop_file).parent().unwrap_or(Path::new(""));
    let path = folder.join(name);
    let text = read_text(&path).map_err(|error| value.error(error.to_string()))?;
    let table = CsvTable::parse(&path.display().to_string(), &text)?;
    let mut axes: Vec<(AxisName, Column)> = Vec::new();
    let mut sphere = None;
    for (column, head) in table.columns() {
        if head == "sphere" && spheres > 0 && sphere.is_none() {
            sphere = Some(column);
            continue;
        }
        let axis = axis_of_head(head).filter(|axis| machine.axis(*axis).is_some());
        let Some(axis) = axis else {
            let letters = machine.axes().iter().map(|axis| axis.name.to_string());
            let letters: Vec<String> = letters.collect();
            let more = if spheres > 0 { ", or `sphere`" } else { "" };
            return Err(table.header_error(format!(
                "found a column {}, expected the letters of the machine's axes, alone or with mm or deg ({}){more}",
                quoted(head),
                letters.join(", ")
            )));
        };
        if axes.iter().any(|(other, _)| *other == axis) {
            return Err(table.header_error(format!("found two columns of {axis}, expected one")));
        }
        if held.iter().any(|(other, _)| *other == axis) {
            return Err(table.header_error(format!(
                "found a column of {axis}, which `at` of the shop file holds: expected one of them"
            )));
        }
        axes.push((axis, column));
    }
    if spheres > 1 && sphere.is_none() {
        return Err(table.header_error(format!(
            "found no column `sphere`, expected one with the sphere of each row: S1 to S{spheres}"
        )));
    }
    // The linear axes move to the sphere if the plan commands none of them.
    let follow = spheres > 0 && axes.iter().all(|(axis, _)| axis.is_rotary());
    for axis in machine.axes() {
        let name = axis.name;
        let is_said = axes.iter().any(|(other, _)| *other == name)
            || held.iter().any(|(other, _)| *other == name)
            || (follow && !name.is_rotary());
        if !is_said && let Err(message) = axis.check_coordinate(0.0) {
            return Err(table.header_error(format!(
                "found no column of {name}, which is then at 0: {message}"
            )));
        }
    }
    let rows = table.rows().len();
    if !(1..=MOST_POSES).contains(&rows) {
        return Err(table.header_error(format!("found {rows} rows, expected 1 to {MOST_POSES}")));
    }
    let mut poses = Vec::with_capacity(rows);
    for row in table.rows() {
        let mut at = Vec::with_capacity(axes.len());
        for &(name, column) in &axes {
            let cell = row.cell(column);
            let found = cell.number()?;
            // The name was looked up above, so the axis exists.
            let Some(axis) = machine.axis(name) else {
                continue;
            };
            axis.check_coordinate(found).map_err(|message| cell.error(message))?;
            at.push(found);
        }
        let sphere = match sphere {
            Some(column) => {
                let cell = row.cell(column);
                let number = (1..=spheres).find(|number| format!("S{number}") == cell.text());
                let number = number.ok_or_else(|| {
                    cell.error(format!(
                        "found {}, expected one of the spheres S1 to S{spheres}",
                        quoted(cell.text())
                    ))
                })?;
                number - 1
            }
            None => 0,
        };
        poses.push(PlannedPose { at, sphere });
    }
    let axes = axes.into_iter().map(|(axis, _)| axis).collect();
    Ok((path, Plan { axes, poses }))
}

/// Resolution of commands, mm or deg.
const COMMAND_STEP: f64 = 1e-3;
/// Maximum number of attempts for one pose, each with other random rotary coordinates.
const TRIES: usize = 200;

#[derive(Clone, Debug)]
pub(crate) struct FreeAxes {
    /// Chain index, kind and travel (mm or deg) of each free axis.
    free: Vec<(usize, AxisKind, [f64; 2])>,
    held: State,
}

impl FreeAxes {
    pub(crate) fn new(machine: &Machine, at: &[(AxisName, f64)]) -> Self {
        let mut held = State::default();
        let mut free = Vec::new();
        for (place, axis) in machine.axes().iter().enumerate() {
            let kind = axis.name.kind();
            match at.iter().find(|(name, _)| *name == axis.name) {
                Some((_, q)) => held.q[place] = Displacement::from_coordinate(kind, *q).mm_or_rad(),
                None => free.push((place, kind, axis.travel)),
            }
        }
        Self { free, held }
    }

    fn of(&self, kind: AxisKind) -> impl Iterator<Item = (usize, [f64; 2])> + '_ {
        let own = self.free.iter().filter(move |(_, of, _)| *of == kind);
        own.map(|(place, _, travel)| (*place, *travel))
    }

    /// Draws poses distributed over the travels: each axis visits `poses` evenly spaced coordinates, ends included, each once in an independent
    /// random order.
    pub(crate) fn everywhere(&self, poses: usize, random: &mut impl Rng) -> Vec<State> {
        let mut states = vec![self.held; poses];
        for (place, kind, travel) in &self.free {
            for (state, q) in states.iter_mut().zip(spread(*travel, poses, random)) {
                state.q[*place] = Displacement::from_coordinate(*kind, q).mm_or_rad();
            }
        }
        states
    }

    /// States of the poses of a plan; axes that the plan does not command are at their held coordinates, or at 0.
    pub(crate) fn planned(&self, machine: &Machine, plan: &Plan) -> Vec<State> {
        let state = |pose: &PlannedPose| {
            let mut state = self.held;
            for (name, q) in plan.axes.iter().zip(&pose.at) {
                if let Ok(place) = machine.index_of(*name) {
                    state.q[place] = Displacement::from_coordinate(name.kind(), *q).mm_or_rad();
                }
            }
            state
        };
        plan.poses.iter().map(state).collect()
    }

    /// Draws poses with the ideal tip at points (mm in workpiece axes), with rotary coordinates distributed over the
    /// travels. `point` and `machine` are called with the index of the pose; poses with unreachable points are redrawn.
    /// `Err`: the number of poses found before an unreachable one.
    pub(crate) fn around<'m, R: Rng>(
        &self,
        poses: usize,
        machine: impl Fn(usize) -> &'m Machine,
        mut point: impl FnMut(usize, &mut R) -> Vector3<f64>,
        random: &mut R,
    ) -> Result<Vec<State>, usize> {
        let rotary: Vec<(usize, [f64; 2])> = self.of(AxisKind::Rotary).collect();
        let angles: Vec<Vec<f64>> =
            rotary.iter().map(|(_, travel)| spread(*travel, poses, random)).collect();
        let mut states = Vec::with_capacity(poses);
        for pose in 0..poses {
            let mut found = None;
            for attempt in 0..TRIES {
                let mut state = self.held;
                for ((place, [low, high]), angles) in rotary.iter().zip(&angles) {
                    let angle = if attempt == 0 {
                        angles[pose]
                    } else {
                        command(low + (high - low) * random.random::<f64>(), [*low, *high])
                    };
                    state.q[*place] = angle.to_radians();
                }
                let target = point(pose, random);
                found = self.ideal(machine(pose), state, &target);
                if found.is_some() {
                    break;
                }
            }
            states.push(found.ok_or(pose)?);
        }
        Ok(states)
    }

    /// Moves the free linear axes, in steps of commands, so that the ideal tip is at `target` (mm in workpiece axes); `None` if they cannot reach it
    /// within their travels.
    pub(crate) fn ideal(
        &self,
        machine: &Machine,
        state: State,
        target: &Vector3<f64>,
    ) -> Option<State> {
        let tip = |state: &State| machine.chain().ideal_tip_mm(state);
        let mut state = self.to(machine, state, target, tip)?;
        for (place, travel) in self.of(AxisKind::Linear) {
            let [low, high] = travel;
            if !(low - COMMAND_STEP..=high + COMMAND_STEP).contains(&state.q[place]) {
                return None;
            }
            state.q[place] = command(state.q[place], travel);
        }
        Some(state)
    }

    pub(crate) fn actual(
        &self,
        machine: &Machine,
        state: State,
        target: &Vector3<f64>,
    ) -> Option<State> {
        let tip = |state: &State| actual_tip(machine, state, &Vector3::zeros());
        self.to(machine, state, target, tip)
    }

    fn to(
        &self,
        machine: &Machine,
        mut state: State,
        target: &Vector3<f64>,
        tip: impl Fn(&State) -> Vector3<f64>,
    ) -> Option<State> {
        let is_free = |place| self.free.iter().any(|(free, ..)| *free == place);
        let missed_mm = machine.chain().bring(&mut state, is_free, target, tip);
        (missed_mm <= REACHED_WITHIN_MM).then_some(state)
    }

    /// Replaces the coordinate of each free linear axis, mm, by the result of `by`.
    pub(crate) fn shift_linear(&self, state: &mut State, mut by: impl FnMut(f64) -> f64) {
        for (place, _) in self.of(AxisKind::Linear) {
            state.q[place] = by(state.q[place]);
        }
    }
}

/// Actual tip plus an offset in tool axes, mm in workpiece axes.
pub(crate) fn actual_tip(
    machine: &Machine,
    state: &State,
    offset_mm: &Vector3<f64>,
) -> Vector3<f64> {
    let none = Temperatures::new();
    let chain = machine.chain();
    let tip = chain.tool_tip_mm() + offset_mm;
    actual_pose(chain, &machine.source(&none), state).transform_point(&tip)
        - chain.workpiece_origin_mm()
}

/// `count` evenly spaced coordinates over a travel, ends included, in random order.
fn spread(travel: [f64; 2], count: usize, random: &mut impl Rng) -> Vec<f64> {
    let [low, high] = travel;
    let last = count.saturating_sub(1) as f64;
    let place = |k: usize| if last > 0.0 { k as f64 / last } else { 0.5 };
    let mut places: Vec<f64> =
        (0..count).map(|k| command(low + (high - low) * place(k), travel)).collect();
    for last in (1..count).rev() {
        places.swap(last, random.random_range(0..=last));
    }
    places
}

fn command(q: f64, [low, high]: [f64; 2]) -> f64 {
    ((q / COMMAND_STEP).round() * COMMAND_STEP).max(low).min(high)
}
