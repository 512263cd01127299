//! The rows of a file of observations.

use volcomp_document::{Column, CsvRow, CsvTable, InputError, quoted};
use volcomp_kinematics::{
    State,
    nalgebra::{Matrix3, Vector3},
};
use volcomp_model::{Machine, ModelError};
use volcomp_vocabulary::{AxisName, Displacement};

use crate::{
    observations::{Quantity, Row, Seen, Stand},
    read::Reading,
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
}

/// A coordinate further outside travel than so many travels is no pose of this machine.
const NEVER_BEYOND: f64 = 1.0;
/// Rows outside travel that are named.
const SHOWN: usize = 5;

/// The columns of a table by their exact names: `X` is an axis, `x` a coordinate of a target.
struct Columns<'t> {
    table: &'t CsvTable,
    used: Vec<String>,
}

impl Columns<'_> {
    fn get(&mut self, name: &str) -> Result<Option<Column>, InputError> {
        self.used.push(name.to_owned());
        let mut named = self.table.columns().filter(|(_, found)| *found == name);
        let first = named.next().map(|(column, _)| column);
        match named.next() {
            Some(_) => Err(self
                .table
                .header_error(format!("column `{name}` stands twice"))),
            None => Ok(first),
        }
    }

    fn require(&mut self, name: &str) -> Result<Column, InputError> {
        self.get(name)?.ok_or_else(|| {
            let found: Vec<&str> = self.table.names().map(|(_, name)| name).collect();
            let found = quoted(&found.join(","));
            self.table
                .header_error(format!("found {found}, expected a column `{name}`"))
        })
    }
}

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
    let mut what = What::columns(&mut columns, kind)?;
    let mut poses: Vec<(String, Stand)> = Vec::new();
    let mut rows = Vec::new();
    let mut orders: Vec<f64> = Vec::new();
    let mut outside = Vec::new();
    for (number, row) in table.rows().enumerate() {
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
        if let (What::Pair { .. }, Some(stand)) = (&what, stand) {
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
            time: 0.0,
            uncertainty_mm: match uncertainty {
                Some(column) => {
                    let cell = row.cell(column);
                    let found = cell.number()?;
                    if found <= 0.0 {
                        return Err(cell.error(format!("found {found}, expected a number above 0")));
                    }
                    found * 1e-3
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
    let used: Vec<&str> = columns.used.iter().map(String::as_str).collect();
    let unused: Vec<&str> = table
        .names()
        .map(|(_, n)| n)
        .filter(|n| !used.contains(n))
        .collect();
    if !unused.is_empty() {
        let file = table.header_error("").file;
        reading.notes.push(format!(
            "{file}: columns that are not used: {}",
            unused.join(", ")
        ));
    }
    Ok(ReadRows {
        rows,
        orders,
        has_order: order.is_some(),
    })
}

/// The columns of the machine's axes.
fn axis_columns(
    columns: &mut Columns<'_>,
    machine: &Machine,
) -> Result<Vec<(Column, AxisName, usize)>, InputError> {
    let mut found = Vec::new();
    for axis in AxisName::ALL {
        let Some(column) = columns.get(&axis.to_string())? else {
            continue;
        };
        let structure = machine.chain().structure();
        let index = structure.index_of(axis).ok_or_else(|| {
            columns.table.header_error(format!(
                "found a column `{axis}`, the structure `{structure}` has no axis {axis}"
            ))
        })?;
        found.push((column, axis, index));
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
        let [low, high] = machine.axes()[index].travel;
        let unit = axis.kind().coordinate_unit();
        let beyond = (low - found).max(found - high);
        if machine.axes()[index].modulo.is_none() && beyond > 1e-9 * (high - low) {
            let what = format!(
                "found {found} {unit}, expected a position within the travel of {axis}, {low} to {high} {unit}"
            );
            if beyond > NEVER_BEYOND * (high - low) {
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
        let mut with_tool = machine.clone();
        return match with_tool.select_tool(name) {
            Ok(()) => Ok(with_tool.chain().tool_tip_mm()),
            Err(error) => Err(error.to_string()),
        };
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

/// The columns of what was seen.
enum What {
    Points {
        at: [Column; 3],
    },
    Sphere {
        sphere: Option<Column>,
        offset: Option<[Column; 3]>,
        drift: usize,
    },
    Distance {
        length: Column,
    },
    Pair {
        from: Column,
        to: Column,
        length: Column,
    },
    Line {
        deviation: Column,
    },
    Ball {
        ball: Column,
        /// Along and to the sides; none of them: the tip was on the centre of the ball.
        offsets: [Option<Column>; 3],
    },
}

impl What {
    fn columns(columns: &mut Columns<'_>, kind: &RowKind) -> Result<Self, InputError> {
        Ok(match kind {
            RowKind::Points { .. } => Self::Points {
                at: [
                    columns.require("x")?,
                    columns.require("y")?,
                    columns.require("z")?,
                ],
            },
            RowKind::Sphere { drift } => {
                let sphere = columns.get("sphere")?;
                let offset = match columns.get("dx_um")? {
                    Some(x) => Some([x, columns.require("dy_um")?, columns.require("dz_um")?]),
                    None => None,
                };
                Self::Sphere {
                    sphere,
                    offset,
                    drift: *drift,
                }
            }
            RowKind::Distance { point: None, .. } => Self::Pair {
                from: columns.require("from")?,
                to: columns.require("to")?,
                length: columns.require("length_mm")?,
            },
            RowKind::Distance { .. } => Self::Distance {
                length: columns.require("length_mm")?,
            },
            RowKind::Line { .. } => Self::Line {
                deviation: columns.require("deviation_um")?,
            },
            RowKind::Ball { .. } => Self::Ball {
                ball: columns.require("ball")?,
                offsets: [
                    columns.get("along_um")?,
                    columns.get("side1_um")?,
                    columns.get("side2_um")?,
                ],
            },
        })
    }

    /// Whether a row names two poses instead of being one.
    fn is_pair(
        &self,
        row: &CsvRow<'_>,
        axes: &[(Column, AxisName, usize)],
    ) -> Result<bool, InputError> {
        let Self::Pair { from, to, length } = self else {
            return Ok(false);
        };
        let is_pose = axes
            .iter()
            .any(|(column, ..)| !row.cell(*column).text().is_empty());
        let is_pair = [from, to, length]
            .iter()
            .any(|column| !row.cell(**column).text().is_empty());
        if is_pose == is_pair {
            return Err(row.error(
                "expected either the coordinates of a pose, or `from`, `to` and `length_mm`",
            ));
        }
        Ok(is_pair)
    }

    #[expect(clippy::too_many_arguments, reason = "what a row refers to")]
    #[expect(clippy::too_many_lines, reason = "one arm for each kind")]
    fn read(
        &mut self,
        row: &CsvRow<'_>,
        stand: Option<Stand>,
        tool: &str,
        kind: &RowKind,
        poses: &[(String, Stand)],
        reading: &mut Reading,
        judge: bool,
    ) -> Result<(Stand, Seen), InputError> {
        let numbers = |columns: &[Column; 3]| -> Result<Vector3<f64>, InputError> {
            let mut vector = Vector3::zeros();
            for (place, column) in columns.iter().enumerate() {
                vector[place] = row.cell(*column).number()?;
            }
            Ok(vector)
        };
        let here = || stand.ok_or_else(|| row.error("expected the coordinates of a pose"));
        match (&*self, kind) {
            (Self::Points { at }, RowKind::Points { frame, targets }) => {
                let target = targets
                    .iter()
                    .find(|(name, _)| name == tool || name.is_empty());
                Ok((
                    here()?,
                    Seen::Point {
                        frame: *frame,
                        target: target.and_then(|(_, place)| *place),
                        at_mm: numbers(at)?,
                    },
                ))
            }
            (
                Self::Sphere {
                    sphere,
                    offset,
                    drift,
                },
                _,
            ) => {
                let name = sphere.map_or("", |column| row.cell(column).text());
                let centre = centre_of(name, *drift, judge, row, reading)?;
                let offset_mm = match offset {
                    Some(columns) => numbers(columns)? * 1e-3,
                    None => Vector3::zeros(),
                };
                Ok((here()?, Seen::Sphere { centre, offset_mm }))
            }
            (
                Self::Distance { length },
                RowKind::Distance {
                    point: Some(point),
                    dead,
                },
            ) => Ok((
                here()?,
                Seen::Distance {
                    point: *point,
                    dead: *dead,
                    length_mm: row.cell(*length).number()?,
                },
            )),
            (Self::Pair { from, to, length }, RowKind::Distance { dead, .. }) => {
                let [from, stand] = pair(row, [*from, *to], poses)?;
                Ok((
                    stand,
                    Seen::Pair {
                        from,
                        dead: *dead,
                        length_mm: row.cell(*length).number()?,
                    },
                ))
            }
            (
                Self::Line { deviation },
                RowKind::Line {
                    direction,
                    offset,
                    slope,
                },
            ) => Ok((
                here()?,
                Seen::Line {
                    direction: *direction,
                    offset: *offset,
                    slope: *slope,
                    deviation_mm: row.cell(*deviation).number()? * 1e-3,
                },
            )),
            (
                Self::Ball { ball, offsets },
                RowKind::Ball {
                    balls,
                    origin,
                    tilts,
                },
            ) => {
                let cell = row.cell(*ball);
                let distance = reading.rows_of_balls[*balls]
                    .distance_of(cell.text(), &mut reading.setup)
                    .map_err(|message| cell.error(message))?;
                Ok((
                    here()?,
                    Seen::Ball {
                        origin: *origin,
                        tilts: *tilts,
                        distance,
                        // Laid through all rows when they are read.
                        axes: Matrix3::identity(),
                        offset_mm: ball_offset(row, offsets)?,
                    },
                ))
            }
            // The columns were made for the kind.
            _ => Err(row.error("expected a row of this kind of observation")),
        }
    }
}

/// The two poses between which a row measures.
fn pair(
    row: &CsvRow<'_>,
    columns: [Column; 2],
    poses: &[(String, Stand)],
) -> Result<[Stand; 2], InputError> {
    let find = |column: Column| {
        let cell = row.cell(column);
        let pose = poses.iter().find(|(name, _)| name == cell.text());
        pose.map(|(_, stand)| *stand).ok_or_else(|| {
            cell.error(format!(
                "found {}, expected the name of a pose above this row",
                quoted(cell.text())
            ))
        })
    };
    let [from, to] = columns;
    let pair = [find(from)?, find(to)?];
    if pair[0] == pair[1] {
        return Err(row.error("found the same pose twice, expected two poses that differ"));
    }
    Ok(pair)
}

/// Tip minus ball, mm, as far as it was read: all of it zero where there is no column for it.
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

/// The centre of a sphere, the same in all files that name it.
fn centre_of(
    name: &str,
    drift: usize,
    judge: bool,
    row: &CsvRow<'_>,
    reading: &mut Reading,
) -> Result<usize, InputError> {
    if let Some((_, place)) = reading.spheres.iter().find(|(known, _)| known == name) {
        return Ok(*place);
    }
    if judge {
        return Err(row.error(format!(
            "sphere {} is in no fitted observation, expected one that is",
            quoted(name)
        )));
    }
    let place = reading.setup.points.len();
    reading.setup.points.push(Quantity {
        name: if name.is_empty() {
            "sphere".to_owned()
        } else {
            format!("sphere {name}")
        },
        value: None,
        unknown: true,
        drift,
        known_within: None,
    });
    reading.spheres.push((name.to_owned(), place));
    Ok(place)
}
