//! Plain tables of readings with the header `target,run,direction,deviation` or `target,deviation`.

use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::fmt::Write as _;

use volcomp_document::{Column, CsvRow, CsvTable, quoted};
use volcomp_vocabulary::{AxisKind, AxisName};

use crate::csv_head::{
    direction_named, heads, inches_without_targets, not_read, unit_of, with_unit,
};
use crate::encoding::{decode, first_line, refuse_empty};
use crate::number::{Place, decimals};
use crate::runs::alignment_notes;
use crate::test_plan::counted;
use crate::wide_table::{Targets, WideReading, WideTable};
use crate::{
    DeviationUnit, Direction, FileFormat, Measurement, MetrologyError, Reading, ReadingUnit,
    TargetUnit,
};

const NAMES: [&str; 4] = ["target", "run", "direction", "deviation"];
const EXPECTED_HEADER: &str = "the header `target,run,direction,deviation` or `target,deviation`";
const OTHER_HEADS: &str = "the header `target,run,direction,deviation` or `target,deviation`, or a column for each run as `target mm,Run 1 fwd,Run 1 bwd`; state other heads with `columns = { target = …, deviation = … }` in the calibration file or as `[columns]` in a file of this name with `.toml` appended";

/// Reads a table of readings from CSV text. `name` is the name of the file in messages.
///
/// The header has the columns `target` and `deviation`. It may have `run` and `direction` (`+` or `-`, `forward` or
/// `backward`) too; without both, the rows are one unidirectional run.
///
/// Or the header has `target` and a column for each run. The head of such a column states the number and direction of
/// the run (`Run 1 fwd`). Its cells are deviations or measured positions, as the heads say, or else by their unit and
/// values.
///
/// Columns may be in any order, and other columns are ignored, with a note. Cells are separated by `,`, `;` or tabs.
/// Unless commas separate the cells, numbers may have a decimal comma. Targets are in mm or deg, or in inches if their
/// head says so (`target inch`).
///
/// The head of the deviations may contain a unit: `deviation [µm]`, `deviation_mm`, `deviation arcsec`. The deviations
/// are then converted to µm or µrad, which [`Measurement::unit`] names. Without a unit they are not converted, and
/// `unit` is `None`.
///
/// The format has no end mark. A last line without a line break is rejected if its number has fewer decimals than all
/// others, because the number is probably truncated. Otherwise the missing line break is noted. A run that lacks a
/// target, and a direction with fewer runs, are noted too.
///
/// # Errors
/// # Errors
/// Wrong header or number of columns, cells that are not finite numbers, repeated readings, or an empty file.
/// Messages name the file, the line, what was found and what was expected.
pub fn parse_csv(bytes: &[u8], name: &str) -> Result<Measurement, MetrologyError> {
    let (text, encoding_note) = decode(bytes, name)?;
    refuse_empty(&text, name, EXPECTED_HEADER)?;
    refuse_renishaw(&text, name)?;
    let table = CsvTable::parse(name, &text)?;
    let mut read = Rows::default();
    let (unit, target_unit, not_read, note) = if let Some((targets, wide)) = wide(&table)? {
        let found = wide.readings(name, &table, targets)?;
        for reading in found.readings {
            let place = Place::new(name, reading.line);
            let WideReading { target, run, direction, deviation, text, .. } = reading;
            let reading = Reading { target, run, direction, deviation };
            read.push(place, reading, text)?;
        }
        let is_read = |column| column == targets.column || wide.reads(column);
        (found.unit, targets.unit, columns_besides(&table, is_read), found.note)
    } else {
        let columns = Columns::of(&table)?;
        for row in table.rows() {
            read.add(name, row, &columns)?;
        }
        (columns.unit, columns.target.unit, columns_not_read(&table), None)
    };
    if read.readings.is_empty() {
        return Err(MetrologyError::Empty {
            file: name.into(),
            expected: "at least one reading under the header".into(),
        });
    }
    let mut notes: Vec<String> = encoding_note.into_iter().collect();
    notes.extend(note);
    notes.extend(not_read);
    notes.extend(read.end_of_file(&text, name)?);
    notes.extend(incomplete_runs(&read.readings));
    notes.extend(zero_direction(&read.readings));
    Ok(Measurement {
        name: name.into(),
        format: Some(FileFormat::Table),
        quantity: None,
        unit: unit.map(ReadingUnit::deviation_unit),
        stated: unit,
        target_unit,
        readings: read.readings,
        notes,
        ..Measurement::default()
    })
}

