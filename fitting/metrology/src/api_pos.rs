//! API laser files `.pos`: tables of mean errors over the runs, in mm.

use std::fmt::Write as _;

use volcomp_document::quoted;

use crate::decimal_comma::{begins_with_number, with_points};
use crate::encoding::{decode, refuse_empty};
use crate::number::Place;
use crate::text_report::{decimals_of, head_of, metadata_of, step_of};
use crate::{DeviationUnit, Direction, FileFormat, Measurement, MetrologyError, Quantity, Reading};

const EXPECTED: &str = "a table headed `Position   Bidirectional Avg Error`";
/// Factor from the unit of the file, mm, to µm.
const UM_PER_MM: f64 = 1e3;

/// Reads a position file of an API laser (`.pos`). Its tables have the heads `Position  Bidirectional Avg Error`,
/// `Position  Forward Directional Avg Error` and `Position  Backward Directional Avg Error`. Targets and errors are in
/// mm.
///
/// The file has means over the runs, but not the single runs. So the forward means and the backward means become one
/// run each. If the file has only the mean of both directions, this mean becomes one forward run, with a note. The mean
/// of both directions is checked against the two directions.
///
/// # Errors
/// No table, a repeated table, rows that are not two numbers, repeated targets, tables with different targets, or a
/// bidirectional mean that differs from the mean of the two directions.
pub fn parse_pos(bytes: &[u8], name: &str) -> Result<Measurement, MetrologyError> {
    let (text, encoding_note) = decode(bytes, name)?;
    refuse_empty(&text, name, EXPECTED)?;
    let mut in_table = false;
    let text = with_points(&text, name, |line| {
        in_table |= TableKind::of(line.trim()).is_some();
        (in_table && begins_with_number(line)).then_some(0)
    })?;
    let tables = tables(&text, name)?;
    let of = |which: TableKind| tables.iter().find(|table| table.which == which);
    let (both, forward, backward) =
        (of(TableKind::Both), of(TableKind::Forward), of(TableKind::Backward));
    let mut notes: Vec<String> = encoding_note.into_iter().collect();
    notes.push(
        "the file holds means over the runs: single runs, A, R and outliers are not in it".into(),
    );
    let mut readings = Vec::new();
    match (forward, backward, both) {
        (Some(forward), Some(backward), both) => {
            compare(name, forward, backward, both)?;
            readings.extend(forward.readings(Direction::Positive));
            readings.extend(backward.readings(Direction::Negative));
        }
        (Some(forward), None, _) => {
            notes.push("no table of the backward direction: reversal values are not in it".into());
            readings.extend(forward.readings(Direction::Positive));
        }
        (None, _, Some(both)) => {
            notes.push("only the mean of both directions is in the file, and read as one forward run: reversal values are not in it".into());
            readings.extend(both.readings(Direction::Positive));
        }
        (None, Some(backward), None) => readings.extend(backward.readings(Direction::Negative)),
        (None, None, None) => {
            let first = text.lines().next().unwrap_or_default().trim();
            return Err(Place::new(name, 1).wrong_kind(quoted(first), EXPECTED));
        }
    }
    let above = text.lines().take_while(|line| TableKind::of(line.trim()).is_none());
    Ok(Measurement {
        name: name.into(),
        format: Some(FileFormat::ApiPos),
        quantity: Some(Quantity::Positioning),
        unit: Some(DeviationUnit::Um),
        metadata: metadata_of(above),
        readings,
        notes,
        ..Measurement::default()
    })
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum TableKind {
    Both,
    Forward,
    Backward,
}

impl TableKind {
    fn of(line: &str) -> Option<Self> {
        let words =
            line.split_ascii_whitespace().collect::<Vec<_>>().join(" ").to_ascii_lowercase();
        let which = words.strip_prefix("position ")?.strip_suffix(" avg error")?;
        match which {
            "bidirectional" | "bi-directional" => Some(Self::Both),
            "forward directional" | "forward" => Some(Self::Forward),
            "backward directional" | "reverse directional" | "backward" | "reverse" => {
                Some(Self::Backward)
            }
            _ => None,
        }
    }
}

struct Row {
    line: usize,
    target: f64,
    error_mm: f64,
    decimals: i32,
}

struct Table {
    which: TableKind,
    line: usize,
    rows: Vec<Row>,
}

impl Table {
    fn readings(&self, direction: Direction) -> impl Iterator<Item = Reading> + '_ {
        self.rows.iter().map(move |row| Reading {
            target: row.target,
            run: 1,
            direction,
            deviation: row.error_mm * UM_PER_MM,
        })
    }
}

