//! Reads row files, including rows of balls on a bar (1-D ball array). Columns are found by name.

use std::path::{Path, PathBuf};

use volcomp_document::{
    Column, CsvRow, CsvTable, InputError, Value, quoted, split_head, unit_named,
};
use volcomp_kinematics::State;
use volcomp_kinematics::nalgebra::{Matrix3, Vector3};
use volcomp_model::{Machine, ModelError, axis_of_head};
use volcomp_vocabulary::{AxisName, Displacement};

use crate::checks::{limit_mm, standard_uncertainty_um, unit_vector};
use crate::error::IdentifyError;
use crate::observations::{MachinePose, NumberKind, Quantity, Row, RowReading, SetUp};
use crate::setup_keys::{
    Ball, BallRow, ObservationHeader, ReadFile, ReadState, point, stated_vector,
};
use crate::timeline::Approach;

/// Columns of a table by exact name. Case matters: `X` is an axis, `x` a coordinate of a target.
pub(crate) struct Columns<'t> {
    pub(crate) table: &'t CsvTable,
    pub(crate) used: Vec<String>,
}

impl Columns<'_> {
    pub(crate) fn get(&mut self, name: &str) -> Result<Option<Column>, InputError> {
        self.used.push(name.to_owned());
        let mut named = self.table.columns().filter(|(_, found)| *found == name);
        let first = named.next().map(|(column, _)| column);
        match named.next() {
            Some(_) => Err(self.table.header_error(format!("column `{name}` occurs twice"))),
            None => Ok(first),
        }
    }

    /// Column of an axis: its letter, alone or with the unit (`X`, `X mm`, `X_mm`, `C [deg]`).
    pub(crate) fn axis(&mut self, axis: AxisName) -> Result<Option<Column>, InputError> {
        self.alone_or(&axis.to_string(), |found| axis_of_head(found) == Some(axis))
    }

    /// Name of the column of an axis, alone or with any unit, also if the column was not requested.
    fn named_like(&self, axis: AxisName) -> Option<&str> {
        let letter = axis.to_string();
        let is_axis = |found: &str| without_unit(found) == Some(letter.as_str());
        let mut names = self.table.names().map(|(_, name)| name);
        names.find(|name| is_axis(name))
    }

    /// Column with this name, alone or with the unit `unit`.
    fn with_unit(&mut self, name: &str, unit: &str) -> Result<Option<Column>, InputError> {
        self.alone_or(name, |found| {
            let (stem, found) = split_head(found);
            stem == name && unit_named(found) == Some(unit)
        })
    }

    /// Column with this name, or with a name that `means_it` accepts as equivalent.
    fn alone_or(
        &mut self,
        name: &str,
        means_it: impl Fn(&str) -> bool,
    ) -> Result<Option<Column>, InputError> {
        let names = || self.table.names().map(|(_, name)| name);
        let mut others =
            names().filter(|found| *found != name && means_it(found)).map(str::to_owned);
        let Some(with_unit) = others.next() else {
            return self.get(name);
        };
        let alone = names().find(|found| *found == name).map(str::to_owned);
        if let Some(other) = alone.or_else(|| others.next()) {
            return Err(self.table.header_error(format!(
                "found columns `{other}` and `{with_unit}`, expected one of them"
            )));
        }
        self.get(&with_unit)
    }

    fn unused(&self) -> Vec<&str> {
        let names = self.table.names().map(|(_, name)| name);
        names.filter(|name| !self.used.iter().any(|used| used == name)).collect()
    }

    /// Rejects an unused column whose name resembles that of a missing column, in other letters or with another unit:
    /// `a` for `A`, `X [mm]` for `X`, `dx_mm` for `dx_um`. Otherwise the missing value would silently be taken as zero.
    fn refuse_lookalikes(&self) -> Result<(), InputError> {
        let is_there = |name: &str| self.table.names().any(|(_, found)| found == name);
        for found in self.unused() {
            // `X_actual`, `X MCS` and `Xmm` are columns of X; whatever follows the letter is ignored.
            let axis = axis_named_first(found).filter(|axis| {
                let mut names = self.table.names().map(|(_, name)| name);
                self.used.contains(&axis.to_string())
                    && !names.any(|name| axis_of_head(name) == Some(*axis))
            });
            if let Some(axis) = axis {
                return Err(self.table.header_error(format!(
                    "found a column {}, expected `{axis}`, alone or with its unit: otherwise the axis would be taken as 0",
                    quoted(found)
                )));
            }
            let Some(stem) = without_unit(found) else {
                continue;
            };
            let missing = || self.used.iter().filter(|name| !is_there(name));
            let stem_of = |name: &String| split_head(name).0.to_owned();
            // `z_mm` is taken for the `z` of a target before the axis `Z`.
            let meant = missing()
                .find(|name| stem_of(name) == stem)
                .or_else(|| missing().find(|name| stem_of(name).eq_ignore_ascii_case(stem)));
            if let Some(meant) = meant {
                return Err(self.table.header_error(format!(
                    "found a column {}, expected `{meant}`: names and units of columns must match exactly",
                    quoted(found)
                )));
            }
        }
        Ok(())
    }

    pub(crate) fn require(&mut self, name: &str) -> Result<Column, InputError> {
        let column = self.get(name)?;
        self.found(name, column)
    }

    /// Column of a required length, alone or with its unit: `x`, `x mm`, `x_mm`.
    fn require_mm(&mut self, name: &str) -> Result<Column, InputError> {
        let column = self.with_unit(name, "mm")?;
        self.found(name, column)
    }

    /// Returns `column`, the result of a search for `name`, or rejects the file if the column is missing.
    pub(crate) fn found(&self, name: &str, column: Option<Column>) -> Result<Column, InputError> {
        if column.is_none() {
            self.refuse_lookalikes()?;
        }
        column.ok_or_else(|| {
            let found: Vec<&str> = self.table.names().map(|(_, name)| name).collect();
            let found = quoted(&found.join(","));
            self.table.header_error(format!("found {found}, expected a column `{name}`"))
        })
    }
}

