//! The columns of a table that holds a trace.

use volcomp_document::{Column, CsvTable, quoted};

use crate::{MetrologyError, ReadingUnit, csv_head::unit_of};

/// Where the quantities of a trace stand.
pub(super) struct TraceColumns {
    pub(super) kind: Kind,
    pub(super) direction: Option<Column>,
}

pub(super) enum Kind {
    /// Angle and radial deviation, with what one unit of each is in rad and in µm.
    Radial {
        angle: (Column, f64),
        deviation: (Column, f64),
    },
    /// Two coordinates, mm.
    Positions([Column; 2]),
}

const EXPECTED: &str = "the columns `angle` and `deviation` (or `radius deviation`, `radial deviation`; a radius alone is none), or two of `x`, `y` and `z`";

impl TraceColumns {
    /// The coordinates are called as the axes of the plane are.
    pub(super) fn of(table: &CsvTable, axes: [&str; 2]) -> Result<Self, MetrologyError> {
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
                let heads: Vec<&str> = table.names().map(|(_, name)| name).collect();
                let found = quoted(&heads.join(&table.separator().to_string()));
                let [a, b] = axes;
                let message = format!("found {found}, expected {EXPECTED}, here `{a}` and `{b}`");
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

/// The column of radial deviations and its unit: `deviation`, or `radius` or `radial` with the word `deviation` behind.
fn deviation(table: &CsvTable) -> Result<Option<(Column, &str)>, MetrologyError> {
    if let Some(found) = with_unit(table, "deviation")? {
        return Ok(Some(found));
    }
    one(table, "radius deviation", |head| {
        let behind = unit_of(head, "radius").or_else(|| unit_of(head, "radial"));
        unit_of(behind?, "deviation")
    })
}

/// The column of a name, alone or with a unit behind it, and that unit.
fn with_unit<'t>(
    table: &'t CsvTable,
    name: &str,
) -> Result<Option<(Column, &'t str)>, MetrologyError> {
    one(table, name, |head| unit_of(head, name))
}

/// The one column in whose head a unit is found, which may be empty.
fn one<'t>(
    table: &'t CsvTable,
    name: &str,
    unit: impl Fn(&'t str) -> Option<&'t str>,
) -> Result<Option<(Column, &'t str)>, MetrologyError> {
    let mut named = table
        .names()
        .filter_map(|(column, head)| Some((column, unit(head)?)));
    let first = named.next();
    if named.next().is_some() {
        let message = format!("column `{name}` stands twice");
        return Err(table.header_error(message).into());
    }
    Ok(first)
}
