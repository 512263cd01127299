//! Plain tables of readings, as CSV.
//!
//! There is either one row for each reading, with the header `target,run,direction,deviation` or `target,deviation`, or
//! one row for each target and one column for each run, with heads such as `Target (mm), Run 1 fwd, Run 1 bwd, …`.

use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::fmt::Write as _;

use volcomp_document::{Column, CsvRow, CsvTable, quoted};
use volcomp_vocabulary::{AxisKind, AxisName};

use crate::positioning::counted;
use crate::runs::alignment_notes;
use crate::text::{Place, decimals, decode, first_line, range, refuse_empty};
use crate::unit::{direction_named, heads, inches_without_targets, not_read, unit_of, with_unit};
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

/// The columns of a table that contain runs.
pub(crate) struct WideTable {
    runs: Vec<Run>,
    /// Unit in the heads of the runs; `None` if no head states a unit.
    unit: Option<ReadingUnit>,
    /// Whether the columns contain measured positions (true) or deviations (false); `None` if no head states this.
    is_measured: Option<bool>,
}

struct Run {
    column: Column,
    number: u32,
    direction: Direction,
}

/// A reading of a wide table. The deviation is in µm or µrad, or in the unit of the file if that is unknown.
pub(crate) struct WideReading {
    pub(crate) line: usize,
    pub(crate) target: f64,
    pub(crate) run: u32,
    pub(crate) direction: Direction,
    pub(crate) deviation: f64,
    pub(crate) text: String,
}

pub(crate) struct WideReadings {
    pub(crate) readings: Vec<WideReading>,
    /// Unit of the columns: the stated unit, or else the unit of the targets.
    pub(crate) unit: Option<ReadingUnit>,
    pub(crate) note: Option<String>,
}

#[derive(Clone, Copy)]
pub(crate) struct Targets {
    pub(crate) column: Column,
    pub(crate) unit: Option<TargetUnit>,
    in_inches: bool,
}

impl Targets {
    /// Target of a row, mm or deg. Inches are converted to mm.
    pub(crate) fn of(self, row: CsvRow<'_>, place: Place<'_>) -> Result<f64, MetrologyError> {
        let stated = place.number("target", &row.cell(self.column).decimal_text()?)?;
        Ok(if self.in_inches { 25.4 * stated } else { stated })
    }
}

/// Run, direction, unit and kind of reading as stated in a column head.
#[derive(Default)]
struct Head {
    says_run: bool,
    run: Option<u32>,
    direction: Option<Direction>,
    unit: Option<ReadingUnit>,
    is_measured: Option<bool>,
}

/// Values, or their differences from the targets, count as deviations if they are below this fraction of the range of
/// the targets.
const DEVIATION_SHARE: f64 = 0.05;

impl Head {
    /// Parses the words of a head. `None` if a word is unknown, as in `mean fwd`: the column is not a run.
    ///
    /// Letters and short words that also name results of ISO 230-2 or numbers of positions count as directions only if the
    /// heads show it. `f` does so with a number, or if another head has `r` or `b` in its place; `r` and `b` with a number,
    /// or if another head has `f` in their place; `pos` if another head has `neg`. `r` with a number means run if another
    /// word states the direction, or if no head has `f`.
    fn of(words: &[String], all: &[Vec<String>]) -> Option<Self> {
        let mut found = Self::default();
        let is_in_any = |wanted: &str| all.iter().flatten().any(|word| word == wanted);
        let is_numbered = words.iter().any(|word| word.parse::<u32>().is_ok());
        let has_pair = |word: &str, instead: &[&str]| {
            instead.iter().any(|instead| {
                let other = words.iter().map(|of| if of == word { instead } else { of.as_str() });
                let other: Vec<&str> = other.collect();
                all.iter().any(|head| *head == other)
            })
        };
        let is_direction = |word: &str| match word {
            "f" => is_numbered || has_pair("f", &["r", "b"]),
            "r" | "b" => is_numbered && is_in_any("f") || has_pair(word, &["f"]),
            "pos" => is_in_any("neg"),
            _ => true,
        };
        let is_letter_r = |word: &&String| *word == "r";
        let mut others =
            words.iter().filter(|word| !is_letter_r(word) && word.parse::<u32>().is_err());
        // `R1 r` is the first run, backward.
        let has_other_direction = words.iter().filter(is_letter_r).count() > 1
            || others.any(|word| word != "-" && direction_named(word).is_some());
        // A hyphen means backward only if no word states a direction and another head has a `+`. In `Run - 1` it has no
        // meaning.
        let hyphen = words.iter().any(|word| word == "-") && is_in_any("+");
        for word in words.iter().filter(|word| *word != "-") {
            let is_new = if let Ok(run) = word.parse::<u32>() {
                found.run.replace(run).is_none()
            } else if ["run", "pass"].contains(&word.as_str())
                || word == "r"
                    && is_numbered
                    && !found.says_run
                    && (has_other_direction || !is_in_any("f"))
            {
                !core::mem::replace(&mut found.says_run, true)
            } else if ["measured", "position", "actual"].contains(&word.as_str()) {
                found.is_measured.replace(true).is_none()
            } else if ["deviation", "dev", "error"].contains(&word.as_str()) {
                found.is_measured.replace(false).is_none()
            } else if let Some(direction) = direction_named(word).filter(|_| is_direction(word)) {
                found.direction.replace(direction).is_none()
            } else {
                let unit = ReadingUnit::named(word)?;
                found.unit.replace(unit).is_none()
            };
            if !is_new {
                return None;
            }
        }
        if hyphen && found.direction.is_none() {
            found.direction = Some(Direction::Negative);
        }
        (found.says_run || found.direction.is_some()).then_some(found)
    }
}