/// Name of a column without its unit; `None` if the suffix is not a unit.
fn without_unit(head: &str) -> Option<&str> {
    let (name, unit) = split_head(head);
    (unit.is_empty() || unit_named(unit).is_some()).then_some(name)
}

/// The axis whose letter is the first of a head and is followed by a unit or by no letter or digit: `X_actual`, `X
/// MCS`, `Xmm`.
fn axis_named_first(head: &str) -> Option<AxisName> {
    let (letter, behind) = head.split_at_checked(1)?;
    let is_word = behind.starts_with(char::is_alphanumeric) && unit_named(behind).is_none();
    letter.parse().ok().filter(|_| !is_word)
}

pub(crate) enum RowKind {
    Points {
        frame: usize,
        /// Index of the target's point for each tool; the empty name applies to any tool.
        targets: Vec<(String, Option<usize>)>,
    },
    Sphere {
        drift: usize,
    },
    Distance {
        /// Index of the point from which distances are measured; `None` if the length is between two poses.
        point: Option<usize>,
        dead: usize,
    },
    Line {
        direction: Vector3<f64>,
        offset: usize,
        slope: usize,
    },
    Ball {
        /// Index in `rows_of_balls`.
        balls: usize,
        origin: usize,
        tilts: [usize; 2],
    },
}

pub(crate) struct ReadRows {
    pub(crate) rows: Vec<Row>,
    pub(crate) orders: Vec<f64>,
    pub(crate) has_order: bool,
    pub(crate) has_tool: bool,
}

/// Maximum distance of a coordinate outside the travel, as a multiple of the travel; beyond it the pose belongs to another machine.
const MAX_OVERTRAVEL: f64 = 1.0;
const MAX_LISTED: usize = 5;

