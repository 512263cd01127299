//! Table of a circular test, with angles and radial deviations, or with positions.

use volcomp_document::{Column, CsvTable, quoted};

use super::trace::{least_squares_circle, one_turn, senses};
use super::{CircularPlane, CircularTrace, LARGEST_RADIUS_MM, Sense, TracePoint};
use crate::csv_head::{heads, one_column, unit_of, with_unit};
use crate::encoding::{decode, refuse_empty};
use crate::number::Place;
use crate::{MetrologyError, ReadingUnit};

const FEWEST_POINTS: usize = 16;

/// Reads a trace from CSV text. `name` is the name of the file in messages.
///
/// The header has `angle` (deg, or `angle rad`) and one of `deviation`, `radius deviation` and `radial deviation` (µm,
/// or followed by `mm` or `nm`). Or it has the two coordinates of the plane in mm, such as `x` and `y` in X–Y. A column
/// `direction` with `ccw` or `+` and `cw` or `-` states the sense of each point. Without this column the sense follows
/// from the order of the rows. `radius_mm` is the nominal radius. Without a radius, positions are measured against
/// their mean radius.
///
/// # Errors
/// Wrong header, units or cells, a radius that is out of range, fewer than 16 points, positions that are not on a
/// circle, or angles without a radius. Messages name the file, the line, what was found and what was expected.
pub fn parse_trace(
    bytes: &[u8],
    name: &str,
    plane: CircularPlane,
    radius_mm: Option<f64>,
) -> Result<CircularTrace, MetrologyError> {
    if let Some(radius) = radius_mm
        && !(radius > 0.0 && radius <= LARGEST_RADIUS_MM)
    {
        let found = format!("{radius} mm");
        let expected = "above 0 and at most 100000 mm";
        return Err(refuse(name, "nominal radius", found, expected));
    }
    let (text, encoding_note) = decode(bytes, name)?;
    let expected = "the header `angle,deviation` or `x,y`, and a point in each row";
    refuse_empty(&text, name, expected)?;
    let table = CsvTable::parse(name, &text)?;
    let letters = plane.axes().map(|axis| axis.to_string());
    let columns = TraceColumns::of(&table, [&letters[0], &letters[1]])?;
    let mut notes: Vec<String> = encoding_note.into_iter().collect();
    let mut pairs = Vec::new();
    let mut stated = Vec::new();
    for row in table.rows() {
        let place = Place::new(name, row.line());
        let pair = match columns.kind {
            Kind::Radial { angle, deviation } => {
                let number = |what: &str, (column, unit): (_, f64)| {
                    Ok::<f64, MetrologyError>(
                        place.number(what, &row.cell(column).decimal_text()?)? * unit,
                    )
                };
                [number("angle", angle)?, number("deviation", deviation)?]
            }
            Kind::Positions([x, y]) => [
                place.number(&letters[0], &row.cell(x).decimal_text()?)?,
                place.number(&letters[1], &row.cell(y).decimal_text()?)?,
            ],
        };
        pairs.push(pair);
        if let Some(column) = columns.direction {
            stated.push(sense_of(place, row.cell(column).text())?);
        }
    }
    if pairs.len() < FEWEST_POINTS {
        let found = pairs.len().to_string();
        return Err(refuse(name, "points", found, "at least 16 around the circle"));
    }
    let is_positions = matches!(columns.kind, Kind::Positions(_));
    let angles = angles(&pairs, is_positions, name)?;
    let senses = if stated.is_empty() {
        notes.push("the sense of the motion is taken from the order of the rows".to_owned());
        senses(&angles)
    } else {
        stated
    };
    let one_turn = one_turn(&angles, &senses);
    notes.extend(one_turn.notes);
    let kept = pairs.into_iter().zip(senses).zip(one_turn.keeps);
    let kept = kept.filter_map(|(point, keeps)| keeps.then_some(point));
    let (mut radial, senses): (Vec<[f64; 2]>, Vec<Sense>) = kept.unzip();
    let mut radius = radius_mm;
    if is_positions {
        let (centre, mean_mm) = least_squares_circle(&radial, name)?;
        let nominal = *radius.get_or_insert(mean_mm);
        for pair in &mut radial {
            let (u, v) = (pair[0] - centre[0], pair[1] - centre[1]);
            *pair = [v.atan2(u), (u.hypot(v) - nominal) * 1e3];
        }
        notes.push(format!(
            "the centre of the points, {:.4}, {:.4} mm, is taken out",
            centre[0], centre[1]
        ));
    }
    let Some(nominal) = radius else {
        let found = "none".to_owned();
        let expected =
            "one, with deviations over angles: squareness and scale are sizes against it";
        return Err(refuse(name, "nominal radius", found, expected));
    };
    // A deviation above a hundredth of the radius (10 µm per mm) must be in another unit.
    if let Some([_, deviation]) = radial.iter().find(|pair| pair[1].abs() > 10.0 * nominal) {
        let found = format!("{deviation} µm at a radius of {nominal} mm");
        let expected = "deviations below a hundredth of the radius";
        return Err(refuse(name, "deviation", found, expected));
    }
    let points = radial.iter().zip(senses);
    Ok(CircularTrace {
        name: name.to_owned(),
        radius_mm: nominal,
        radius_is_stated: radius_mm.is_some(),
        points: points
            .map(|(pair, sense)| TracePoint { angle_rad: pair[0], deviation_um: pair[1], sense })
            .collect(),
        notes,
    })
}

