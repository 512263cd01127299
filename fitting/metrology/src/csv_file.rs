//! The plain table of readings, `target,run,direction,deviation` or `target,deviation`.

use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::fmt::Write as _;

use crate::encoding::{decode, first_line, refuse_empty, wrong_kind};
use crate::number::{Place, decimals, quoted};
use crate::{Direction, Measurement, MetrologyError, Reading};

const FULL: [&str; 4] = ["target", "run", "direction", "deviation"];
const SHORT: [&str; 2] = ["target", "deviation"];
const EXPECTED_HEADER: &str = "the header `target,run,direction,deviation` or `target,deviation`";

/// Reads a table of readings from CSV text.
///
/// The header is `target,run,direction,deviation` (direction `+` or `-`) or `target,deviation`, which is one
/// unidirectional run. Targets are mm or deg, deviations µm or µrad; the file does not say which, so
/// [`Measurement::unit`] is `None`. `name` is used in messages.
///
/// The format has no end mark. A last line without a line break is refused when its number has fewer decimals
/// than every other one (a number cut in two) and noted otherwise; a run that lacks a target, or a direction with
/// fewer runs, is noted.
///
/// # Errors
/// Wrong header or number of columns, anything but finite numbers, repeated readings, an empty file: with file, line,
/// what was found and what was expected.
pub fn parse_csv(bytes: &[u8], name: &str) -> Result<Measurement, MetrologyError> {
    let (text, encoding_note) = decode(bytes, name)?;
    refuse_empty(&text, name, EXPECTED_HEADER)?;
    refuse_renishaw(&text, name)?;
    let mut rows = ::csv::ReaderBuilder::new()
        .has_headers(false)
        .flexible(true)
        .trim(::csv::Trim::All)
        .from_reader(text.as_bytes());
    let mut table = Table::default();
    let mut full = None;
    let mut lines = LineCounter {
        text: text.as_bytes(),
        counted: 0,
        line: 1,
    };
    for record in rows.records() {
        let record = record.map_err(|e| unreadable_record(name, &e))?;
        if record.len() == 1 && record[0].is_empty() {
            continue;
        }
        let line = lines.line_of(&record);
        let place = Place { file: name, line };
        match full {
            None => full = Some(header_is_full(place, &record)?),
            Some(full) => table.add(place, &record, full)?,
        }
    }
    if table.readings.is_empty() {
        return Err(MetrologyError::Empty {
            file: name.into(),
            expected: "at least one reading under the header".into(),
        });
    }
    let mut notes: Vec<String> = encoding_note.into_iter().collect();
    notes.extend(table.end_of_file(&text, name)?);
    notes.extend(incomplete_runs(&table.readings));
    notes.extend(zero_direction(&table.readings));
    Ok(Measurement {
        name: name.into(),
        readings: table.readings,
        notes,
        ..Measurement::default()
    })
}

/// Writes the readings as `target,run,direction,deviation`, in their order, with as many digits as it takes to
/// read the very same numbers again. Unit, metadata, environment and notes have no place in the format.
pub fn write_csv(measurement: &Measurement) -> String {
    let mut text = FULL.join(",") + "\n";
    for Reading {
        target,
        run,
        direction,
        deviation,
    } in &measurement.readings
    {
        // Writing to a String cannot fail.
        let _ = writeln!(text, "{target},{run},{direction},{deviation}");
    }
    text
}

/// Line numbers of records; the position of a record may stand before the blank lines above it.
struct LineCounter<'t> {
    text: &'t [u8],
    counted: usize,
    line: usize,
}

impl LineCounter<'_> {
    fn line_of(&mut self, record: &::csv::StringRecord) -> usize {
        let start = record
            .position()
            .and_then(|p| usize::try_from(p.byte()).ok())
            .unwrap_or(0);
        let rest = self.text.get(start..).unwrap_or_default();
        let record_start = start + rest.iter().take_while(|b| b.is_ascii_whitespace()).count();
        let passed = self
            .text
            .get(self.counted..record_start)
            .unwrap_or_default();
        self.line += passed.split(|b| *b == b'\n').count() - 1;
        self.counted = record_start;
        self.line
    }
}

#[derive(Default)]
struct Table {
    readings: Vec<Reading>,
    deviation_texts: Vec<String>,
    lines: HashMap<(u32, Direction, u64), usize>,
}

impl Table {
    fn add(
        &mut self,
        place: Place<'_>,
        record: &::csv::StringRecord,
        full: bool,
    ) -> Result<(), MetrologyError> {
        let columns = if full { FULL.len() } else { SHORT.len() };
        if record.len() != columns {
            let found = format!(
                "{} in {}",
                counted(record.len(), "column"),
                quoted(&joined(record))
            );
            return Err(MetrologyError::Structure(place.finding(
                "row",
                found,
                counted(columns, "column"),
            )));
        }
        let target = place.number("target", &record[0])?;
        let deviation = place.number("deviation", &record[columns - 1])?;
        let (run, direction) = if full {
            (
                place.count("run", &record[1])?,
                direction_of(place, &record[2])?,
            )
        } else {
            (1, Direction::Positive)
        };
        if let Some(first) = self
            .lines
            .insert((run, direction, target.to_bits()), place.line)
        {
            let found =
                format!("target {target} in run {run} {direction} again (first in line {first})");
            return Err(MetrologyError::Repeated(place.finding(
                "reading",
                found,
                "each target once in a run",
            )));
        }
        self.readings.push(Reading {
            target,
            run,
            direction,
            deviation,
        });
        self.deviation_texts.push(record[columns - 1].to_owned());
        Ok(())
    }