/// Words, numbers and signs of a head, in lower case. A hyphen between letters and digits is omitted. Another sign,
/// such as a double prime, is a word, because it may be a unit. A head with an unknown sign is therefore not read.
fn words(head: &str) -> Vec<String> {
    let mut words: Vec<String> = Vec::new();
    let mut before = None;
    for (at, c) in head.char_indices() {
        let kind = if c.is_alphabetic() {
            'a'
        } else if c.is_ascii_digit() {
            '1'
        } else if !is_separator(head, at, c) && (c != '-' || !is_joining(head, at)) {
            '+'
        } else {
            ' '
        };
        match words.last_mut() {
            Some(word) if before == Some(kind) && kind != '+' && kind != ' ' => {
                word.extend(c.to_lowercase());
            }
            _ if kind != ' ' => words.push(c.to_lowercase().collect()),
            _ => {}
        }
        before = Some(kind);
    }
    words
}

fn is_separator(head: &str, at: usize, c: char) -> bool {
    let behind = head[at..].chars().nth(1);
    // A slash before a number belongs to a unit, as in mm/1000.
    let divides = c == '/' && behind.is_some_and(|c| c.is_ascii_digit());
    (c.is_whitespace() || "_/,:;.|=#–—&()[]{}".contains(c)) && !divides
}

fn is_joining(head: &str, hyphen: usize) -> bool {
    let (before, behind) = head.split_at(hyphen);
    let is_joined = |c: Option<char>| c.is_some_and(char::is_alphanumeric);
    is_joined(before.chars().next_back()) && is_joined(behind.chars().nth(1))
}

impl WideTable {
    /// Finds the columns of runs; `None` if no head names a run.
    pub(crate) fn of(table: &CsvTable, target: Column) -> Result<Option<Self>, MetrologyError> {
        let all: Vec<Vec<String>> = table.names().map(|(_, head)| words(head)).collect();
        let heads = table.names().zip(&all).filter(|((column, _), _)| *column != target);
        let heads = heads.filter_map(|((column, text), words)| {
            Some((column, text, words, Head::of(words, &all)?))
        });
        let mut wide = Self { runs: Vec::new(), unit: None, is_measured: None };
        let wrong = |found: String, expected: &str| {
            table.header_error(format!("found {found}, expected {expected}"))
        };
        let mut is_numbered = None;
        // Words of the first run in each direction.
        let mut first: [Option<Vec<String>>; 2] = [None, None];
        for (index, (column, text, words, head)) in heads.enumerate() {
            let Some(direction) = head.direction else {
                let expected = "the direction of each run in its head: `Run 1 fwd`, `Run 1 bwd`";
                return Err(wrong(quoted(text), expected).into());
            };
            if index > 0 && (wide.unit, wide.is_measured) != (head.unit, head.is_measured) {
                let expected = "the same unit and kind of values in the heads of all runs";
                return Err(wrong(quoted(text), expected).into());
            }
            (wide.unit, wide.is_measured) = (head.unit, head.is_measured);
            if *is_numbered.get_or_insert(head.run.is_some()) != head.run.is_some() {
                let expected = "a number in the heads of all runs or of none";
                return Err(wrong(quoted(text), expected).into());
            }
            if head.run == Some(0) {
                return Err(wrong(quoted(text), "runs numbered from 1").into());
            }
            let first = &mut first[usize::from(direction == Direction::Negative)];
            if head.run.is_none() && first.get_or_insert_with(|| words.clone()) != words {
                let expected =
                    "a number in the heads of the runs, or the same head for all in a direction";
                return Err(wrong(quoted(text), expected).into());
            }
            let others = wide.runs.iter().filter(|run| run.direction == direction);
            let highest = || others.clone().map(|other| other.number).max().unwrap_or(0);
            let next = || highest().saturating_add(1);
            let number = head.run.unwrap_or_else(next);
            if others.clone().any(|other| other.number == number) {
                let expected = format!("each run {direction} once");
                return Err(wrong(
                    format!("run {number} {direction} again in {}", quoted(text)),
                    &expected,
                )
                .into());
            }
            wide.runs.push(Run { column, number, direction });
        }
        Ok((!wide.runs.is_empty()).then_some(wide))
    }

    /// Whether this column contains a run.
    pub(crate) fn reads(&self, column: Column) -> bool {
        self.runs.iter().any(|run| run.column == column)
    }

