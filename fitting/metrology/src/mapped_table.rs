//! Tables whose columns are assigned by a mapping.
//!
//! The mapping is a TOML file, which states the roles of the columns of a table, or of the channels of a log.

use std::collections::HashMap;
use std::path::{Path, PathBuf};

use csv::{ReaderBuilder, Trim};
use volcomp_document::{Document, InputError, Section, Value, quoted, split_unit, unit_named};

use crate::channel_log::{Channels, runs_by_travel};
use crate::csv_file::{incomplete_runs, zero_direction};
use crate::text::{Place, decode, refuse_empty};
use crate::unit::{direction_named, not_read};
use crate::{
    DeviationUnit, Direction, FileFormat, Measurement, MetrologyError, Reading, ReadingUnit,
    TargetUnit,
};

/// Information from the user about a file that the file itself does not contain.
#[derive(Debug, Clone, PartialEq)]
pub enum Mapping {
    /// Roles of the columns of a table.
    Columns(Columns),
    /// Roles of the channels of a log, and the criteria for standstill of the axis.
    Channels(Channels),
}

/// Column of a table, named by its header or by its number.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum ColumnName {
    /// Header of the column, case-insensitive.
    Head(String),
    /// Number of the column, from 1.
    Number(usize),
}

/// Roles of the columns of a table, and the notation of its cells.
#[derive(Debug, Clone, PartialEq)]
pub struct Columns {
    pub target: ColumnName,
    /// Column of the deviations, or of measured positions from which the targets are subtracted.
    pub reading: ColumnName,
    /// Whether `reading` is a column of measured positions.
    pub reads_position: bool,
    /// Column of the run numbers. `None`: runs are counted.
    pub run: Option<ColumnName>,
    /// Column of the directions of approach. `None`: directions follow from the order of travel.
    pub direction: Option<ColumnName>,
    /// Separator of the cells. `None`: cells are separated by one or more blanks.
    pub separator: Option<char>,
    /// Whether numbers have a decimal comma.
    pub decimal_comma: bool,
    /// Unit of the readings; `None` if it is not stated.
    pub unit: Option<ReadingUnit>,
    /// Unit of the targets, mm or deg; `None` if it is not stated.
    pub target_unit: Option<TargetUnit>,
    /// Number of lines above the first reading, including blank lines. The last of these lines that is not blank
    /// contains the heads.
    pub header_rows: usize,
}

const UNITS: [(&str, ReadingUnit); 10] = [
    ("um", ReadingUnit::Um),
    ("µm", ReadingUnit::Um),
    ("mm", ReadingUnit::Mm),
    ("nm", ReadingUnit::Nm),
    ("urad", ReadingUnit::Urad),
    ("µrad", ReadingUnit::Urad),
    ("mrad", ReadingUnit::Mrad),
    ("rad", ReadingUnit::Rad),
    ("arcsec", ReadingUnit::Arcsec),
    ("deg", ReadingUnit::Deg),
];

impl Mapping {
    /// Path of the mapping file that belongs to a measurement file: `x.csv.toml` for `x.csv`.
    pub fn beside(file: &Path) -> PathBuf {
        let mut name = file.file_name().unwrap_or_default().to_owned();
        name.push(".toml");
        file.with_file_name(name)
    }

    /// Reads the mapping file that belongs to a measurement file; `None` if there is no mapping file.
    ///
    /// # Errors
    /// The mapping file cannot be read, is not valid TOML, or contains other keys than columns or channels.
    pub fn read_beside(file: &Path) -> Result<Option<Self>, MetrologyError> {
        let path = Self::beside(file);
        if !path.is_file() {
            return Ok(None);
        }
        let unreadable = |error: volcomp_document::ReadError| MetrologyError::Mapping {
            message: error.to_string(),
        };
        let document = Document::read(&path).map_err(unreadable)?;
        Ok(document.decode(|root| Self::decode(&root))?)
    }

    /// Decodes the mapping under the key `columns` or `channels` of a table; `None` if the table has neither key.
    ///
    /// # Errors
    /// Both keys, another key, or an invalid value.
    pub fn decode(root: &Section<'_>) -> Result<Option<Self>, InputError> {
        root.allow(&["columns", "channels"])?;
        Self::decode_keys(root)
    }

