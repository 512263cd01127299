//! Exports of compensation values, `.REN`.

use std::collections::HashMap;

use volcomp_document::quoted;

use crate::decimal_comma::with_points;
use crate::encoding::{decode, refuse_empty};
use crate::number::Place;
use crate::{Direction, FileFormat, Measurement, MetrologyError, Reading};

const EXPECTED: &str =
    "`Compensation start`, `end` and `spacing`, then rows of number, axis position and value";

/// Reads an export of compensation values (`.REN`). The file has the lines `Compensation start | end | spacing
/// <number>` and, below the head `No.  Axis position  Combined`, rows of number, axis position and combined value.
///
/// The values are for a control. The file states neither their sign (deviations or corrections) nor their unit. So
/// [`Measurement::unit`] is `None`, with a note.
///
/// # Errors
/// No head, no rows, rows that are not numbers or not numbered from 1 (or 0) on, positions that are not `spacing`
/// apart, or positions that do not end at the stated end.
pub fn parse_ren(bytes: &[u8], name: &str) -> Result<Measurement, MetrologyError> {
    let (text, encoding_note) = decode(bytes, name)?;
    refuse_empty(&text, name, EXPECTED)?;
    let mut in_table = false;
    let text = with_points(&text, name, |line| {
        in_table |= is_head(line.trim());
        let states_grid = || line.trim().to_ascii_lowercase().starts_with("compensation ");
        (in_table || states_grid()).then_some(0)
    })?;
    let mut grid = Grid::default();
    let mut lines = text.lines().enumerate().map(|(index, line)| (index + 1, line.trim()));
    let mut head = None;
    for (number, line) in lines.by_ref() {
        let place = Place::new(name, number);
        grid.read(place, line)?;
        if is_head(line) {
            head = Some(number);
            break;
        }
    }
    let Some(head) = head else {
        let first = text.lines().next().unwrap_or_default().trim();
        return Err(Place::new(name, 1).wrong_kind(quoted(first), EXPECTED));
    };
    let mut readings: Vec<Reading> = Vec::new();
    let mut line_of = HashMap::new();
    for (line, row) in lines {
        let place = Place::new(name, line);
        let cells: Vec<&str> = row.split_ascii_whitespace().collect();
        let starts_with_number = cells.first().is_some_and(|cell| cell.parse::<u32>().is_ok());
        if !starts_with_number {
            // The table ends at the first line that does not begin with a number.
            if cells.is_empty() && readings.is_empty() {
                continue;
            }
            break;
        }
        let [_, target, value, ..] = cells[..] else {
            return Err(place.malformed(
                "row",
                quoted(row),
                "three columns: number, axis position, value",
            ));
        };
        let target = place.number("axis position", target)?;
        if let Some(last) = readings.last() {
            grid.step(place, last.target, target)?;
        }
        if let Some(first) = line_of.insert(target.to_bits(), line) {
            return Err(place.contradictory(
                "axis position",
                format!("{target} again (first in line {first})"),
                "each position once",
            ));
        }
        readings.push(Reading {
            target,
            run: 1,
            direction: Direction::Positive,
            deviation: place.number("value", value)?,
        });
    }
    if readings.is_empty() {
        return Err(MetrologyError::Empty {
            file: name.into(),
            expected: "at least one row under `No.  Axis position  Combined`".into(),
        });
    }
    grid.ends(Place::new(name, head), &readings)?;
    let mut notes: Vec<String> = encoding_note.into_iter().collect();
    notes.push("these are compensation values for a control, not readings: neither sign nor unit is stated, and there are no single runs".into());
    Ok(Measurement {
        name: name.into(),
        format: Some(FileFormat::RenishawExport),
        readings,
        notes,
        ..Measurement::default()
    })
}

fn is_head(line: &str) -> bool {
    let line = line.to_ascii_lowercase();
    line.starts_with("no.") && line.contains("axis position")
}

/// Start, end and spacing of the positions, from the lines above the table, mm.
#[derive(Default)]
struct Grid {
    start: Option<f64>,
    end: Option<f64>,
    spacing: Option<f64>,
}

/// Rounding error of positions, mm. Positions are written with few decimals.
const ROUNDING: f64 = 1e-3;

impl Grid {
    fn read(&mut self, place: Place<'_>, line: &str) -> Result<(), MetrologyError> {
        let lower = line.to_ascii_lowercase();
        let fields = [
            ("compensation start", &mut self.start),
            ("compensation end", &mut self.end),
            ("compensation spacing", &mut self.spacing),
        ];
        for (key, field) in fields {
            let Some(rest) = lower.strip_prefix(key) else {
                continue;
            };
            let number = rest.trim_start_matches([' ', '\t', ':', '=']);
            let number = number.split_ascii_whitespace().next().unwrap_or_default();
            *field = Some(place.number(key, number)?);
        }
        Ok(())
    }

    fn step(&self, place: Place<'_>, from: f64, to: f64) -> Result<(), MetrologyError> {
        let Some(spacing) = self.spacing else {
            return Ok(());
        };
        if ((to - from).abs() - spacing.abs()).abs() <= ROUNDING {
            return Ok(());
        }
        Err(place.malformed(
            "axis position",
            format!("{to} after {from}"),
            format!("positions {spacing} apart, the spacing that the file states"),
        ))
    }

    fn ends(&self, place: Place<'_>, readings: &[Reading]) -> Result<(), MetrologyError> {
        let (Some(start), Some(end), [first, .., last]) = (self.start, self.end, readings) else {
            return Ok(());
        };
        let sorted = |a: f64, b: f64| [a.min(b), a.max(b)];
        let [low, high] = sorted(start, end);
        let [found_low, found_high] = sorted(first.target, last.target);
        // The distance from start to end need not be a whole number of spacings.
        let slack = self.spacing.map_or(ROUNDING, |s| s.abs() + ROUNDING);
        if (found_low - low).abs() <= slack && (found_high - high).abs() <= slack {
            return Ok(());
        }
        Err(place.contradictory(
            "rows",
            format!("positions from {} to {}", first.target, last.target),
            format!("{start} to {end}, as the file states (it may be cut off)"),
        ))
    }
}
