//! Plans of poses: commands from a file instead of random poses.

use std::path::{Path, PathBuf};

use volcomp_document::{Column, CsvTable, InputError, Value, quoted, read_text};
use volcomp_model::{Machine, axis_of_head};
use volcomp_vocabulary::AxisName;

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