fn tables(text: &str, name: &str) -> Result<Vec<Table>, MetrologyError> {
    let mut tables: Vec<Table> = Vec::new();
    let mut open = false;
    for (index, line) in text.lines().enumerate() {
        let (number, line) = (index + 1, line.trim());
        let place = Place::new(name, number);
        if let Some(which) = TableKind::of(line) {
            if let Some(first) = tables.iter().find(|table| table.which == which) {
                let found = format!("{} again (first in line {})", quoted(line), first.line);
                return Err(place.contradictory("table", found, "each table once"));
            }
            tables.push(Table { which, line: number, rows: Vec::new() });
            open = true;
            continue;
        }
        let Some(table) = tables.last_mut().filter(|_| open) else {
            continue;
        };
        if line.is_empty() {
            continue;
        }
        let cells: Vec<&str> = line.split_ascii_whitespace().collect();
        let is_text = line.starts_with(|c: char| c.is_alphabetic());
        if is_text && !table.rows.is_empty() {
            // The text begins another, unknown part of the file, such as a summary.
            open = false;
            continue;
        }
        let [target, error] = cells[..] else {
            let expected = "two numbers: position and error, mm";
            return Err(place.malformed("row", quoted(line), expected));
        };
        let row = Row {
            line: number,
            target: place.number("position", target)?,
            error_mm: place.number("error", error)?,
            decimals: decimals_of(error),
        };
        if let Some(first) = table.rows.iter().find(|other| other.target == row.target) {
            let found = format!("{} again (first in line {})", quoted(target), first.line);
            return Err(place.contradictory("position", found, "each position once"));
        }
        table.rows.push(row);
    }
    if let Some(empty) = tables.iter().find(|table| table.rows.is_empty()) {
        let place = Place::new(name, empty.line);
        let expected = "rows of position and error under each head (the file may be cut off)";
        return Err(place.truncated("table", "no rows", expected));
    }
    Ok(tables)
}

/// Checks that the tables of a test have the same targets, and that the bidirectional means are the means of both
/// directions.
fn compare(
    name: &str,
    forward: &Table,
    backward: &Table,
    both: Option<&Table>,
) -> Result<(), MetrologyError> {
    let value = |table: &Table, target: f64| {
        let row = table.rows.iter().find(|row| row.target == target);
        row.map(|row| (row.error_mm, row.line, row.decimals))
    };
    for other in [Some(backward), both].into_iter().flatten() {
        if other.rows.len() != forward.rows.len() {
            let place = Place::new(name, other.rows.last().map_or(other.line, |row| row.line));
            return Err(place.contradictory(
                "table",
                format!("{} rows", other.rows.len()),
                format!(
                    "{}, as in the forward table (the file may be cut off)",
                    forward.rows.len()
                ),
            ));
        }
    }
    for row in &forward.rows {
        let place = Place::new(name, row.line);
        let missing = || {
            let expected = "the same positions in every table";
            place.contradictory("position", row.target.to_string(), expected)
        };
        let (back, _, of_back) = value(backward, row.target).ok_or_else(missing)?;
        let Some(both) = both else { continue };
        let (mean, line, of_mean) = value(both, row.target).ok_or_else(missing)?;
        let expected = f64::midpoint(row.error_mm, back);
        // Numbers with exponents have last digits of different size, so take the largest step.
        let rounding = 1.01 * step_of([row.decimals, of_back, of_mean].into_iter());
        if (mean - expected).abs() > rounding {
            let place = Place::new(name, line);
            return Err(place.malformed(
                "mean of both directions",
                mean.to_string(),
                format!("{expected}, the mean of forward and backward at {}", row.target),
            ));
        }
    }
    Ok(())
}

const MM_PER_UM: f64 = 1e-3;

/// Writes the position file of an API laser (`.pos`): tables of targets and mean errors in mm, with CRLF and seven
/// decimals.
///
/// The format has no single runs. It contains the means over the runs of each direction and, if both directions were
/// measured, first the mean of both. Deviations are taken as µm, because the format contains only lengths.
pub fn write_pos(measurement: &Measurement) -> String {
    let [forward, backward] = Direction::BOTH.map(|direction| measurement.mean_curve_in(direction));
    let mut text = head_of(&measurement.metadata);
    let mut table = |name: &str, rows: &[(f64, f64)]| {
        // Writing to a String cannot fail.
        let _ = write!(text, "Position   \t{name} Avg Error\r\n");
        for (target, mean_um) in rows {
            let _ = write!(text, "{target:.4}\t{:.7}\r\n", mean_um * MM_PER_UM);
        }
    };
    if !forward.is_empty() && !backward.is_empty() {
        table("Bidirectional", &measurement.mean_curve());
    }
    for (name, rows) in [("Forward Directional", &forward), ("Backward Directional", &backward)] {
        if !rows.is_empty() {
            table(name, rows);
        }
    }
    text
}