pub(crate) fn read_rows(
    table: &CsvTable,
    kind: &RowKind,
    machine: &Machine,
    uncertainty_mm: f64,
    judge: bool,
    state: &mut ReadState,
) -> Result<ReadRows, InputError> {
    let mut columns = Columns { table, used: Vec::new() };
    let axes = axis_columns(&mut columns, machine)?;
    let tool = columns.get("tool")?;
    let name = match columns.get("pose")? {
        Some(column) => Some(column),
        None => columns.get("name")?,
    };
    let order = columns.get("order")?;
    let uncertainty = columns.get("uncertainty_um")?;
    let reading_columns = ReadingColumns::new(&mut columns, kind)?;
    columns.refuse_lookalikes()?;
    let mut poses: Vec<(String, MachinePose)> = Vec::new();
    // The machine moved to the named poses in the order of their rows.
    let mut approach = Approach::default();
    let mut rows = Vec::new();
    let mut orders: Vec<f64> = Vec::new();
    let mut outside = Vec::new();
    for (number, row) in table.rows().enumerate() {
        refuse_absurd_numbers(&columns, &row)?;
        let is_pair = reading_columns.is_pair(&row, &axes)?;
        let tool_name = tool.map_or("", |column| row.cell(column).text());
        let pose = if is_pair {
            None
        } else {
            Some(read_pose(
                &row,
                &axes,
                tool.map(|c| row.cell(c)),
                tool_name,
                kind,
                machine,
                &mut outside,
            )?)
        };
        if let (ReadingColumns::Pair { .. }, Some(mut pose)) = (&reading_columns, pose) {
            approach.to(&mut pose.state, machine);
            let column = name.ok_or_else(|| {
                table.header_error("expected a column `pose` with the names of the poses")
            })?;
            let cell = row.cell(column);
            if poses.iter().any(|(known, _)| known == cell.text()) {
                return Err(cell.error(format!("pose {} is listed twice", quoted(cell.text()))));
            }
            poses.push((cell.text().to_owned(), pose));
            continue;
        }
        let at = match order {
            Some(column) => row.cell(column).number()?,
            None => number as f64,
        };
        if let (Some(&last), Some(column)) = (orders.last(), order)
            && at < last
        {
            return Err(row.cell(column).error(format!("found {at} after {last}, expected increasing numbers: rows are listed in the order in which they were measured")));
        }
        let (pose, reading) =
            reading_columns.decode(&row, pose, tool_name, &poses, state, judge)?;
        orders.push(at);
        rows.push(Row {
            line: row.line(),
            pose,
            reading,
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
    let file = table.header_error("").file;
    let mut note = |text: String| state.notes.push(format!("{file}: {text}"));
    let more = outside.len().saturating_sub(MAX_LISTED);
    outside.into_iter().take(MAX_LISTED).for_each(&mut note);
    if more > 0 {
        note(format!("{more} more rows outside travel"));
    }
    let unused = columns.unused();
    if !unused.is_empty() {
        note(format!("columns that are not used: {}", unused.join(", ")));
    }
    let anomalies = shared_pose(&rows).into_iter().chain(below_uncertainty(&rows));
    anomalies.for_each(note);
    Ok(ReadRows { rows, orders, has_order: order.is_some(), has_tool: tool.is_some() })
}

/// Rejects a number that is too large for any coordinate or reading, and names its cell: in the equations it would make
/// all other rows look like outliers.
fn refuse_absurd_numbers(columns: &Columns<'_>, row: &CsvRow<'_>) -> Result<(), InputError> {
    /// Maximum magnitude: 1000 km in mm, 1 km in µm.
    const MOST: f64 = 1e9;
    let is_read = |name: &str| name != "order" && columns.used.iter().any(|used| used == name);
    let read = columns.table.columns().filter(|(_, name)| is_read(name));
    for (column, _) in read {
        let cell = row.cell(column);
        if let Ok(found) = cell.number()
            && found.abs() > MOST
        {
            return Err(cell.error(format!(
                "found {found:e}, expected at most {MOST:e}: no quantity of a machine is larger"
            )));
        }
    }
    Ok(())
}

/// Note on lengths between poses if several of them share a pose.
fn shared_pose(rows: &[Row]) -> Option<String> {
    let pairs = |place: usize| match &rows[place].reading {
        RowReading::Pair { from, .. } => Some([*from, rows[place].pose]),
        _ => None,
    };
    let shared = (0..rows.len()).find_map(|later| {
        let own = pairs(later)?;
        let earlier = (0..later).find(|earlier| {
            pairs(*earlier).is_some_and(|other| own.iter().any(|pose| other.contains(pose)))
        })?;
        Some((earlier, later))
    });
    shared.map(|(earlier, later)| {
        format!(
            "several lengths share a pose, first those of lines {} and {}: they count as independent. Where each length is the difference of two readings, the one at the common pose is in several of them, and the uncertainties are too small, by up to a factor of √2 where every pose is in two lengths; where each was measured separately (a step gauge probed again, a ballbar between two balls), they are correct",
            rows[earlier].line, rows[later].line
        )
    })
}

/// Note if all readings in µm are below their uncertainty, because they may be in mm.
fn below_uncertainty(rows: &[Row]) -> Option<String> {
    let readings = rows.iter().filter_map(|row| {
        let largest_mm = match &row.reading {
            RowReading::Sphere { offset_mm, .. } => offset_mm.amax(),
            RowReading::Line { deviation_mm, .. } => deviation_mm.abs(),
            RowReading::Ball { offset_mm, .. } => {
                let read = offset_mm.iter().flatten();
                read.fold(0.0_f64, |largest, reading| largest.max(reading.abs()))
            }
            RowReading::Point { .. } | RowReading::Distance { .. } | RowReading::Pair { .. } => {
                return None;
            }
        };
        Some((largest_mm, row.uncertainty_mm))
    });
    let readings: Vec<(f64, f64)> = readings.collect();
    let largest_mm = readings.iter().fold(0.0_f64, |l, (reading, _)| l.max(*reading));
    let is_small = |(reading, uncertainty): &(f64, f64)| reading < uncertainty;
    (largest_mm > 0.0 && readings.iter().all(is_small)).then(|| {
        format!(
            "the largest reading is {:.3} µm, and all are below their uncertainty: are they mm?",
            1e3 * largest_mm
        )
    })
}

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
        let letters: Vec<String> =
            machine.axes().iter().map(|axis| axis.name.to_string()).collect();
        return Err(columns.table.header_error(format!(
            "found no column of an axis, expected the letters of the machine axes: {}",
            letters.join(", ")
        )));
    }
    Ok(found)
}

fn read_pose(
    row: &CsvRow<'_>,
    axes: &[(Column, AxisName, usize)],
    tool_cell: Option<volcomp_document::Cell<'_>>,
    tool: &str,
    kind: &RowKind,
    machine: &Machine,
    outside: &mut Vec<String>,
) -> Result<MachinePose, InputError> {
    let mut axes_state = State::default();
    for &(column, axis, index) in axes {
        let cell = row.cell(column);
        let found = cell.number()?;
        let stated = &machine.axes()[index];
        if let Err(what) = stated.check_coordinate(found) {
            let [low, high] = stated.travel;
            if stated.beyond_travel(found) > MAX_OVERTRAVEL * (high - low) {
                return Err(cell.error(format!("{what}: is it another unit, or another machine?")));
            }
            outside.push(format!("line {}: {axis}: {what}", row.line()));
        }
        axes_state.q[index] = Displacement::from_coordinate(axis.kind(), found).mm_or_rad();
    }
    let tip_mm = match (tool, tool_cell) {
        ("", _) | (_, None) => machine.chain().tool_tip_mm(),
        (name, Some(cell)) => tip_of(name, kind, machine).map_err(|message| cell.error(message))?,
    };
    Ok(MachinePose { state: axes_state, tip_mm })
}

/// Tip of a tool of the machine file, mm. A tool that only the key `target` names has the tip of `[tool]`.
fn tip_of(name: &str, kind: &RowKind, machine: &Machine) -> Result<Vector3<f64>, String> {
    if machine.tools().contains_key(name) {
        return machine.tip_of(name).map_err(|error| error.to_string());
    }
    let mut known: Vec<&str> = machine.tools().keys().map(String::as_str).collect();
    if let RowKind::Points { targets, .. } = kind {
        if targets.iter().any(|(tool, _)| tool == name) {
            return Ok(machine.chain().tool_tip_mm());
        }
        known.extend(targets.iter().map(|(tool, _)| tool.as_str()).filter(|tool| !tool.is_empty()));
    }
    let unknown = ModelError::NoSuchTool {
        machine: machine.name.clone(),
        tool: name.to_owned(),
        known: known.join(", "),
    };
    Err(unknown.to_string())
}

/// Columns of an R-test: tip minus centre of the sphere.
const OFFSET: [&str; 3] = ["dx_um", "dy_um", "dz_um"];

enum ReadingColumns<'k> {
    Points {
        at: [Column; 3],
        frame: usize,
        targets: &'k [(String, Option<usize>)],
    },
    Sphere {
        sphere: Option<Column>,
        offset: Option<[Column; 3]>,
        drift: usize,
    },
    Distance {
        length: Column,
        point: usize,
        dead: usize,
    },
    Pair {
        from: Column,
        to: Column,
        length: Column,
        dead: usize,
    },
    Line {
        deviation: Column,
        direction: Vector3<f64>,
        offset: usize,
        slope: usize,
    },
    Ball {
        ball: Column,
        /// Columns of the offsets of the tip along the row and to the sides. A file without these columns is from a
        /// touch probe, whose tip was at the centre of the ball.
        offsets: [Option<Column>; 3],
        balls: usize,
        origin: usize,
        tilts: [usize; 2],
    },
}