/// Angles of the points, rad. The angles of positions are about the centre of their least-squares circle.
fn angles(pairs: &[[f64; 2]], is_positions: bool, name: &str) -> Result<Vec<f64>, MetrologyError> {
    if !is_positions {
        return Ok(pairs.iter().map(|pair| pair[0]).collect());
    }
    let (centre, _) = least_squares_circle(pairs, name)?;
    let angle = |[x, y]: &[f64; 2]| (y - centre[1]).atan2(x - centre[0]);
    Ok(pairs.iter().map(angle).collect())
}

/// Whether the header of a table is that of a trace in one of the planes. A third coordinate or a target column
/// excludes this.
pub(crate) fn looks_like_circle(text: &str, name: &str) -> bool {
    let Ok(table) = CsvTable::parse(name, text) else {
        return false;
    };
    let planes = [CircularPlane::Xy, CircularPlane::Yz, CircularPlane::Zx];
    let fitting = planes.iter().filter(|plane| {
        let letters = plane.axes().map(|axis| axis.to_string());
        TraceColumns::of(&table, [&letters[0], &letters[1]]).is_ok()
    });
    let has = |name: &str| {
        let mut heads = table.names();
        heads.any(|(_, head)| unit_of(head, name).is_some())
    };
    // Columns of angles match every plane, columns of coordinates only their own plane.
    !has("target") && matches!((fitting.count(), has("angle")), (1, false) | (3, true))
}

fn sense_of(place: Place<'_>, text: &str) -> Result<Sense, MetrologyError> {
    match text.to_ascii_lowercase().as_str() {
        "ccw" | "+" => Ok(Sense::CounterClockwise),
        "cw" | "-" => Ok(Sense::Clockwise),
        _ => Err(place.malformed("direction", quoted(text), "`ccw` or `cw`, `+` or `-`")),
    }
}

fn refuse(name: &str, what: &str, found: String, expected: &str) -> MetrologyError {
    MetrologyError::readings(name, what, found, expected)
}

struct TraceColumns {
    kind: Kind,
    direction: Option<Column>,
}

enum Kind {
    /// Columns of angle and radial deviation, each with the factor from its unit to rad or µm.
    Radial { angle: (Column, f64), deviation: (Column, f64) },
    /// Columns of the two coordinates, mm.
    Positions([Column; 2]),
}

const EXPECTED_COLUMNS: &str = "the columns `angle` and `deviation` (or `radius deviation`, `radial deviation`; not a radius alone), or two of `x`, `y` and `z`";

impl TraceColumns {
    /// Finds the columns. The columns of coordinates have the names of the `axes` of the plane.
    fn of(table: &CsvTable, axes: [&str; 2]) -> Result<Self, MetrologyError> {
        let direction = table.column("direction")?;
        let angle = with_unit(table, "angle")?;
        let deviation = deviation(table)?;
        let positions = [with_unit(table, axes[0])?, with_unit(table, axes[1])?];
        let kind = match (angle, deviation, positions) {
            (Some(_), Some(_), [Some(_), Some(_)]) => {
                let message = "found angles and positions, expected one of them";
                return Err(table.header_error(message).into());
            }
            (Some((angle, angle_unit)), Some((deviation, unit)), _) => Kind::Radial {
                angle: (angle, angle_in_rad(table, angle_unit)?),
                deviation: (deviation, deviation_in_um(table, unit)?),
            },
            (None, None, [Some((x, x_unit)), Some((y, y_unit))]) => {
                for unit in [x_unit, y_unit] {
                    if !unit.is_empty() && !unit.eq_ignore_ascii_case("mm") {
                        let found = quoted(unit);
                        let message = format!("found positions in {found}, expected mm");
                        return Err(table.header_error(message).into());
                    }
                }
                Kind::Positions([x, y])
            }
            _ => {
                let found = heads(table);
                let [a, b] = axes;
                let message =
                    format!("found {found}, expected {EXPECTED_COLUMNS}, here `{a}` and `{b}`");
                return Err(table.header_error(message).into());
            }
        };
        Ok(Self { kind, direction })
    }
}

fn angle_in_rad(table: &CsvTable, unit: &str) -> Result<f64, MetrologyError> {
    if unit.is_empty() {
        return Ok(1.0_f64.to_radians());
    }
    match ReadingUnit::named(unit) {
        Some(ReadingUnit::Deg) => Ok(1.0_f64.to_radians()),
        Some(ReadingUnit::Rad) => Ok(1.0),
        _ => {
            let message = format!("found angles in {}, expected deg or rad", quoted(unit));
            Err(table.header_error(message).into())
        }
    }
}

fn deviation_in_um(table: &CsvTable, unit: &str) -> Result<f64, MetrologyError> {
    if unit.is_empty() {
        return Ok(1.0);
    }
    if let Some(unit @ (ReadingUnit::Mm | ReadingUnit::Um | ReadingUnit::Nm)) =
        ReadingUnit::named(unit)
    {
        return Ok(unit.micro());
    }
    let found = quoted(unit);
    let message = format!("found radial deviations in {found}, expected µm, mm or nm");
    Err(table.header_error(message).into())
}

/// Column of the radial deviations and its unit. The head is `deviation`, `radius deviation` or `radial deviation`.
fn deviation(table: &CsvTable) -> Result<Option<(Column, &str)>, MetrologyError> {
    if let Some(found) = with_unit(table, "deviation")? {
        return Ok(Some(found));
    }
    one_column(table, "radius deviation", |head| {
        let behind = unit_of(head, "radius").or_else(|| unit_of(head, "radial"));
        unit_of(behind?, "deviation")
    })
}
