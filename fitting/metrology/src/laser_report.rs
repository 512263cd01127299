//! Text reports of laser interferometers.
//!
//! HP, Agilent and Keysight 5529/5530 reports have statistics of each target. API `.pos` files have mean errors over
//! the runs, in mm.

use std::fmt::Write as _;

use volcomp_document::quoted;

use crate::positioning::approach;
use crate::text::{Place, begins_with_number, decode, refuse_empty, with_points};
use crate::{
    DeviationUnit, Direction, FileFormat, Measurement, Metadata, MetrologyError, Quantity, Reading,
    ReadingUnit,
};

/// Maximum number of decimals that is considered, because sums of such numbers lose finer digits.
const MOST_DECIMALS: i32 = 12;

/// Decimal place of the last digit of a number: 3 for `1.250`, 4 for `2.0E-03`, −2 for `1.2E+03`. For a zero with an
/// exponent the place is unknown, and the maximum is returned.
fn decimals_of(text: &str) -> i32 {
    let (mantissa, exponent) = match text.split_once(['e', 'E']) {
        Some((mantissa, exponent)) => (mantissa, Some(exponent)),
        None => (text, None),
    };
    let is_zero = !mantissa.contains(|c: char| ('1'..='9').contains(&c));
    if exponent.is_some() && is_zero {
        return MOST_DECIMALS;
    }
    let behind = i32::try_from(crate::text::decimals(mantissa)).unwrap_or(MOST_DECIMALS);
    // A number with an exponent that cannot be parsed is invalid anyway.
    let exponent = exponent.map_or(0, |text| text.parse().unwrap_or(0));
    behind.saturating_sub(exponent).min(MOST_DECIMALS)
}

/// Size of the last digit of the coarsest number. `decimals` are the decimal places of the numbers.
fn step_of(decimals: impl Iterator<Item = i32>) -> f64 {
    10_f64.powi(-decimals.min().unwrap_or(0))
}

/// Writes the lines that `metadata_of` reads, for the known values, with CRLF. Line breaks in texts become blanks.
fn head_of(metadata: &Metadata) -> String {
    let texts = [
        ("Machine", &metadata.machine),
        ("Serial No", &metadata.serial),
        ("Date", &metadata.date),
        ("By", &metadata.by),
        ("Axis", &metadata.axis),
        ("Location", &metadata.location),
        ("Title", &metadata.title),
    ];
    let mut head = String::new();
    for (key, text) in texts {
        if let Some(text) = text {
            // Writing to a String cannot fail.
            let _ = write!(head, "{key}: {}\r\n", text.replace(char::is_control, " "));
        }
    }
    head
}

/// Reads lines `key: value` whose keys have the same meaning in every report. Other lines are skipped.
fn metadata_of<'t>(lines: impl Iterator<Item = &'t str>) -> Metadata {
    let mut metadata = Metadata::default();
    for line in lines {
        let Some((key, value)) = line.split_once(':') else {
            continue;
        };
        let value = value.trim();
        let field = match key.trim().to_ascii_lowercase().as_str() {
            "machine" => &mut metadata.machine,
            "serial no" | "serial number" => &mut metadata.serial,
            "date" => &mut metadata.date,
            "by" | "operator" => &mut metadata.by,
            "axis" => &mut metadata.axis,
            "location" => &mut metadata.location,
            "title" => &mut metadata.title,
            _ => continue,
        };
        if !value.is_empty() && field.is_none() {
            *field = Some(value.to_owned());
        }
    }
    metadata
}

const KEYSIGHT_EXPECTED: &str = "a report with rows of target, forward, reverse and system mean, 2σ forward, 2σ reverse and dead zone";
const COLUMNS: usize = 7;

pub(crate) fn is_report(text: &str) -> bool {
    let lower = text.to_ascii_lowercase();
    lower.contains("dead zone") && ["forward", "reverse"].iter().all(|word| lower.contains(word))
}