    /// Like [`Mapping::decode`], for a table that may have other keys.
    ///
    /// # Errors
    /// Both keys, or an invalid value.
    pub fn decode_keys(section: &Section<'_>) -> Result<Option<Self>, InputError> {
        match (section.section("columns")?, section.section("channels")?) {
            (Some(_), Some(channels)) => Err(channels.error(
                "found `columns` and `channels` together, expected one of them: a table has columns, a log has channels",
            )),
            (Some(columns), None) => Columns::decode(&columns).map(|c| Some(Self::Columns(c))),
            (None, Some(channels)) => Channels::decode(&channels).map(|c| Some(Self::Channels(c))),
            (None, None) => Ok(None),
        }
    }
}

impl Columns {
    /// Decodes the table `columns`.
    ///
    /// # Errors
    /// An unknown key, an invalid value, or no key for the readings.
    pub fn decode(section: &Section<'_>) -> Result<Self, InputError> {
        section.allow(&[
            "target",
            "deviation",
            "measured",
            "run",
            "direction",
            "separator",
            "decimal_comma",
            "unit",
            "target_unit",
            "header_rows",
        ])?;
        let (reading, reads_position) = match (section.get("deviation"), section.get("measured")) {
            (Some(value), None) => (column(&value)?, false),
            (None, Some(value)) => (column(&value)?, true),
            (Some(_), Some(both)) => {
                return Err(both.error("found `deviation` and `measured`, expected one of them"));
            }
            (None, None) => {
                return Err(section.error(
                    "expected `deviation`, the column of deviations, or `measured`, that of measured positions",
                ));
            }
        };
        let separators = [
            (",", Some(',')),
            (";", Some(';')),
            ("tab", Some('\t')),
            ("\t", Some('\t')),
            ("blank", None),
        ];
        let columns = Self {
            target: column(&section.require("target")?)?,
            reading,
            reads_position,
            run: section.optional("run", column)?,
            direction: section.optional("direction", column)?,
            separator: section.one_of("separator", &separators, Some(','))?,
            decimal_comma: section.truth_or("decimal_comma", false)?,
            unit: section.optional("unit", |value| value.one_of(&UNITS))?,
            target_unit: section.optional("target_unit", |value| {
                value.one_of(&[("mm", TargetUnit::Mm), ("deg", TargetUnit::Deg)])
            })?,
            header_rows: section.whole_or("header_rows", 0..=1000, 1)?,
        };
        if columns.decimal_comma && columns.separator == Some(',') {
            return Err(section.error(
                "found decimal commas and the separator `,`, expected `separator = \";\"`, \"tab\" or \"blank\"",
            ));
        }
        if columns.reads_position && columns.unit.is_none() {
            return Err(section.error(
                "found `measured` without `unit`, expected the unit of the measured positions: `unit = \"mm\"`",
            ));
        }
        columns.refuse_contradictory_units(section)?;
        let is_head = |name: &&ColumnName| matches!(name, ColumnName::Head(_));
        if columns.header_rows == 0 && columns.names().any(|(_, name)| is_head(&name)) {
            return Err(section.error(
                "found names of columns and `header_rows = 0`, expected their numbers from 1",
            ));
        }
        Ok(columns)
    }

    /// Returns an error if measured positions are lengths and targets are angles, or the reverse, because the targets
    /// are subtracted from the positions.
    fn refuse_contradictory_units(&self, section: &Section<'_>) -> Result<(), InputError> {
        let (true, Some(unit), Some(target)) = (self.reads_position, self.unit, self.target_unit)
        else {
            return Ok(());
        };
        let (found, expected) = match (unit.deviation_unit(), target) {
            (DeviationUnit::Um, TargetUnit::Deg) => ("deg", "mm"),
            (DeviationUnit::Urad, TargetUnit::Mm) => ("mm", "deg"),
            _ => return Ok(()),
        };
        Err(section.error(format!(
            "found `target_unit = \"{found}\"` and measured positions in {unit}, expected `target_unit = \"{expected}\"`: the targets are subtracted from the positions"
        )))
    }

    pub(crate) fn names(&self) -> impl Iterator<Item = (&'static str, &ColumnName)> {
        [
            ("target", Some(&self.target)),
            ("reading", Some(&self.reading)),
            ("run", self.run.as_ref()),
            ("direction", self.direction.as_ref()),
        ]
        .into_iter()
        .filter_map(|(what, name)| Some((what, name?)))
    }
}

fn column(value: &Value<'_>) -> Result<ColumnName, InputError> {
    if value.is_number() {
        return Ok(ColumnName::Number(value.whole(1..=10_000)?));
    }
    let name = value.text()?.trim();
    if name.is_empty() {
        return Err(
            value.error("found an empty name, expected the head of a column or its number from 1")
        );
    }
    Ok(ColumnName::Head(name.to_owned()))
}

