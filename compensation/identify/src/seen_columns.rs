//! The columns of what was seen in a row of observations, and what a row says there.

use volcomp_document::{Column, CsvRow, InputError, quoted};
use volcomp_kinematics::nalgebra::{Matrix3, Vector3};
use volcomp_vocabulary::AxisName;

use crate::{
    columns::Columns,
    observations::{Quantity, Seen, Stand},
    rows::RowKind,
    setup_keys::Reading,
};

/// The columns of an R-test: the tip minus the centre of the sphere.
const OFFSET: [&str; 3] = ["dx_um", "dy_um", "dz_um"];

/// The columns of what was seen.
pub(crate) enum SeenColumns {
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

impl SeenColumns {
    pub(crate) fn columns(columns: &mut Columns<'_>, kind: &RowKind) -> Result<Self, InputError> {
        Ok(match kind {
            RowKind::Points { .. } => Self::Points {
                at: [
                    columns.require_mm("x")?,
                    columns.require_mm("y")?,
                    columns.require_mm("z")?,
                ],
            },
            RowKind::Sphere { drift } => {
                let sphere = columns.get("sphere")?;
                let [x, y, z] = OFFSET.map(|name| columns.get(name));
                // With none of them it is the file of a touch probe; one that is missing must not make it one.
                let offset = match [x?, y?, z?] {
                    [None, None, None] => None,
                    found => {
                        let [x, y, z] = [0, 1, 2].map(|k| columns.found(OFFSET[k], found[k]));
                        Some([x?, y?, z?])
                    }
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
    pub(crate) fn is_pair(
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
    pub(crate) fn read(
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
    // From which side it came makes no other pose.
    if pair[0].state.q == pair[1].state.q && pair[0].tip_mm == pair[1].tip_mm {
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