/// Writes the readings as `target,run,direction,deviation`, in their order, with enough digits to read the same numbers
/// again. The heads name the unit of the deviations if it is known (`deviation_um`), and the unit of the targets if the
/// metadata name the axis (`target_mm`). The format has no other metadata, environment or notes.
pub fn write_csv(measurement: &Measurement) -> String {
    let axis = measurement.metadata.axis.as_deref();
    let axis: Option<AxisName> = axis.and_then(|letter| letter.trim().parse().ok());
    let unit = |name: &str| match (name, measurement.unit) {
        ("target", _) => axis.map_or("", |axis| match axis.kind() {
            AxisKind::Linear => "_mm",
            AxisKind::Rotary => "_deg",
        }),
        ("deviation", Some(DeviationUnit::Um)) => "_um",
        ("deviation", Some(DeviationUnit::Urad)) => "_urad",
        _ => "",
    };
    let heads = NAMES.map(|name| format!("{name}{}", unit(name)));
    let mut text = heads.join(",") + "\n";
    for Reading { target, run, direction, deviation } in &measurement.readings {
        // Writing to a String cannot fail.
        let _ = writeln!(text, "{target},{run},{direction},{deviation}");
    }
    text
}

/// Targets and runs of a table with a column for each run; `None` for other tables.
fn wide(table: &CsvTable) -> Result<Option<(Targets, WideTable)>, MetrologyError> {
    let is_deviation = |head: &str| {
        unit_of(head, "deviation")
            .is_some_and(|unit| unit.is_empty() || ReadingUnit::named(unit).is_some())
    };
    // The heads of a table with a row for each reading, whatever the unit of its deviations.
    let has_rows = table.column("run")?.is_some() && table.column("direction")?.is_some();
    if has_rows || table.names().any(|(_, head)| is_deviation(head)) {
        return Ok(None);
    }
    let Some((column, unit)) = with_unit(table, "target")? else {
        return Ok(None);
    };
    match WideTable::of(table, column)? {
        Some(wide) => Ok(Some((targets_of(table, column, unit)?, wide))),
        None => Ok(None),
    }
}

fn wrong_header(table: &CsvTable, found: &str, expected: &str) -> MetrologyError {
    let error = table.header_error(format!("found {found}, expected {expected}"));
    error.into()
}

fn targets_of(table: &CsvTable, column: Column, unit: &str) -> Result<Targets, MetrologyError> {
    let in_inches = ReadingUnit::named(unit) == Some(ReadingUnit::Inch);
    let unit = match unit {
        "" => None,
        _ if in_inches => Some(TargetUnit::Mm),
        unit => Some(TargetUnit::named(unit).ok_or_else(|| {
            let found = format!("targets in {}", quoted(unit));
            let expected = "mm, inch or deg: `target`, `target mm`, `target inch` or `target deg`";
            wrong_header(table, &found, expected)
        })?),
    };
    Ok(Targets { column, unit, in_inches })
}

struct Columns {
    target: Targets,
    deviation: Column,
    unit: Option<ReadingUnit>,
    run_and_direction: Option<(Column, Column)>,
}

impl Columns {
    fn of(table: &CsvTable) -> Result<Self, MetrologyError> {
        let wrong = |found: &str, expected: &str| wrong_header(table, found, expected);
        let (target, deviation) = (with_unit(table, "target")?, with_unit(table, "deviation")?);
        let (Some((target, target_unit)), Some((deviation, unit))) = (target, deviation) else {
            return Err(wrong(&heads(table), OTHER_HEADS));
        };
        let target = targets_of(table, target, target_unit)?;
        let unit = match unit {
            "" => None,
            unit => Some(ReadingUnit::named(unit).ok_or_else(|| {
                let found = format!("deviations in {}", quoted(unit));
                let expected =
                    "one of µm, mm, nm, inch, µrad, mrad, rad, arcsec, deg: `deviation µm`";
                wrong(&found, expected)
            })?),
        };
        if unit == Some(ReadingUnit::Inch) && target.unit.is_none() {
            return Err(inches_without_targets(table));
        }
        let run_and_direction = match (table.column("run")?, table.column("direction")?) {
            (Some(run), Some(direction)) => Some((run, direction)),
            (None, None) => None,
            _ => {
                let expected = "both of the columns `run` and `direction`, or none of them";
                return Err(wrong(&heads(table), expected));
            }
        };
        Ok(Self { target, deviation, unit, run_and_direction })
    }
}