    fn end_of_file(&self, text: &str, name: &str) -> Result<Option<String>, MetrologyError> {
        const ENOUGH_TO_COMPARE: usize = 4;
        if text.ends_with(['\n', '\r']) {
            return Ok(None);
        }
        let Some((last, others)) = self.deviation_texts.split_last() else {
            return Ok(None);
        };
        let fewest = others.iter().map(|t| decimals(t)).min().unwrap_or(0);
        if others.len() >= ENOUGH_TO_COMPARE && decimals(last) < fewest {
            let line = text.lines().count();
            let found = format!("{} and no line break after it", quoted(last));
            let expected = format!(
                "{fewest} decimals as in every other row: the file seems cut in the middle of a number"
            );
            return Err(MetrologyError::Truncated(
                Place { file: name, line }.finding("last deviation", found, expected),
            ));
        }
        Ok(Some(
            "the last line does not end in a line break: the file may be cut off".into(),
        ))
    }
}

fn refuse_renishaw(text: &str, name: &str) -> Result<(), MetrologyError> {
    match first_line(text) {
        Some((line, first)) if first.ends_with("::") => Err(MetrologyError::Kind(wrong_kind(
            name,
            line,
            quoted(first),
            EXPECTED_HEADER,
        ))),
        _ => Ok(()),
    }
}

fn unreadable_record(name: &str, error: &::csv::Error) -> MetrologyError {
    let line = error
        .position()
        .map_or(1, |p| usize::try_from(p.line()).unwrap_or(usize::MAX));
    MetrologyError::Structure(Place { file: name, line }.finding(
        "row",
        error.to_string(),
        "comma-separated values",
    ))
}

fn header_is_full(place: Place<'_>, record: &::csv::StringRecord) -> Result<bool, MetrologyError> {
    let is = |names: &[&str]| {
        record.len() == names.len()
            && record
                .iter()
                .zip(names)
                .all(|(found, name)| found.eq_ignore_ascii_case(name))
    };
    if is(&FULL) {
        Ok(true)
    } else if is(&SHORT) {
        Ok(false)
    } else {
        Err(MetrologyError::Structure(place.finding(
            "header",
            quoted(&joined(record)),
            EXPECTED_HEADER,
        )))
    }
}

fn direction_of(place: Place<'_>, text: &str) -> Result<Direction, MetrologyError> {
    match text {
        "+" => Ok(Direction::Positive),
        "-" => Ok(Direction::Negative),
        _ => Err(MetrologyError::Structure(place.finding(
            "direction",
            quoted(text),
            "`+` or `-`",
        ))),
    }
}

fn joined(record: &::csv::StringRecord) -> String {
    record.iter().collect::<Vec<_>>().join(",")
}

fn counted(n: usize, noun: &str) -> String {
    format!("{n} {noun}{}", if n == 1 { "" } else { "s" })
}

fn incomplete_runs(readings: &[Reading]) -> Vec<String> {
    let mut targets_of_run: BTreeMap<(Direction, u32), usize> = BTreeMap::new();
    let mut all: BTreeSet<u64> = BTreeSet::new();
    for reading in readings {
        *targets_of_run
            .entry((reading.direction, reading.run))
            .or_default() += 1;
        all.insert(reading.target.to_bits());
    }
    let lacking = targets_of_run.iter().filter(|(_, n)| **n < all.len());
    let mut notes: Vec<String> = lacking
        .map(|((d, run), n)| format!("run {run} {d} holds {n} of {} targets", all.len()))
        .collect();
    let runs = |direction| {
        targets_of_run
            .keys()
            .filter(|(d, _)| *d == direction)
            .count()
    };
    let [forward, backward] = Direction::BOTH.map(runs);
    if forward > 0 && backward > 0 && forward != backward {
        notes.push(format!(
            "{} forward, {backward} backward",
            counted(forward, "run")
        ));
    }
    notes
}

fn zero_direction(readings: &[Reading]) -> Option<String> {
    let in_direction = |direction| readings.iter().filter(move |r| r.direction == direction);
    let all_zero = |direction| in_direction(direction).all(|r| r.deviation == 0.0);
    let suspicious = in_direction(Direction::Negative).count() > 1
        && all_zero(Direction::Negative)
        && !all_zero(Direction::Positive);
    suspicious.then(|| "every backward reading is exactly 0: if the test was unidirectional, leave those rows out".into())
}
