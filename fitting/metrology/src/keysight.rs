//! Text reports of HP, Agilent and Keysight 5529/5530 lasers, which have statistics of each target.

use std::fmt::Write as _;

use volcomp_document::quoted;

use crate::decimal_comma::{begins_with_number, with_points};
use crate::encoding::{decode, refuse_empty};
use crate::iso230_2::approach;
use crate::number::Place;
use crate::text_report::{decimals_of, head_of, metadata_of, step_of};
use crate::{
    DeviationUnit, Direction, FileFormat, Measurement, MetrologyError, Reading, ReadingUnit,
};

const EXPECTED: &str = "a report with rows of target, forward, reverse and system mean, 2σ forward, 2σ reverse and dead zone";
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
    refuse_empty(&text, name, EXPECTED)?;
    if !is_report(&text) {
        let first = text.lines().next().unwrap_or_default().trim();
        return Err(Place::new(name, 1).wrong_kind(quoted(first), EXPECTED));
    }
    let text = with_points(&text, name, |line| begins_with_number(line).then_some(0))?;
    let rows = rows(&text, name)?;
    let unit = unit(&text, name)?;
    let scale = unit.map_or(1.0, ReadingUnit::micro);
    let readings_of = |direction, mean: fn(&Row) -> f64| {
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

struct Row {
    line: usize,
    target: f64,
    forward: f64,
    reverse: f64,
    two_sigma: f64,
}

fn rows(text: &str, name: &str) -> Result<Vec<Row>, MetrologyError> {
    let mut rows: Vec<Row> = Vec::new();
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
                let expected = format!("{COLUMNS} numbers: {EXPECTED}");
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
        return Err(MetrologyError::Empty { file: name.into(), expected: EXPECTED.into() });
    }
    Ok(rows)
}

fn row(place: Place<'_>, cells: &[&str]) -> Result<Row, MetrologyError> {
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
    Ok(Row { line: place.line, target, forward, reverse, two_sigma })
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