impl Channels {
    /// Decodes the table `channels`.
    ///
    /// # Errors
    /// An unknown or missing key, an invalid value, or the same channel as target and reading.
    pub fn decode(section: &Section<'_>) -> Result<Self, InputError> {
        section.allow(&[
            "target",
            "reading",
            "reading_is",
            "unit",
            "targets",
            "within",
            "dwell_s",
            "settle_s",
            "zero_at_first",
        ])?;
        let reads_position =
            section.require("reading_is")?.one_of(&[("position", true), ("deviation", false)])?;
        let channels = Self {
            target: section.require("target")?.text()?.to_owned(),
            reading: section.require("reading")?.text()?.to_owned(),
            reads_position,
            unit: section.require("unit")?.one_of(&UNITS)?,
            targets: section.optional("targets", Value::numbers)?.unwrap_or_default(),
            within: section.number_or("within", 0.0..=10.0, 0.005)?,
            dwell_s: section.number_or("dwell_s", 0.0..=86_400.0, 1.0)?,
            settle_s: section.number_or("settle_s", 0.0..=86_400.0, 0.0)?,
            zero_at_first: section.truth_or("zero_at_first", false)?,
        };
        if channels.target == channels.reading {
            return Err(section.error("found one channel as `target` and `reading`, expected two"));
        }
        let mut sorted = channels.targets.clone();
        sorted.sort_by(f64::total_cmp);
        if let Some([twice, ..]) = sorted.windows(2).find(|pair| pair[0] == pair[1]) {
            return Err(
                section.error(format!("found the target {twice} twice, expected each target once"))
            );
        }
        Ok(channels)
    }
}

/// Reads a table with the columns that a mapping names. The rows must be in the order of travel. Blank rows are
/// skipped.
///
/// Without a column of directions, the directions follow from the order of travel. A target is approached in the
/// direction of the move towards it. If a target is repeated, the second reading is from the other side. Without a
/// column of runs, the runs are counted.
///
/// # Errors
///
/// A column that is missing or repeated, a cell that is not a number, an invalid direction or run, or a repeated
/// reading.
pub fn parse_table_with(
    bytes: &[u8],
    name: &str,
    columns: &Columns,
) -> Result<Measurement, MetrologyError> {
    let (text, encoding_note) = decode(bytes, name)?;
    refuse_empty(&text, name, "a table with the columns of the mapping")?;
    let rows = rows(&text, name, columns)?;
    let header_end = rows.partition_point(|(line, _)| *line <= columns.header_rows);
    let (header, body) = rows.split_at(header_end);
    let places = ColumnIndices::of(header.last(), name, columns)?;
    let columns = &places.with_units_of_heads(header.last(), name, columns)?;
    let read: Vec<Row> = body
        .iter()
        .map(|(line, cells)| places.row(Place::new(name, *line), cells, columns))
        .collect::<Result<_, _>>()?;
    if read.is_empty() {
        return Err(MetrologyError::Empty {
            file: name.into(),
            expected: format!("at least one reading under {} lines of header", columns.header_rows),
        });
    }
    let readings = readings(name, &read)?;
    let mut notes: Vec<String> = encoding_note.into_iter().collect();
    if columns.direction.is_none() {
        notes.push("directions of approach follow the order of the rows".into());
    }
    if columns.unit.is_none() {
        notes.push("neither a head nor `columns` states a unit of the readings: without `unit` they are taken as µm or µrad".into());
    }
    notes.extend(places.columns_not_read(header.last()));
    notes.extend(incomplete_runs(&readings));
    notes.extend(zero_direction(&readings));
    Ok(Measurement {
        name: name.into(),
        format: Some(FileFormat::MappedTable),
        unit: columns.unit.map(ReadingUnit::deviation_unit),
        stated: columns.unit,
        target_unit: columns.target_unit,
        readings,
        notes,
        ..Measurement::default()
    })
}

