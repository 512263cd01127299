//! Table of points with the columns `x,y,z`.

use volcomp_document::{Column, CsvTable};

use super::LARGEST_MM;
use crate::{
    MetrologyError,
    csv_head::{not_read, unit_of},
};

#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct FormPoints {
    /// Points in the order of the rows, mm.
    pub points_mm: Vec<[f64; 3]>,
    /// Line of each point in the file, from 1.
    pub lines: Vec<usize>,
    /// Notes on ignored columns.
    pub notes: Vec<String>,
}

const NAMES: [&str; 3] = ["x", "y", "z"];

/// Reads points from CSV text. `name` is the name of the file in messages.
///
/// The header has the columns `x`, `y` and `z` in any order, each alone or followed by the unit mm: `x`, `X mm`, `x
/// [mm]`. Other columns are ignored, with a note. Cells are separated by `,`, `;` or tabs. Unless commas separate the
/// cells, numbers may have a decimal comma.
///
/// # Errors
/// A column is missing, repeated or in another unit; a cell is not a finite number of at most [`LARGEST_MM`]; or there
/// is no row. Messages name the file, the line, the column, what was found and what was expected.
pub fn parse_points(text: &str, name: &str) -> Result<FormPoints, MetrologyError> {
    if text.trim().is_empty() {
        return Err(MetrologyError::Empty {
            file: name.into(),
            expected: "the header `x,y,z` and one point a row, in mm".into(),
        });
    }
    let table = CsvTable::parse(name, text)?;
    let mut columns = Vec::new();
    for wanted in NAMES {
        columns.push(column(&table, wanted)?);
    }
    let mut read = FormPoints { points_mm: Vec::new(), lines: Vec::new(), notes: Vec::new() };
    for row in table.rows() {
        let mut point_mm = [0.0; 3];
        for (coordinate, &column) in point_mm.iter_mut().zip(&columns) {
            let cell = row.cell(column);
            *coordinate = cell.number()?;
            if coordinate.abs() > LARGEST_MM {
                let found = cell.text();
                let message = format!("found `{found}`, expected at most {LARGEST_MM} mm");
                return Err(cell.error(message).into());
            }
        }
        read.points_mm.push(point_mm);
        read.lines.push(row.line());
    }
    if read.points_mm.is_empty() {
        let expected = "found no row under the header, expected one point a row";
        return Err(table.header_error(expected).into());
    }
    let is_read = |column: &Column| columns.contains(column);
    let others: Vec<&str> =
        table.names().filter(|(c, _)| !is_read(c)).map(|(_, name)| name).collect();
    read.notes.extend(not_read(&others));
    Ok(read)
}

fn column(table: &CsvTable, wanted: &str) -> Result<Column, MetrologyError> {
    let mut named =
        table.names().filter_map(|(column, head)| Some((column, head, unit_of(head, wanted)?)));
    let Some((column, head, unit)) = named.next() else {
        let heads: Vec<&str> = table.names().map(|(_, name)| name).collect();
        let message = format!(
            "found `{}`, expected columns x, y and z in mm: `{wanted}` is missing",
            heads.join(&table.separator().to_string())
        );
        return Err(table.header_error(message).into());
    };
    if let Some((_, other, _)) = named.next() {
        let message = format!("found columns `{head}` and `{other}`, expected one for {wanted}");
        return Err(table.header_error(message).into());
    }
    if !unit.is_empty() && !unit.eq_ignore_ascii_case("mm") {
        let message =
            format!("found column `{head}` in {unit}, expected mm: {wanted} or {wanted}_mm");
        return Err(table.header_error(message).into());
    }
    Ok(column)
}