    pub(crate) fn readings(
        &self,
        file: &str,
        table: &CsvTable,
        targets: Targets,
    ) -> Result<WideReadings, MetrologyError> {
        if self.unit == Some(ReadingUnit::Inch) && targets.unit.is_none() {
            return Err(inches_without_targets(table));
        }
        let mut readings = Vec::new();
        for row in table.rows() {
            let place = Place::new(file, row.line());
            let target = targets.of(row, place)?;
            for run in &self.runs {
                let text = row.cell(run.column).decimal_text()?;
                // An empty cell is a missing reading.
                if text.is_empty() {
                    continue;
                }
                readings.push(WideReading {
                    line: row.line(),
                    target,
                    run: run.number,
                    direction: run.direction,
                    deviation: place.number("reading", &text)?,
                    text,
                });
            }
        }
        let unit = self.unit.or_else(|| {
            let of_targets = match targets.unit? {
                TargetUnit::Mm if targets.in_inches => ReadingUnit::Inch,
                TargetUnit::Mm => ReadingUnit::Mm,
                TargetUnit::Deg => ReadingUnit::Deg,
            };
            Some(of_targets)
        });
        if !self.holds_positions(table, &readings, unit)? {
            let micro = self.unit.map_or(1.0, ReadingUnit::micro);
            for reading in &mut readings {
                reading.deviation *= micro;
            }
            return Ok(WideReadings { readings, unit: self.unit, note: None });
        }
        let wrong = |found: &str, expected: &str| {
            table.header_error(format!("found {found}, expected {expected}"))
        };
        let Some(unit) = unit else {
            let found = "measured positions without a unit";
            return Err(
                wrong(found, "it in the head of the targets: `target mm`, `target deg`").into()
            );
        };
        let is_angle = unit.deviation_unit() == DeviationUnit::Urad;
        let is_other = |target| (target == TargetUnit::Deg) != is_angle;
        if targets.unit.is_some_and(is_other) {
            let found = format!("measured positions in {unit}");
            return Err(
                wrong(&found, "the kind of unit of the targets, which are subtracted").into()
            );
        }
        for reading in &mut readings {
            reading.deviation =
                reading.deviation * unit.micro() - reading.target * unit.micro_of_coordinate();
        }
        Ok(WideReadings {
            readings,
            unit: Some(unit),
            note: (self.is_measured.is_none())
                .then(|| format!("the columns of the runs are read as measured positions in {unit}, from which the targets are subtracted")),
        })
    }

    /// Whether the columns contain measured positions. The heads decide or, if they do not state it and the unit allows
    /// both, the values.
    fn holds_positions(
        &self,
        table: &CsvTable,
        readings: &[WideReading],
        unit: Option<ReadingUnit>,
    ) -> Result<bool, MetrologyError> {
        let is_coordinate =
            |unit| matches!(unit, ReadingUnit::Mm | ReadingUnit::Inch | ReadingUnit::Deg);
        if let Some(stated) = self.is_measured {
            return Ok(stated);
        }
        if self.unit.is_some_and(|unit| !is_coordinate(unit)) {
            return Ok(false);
        }
        let to_targets = unit.map_or(1.0, |unit| unit.micro() / unit.micro_of_coordinate());
        let [low, high] = range(readings.iter().map(|reading| reading.target));
        let within = |difference: &dyn Fn(&WideReading) -> f64| {
            let mut all = readings.iter();
            high > low
                && all.all(|reading| difference(reading).abs() < DEVIATION_SHARE * (high - low))
        };
        let is_near = within(&|reading| reading.deviation * to_targets - reading.target);
        let is_small = within(&|reading| reading.deviation * to_targets);
        let is_shifted =
            || [1.0, -1.0].iter().any(|sign| follow_targets(readings, sign * to_targets));
        if !is_near && !is_small && (self.unit.is_some() || is_shifted()) {
            let message = "found values that are neither near the targets nor small, expected measured positions or deviations: write `measured` or `deviation` into the heads of the runs";
            return Err(table.header_error(message).into());
        }
        Ok(is_near)
    }
}

/// Whether the values at more than two thirds of the targets are the targets plus a common offset. The offset allows
/// for another zero, a further turn or an outlier. A half of the targets would be too few: among five random
/// deviations, two may by chance differ by as much as their targets.
fn follow_targets(readings: &[WideReading], to_targets: f64) -> bool {
    let offset = |reading: &WideReading| reading.deviation * to_targets - reading.target;
    let mut offsets: Vec<f64> = readings.iter().map(offset).collect();
    offsets.sort_by(f64::total_cmp);
    let Some(&median) = offsets.get(offsets.len() / 2) else {
        return false;
    };
    let [low, high] = range(readings.iter().map(|reading| reading.target));
    let is_close =
        |reading: &&WideReading| (offset(reading) - median).abs() < DEVIATION_SHARE * (high - low);
    let targets = |readings: &mut dyn Iterator<Item = &WideReading>| {
        readings.map(|reading| reading.target.to_bits()).collect::<BTreeSet<u64>>().len()
    };
    3 * targets(&mut readings.iter().filter(is_close)) > 2 * targets(&mut readings.iter())
}