/// Rows that are not blank, with their line numbers.
fn rows(
    text: &str,
    name: &str,
    columns: &Columns,
) -> Result<Vec<(usize, Vec<String>)>, MetrologyError> {
    let Some(separator) = columns.separator else {
        let lines = text.lines().enumerate().map(|(index, line)| (index + 1, line));
        let filled = lines.filter(|(_, line)| !line.trim().is_empty());
        let cells = |line: &str| line.split_whitespace().map(str::to_owned).collect();
        return Ok(filled.map(|(number, line)| (number, cells(line))).collect());
    };
    let mut reader = ReaderBuilder::new()
        .has_headers(false)
        .flexible(true)
        .trim(Trim::All)
        // A separator in a mapping is a single byte.
        .delimiter(u8::try_from(separator).unwrap_or(b','))
        .from_reader(text.as_bytes());
    let mut rows = Vec::new();
    let mut lines = Lines { text, at: 0, line: 1 };
    for record in reader.records() {
        let record = record.map_err(|error| {
            let line = error.position().map_or(1, csv::Position::line);
            let place = Place::new(name, usize::try_from(line).unwrap_or(1));
            place.malformed("row", error.to_string(), "cells")
        })?;
        let start = record.position().map_or(0, csv::Position::byte);
        let line = lines.of(usize::try_from(start).unwrap_or(0));
        if record.iter().any(|cell| !cell.is_empty()) {
            let cells = record.iter().map(str::to_owned).collect();
            rows.push((line, cells));
        }
    }
    Ok(rows)
}

struct Lines<'t> {
    text: &'t str,
    at: usize,
    line: usize,
}

impl Lines<'_> {
    /// Line of a record. The position that the CSV reader reports is before the blank lines above the record.
    fn of(&mut self, start: usize) -> usize {
        let bytes = self.text.as_bytes();
        while let Some(byte) = bytes.get(self.at) {
            let is_end = match byte {
                b'\n' => true,
                b'\r' => bytes.get(self.at + 1) != Some(&b'\n'),
                _ if self.at >= start => break,
                _ => false,
            };
            self.line += usize::from(is_end);
            self.at += 1;
        }
        self.line
    }
}

struct ColumnIndices {
    target: usize,
    reading: usize,
    run: Option<usize>,
    direction: Option<usize>,
}

pub(super) struct Row {
    line: usize,
    target: f64,
    deviation: f64,
    run: Option<u32>,
    direction: Option<Direction>,
}

impl ColumnIndices {
    fn of(
        header: Option<&(usize, Vec<String>)>,
        file: &str,
        columns: &Columns,
    ) -> Result<Self, MetrologyError> {
        let place_of = |what: &str, name: &ColumnName| match name {
            ColumnName::Number(number) => Ok(number - 1),
            ColumnName::Head(head) => {
                let (line, cells) =
                    header.map_or((1, &[][..]), |(line, cells)| (*line, &cells[..]));
                let is_it = |cell: &&String| cell.to_lowercase() == head.to_lowercase();
                let count = cells.iter().filter(is_it).count();
                let found = cells.iter().position(|cell| is_it(&cell));
                match found {
                    Some(place) if count == 1 => Ok(place),
                    _ => {
                        let found = match count {
                            0 => quoted(&cells.join(" | ")),
                            _ => format!("{} {count} times", quoted(head)),
                        };
                        let expected = format!("one column {} (the {what})", quoted(head));
                        Err(Place::new(file, line).malformed("header", found, expected))
                    }
                }
            }
        };
        let mut taken: HashMap<usize, &str> = HashMap::new();
        for (what, name) in columns.names() {
            let place = place_of(what, name)?;
            if let Some(other) = taken.insert(place, what) {
                return Err(MetrologyError::readings(
                    file,
                    "columns",
                    format!("column {} as {other} and as {what}", place + 1),
                    "a separate column for each",
                ));
            }
        }
        Ok(Self {
            target: place_of("target", &columns.target)?,
            reading: place_of("reading", &columns.reading)?,
            run: columns.run.as_ref().map(|name| place_of("run", name)).transpose()?,
            direction: columns
                .direction
                .as_ref()
                .map(|name| place_of("direction", name))
                .transpose()?,
        })
    }