impl<'k> ReadingColumns<'k> {
    fn new(columns: &mut Columns<'_>, kind: &'k RowKind) -> Result<Self, InputError> {
        Ok(match *kind {
            RowKind::Points { frame, ref targets } => Self::Points {
                at: [columns.require_mm("x")?, columns.require_mm("y")?, columns.require_mm("z")?],
                frame,
                targets,
            },
            RowKind::Sphere { drift } => {
                let sphere = columns.get("sphere")?;
                let [x, y, z] = OFFSET.map(|name| columns.get(name));
                // A file without these columns is from a touch probe. A file with some of them is rejected, so that a
                // missing column does not change the kind of measurement.
                let offset = match [x?, y?, z?] {
                    [None, None, None] => None,
                    found => {
                        let [x, y, z] = [0, 1, 2].map(|k| columns.found(OFFSET[k], found[k]));
                        Some([x?, y?, z?])
                    }
                };
                Self::Sphere { sphere, offset, drift }
            }
            RowKind::Distance { point: None, dead } => Self::Pair {
                from: columns.require("from")?,
                to: columns.require("to")?,
                length: columns.require("length_mm")?,
                dead,
            },
            RowKind::Distance { point: Some(point), dead } => {
                Self::Distance { length: columns.require("length_mm")?, point, dead }
            }
            RowKind::Line { direction, offset, slope } => {
                Self::Line { deviation: columns.require("deviation_um")?, direction, offset, slope }
            }
            RowKind::Ball { balls, origin, tilts } => Self::Ball {
                ball: columns.require("ball")?,
                offsets: [
                    columns.get("along_um")?,
                    columns.get("side1_um")?,
                    columns.get("side2_um")?,
                ],
                balls,
                origin,
                tilts,
            },
        })
    }

