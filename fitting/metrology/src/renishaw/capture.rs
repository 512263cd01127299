//! Two further Renishaw files: dynamic captures `.rtx`, and exports of compensation values `.REN`.
//!
//! A capture has an ASCII header, followed by the samples as little-endian f64.

use std::collections::HashMap;

use volcomp_document::quoted;

use super::key_value;
use crate::text::{Place, decode, refuse_empty, with_points};
use crate::{Direction, FileFormat, Measurement, Metadata, MetrologyError, Reading};

const DATA: &[u8] = b"Data:";
const END: &[u8] = b"EOF::";

/// Dynamic capture: samples over time, without targets. The file does not state the unit of the samples.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Capture {
    /// Name of the source file, for messages.
    pub name: String,
    pub metadata: Metadata,
    /// Sample rate from the header, Hz. If the header has a nominal and an actual rate, the actual rate.
    pub sample_rate_hz: Option<f64>,
    /// Samples in the order of time, in the unit of the program that captured them.
    pub samples: Vec<f64>,
    /// Notes for the user on how the file was read.
    pub notes: Vec<String>,
}

impl Capture {
    /// Duration of the capture, s; `None` without a sample rate.
    pub fn duration_s(&self) -> Option<f64> {
        let intervals = self.samples.len().saturating_sub(1) as f64;
        self.sample_rate_hz.map(|rate| intervals / rate)
    }
}

/// Reads a Renishaw dynamic capture (`.rtx`).
///
/// # Errors
/// No `Data:` line, no `EOF::` after the samples, another number of samples than `Sample no` states, bytes that are not
/// a whole number of samples, or a sample that is not finite.
pub fn parse_rtx(bytes: &[u8], name: &str) -> Result<Capture, MetrologyError> {
    let Some((head, data, data_line)) = split(bytes) else {
        let end = bytes.len().min(400);
        let (text, _) = decode(&bytes[..end], name)?;
        let first = text.lines().next().unwrap_or_default();
        let expected = "`HEADER::`, its keys, and a line `Data:` before the samples";
        return Err(Place::new(name, 1).wrong_kind(quoted(first), expected));
    };
    let (text, encoding_note) = decode(head, name)?;
    let header = Header::of(&text, name)?;
    let place = Place::new(name, data_line);
    let body = without_end(data, header.count).ok_or_else(|| {
        let found = format!("{} bytes and no `EOF::` where it should stand", data.len());
        let expected = match header.count {
            Some(count) => format!("{count} samples of 8 bytes, then `EOF::`"),
            None => "samples of 8 bytes, then `EOF::`".to_owned(),
        };
        place.truncated("Data", found, expected)
    })?;
    let (chunks, _) = body.as_chunks::<8>();
    let samples: Vec<f64> = chunks.iter().map(|chunk| f64::from_le_bytes(*chunk)).collect();
    if samples.is_empty() {
        return Err(MetrologyError::Empty {
            file: name.into(),
            expected: "at least one sample behind `Data:`".into(),
        });
    }
    if let Some(bad) = samples.iter().position(|sample| !sample.is_finite()) {
        let found = format!("{} as sample {}", samples[bad], bad + 1);
        return Err(place.not_a_number("Data", found, "finite numbers"));
    }
    let mut notes: Vec<String> = encoding_note.into_iter().collect();
    notes.push("the file does not state the unit of its samples, and has no targets".into());
    Ok(Capture {
        name: name.into(),
        metadata: header.metadata,
        sample_rate_hz: header.rate_hz,
        samples,
        notes,
    })
}

/// Splits a file into the header, the bytes after the line `Data:`, and the number of that line.
fn split(bytes: &[u8]) -> Option<(&[u8], &[u8], usize)> {
    let mut start = 0;
    let mut number = 0;
    while let Some(length) = bytes.get(start..)?.iter().position(|byte| *byte == b'\n') {
        number += 1;
        let line = &bytes[start..start + length];
        let next = start + length + 1;
        if line.trim_ascii() == DATA {
            return Some((&bytes[..start], &bytes[next..], number));
        }
        start = next;
    }
    None
}

/// Samples without the end mark. The mark is at the position that follows from the stated number of samples. Without
/// this number it is the last mark in the file.
fn without_end(data: &[u8], count: Option<usize>) -> Option<&[u8]> {
    let is_end = |rest: &[u8]| rest.trim_ascii() == END;
    if let Some(count) = count {
        let length = count.checked_mul(8)?;
        let rest = data.get(length..)?;
        return is_end(rest).then(|| &data[..length]);
    }
    // Samples may contain any bytes, including blanks. So the mark must follow a whole number of samples.
    let mark = data.windows(END.len()).rposition(|window| window == END)?;
    let is_blank = |end: &usize| data[*end..mark].iter().all(u8::is_ascii_whitespace);
    let end = (mark.saturating_sub(2)..=mark).rev().find(|end| end % 8 == 0 && is_blank(end))?;
    is_end(&data[mark..]).then(|| &data[..end])
}

struct Header {
    metadata: Metadata,
    rate_hz: Option<f64>,
    count: Option<usize>,
}

impl Header {
    fn of(text: &str, file: &str) -> Result<Self, MetrologyError> {
        let mut header = Self { metadata: Metadata::default(), rate_hz: None, count: None };
        let mut has_actual = false;
        for (index, line) in text.lines().enumerate() {
            let place = Place::new(file, index + 1);
            let Some((key, value)) = key_value(line).filter(|(_, value)| !value.is_empty()) else {
                continue;
            };
            let meta = &mut header.metadata;
            let field = match key.as_str() {
                "filetype" => &mut meta.format,
                "owner" => &mut meta.owner,
                "versionno" => &mut meta.version,
                "machine" => &mut meta.machine,
                "serialno" => &mut meta.serial,
                "date" => &mut meta.date,
                "by" => &mut meta.by,
                "axis" => &mut meta.axis,
                "location" => &mut meta.location,
                "title" => &mut meta.title,
                "sampleno" => {
                    header.count = Some(place.count("Sample no", value)? as usize);
                    continue;
                }
                "samplerate" | "actualsamplerate" => {
                    let is_actual = key == "actualsamplerate";
                    if is_actual || !has_actual {
                        header.rate_hz = Some(rate(place, value)?);
                    }
                    has_actual |= is_actual;
                    continue;
                }
                _ => continue,
            };
            *field = Some(value.to_owned());
        }
        Ok(header)
    }
}

/// Parses a rate, Hz. A unit may follow the number.
fn rate(place: Place<'_>, value: &str) -> Result<f64, MetrologyError> {
    let number = value.split_ascii_whitespace().next().unwrap_or_default();
    let rate = place.number("Sample rate", number)?;
    if rate > 0.0 {
        return Ok(rate);
    }
    Err(place.not_a_number("Sample rate", quoted(value), "a rate above 0 Hz"))
}

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