#[derive(Default)]
struct Rows {
    readings: Vec<Reading>,
    deviation_texts: Vec<String>,
    lines: HashMap<(u32, Direction, u64), usize>,
}

impl Rows {
    fn add(
        &mut self,
        file: &str,
        row: CsvRow<'_>,
        columns: &Columns,
    ) -> Result<(), MetrologyError> {
        let place = Place::new(file, row.line());
        let target = columns.target.of(row, place)?;
        let deviation_text = row.cell(columns.deviation).decimal_text()?;
        let stated = place.number("deviation", &deviation_text)?;
        let deviation = stated * columns.unit.map_or(1.0, ReadingUnit::micro);
        let (run, direction) = match columns.run_and_direction {
            Some((run, direction)) => (
                place.count("run", row.cell(run).text())?,
                direction_of(place, row.cell(direction).text())?,
            ),
            None => (1, Direction::Positive),
        };
        let reading = Reading { target, run, direction, deviation };
        self.push(place, reading, deviation_text)
    }

    fn push(
        &mut self,
        place: Place<'_>,
        reading: Reading,
        text: String,
    ) -> Result<(), MetrologyError> {
        let Reading { target, run, direction, .. } = reading;
        let key = (run, direction, target.to_bits());
        if let Some(first) = self.lines.insert(key, place.line) {
            let found =
                format!("target {target} in run {run} {direction} again (first in line {first})");
            return Err(place.contradictory("reading", found, "each target once in a run"));
        }
        self.readings.push(reading);
        self.deviation_texts.push(text);
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
            return Err(Place::new(name, line).truncated("last deviation", found, expected));
        }
        Ok(Some("the last line does not end in a line break: the file may be cut off".into()))
    }
}

fn refuse_renishaw(text: &str, name: &str) -> Result<(), MetrologyError> {
    match first_line(text) {
        Some((line, first)) if first.ends_with("::") => {
            Err(Place::new(name, line).wrong_kind(quoted(first), EXPECTED_HEADER))
        }
        _ => Ok(()),
    }
}

fn columns_besides(table: &CsvTable, is_read: impl Fn(Column) -> bool) -> Option<String> {
    let names = table.names().filter(|(column, _)| !is_read(*column));
    not_read(&names.map(|(_, name)| name).collect::<Vec<_>>())
}

fn columns_not_read(table: &CsvTable) -> Option<String> {
    let is_read = |head: &str| {
        NAMES[..].iter().any(|name| match *name {
            "target" | "deviation" => unit_of(head, name).is_some(),
            _ => head.eq_ignore_ascii_case(name),
        })
    };
    let names: Vec<&str> =
        table.names().map(|(_, name)| name).filter(|name| !is_read(name)).collect();
    not_read(&names)
}

fn direction_of(place: Place<'_>, text: &str) -> Result<Direction, MetrologyError> {
    direction_named(text).ok_or_else(|| {
        let expected = "`+` or `-`, `forward` or `backward`";
        place.malformed("direction", quoted(text), expected)
    })
}

pub(crate) fn incomplete_runs(readings: &[Reading]) -> Vec<String> {
    let mut targets_of_run: BTreeMap<(Direction, u32), usize> = BTreeMap::new();
    let mut all: BTreeSet<u64> = BTreeSet::new();
    for reading in readings {
        *targets_of_run.entry((reading.direction, reading.run)).or_default() += 1;
        all.insert(reading.target.to_bits());
    }
    let lacking = targets_of_run.iter().filter(|(_, n)| **n < all.len());
    let mut notes: Vec<String> = lacking
        .map(|((d, run), n)| format!("run {run} {d} holds {n} of {} targets", all.len()))
        .collect();
    let runs = |direction| targets_of_run.keys().filter(|(d, _)| *d == direction).count();
    let [forward, backward] = Direction::BOTH.map(runs);
    if forward > 0 && backward > 0 && forward != backward {
        notes.push(format!("{} forward, {backward} backward", counted(forward, "run")));
    }
    notes.extend(alignment_notes(readings));
    notes
}

pub(crate) fn zero_direction(readings: &[Reading]) -> Option<String> {
    let in_direction = |direction| readings.iter().filter(move |r| r.direction == direction);
    let all_zero = |direction| in_direction(direction).all(|r| r.deviation == 0.0);
    let suspicious = in_direction(Direction::Negative).count() > 1
        && all_zero(Direction::Negative)
        && !all_zero(Direction::Positive);
    suspicious.then(|| "every backward reading is exactly 0: if the test was unidirectional, leave those rows out".into())
}