    fn is_pair(
        &self,
        row: &CsvRow<'_>,
        axes: &[(Column, AxisName, usize)],
    ) -> Result<bool, InputError> {
        let Self::Pair { from, to, length, .. } = self else {
            return Ok(false);
        };
        let is_stated = |column: &Column| !row.cell(*column).text().is_empty();
        let is_pair = [from, to, length].into_iter().any(is_stated);
        if axes.iter().any(|(column, ..)| is_stated(column)) == is_pair {
            return Err(row.error(
                "expected either the coordinates of a pose, or `from`, `to` and `length_mm`",
            ));
        }
        Ok(is_pair)
    }

    fn decode(
        &self,
        row: &CsvRow<'_>,
        pose: Option<MachinePose>,
        tool: &str,
        poses: &[(String, MachinePose)],
        state: &mut ReadState,
        judge: bool,
    ) -> Result<(MachinePose, RowReading), InputError> {
        let numbers = |columns: &[Column; 3]| -> Result<Vector3<f64>, InputError> {
            let mut vector = Vector3::zeros();
            for (place, column) in columns.iter().enumerate() {
                vector[place] = row.cell(*column).number()?;
            }
            Ok(vector)
        };
        let mut pose = pose;
        let reading = match *self {
            Self::Pair { from, to, length, dead } => {
                let [from, to] = pair(row, [from, to], poses)?;
                pose = Some(to);
                RowReading::Pair { from, dead, length_mm: row.cell(length).number()? }
            }
            Self::Points { ref at, frame, targets } => {
                let mut targets = targets.iter();
                let target = targets.find(|(name, _)| name == tool || name.is_empty());
                RowReading::Point {
                    frame,
                    target: target.and_then(|(_, place)| *place),
                    at_mm: numbers(at)?,
                }
            }
            Self::Sphere { sphere, ref offset, drift } => {
                let name = sphere.map_or("", |column| row.cell(column).text());
                let centre = centre_of(name, drift, judge, row, state)?;
                let offset_mm = match offset {
                    Some(columns) => numbers(columns)? * 1e-3,
                    None => Vector3::zeros(),
                };
                RowReading::Sphere { centre, offset_mm }
            }
            Self::Distance { length, point, dead } => {
                RowReading::Distance { point, dead, length_mm: row.cell(length).number()? }
            }
            Self::Line { deviation, direction, offset, slope } => RowReading::Line {
                direction,
                offset,
                slope,
                deviation_mm: row.cell(deviation).number()? * 1e-3,
            },
            Self::Ball { ball, ref offsets, balls, origin, tilts } => {
                let cell = row.cell(ball);
                let distance = state.rows_of_balls[balls]
                    .distance_of(cell.text(), &mut state.setup)
                    .map_err(|message| cell.error(message))?;
                RowReading::Ball {
                    origin,
                    tilts,
                    distance,
                    // The directions are set when the bar is placed, after all rows are read.
                    axes: Matrix3::identity(),
                    offset_mm: ball_offset(row, offsets)?,
                }
            }
        };
        let pose = pose.ok_or_else(|| row.error("expected the coordinates of a pose"))?;
        Ok((pose, reading))
    }
}

