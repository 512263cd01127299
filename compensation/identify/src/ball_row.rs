//! Row of balls on a bar (1-D ball array): the row file, the position of the bar, and the directions of its readings.

use std::path::{Path, PathBuf};

use volcomp_document::{CsvTable, InputError, Value, quoted};
use volcomp_kinematics::nalgebra::{Matrix3, Vector3};
use volcomp_model::Machine;

use crate::{
    checks::{
        input::{standard_uncertainty_um, unit_vector},
        limit_mm,
    },
    error::IdentifyError,
    observations::{NumberKind, Quantity, Row, RowReading, SetUp},
    row_file::RowKind,
    setup_keys::{Ball, BallRow, ObservationHeader, ReadFile, ReadState, point, stated_vector},
};

pub(crate) const KEYS: [&str; 4] = ["row", "origin", "direction", "side1"];

/// Maximum distance of a ball from its nominal place on the bar, mm, scaled by [`limit_mm`]. A larger distance means another ball or another
/// position of the bar.
const MISPLACED_MM: f64 = 2.0;
/// Minimum magnitude of a direction cosine with a machine axis for which the sides have a default; a more oblique row must state `side1`.
const ALONG_AN_AXIS: f64 = 0.9;

pub(crate) struct Placement<'a> {
    origin: usize,
    /// Origin of the row as stated in the file, mm, with its key; `None` if it is to be identified.
    stated: Option<(Value<'a>, Vector3<f64>)>,
    direction: Option<Vector3<f64>>,
    side1: Option<Vector3<f64>>,
}

/// Decodes the keys of a ball row. Returns its kind, the position of the bar, and the path of the row file.
pub(crate) fn decode<'a>(
    of: &ObservationHeader<'a>,
    (folder, read): (&Path, &ReadFile<'_>),
    state: &mut ReadState,
) -> Result<(RowKind, Placement<'a>, PathBuf), IdentifyError> {
    let section = of.section;
    let row_value = section.require("row")?;
    let row = row_value.text()?;
    let path = folder.join(row);
    let known = state.rows_of_balls.iter().position(|b| b.file == row);
    let balls = if let Some(place) = known {
        place
    } else {
        let text = read(&path).map_err(|error| row_value.error(error.to_string()))?;
        let table = CsvTable::parse(&path.display().to_string(), &text)?;
        state.rows_of_balls.push(read_balls(row, &table)?);
        state.rows_of_balls.len() - 1
    };
    let is_stated = |key| matches!(section.get(key), Some(value) if value.text().is_err());
    if let (true, Some(key)) =
        (of.judge, ["origin", "direction"].into_iter().find(|key| !is_stated(key)))
    {
        return Err(section
            .error(format!(
                "found `judge = true` without a known {key}, expected `origin` and `direction` as numbers: the position of the bar is identified from its readings, and judged readings identify nothing"
            ))
            .into());
    }
    let origin = point(of, "origin", of.drift, state)?;
    let direction = match stated_vector(section, "direction")? {
        None => None,
        Some((value, _)) => Some(unit_vector(&value)?),
    };
    let side1 = match section.get("side1") {
        None => None,
        Some(value) => {
            let side = unit_vector(&value)?;
            if let Some(along) = direction
                && along.cross(&side).norm() < 1e-3
            {
                return Err(value
                    .error("found the direction of the row itself, expected a direction across it")
                    .into());
            }
            Some(side)
        }
    };
    let tilts = ["tilt.side1", "tilt.side2"].map(|key| {
        let tilt = Quantity {
            unknown: direction.is_none(),
            ..Quantity::new(format!("{}:{key}", of.file), Some(0.0), 0)
        };
        state.setup.add_number(NumberKind::Tilt, tilt)
    });
    let kind = RowKind::Ball { balls, origin, tilts };
    let placement =
        Placement { origin, stated: stated_vector(section, "origin")?, direction, side1 };
    Ok((kind, placement, path))
}

fn read_balls(file: &str, table: &CsvTable) -> Result<BallRow, InputError> {
    let name = table.require("ball")?;
    let distance = table.require("distance_mm")?;
    let uncertainty = table.column("uncertainty_um")?;
    let mut balls: Vec<Ball> = Vec::new();
    for row in table.rows() {
        let cell = row.cell(name);
        if cell.text().is_empty() {
            return Err(cell.error("found an empty name, expected the name of a ball"));
        }
        if balls.iter().any(|ball| ball.name == cell.text()) {
            return Err(cell.error(format!("ball {} is listed twice", quoted(cell.text()))));
        }
        let uncertainty_um = match uncertainty.map(|column| row.cell(column)) {
            Some(cell) if !cell.text().is_empty() => {
                // An uncertainty of 0 states that the distance is exact.
                match cell.number()? {
                    0.0 => 0.0,
                    found => standard_uncertainty_um(found)
                        .map_err(|why| cell.error(format!("{why}, or 0")))?,
                }
            }
            _ => 0.0,
        };
        let distance_mm = row.cell(distance).number()?;
        if let Some(same) = balls.iter().find(|ball| ball.distance_mm == distance_mm) {
            return Err(row.cell(distance).error(format!(
                "found {distance_mm} mm, the position of ball {}",
                quoted(&same.name)
            )));
        }
        balls.push(Ball {
            name: cell.text().to_owned(),
            distance_mm,
            uncertainty_mm: uncertainty_um * 1e-3,
            number: None,
        });
    }
    if balls.len() < 2 {
        return Err(
            table.header_error(format!("found {} balls, expected at least two", balls.len()))
        );
    }
    Ok(BallRow { file: file.to_owned(), balls })
}

