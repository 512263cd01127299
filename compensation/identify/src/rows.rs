//! The rows of a file of observations.

use volcomp_document::{Column, CsvRow, CsvTable, InputError, quoted};
use volcomp_kinematics::{State, nalgebra::Vector3};
use volcomp_model::{Machine, ModelError};
use volcomp_vocabulary::{AxisName, Displacement};

use crate::{
    checked::standard_uncertainty_um,
    columns::Columns,
    observations::{Row, Seen, Stand},
    seen_columns::SeenColumns,
    setup_keys::Reading,
    timeline::Approach,
};

/// What the rows of a file hold.
pub(crate) enum RowKind {
    Points {
        frame: usize,
        /// The point of the target for each tool; the empty name is any tool.
        targets: Vec<(String, Option<usize>)>,
    },
    Sphere {
        drift: usize,
    },
    Distance {
        /// `None`: between two poses.
        point: Option<usize>,
        dead: usize,
    },
    Line {
        direction: Vector3<f64>,
        offset: usize,
        slope: usize,
    },
    Ball {
        /// Which of the row files.
        balls: usize,
        origin: usize,
        tilts: [usize; 2],
    },
}

/// Rows with the place of each in time.
pub(crate) struct ReadRows {
    pub(crate) rows: Vec<Row>,
    pub(crate) orders: Vec<f64>,
    pub(crate) has_order: bool,
    pub(crate) has_tool: bool,
}

/// A coordinate further outside travel than so many travels is no pose of this machine.
const NEVER_BEYOND: f64 = 1.0;
/// Rows outside travel that are named.
const SHOWN: usize = 5;

/// Reads every row.
#[expect(clippy::too_many_lines, reason = "one column after the other")]
pub(crate) fn read_rows(
    table: &CsvTable,
    kind: &RowKind,
    machine: &Machine,
    uncertainty_mm: f64,
    judge: bool,
    reading: &mut Reading,
) -> Result<ReadRows, InputError> {
    let mut columns = Columns {
        table,
        used: Vec::new(),
    };
    let axes = axis_columns(&mut columns, machine)?;
    let tool = columns.get("tool")?;
    let name = match columns.get("pose")? {
        Some(column) => Some(column),
        None => columns.get("name")?,
    };
    let order = columns.get("order")?;
    let uncertainty = columns.get("uncertainty_um")?;
    let mut what = SeenColumns::columns(&mut columns, kind)?;
    columns.refuse_lookalikes()?;
    let mut poses: Vec<(String, Stand)> = Vec::new();
    // The machine went to poses that are named in the order in which they stand.
    let mut approach = Approach::default();
    let mut rows = Vec::new();
    let mut orders: Vec<f64> = Vec::new();
    let mut outside = Vec::new();
    for (number, row) in table.rows().enumerate() {
        refuse_endless(&columns, &row)?;
        let is_pair = what.is_pair(&row, &axes)?;
        let tool_name = tool.map_or("", |column| row.cell(column).text());
        let stand = if is_pair {
            None
        } else {
            Some(read_stand(
                &row,
                &axes,
                tool.map(|c| row.cell(c)),
                tool_name,
                kind,
                machine,
                &mut outside,
            )?)
        };
        if let (SeenColumns::Pair { .. }, Some(mut stand)) = (&what, stand) {
            approach.to(&mut stand.state, machine);
            let column = name.ok_or_else(|| {
                table.header_error("expected a column `pose` with the names of the poses")
            })?;
            let cell = row.cell(column);
            if poses.iter().any(|(known, _)| known == cell.text()) {
                return Err(cell.error(format!("pose {} stands twice", quoted(cell.text()))));
            }
            poses.push((cell.text().to_owned(), stand));
            continue;
        }
        let at = match order {
            Some(column) => row.cell(column).number()?,
            None => number as f64,
        };
        if let (Some(&last), Some(column)) = (orders.last(), order)
            && at < last
        {
            return Err(row.cell(column).error(format!("found {at} after {last}, expected rising numbers: rows stand in the order in which they were taken")));
        }
        let (stand, seen) = what.read(&row, stand, tool_name, kind, &poses, reading, judge)?;
        orders.push(at);
        rows.push(Row {
            line: row.line(),
            stand,
            seen,
            run: None,
            time: 0.0,
            uncertainty_mm: match uncertainty {
                Some(column) => {
                    let cell = row.cell(column);
                    let found = standard_uncertainty_um(cell.number()?);
                    found.map_err(|why| cell.error(why))? * 1e-3
                }
                None => uncertainty_mm,
            },
        });
    }
    if rows.is_empty() {
        return Err(table.header_error("found no rows, expected at least one below the header"));
    }
    for note in outside.iter().take(SHOWN) {
        reading
            .notes
            .push(format!("{}: {note}", table.header_error("").file));
    }
    if outside.len() > SHOWN {
        reading.notes.push(format!(
            "{}: {} more rows outside travel",
            table.header_error("").file,
            outside.len() - SHOWN
        ));
    }
    let unused = columns.unused();
    if !unused.is_empty() {
        let file = table.header_error("").file;
        reading.notes.push(format!(
            "{file}: columns that are not used: {}",
            unused.join(", ")
        ));
    }
    let file = &table.header_error("").file;
    reading
        .notes
        .extend(common_pose(&rows).map(|note| format!("{file}: {note}")));
    reading
        .notes
        .extend(too_small(&rows).map(|note| format!("{}: {note}", table.header_error("").file)));
    Ok(ReadRows {
        rows,
        orders,
        has_order: order.is_some(),
        has_tool: tool.is_some(),
    })
}