/// The two poses between which a row measures.
fn pair(
    row: &CsvRow<'_>,
    columns: [Column; 2],
    poses: &[(String, MachinePose)],
) -> Result<[MachinePose; 2], InputError> {
    let find = |column: Column| {
        let cell = row.cell(column);
        let pose = poses.iter().find(|(name, _)| name == cell.text());
        pose.map(|(_, pose)| *pose).ok_or_else(|| {
            cell.error(format!(
                "found {}, expected the name of a pose above this row",
                quoted(cell.text())
            ))
        })
    };
    let [from, to] = columns;
    let pair = [find(from)?, find(to)?];
    // Poses that differ only in their approach directions are the same pose.
    if pair[0].state.q == pair[1].state.q && pair[0].tip_mm == pair[1].tip_mm {
        return Err(row.error("found the same pose twice, expected two poses that differ"));
    }
    Ok(pair)
}

/// Tip minus ball, mm; `None` for components that are not measured. All components are zero if the file has no column
/// for them.
fn ball_offset(
    row: &CsvRow<'_>,
    columns: &[Option<Column>; 3],
) -> Result<[Option<f64>; 3], InputError> {
    if columns.iter().all(Option::is_none) {
        return Ok([Some(0.0); 3]);
    }
    let mut offset = [None; 3];
    for (place, column) in columns.iter().enumerate() {
        let cell = column.map(|column| row.cell(column));
        if let Some(cell) = cell.filter(|cell| !cell.text().is_empty()) {
            offset[place] = Some(cell.number()? * 1e-3);
        }
    }
    if offset == [None; 3] {
        return Err(
            row.error("found no reading, expected at least one of along_um, side1_um, side2_um")
        );
    }
    Ok(offset)
}

/// Centre of a sphere, shared by all files that name it.
fn centre_of(
    name: &str,
    drift: usize,
    judge: bool,
    row: &CsvRow<'_>,
    state: &mut ReadState,
) -> Result<usize, InputError> {
    if let Some((_, place)) = state.spheres.iter().find(|(known, _)| known == name) {
        return Ok(*place);
    }
    if judge {
        return Err(row.error(format!(
            "sphere {} is in no fitted observation, expected one that is",
            quoted(name)
        )));
    }
    let full = if name.is_empty() { "sphere".to_owned() } else { format!("sphere {name}") };
    let place = state.setup.add_point(Quantity::new(full, None, drift));
    state.spheres.push((name.to_owned(), place));
    Ok(place)
}

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