/// Reads a text report of a HP, Agilent or Keysight 5529 or 5530 laser.
///
/// The columns, after an optional row number, are: target; mean forward, mean reverse and mean of both (system); 2σ
/// forward and 2σ reverse; dead zone. This is the order of one published report, so it is checked in each row: the
/// system mean must be the mean of both, and the dead zone must be reverse minus forward. Errors are laser reading
/// minus machine reading. Their unit is the only length or angle unit in brackets in the column heads. Without such a
/// unit, [`Measurement::unit`] is `None`.
///
/// A report has no single readings. So the forward means and the reverse means become one run each, and a note names
/// the quantities that cannot be derived from them.
///
/// # Errors
///
/// No rows of this kind, inconsistent rows, several units, or a repeated target.
pub fn parse_keysight_report(bytes: &[u8], name: &str) -> Result<Measurement, MetrologyError> {
    let (text, encoding_note) = decode(bytes, name)?;
    refuse_empty(&text, name, KEYSIGHT_EXPECTED)?;
    if !is_report(&text) {
        let first = text.lines().next().unwrap_or_default().trim();
        return Err(Place::new(name, 1).wrong_kind(quoted(first), KEYSIGHT_EXPECTED));
    }
    let text = with_points(&text, name, |line| begins_with_number(line).then_some(0))?;
    let rows = rows(&text, name)?;
    let unit = unit(&text, name)?;
    let scale = unit.map_or(1.0, ReadingUnit::micro);
    let readings_of = |direction, mean: fn(&KeysightRow) -> f64| {
        rows.iter().map(move |row| Reading {
            target: row.target,
            run: 1,
            direction,
            deviation: mean(row) * scale,
        })
    };
    let readings = readings_of(Direction::Positive, |row| row.forward)
        .chain(readings_of(Direction::Negative, |row| row.reverse))
        .collect();
    let widest = rows.iter().map(|row| row.two_sigma).fold(0.0, f64::max);
    let symbol = unit.map_or(String::new(), |unit| format!(" {unit}"));
    let mut notes: Vec<String> = encoding_note.into_iter().collect();
    notes.push(format!(
        "a report of statistics: it holds means of each target, read as one run in each direction, and its 2σ of up to {widest}{symbol}; single runs, how many there were, A and R by ISO 230-2 and outliers are not in it"
    ));
    Ok(Measurement {
        name: name.into(),
        format: Some(FileFormat::KeysightReport),
        unit: unit.map(ReadingUnit::deviation_unit),
        stated: unit,
        metadata: metadata_of(text.lines()),
        readings,
        notes,
        ..Measurement::default()
    })
}

struct KeysightRow {
    line: usize,
    target: f64,
    forward: f64,
    reverse: f64,
    two_sigma: f64,
}

fn rows(text: &str, name: &str) -> Result<Vec<KeysightRow>, MetrologyError> {
    let mut rows: Vec<KeysightRow> = Vec::new();
    for (index, line) in text.lines().enumerate() {
        let place = Place::new(name, index + 1);
        let cells: Vec<&str> = line.split_ascii_whitespace().collect();
        let Some(first) = cells.first() else { continue };
        if place.number("row", first).is_err() {
            continue;
        }
        if cells.len() < 3 {
            if rows.is_empty() {
                // The number is in a line above the rows.
                continue;
            }
            let expected = format!("{COLUMNS} numbers: the file may be cut off");
            return Err(place.truncated("row", quoted(line.trim()), expected));
        }
        let cells = match cells.len() {
            COLUMNS => &cells[..],
            // The row begins with its number.
            n if n == COLUMNS + 1 && *first == (rows.len() + 1).to_string() => &cells[1..],
            n => {
                let expected = format!("{COLUMNS} numbers: {KEYSIGHT_EXPECTED}");
                return Err(place.malformed(
                    "row",
                    format!("{n} in {}", quoted(line.trim())),
                    expected,
                ));
            }
        };
        let row = row(place, cells)?;
        if let Some(first) = rows.iter().find(|other| other.target == row.target) {
            let found = format!("{} again (first in line {})", row.target, first.line);
            return Err(place.contradictory("target", found, "each target once"));
        }
        rows.push(row);
    }
    if rows.is_empty() {
        return Err(MetrologyError::Empty {
            file: name.into(),
            expected: KEYSIGHT_EXPECTED.into(),
        });
    }
    Ok(rows)
}

fn row(place: Place<'_>, cells: &[&str]) -> Result<KeysightRow, MetrologyError> {
    let mut values = [0.0; COLUMNS];
    for (value, cell) in values.iter_mut().zip(cells) {
        *value = place.number("row", cell)?;
    }
    let [target, forward, reverse, system, two_sigma_forward, two_sigma_reverse, dead_zone] =
        values;
    // Each of the three numbers is rounded separately.
    let rounding = 2.01 * step_of(cells[1..].iter().map(|cell| decimals_of(cell)));
    let check = |what: &str, found: f64, expected: f64, why: &str| {
        if (found - expected).abs() <= rounding {
            return Ok(());
        }
        let expected = format!("{}, {why}", (expected * 1e9).round() / 1e9);
        Err(place.malformed(what, found.to_string(), expected))
    };
    let mean = f64::midpoint(forward, reverse);
    check(
        "system mean",
        system,
        mean,
        "the mean of forward and reverse: are the columns in another order?",
    )?;
    check(
        "dead zone",
        dead_zone,
        reverse - forward,
        "reverse minus forward: are the columns in another order?",
    )?;
    let two_sigma = two_sigma_forward.max(two_sigma_reverse);
    if two_sigma_forward.min(two_sigma_reverse) < 0.0 {
        return Err(place.not_a_number("2σ", "a negative number", "0 or more"));
    }
    Ok(KeysightRow { line: place.line, target, forward, reverse, two_sigma })
}