/// Refuses a number that no coordinate and no reading has, where it stands: with it in an equation the rows of all others look wrong.
fn refuse_endless(columns: &Columns<'_>, row: &CsvRow<'_>) -> Result<(), InputError> {
    /// 1000 km in mm, and 1 km in µm.
    const MOST: f64 = 1e9;
    let is_read = |name: &str| name != "order" && columns.used.iter().any(|used| used == name);
    let read = columns.table.columns().filter(|(_, name)| is_read(name));
    for (column, _) in read {
        let cell = row.cell(column);
        if let Ok(found) = cell.number()
            && found.abs() > MOST
        {
            return Err(cell.error(format!(
                "found {found:e}, expected {MOST:e} at the most: nothing on a machine is so large"
            )));
        }
    }
    Ok(())
}

/// A note on lengths between poses of which several have one pose in common.
fn common_pose(rows: &[Row]) -> Option<String> {
    let pairs = |place: usize| match &rows[place].seen {
        Seen::Pair { from, .. } => Some([*from, rows[place].stand]),
        _ => None,
    };
    let shared = (0..rows.len()).find_map(|later| {
        let own = pairs(later)?;
        let earlier = (0..later).find(|earlier| {
            pairs(*earlier).is_some_and(|other| own.iter().any(|stand| other.contains(stand)))
        })?;
        Some((earlier, later))
    });
    shared.map(|(earlier, later)| {
        format!(
            "lengths have a pose in common, those of lines {} and {} first: they count as independent. Where each length is the difference of two readings, the one at the common pose is in several of them, and the uncertainties are too small, by up to a factor of √2 where every pose is in two lengths; where each was measured by itself (a step gauge probed anew, a ballbar between two balls), they are right",
            rows[earlier].line, rows[later].line
        )
    })
}