    /// Adds the units stated in the column headers to the mapping, such as `Soll mm`, `Abweichung [µm]`, or a unit
    /// alone.
    fn with_units_of_heads(
        &self,
        header: Option<&(usize, Vec<String>)>,
        file: &str,
        columns: &Columns,
    ) -> Result<Columns, MetrologyError> {
        let mut columns = columns.clone();
        let Some((line, cells)) = header else {
            return Ok(columns);
        };
        let wrong = |what: &str, head: &str, expected: &str| {
            let place = Place::new(file, *line);
            place.malformed(what, quoted(head), expected)
        };
        let unit_of = |column: usize| {
            let head: &str = cells.get(column)?;
            Some((head, unit_in(head)?))
        };
        if let Some((head, unit)) = unit_of(self.reading) {
            let found = ReadingUnit::named(unit).ok_or_else(|| {
                let expected = "mm, µm, nm, inch, µrad, mrad, rad, arcsec or deg behind it";
                wrong("head of the readings", head, expected)
            })?;
            if let Some(other) = columns.unit.filter(|other| *other != found) {
                let expected = format!("{other}, as `unit` of `columns` states");
                return Err(wrong("head of the readings", head, &expected));
            }
            columns.unit = Some(found);
        }
        if let Some((head, unit)) = unit_of(self.target) {
            let found = TargetUnit::named(unit)
                .ok_or_else(|| wrong("head of the targets", head, "mm or deg behind it"))?;
            if let Some(other) = columns.target_unit.filter(|other| *other != found) {
                let expected = format!("{}, as `target_unit` of `columns` states", other.key());
                return Err(wrong("head of the targets", head, &expected));
            }
            let is_angle = found == TargetUnit::Deg;
            let unit = columns.unit.filter(|_| columns.reads_position);
            if unit.is_some_and(|unit| (unit.deviation_unit() == DeviationUnit::Urad) != is_angle) {
                let expected =
                    "the kind of unit of the measured positions, from which they are subtracted";
                return Err(wrong("head of the targets", head, expected));
            }
            columns.target_unit = Some(found);
        }
        Ok(columns)
    }

    fn columns_not_read(&self, header: Option<&(usize, Vec<String>)>) -> Option<String> {
        let read = [Some(self.target), Some(self.reading), self.run, self.direction];
        let (_, cells) = header?;
        let others = cells.iter().enumerate();
        let others =
            others.filter(|(place, head)| !read.contains(&Some(*place)) && !head.is_empty());
        let names: Vec<&str> = others.map(|(_, head)| head.as_str()).collect();
        not_read(&names)
    }

    fn row(
        &self,
        place: Place<'_>,
        cells: &[String],
        columns: &Columns,
    ) -> Result<Row, MetrologyError> {
        let cell = |what: &str, at: usize| {
            cells.get(at).map(String::as_str).ok_or_else(|| {
                let found = format!("{} cells", cells.len());
                let expected = format!("at least {}: the {what} is column {}", at + 1, at + 1);
                place.malformed("row", found, expected)
            })
        };
        let number = |what: &str, at: usize| {
            let text = cell(what, at)?;
            if columns.decimal_comma {
                if text.contains('.') {
                    let expected = "a number with a decimal comma, as the mapping states";
                    return Err(place.not_a_number(what, quoted(text), expected));
                }
                return place.number(what, &text.replacen(',', ".", 1));
            }
            place.number(what, text)
        };
        let target = number("target", self.target)?;
        let what = if columns.reads_position { "measured" } else { "deviation" };
        let stated = number(what, self.reading)?;
        let micro = columns.unit.map_or(1.0, ReadingUnit::micro);
        let deviation = if columns.reads_position {
            stated * micro - target * target_micro(columns)
        } else {
            stated * micro
        };
        Ok(Row {
            line: place.line,
            target,
            deviation,
            run: match self.run {
                Some(at) => Some(place.count("run", cell("run", at)?)?),
                None => None,
            },
            direction: match self.direction {
                Some(at) => Some(direction(place, cell("direction", at)?)?),
                None => None,
            },
        })
    }
}

/// Unit in a head: alone, in brackets, or after the name. If the head ends with brackets that contain other text, such
/// as `[1/1000 mm]`, the unit is unknown.
fn unit_in(head: &str) -> Option<&'static str> {
    let head = head.replace('（', "(").replace('）', ")");
    let in_brackets = head.rsplit_once(['[', '(', '{']).and_then(|(_, behind)| {
        let (inside, _) = behind.split_once([']', ')', '}'])?;
        unit_named(inside.trim())
    });
    let ends_in_bracket = head.trim_end().ends_with([']', ')', '}']);
    let behind = || (!ends_in_bracket).then(|| Some(split_unit(&head)?.1)).flatten();
    in_brackets.or_else(|| unit_named(head.trim())).or_else(behind)
}

/// µm per mm, or µrad per degree. The unit of the targets decides or, if it is not stated, the kind of the unit of the
/// readings.
fn target_micro(columns: &Columns) -> f64 {
    match columns.target_unit {
        Some(TargetUnit::Deg) => ReadingUnit::Deg.micro(),
        Some(TargetUnit::Mm) => ReadingUnit::Mm.micro(),
        None => columns.unit.unwrap_or(ReadingUnit::Um).micro_of_coordinate(),
    }
}