/// Unit in brackets in the heads about means, errors, the dead zone or sigma; `None` without brackets. Errors:
/// different units.
fn unit(text: &str, name: &str) -> Result<Option<ReadingUnit>, MetrologyError> {
    let mut found: Option<ReadingUnit> = None;
    for (index, line) in text.lines().enumerate() {
        let lower = line.to_lowercase();
        if !["mean", "error", "dead zone", "sigma"].iter().any(|word| lower.contains(word)) {
            continue;
        }
        let place = Place::new(name, index + 1);
        for word in bracketed(&lower) {
            let unit = match word {
                "microns" | "micron" | "micrometers" | "micrometres" => Some(ReadingUnit::Um),
                "arc-sec" | "arc sec" | "arcseconds" => Some(ReadingUnit::Arcsec),
                word => ReadingUnit::named(word),
            };
            match (unit, found) {
                (None, _) => {}
                (Some(ReadingUnit::Inch), _) => {
                    return Err(place.malformed(
                        "unit",
                        "inches".to_owned(),
                        "a report in micrometres or millimetres: one in inches does not say whether its targets are inches, too",
                    ));
                }
                (Some(unit), Some(before)) if unit != before => {
                    return Err(place.malformed(
                        "unit",
                        format!("{unit} and {before}"),
                        "one unit for all means and sigmas",
                    ));
                }
                (Some(unit), _) => found = Some(unit),
            }
        }
    }
    Ok(found)
}

fn bracketed(line: &str) -> impl Iterator<Item = &str> {
    let inner = line.split(['(', '[']).skip(1);
    inner.filter_map(|part| part.split([')', ']']).next()).map(str::trim)
}

/// Number of decimals of targets, and of means and scatter in µm or µrad.
const DECIMALS: usize = 4;

/// Writes a text report in the order of the one published report of a 5529 laser: number, target, mean forward, mean
/// reverse, mean of both, twice the standard deviation forward and reverse, dead zone (reverse minus forward). Lines
/// end with CRLF, numbers have four decimals, and the heads contain the unit in brackets.
///
/// The report has no single runs. Targets that were approached from one side only have no dead zone and are omitted. If
/// this omits all targets, [`parse_keysight_report`](crate::parse_keysight_report) rejects the text. The standard
/// deviation of a single run is written as 0.
pub fn write_keysight_report(measurement: &Measurement) -> String {
    let unit = match measurement.unit {
        Some(DeviationUnit::Urad) => "urad",
        _ => "microns",
    };
    let mut text = head_of(&measurement.metadata);
    // Writing to a String cannot fail.
    let _ = write!(
        text,
        "Error = Laser Reading (Reference) - Machine Reading (Command)\r\n\
         No.  Position   Forward mean   Reverse mean   System mean   2 sigma forward   2 sigma reverse   Dead zone ({unit})\r\n"
    );
    let readings = measurement.by_target();
    let both = readings.iter().filter_map(|at| {
        let [forward, reverse] = Direction::BOTH.map(|direction| at.deviations(direction));
        Some((at.target, scatter(&forward)?, scatter(&reverse)?))
    });
    for (index, (target, [forward, forward_2s], [reverse, reverse_2s])) in both.enumerate() {
        let system = f64::midpoint(forward, reverse);
        let _ = write!(text, "{:>3} {target:>12.DECIMALS$}", index + 1);
        for value in [forward, reverse, system, forward_2s, reverse_2s, reverse - forward] {
            let _ = write!(text, " {value:>14.DECIMALS$}");
        }
        text.push_str("\r\n");
    }
    text
}

/// Mean, and twice the standard deviation; `None` without readings.
fn scatter(deviations: &[f64]) -> Option<[f64; 2]> {
    approach(deviations).map(|found| [found.mean, 2.0 * found.s.unwrap_or(0.0)])
}

const POS_EXPECTED: &str = "a table headed `Position   Bidirectional Avg Error`";
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
    refuse_empty(&text, name, POS_EXPECTED)?;
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
            return Err(Place::new(name, 1).wrong_kind(quoted(first), POS_EXPECTED));
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

struct PosRow {
    line: usize,
    target: f64,
    error_mm: f64,
    decimals: i32,
}

struct Table {
    which: TableKind,
    line: usize,
    rows: Vec<PosRow>,
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
        let row = PosRow {
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_exponent_moves_the_last_digit() {
        for (text, decimals) in [
            ("1.250", 3),
            ("-7", 0),
            ("0.00", 2),
            ("2.0E-03", 4),
            ("2.0e-3", 4),
            ("-1.25E+01", 1),
            ("1.2E+03", -2),
            ("0.0E+00", MOST_DECIMALS),
            ("1E-99999999999", 0),
            ("1E-2147483648", MOST_DECIMALS),
            ("0.12345678901234567", MOST_DECIMALS),
        ] {
            assert_eq!(decimals_of(text), decimals, "{text}");
        }
    }
}