/// A note where readings in µm are all smaller than their uncertainty: then they say nothing, or are mm.
fn too_small(rows: &[Row]) -> Option<String> {
    let readings = rows.iter().filter_map(|row| {
        let largest_mm = match &row.seen {
            Seen::Sphere { offset_mm, .. } => offset_mm.amax(),
            Seen::Line { deviation_mm, .. } => deviation_mm.abs(),
            Seen::Ball { offset_mm, .. } => {
                let read = offset_mm.iter().flatten();
                read.fold(0.0_f64, |largest, reading| largest.max(reading.abs()))
            }
            Seen::Point { .. } | Seen::Distance { .. } | Seen::Pair { .. } => return None,
        };
        Some((largest_mm, row.uncertainty_mm))
    });
    let readings: Vec<(f64, f64)> = readings.collect();
    let largest_mm = readings
        .iter()
        .fold(0.0_f64, |l, (reading, _)| l.max(*reading));
    let is_small = |(reading, uncertainty): &(f64, f64)| reading < uncertainty;
    (largest_mm > 0.0 && readings.iter().all(is_small)).then(|| {
        format!(
            "the largest reading is {:.3} µm, and all are below their uncertainty: are they mm?",
            1e3 * largest_mm
        )
    })
}

/// The columns of the machine's axes.
fn axis_columns(
    columns: &mut Columns<'_>,
    machine: &Machine,
) -> Result<Vec<(Column, AxisName, usize)>, InputError> {
    let mut found = Vec::new();
    for axis in AxisName::ALL {
        let structure = machine.chain().structure();
        match structure.index_of(axis) {
            Some(index) => found.extend(columns.axis(axis)?.map(|column| (column, axis, index))),
            None => {
                if let Some(name) = columns.named_like(axis) {
                    return Err(columns.table.header_error(format!(
                        "found a column {}, the structure `{structure}` has no axis {axis}",
                        quoted(name)
                    )));
                }
            }
        }
    }
    if found.is_empty() {
        let letters: Vec<String> = machine
            .axes()
            .iter()
            .map(|axis| axis.name.to_string())
            .collect();
        return Err(columns.table.header_error(format!(
            "found no column of an axis, expected the letters of the machine's axes: {}",
            letters.join(", ")
        )));
    }
    Ok(found)
}

fn read_stand(
    row: &CsvRow<'_>,
    axes: &[(Column, AxisName, usize)],
    tool_cell: Option<volcomp_document::Cell<'_>>,
    tool: &str,
    kind: &RowKind,
    machine: &Machine,
    outside: &mut Vec<String>,
) -> Result<Stand, InputError> {
    let mut state = State::default();
    for &(column, axis, index) in axes {
        let cell = row.cell(column);
        let found = cell.number()?;
        let stated = &machine.axes()[index];
        if let Err(what) = stated.check_coordinate(found) {
            let [low, high] = stated.travel;
            if stated.beyond_travel(found) > NEVER_BEYOND * (high - low) {
                return Err(cell.error(format!("{what}: is it another unit, or another machine?")));
            }
            outside.push(format!("line {}: {axis}: {what}", row.line()));
        }
        state.q[index] = Displacement::from_coordinate(axis.kind(), found).mm_or_rad();
    }
    let tip_mm = match (tool, tool_cell) {
        ("", _) | (_, None) => machine.chain().tool_tip_mm(),
        (name, Some(cell)) => tip_of(name, kind, machine).map_err(|message| cell.error(message))?,
    };
    Ok(Stand { state, tip_mm })
}

/// The tip of a tool of the machine file; a tool that only `target` names has that of `[tool]`.
fn tip_of(name: &str, kind: &RowKind, machine: &Machine) -> Result<Vector3<f64>, String> {
    if machine.tools().contains_key(name) {
        return machine.tip_of(name).map_err(|error| error.to_string());
    }
    let mut known: Vec<&str> = machine.tools().keys().map(String::as_str).collect();
    if let RowKind::Points { targets, .. } = kind {
        if targets.iter().any(|(tool, _)| tool == name) {
            return Ok(machine.chain().tool_tip_mm());
        }
        known.extend(
            targets
                .iter()
                .map(|(tool, _)| tool.as_str())
                .filter(|tool| !tool.is_empty()),
        );
    }
    let unknown = ModelError::NoSuchTool {
        machine: machine.name.clone(),
        tool: name.to_owned(),
        known: known.join(", "),
    };
    Err(unknown.to_string())
}