fn direction(place: Place<'_>, text: &str) -> Result<Direction, MetrologyError> {
    direction_named(text).ok_or_else(|| {
        let expected = "+ or -, forward or backward, 1 or -1";
        place.malformed("direction", quoted(text), expected)
    })
}

fn readings(file: &str, rows: &[Row]) -> Result<Vec<Reading>, MetrologyError> {
    let targets: Vec<f64> = rows.iter().map(|row| row.target).collect();
    let travelled = runs_by_travel(&targets);
    let counted = counted_runs(file, rows)?;
    let mut seen: HashMap<(u32, Direction, u64), usize> = HashMap::new();
    let mut readings = Vec::with_capacity(rows.len());
    for ((row, (travel_run, travel_direction)), counted) in rows.iter().zip(travelled).zip(counted)
    {
        let direction = row.direction.unwrap_or(travel_direction);
        let run = row.run.unwrap_or(match row.direction {
            Some(_) => counted,
            None => travel_run,
        });
        if let Some(first) = seen.insert((run, direction, row.target.to_bits()), row.line) {
            let place = Place::new(file, row.line);
            let found = format!(
                "target {} in run {run} {direction} again (first in line {first})",
                row.target
            );
            return Err(place.contradictory("reading", found, "each target once in a run"));
        }
        readings.push(Reading { target: row.target, run, direction, deviation: row.deviation });
    }
    Ok(readings)
}

/// Numbers the runs of rows that state a direction but no run. The first reading of each target in a direction belongs
/// to run 1, the second to run 2, and so on. If the targets have different numbers of readings, some run lacks targets,
/// and the runs are taken from the order of travel.
fn counted_runs(file: &str, rows: &[Row]) -> Result<Vec<u32>, MetrologyError> {
    let mut counts: HashMap<(Option<Direction>, u64), u32> = HashMap::new();
    let count = |row: &Row| {
        let count = counts.entry((row.direction, row.target.to_bits()));
        let count = count.or_default();
        *count += 1;
        *count
    };
    let counted: Vec<u32> = rows.iter().map(count).collect();
    let Some(of_first) = rows.first().filter(|row| row.run.is_none() && row.direction.is_some())
    else {
        return Ok(counted);
    };
    let expected = counts.get(&(of_first.direction, of_first.target.to_bits()));
    if counts.values().all(|count| Some(count) == expected) {
        return Ok(counted);
    }
    runs_by_passes(rows).ok_or_else(|| {
        let found = "targets with different numbers of readings, not in the order of travel";
        let expected = "a column of runs (`run`), which says what run lacks a reading";
        Place::new(file, of_first.line).contradictory("rows", found.to_owned(), expected)
    })
}

/// Run of each row, from the order of travel. All rows must have a direction. A pass ends when the direction changes or
/// the sequence of targets starts again. A run begins with a pass in the direction of the first row, or in the same
/// direction as the previous pass. `None` if there are several targets and a pass before the last has only one: then
/// the rows are in another order, such as by target.
fn runs_by_passes(rows: &[Row]) -> Option<Vec<u32>> {
    let steps = |direction: Option<Direction>| {
        let pairs = rows
            .windows(2)
            .filter(move |pair| pair[0].direction == direction && pair[1].direction == direction);
        pairs.map(|pair| pair[1].target - pair[0].target)
    };
    let ascends = |direction| {
        let up = steps(direction).filter(|step| *step > 0.0).count();
        2 * up > steps(direction).count()
    };
    let both = [Some(Direction::Positive), Some(Direction::Negative)];
    let ascends = both.map(ascends);
    let goes_on = |a: &Row, b: &Row| {
        let step = b.target - a.target;
        let is_up = ascends[usize::from(a.direction == both[1])];
        a.direction == b.direction && step != 0.0 && (step > 0.0) == is_up
    };
    let has_several = rows.iter().any(|row| row.target != rows[0].target);
    let first = rows.first()?.direction;
    let mut runs = Vec::with_capacity(rows.len());
    let (mut run, mut before) = (0, None);
    for pass in rows.chunk_by(goes_on) {
        let direction = pass.first()?.direction;
        // The last pass may end after its first target.
        let is_last = runs.len() + pass.len() == rows.len();
        if has_several && pass.len() < 2 && !is_last {
            return None;
        }
        run += u32::from(direction == first || before == Some(direction));
        before = Some(direction);
        runs.extend(pass.iter().map(|_| run));
    }
    Some(runs)
}