/// One reading: nominal tip, distance of the ball along the row, and measured tip minus ball, mm.
struct Place {
    line: usize,
    nominal_mm: Vector3<f64>,
    distance_mm: f64,
    offset_mm: [Option<f64>; 3],
}

/// Places the bar through the nominal tips, and through its origin if that is stated: sets the directions of the
/// readings and the start value of an unknown origin.
pub(crate) fn place_bar(
    placement: &Placement<'_>,
    table: &CsvTable,
    machine: &Machine,
    rows: &mut [Row],
    setup: &mut SetUp,
) -> Result<(), InputError> {
    let misplaced_mm = limit_mm(machine, rows.iter(), MISPLACED_MM);
    let chain = machine.chain();
    let mut places = Vec::new();
    for row in rows.iter() {
        if let RowReading::Ball { distance, offset_mm, .. } = row.reading {
            places.push(Place {
                line: row.line,
                nominal_mm: row.pose.ideal_tip_mm(chain),
                distance_mm: setup.numbers[distance].value.unwrap_or_default(),
                offset_mm,
            });
        }
    }
    let count = places.len().max(1) as f64;
    let mean_s = places.iter().map(|p| p.distance_mm).sum::<f64>() / count;
    let mean_tip = places.iter().map(|p| p.nominal_mm).sum::<Vector3<f64>>() / count;
    let along = if let Some(direction) = placement.direction {
        direction
    } else {
        let stated = placement.stated.as_ref();
        let (from, from_s) = stated.map_or((mean_tip, mean_s), |(_, origin)| (*origin, 0.0));
        let sum: Vector3<f64> =
            places.iter().map(|p| (p.nominal_mm - from) * (p.distance_mm - from_s)).sum();
        sum.try_normalize(1e-9).ok_or_else(|| {
            table.header_error("found readings at a single position of the row, expected at least two balls, or `direction` as numbers")
        })?
    };
    let axes = across(&along, placement, &places, table)?;
    let ball = |p: &Place| {
        let offset = Vector3::from(p.offset_mm.map(Option::unwrap_or_default));
        p.nominal_mm - axes * offset
    };
    let mean = places.iter().map(ball).sum::<Vector3<f64>>() / count;
    let apart = |p: &Place| (ball(p) - mean - along * (p.distance_mm - mean_s)).norm();
    let worst = places.iter().max_by(|a, b| apart(a).total_cmp(&apart(b)));
    if let Some(worst) = worst.filter(|p| apart(p) > misplaced_mm) {
        let message = format!(
            "found a ball {:.1} mm from its nominal position on a straight bar, expected less than {misplaced_mm} mm: is it another ball or another unit, or is the bar placed differently?",
            apart(worst)
        );
        return Err(table.error_at(worst.line, message));
    }
    let found = mean - along * mean_s;
    if let Some((value, stated)) = &placement.stated {
        let off = found - stated;
        if off.norm() > misplaced_mm {
            return Err(value.error(format!(
                "found an origin {:.1} mm from the position that the ball readings give, {:.1} mm of it along the row, expected less than {misplaced_mm} mm: it is the position in workpiece axes at which the distance along the row is 0, or \"unknown\"",
                off.norm(),
                off.dot(&along).abs()
            )));
        }
    }
    let origin = &mut setup.points[placement.origin];
    if origin.unknown {
        origin.value = Some(found.into());
    }
    for row in rows {
        if let RowReading::Ball { axes: own, .. } = &mut row.reading {
            *own = axes;
        }
    }
    Ok(())
}

/// Matrix whose columns are the unit directions along the row, to side 1 and to side 2.
fn across(
    along: &Vector3<f64>,
    placement: &Placement<'_>,
    places: &[Place],
    table: &CsvTable,
) -> Result<Matrix3<f64>, InputError> {
    let largest = along.iamax();
    let reads_sides =
        places.iter().any(|p| p.offset_mm[1..].iter().flatten().any(|offset| *offset != 0.0));
    let side = match placement.side1 {
        Some(side) => side,
        None if reads_sides && along[largest].abs() < ALONG_AN_AXIS => {
            return Err(table.header_error("found side readings of a row that is not parallel to an axis, expected `side1 = [x, y, z]`, the direction of side 1 in workpiece axes"));
        }
        // Default sides of a row along X: Y and Z; along Y: Z and X; along Z: X and Y.
        None => Vector3::ith((largest + 1) % 3, 1.0),
    };
    let side1 = (side - along * along.dot(&side)).try_normalize(1e-3).ok_or_else(|| {
        table.header_error(
            "found `side1` along the row, expected a direction across it, in workpiece axes",
        )
    })?;
    Ok(Matrix3::from_columns(&[*along, side1, along.cross(&side1)]))
}
