//! Renishaw laser files: `.rtl` (linear, µm), `.rta` (angular, milliradian) and `.rts` (straightness, taken as µm).
//!
//! Dynamic captures `.rtx` and compensation exports `.REN` are in a submodule.

mod capture;

use std::collections::{BTreeMap, HashMap};
use std::fmt::Write as _;

use volcomp_document::quoted;

use crate::checks::environment_notes;
use crate::runs::alignment_notes;
use crate::text::{Place, decode, refuse_empty, with_points};
use crate::{
    DeviationUnit, Direction, Environment, FileFormat, Measurement, Metadata, MetrologyError,
    Quantity, Reading, StartEnd,
};

pub use capture::{Capture, parse_ren, parse_rtx};

/// Kind of a Renishaw laser file.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub enum RenishawKind {
    /// `.rtl`: linear optics, deviations in µm.
    Linear,
    /// `.rta`: angular optics. Deviations are in milliradian in the file and in µrad in memory.
    Angular,
    /// `.rts`: straightness optics. Deviations perpendicular to the axis are taken as µm; this unit is not verified
    /// with a real file.
    Straightness,
}

impl RenishawKind {
    fn file_type(self) -> &'static str {
        match self {
            Self::Linear => "rtl",
            Self::Angular => "rta",
            Self::Straightness => "rts",
        }
    }

    fn unit(self) -> DeviationUnit {
        match self {
            Self::Linear | Self::Straightness => DeviationUnit::Um,
            Self::Angular => DeviationUnit::Urad,
        }
    }

    /// Factor from the unit of the file to µm or µrad.
    fn scale(self) -> f64 {
        match self {
            Self::Linear | Self::Straightness => 1.0,
            Self::Angular => 1000.0,
        }
    }

    fn format(self) -> FileFormat {
        match self {
            Self::Linear => FileFormat::RenishawLinear,
            Self::Angular => FileFormat::RenishawAngular,
            Self::Straightness => FileFormat::RenishawStraightness,
        }
    }

    fn quantity(self) -> Quantity {
        match self {
            Self::Linear => Quantity::Positioning,
            Self::Angular => Quantity::Angle,
            Self::Straightness => Quantity::Straightness,
        }
    }
}

const STRAIGHTNESS_NOT_PROVEN: &str = "deviations of .rts files are taken as µm, positive as the optics read them: no real file has proven unit and sign, so compare one with a known deviation";

/// Reads a Renishaw laser file.
///
/// Sections, keys (case, blanks and hyphens ignored) and numbers follow the grammar on which independent readers and
/// writers of the format agree. Unknown sections and keys are skipped. Targets are in mm or deg. Deviations are
/// measured value minus target: µm in `.rtl`; milliradian in `.rta`, converted to µrad; in `.rts` taken as µm
/// perpendicular to the axis, with a note.
///
/// - The middle column of DEVIATIONS is the number of the target in the list, from 1. If a cell cannot be such a number
///   (not whole, out of range) and every cell equals a target, the column contains the targets themselves. The order of
///   the rows never assigns a deviation to a target.
/// - The order of the targets of a run is its direction (ascending is forward), and the run number counts the passes of
///   its direction. The second flag is compared with the directions: "bidirectional" with all runs in one direction is
///   an error, because the reverse runs may have been sorted; "unidirectional" with runs in both directions is a note.
/// - Reverse (even) runs that contain only zeros, beside real forward runs, are omitted, with a note.
/// - Text that is not UTF-8 is read as GBK or Latin-1, with a note. Numbers are always ASCII.
///
/// # Errors
/// Any incomplete or inconsistent file: `EOF::` is missing, counts differ from the rows, readings, targets or sections
/// are repeated, numbers are not finite decimals, or the header names another file type. Each error names the file, the
/// line, what was found and what was expected.
pub fn parse_renishaw(
    bytes: &[u8],
    name: &str,
    kind: RenishawKind,
) -> Result<Measurement, MetrologyError> {
    let (text, encoding_note) = decode(bytes, name)?;
    refuse_empty(&text, name, "a Renishaw file from `HEADER::` to `EOF::`")?;
    let mut section = None;
    let text = with_points(&text, name, |line| {
        section = section_name(line.trim_ascii()).or(section.take());
        numbers_from(section.as_deref(), line)
    })?;
    let document = Document::split(&text, name)?;
    let metadata = metadata(&document, kind)?;
    let targets = targets(&document)?;
    let rows = rows(&document, &targets.values)?;
    let environment = environment(document.section("ENVIRONMENT"), name)?;
    let (readings, direction_notes) = readings(name, rows, &targets)?;
    let in_memory = |r: Reading| Reading { deviation: r.deviation * kind.scale(), ..r };
    let mut notes: Vec<String> = encoding_note.into_iter().collect();
    notes.extend(direction_notes);
    if document.text_after_end {
        notes.push("text after `EOF::` was not read".into());
    }
    if kind == RenishawKind::Straightness {
        notes.push(STRAIGHTNESS_NOT_PROVEN.into());
    }
    notes.extend(environment_notes(&environment, kind.quantity()));
    Ok(Measurement {
        name: name.into(),
        format: Some(kind.format()),
        quantity: Some(kind.quantity()),
        unit: Some(kind.unit()),
        stated: None,
        target_unit: None,
        readings: readings.into_iter().map(in_memory).collect(),
        metadata,
        environment,
        notes,
    })
}

/// Byte at which the numbers of a line begin, which is after the key if there is one; `None` outside the sections with
/// numbers.
fn numbers_from(section: Option<&str>, line: &str) -> Option<usize> {
    let is_of_numbers = matches!(section?, "TARGET DATA" | "DEVIATIONS" | "ENVIRONMENT");
    // A date is not a number, although its hours may look like one.
    let is_date = key_value(line).is_some_and(|(key, _)| key.starts_with("date"));
    (is_of_numbers && !is_date).then(|| line.find(':').map_or(0, |at| at + 1))
}

fn metadata(document: &Document<'_>, kind: RenishawKind) -> Result<Metadata, MetrologyError> {
    let text_of = |section: Option<&Section<'_>>, key| -> Result<Option<String>, MetrologyError> {
        let value = section.map(|s| s.value(document.file, key)).transpose()?.flatten();
        Ok(value.map(|(_, text)| text.trim().to_owned()).filter(|text| !text.is_empty()))
    };
    let header = document.section("HEADER");
    let user = document.section("USER-TEXT");
    check_file_type(document, header, kind)?;
    Ok(Metadata {
        format: text_of(header, "filetype")?,
        owner: text_of(header, "owner")?,
        version: text_of(header, "versionno")?,
        machine: text_of(user, "machine")?,
        serial: text_of(user, "serialno")?,
        date: text_of(user, "date")?,
        by: text_of(user, "by")?,
        axis: text_of(user, "axis")?,
        location: text_of(user, "location")?,
        title: text_of(user, "title")?,
    })
}

fn check_file_type(
    document: &Document<'_>,
    header: Option<&Section<'_>>,
    kind: RenishawKind,
) -> Result<(), MetrologyError> {
    let stated = header.map(|h| h.value(document.file, "filetype")).transpose()?.flatten();
    match stated {
        Some((line, text))
            if !text.trim_start_matches('.').eq_ignore_ascii_case(kind.file_type()) =>
        {
            let expected = format!("`File type : {}`", kind.file_type());
            Err(Place::new(document.file, line).wrong_kind(quoted(text), &expected))
        }
        _ => Ok(()),
    }
}

pub(super) struct Section<'t> {
    pub(super) name: String,
    pub(super) line: usize,
    pub(super) lines: Vec<(usize, &'t str)>,
}

pub(super) struct Document<'t> {
    pub(super) file: &'t str,
    sections: Vec<Section<'t>>,
    last_line: usize,
    text_after_end: bool,
}

impl<'t> Document<'t> {
    pub(super) fn split(text: &'t str, file: &'t str) -> Result<Self, MetrologyError> {
        let mut document = Self { file, sections: Vec::new(), last_line: 0, text_after_end: false };
        let mut ended = false;
        for (index, raw) in text.lines().enumerate() {
            let (number, line) = (index + 1, raw.trim_ascii());
            if ended {
                document.text_after_end |= !line.trim_matches('\u{1a}').is_empty();
            } else if let Some(name) = section_name(line) {
                ended = name == "EOF";
                document.open(name, number)?;
            } else if !line.is_empty() {
                document.append(number, line)?;
            }
            document.last_line = number;
        }
        if ended { Ok(document) } else { Err(document.cut()) }
    }

    fn open(&mut self, name: String, line: usize) -> Result<(), MetrologyError> {
        if let Some(first) = self.sections.iter().find(|s| s.name == name) {
            let found = format!("`{name}::` again (first in line {})", first.line);
            let place = Place::new(self.file, line);
            return Err(place.contradictory("section", found, "each section once"));
        }
        self.sections.push(Section { name, line, lines: Vec::new() });
        Ok(())
    }

    fn append(&mut self, number: usize, line: &'t str) -> Result<(), MetrologyError> {
        let Some(section) = self.sections.last_mut() else {
            let expected = "a section line such as `HEADER::`";
            return Err(Place::new(self.file, number).wrong_kind(quoted(line), expected));
        };
        section.lines.push((number, line));
        Ok(())
    }

    fn cut(&self) -> MetrologyError {
        let last = self.sections.last();
        let last_text = last.and_then(|s| s.lines.last()).map_or_else(
            || last.map(|s| format!("{}::", s.name)).unwrap_or_default(),
            |(_, text)| (*text).to_owned(),
        );
        let found = format!("the end of the file after {}", quoted(&last_text));
        let place = Place::new(self.file, self.last_line);
        place.truncated("end of file", found, "`EOF::` as the last line (the file is cut off)")
    }

    pub(super) fn section(&self, name: &str) -> Option<&Section<'t>> {
        self.sections.iter().find(|s| s.name == name)
    }

    pub(super) fn required(&self, name: &str) -> Result<&Section<'t>, MetrologyError> {
        self.section(name).ok_or_else(|| {
            let names: Vec<&str> = self.sections.iter().map(|s| s.name.as_str()).collect();
            let place = Place::new(self.file, self.last_line);
            let found = format!("only {}", names.join(", "));
            place.malformed("sections", found, format!("a section `{name}::`"))
        })
    }
}

/// Name of a section, if the line is `NAME::`. The name must not contain a colon, because free text may contain one.
fn section_name(line: &str) -> Option<String> {
    let name = line.strip_suffix("::")?.trim_ascii_end();
    let plain = |c: char| c.is_ascii_alphanumeric() || matches!(c, ' ' | '-' | '_');
    (!name.is_empty() && name.chars().all(plain)).then(|| name.to_ascii_uppercase())
}

/// Splits a line `key : value`. Upper case, blanks, tabs and hyphens are removed from the key, so that `Target-count`
/// and `Target count` are equal.
pub(super) fn key_value(line: &str) -> Option<(String, &str)> {
    let (key, value) = line.split_once(':')?;
    let key = key
        .chars()
        .filter(|c| !matches!(c, ' ' | '\t' | '-'))
        .map(|c| c.to_ascii_lowercase())
        .collect();
    Some((key, value.trim_ascii()))
}

impl<'t> Section<'t> {
    /// Number of the only line with this key, and its value; `None` if there is no such line.
    pub(super) fn value(
        &self,
        file: &str,
        key: &str,
    ) -> Result<Option<(usize, &'t str)>, MetrologyError> {
        let mut found = None;
        for (line, text) in &self.lines {
            let Some((_, value)) = key_value(text).filter(|(k, _)| k == key) else {
                continue;
            };
            if let Some((first, _)) = found {
                let what = format!("{} (first in line {first})", quoted(text));
                let expected = "each key once in its section";
                return Err(Place::new(file, *line).contradictory("key", what, expected));
            }
            found = Some((*line, value));
        }
        Ok(found)
    }

    fn required_value(
        &self,
        file: &str,
        key: &str,
        shown: &str,
    ) -> Result<(usize, &'t str), MetrologyError> {
        self.value(file, key)?.ok_or_else(|| {
            let place = Place::new(file, self.line);
            place.malformed(&self.name, format!("no `{shown}`"), format!("a line `{shown}:`"))
        })
    }
}

pub(super) struct Targets {
    pub(super) values: Vec<f64>,
    /// Whether the second flag declares the test unidirectional; `None` for a value other than 0 and 1.
    pub(super) unidirectional: Option<bool>,
    flags_line: usize,
}

pub(super) fn targets(document: &Document<'_>) -> Result<Targets, MetrologyError> {
    let section = document.required("TARGET DATA")?;
    let file = document.file;
    let (count_line, count) = section.required_value(file, "targetcount", "Target-count")?;
    let count = Place::new(file, count_line).count("Target-count", count)?;
    section.required_value(file, "targets", "Targets ")?;
    let (flags_line, flags) = section.required_value(file, "flags", "Flags")?;
    let values = target_list(section, file)?;
    if values.len() as u64 != u64::from(count) {
        let found = format!("`{count}`");
        let expected = format!("{}, the number of targets listed", values.len());
        return Err(Place::new(file, count_line).contradictory("Target-count", found, expected));
    }
    let unidirectional = second_flag(Place::new(file, flags_line), flags)?;
    Ok(Targets { values, unidirectional, flags_line })
}

/// All numbers between `Targets :` and `Flags`, on any number of lines.
fn target_list(section: &Section<'_>, file: &str) -> Result<Vec<f64>, MetrologyError> {
    let is_key = |line: &str, key: &str| key_value(line).is_some_and(|(k, _)| k == key);
    let mut values: Vec<f64> = Vec::new();
    let mut lines: HashMap<u64, usize> = HashMap::new();
    let from_list = section.lines.iter().skip_while(|(_, text)| !is_key(text, "targets"));
    for (index, (line, text)) in from_list.enumerate() {
        let place = Place::new(file, *line);
        let numbers = match text.split_once(':') {
            Some((_, rest)) if index == 0 => rest,
            _ if is_key(text, "flags") => break,
            _ => text,
        };
        for token in numbers.split_ascii_whitespace() {
            let value = place.number("target", token)?;
            if let Some(first) = lines.insert(value.to_bits(), *line) {
                let found = format!("{} again (first in line {first})", quoted(token));
                return Err(place.contradictory("target", found, "each target once"));
            }
            values.push(value);
        }
    }
    Ok(values)
}

fn second_flag(place: Place<'_>, text: &str) -> Result<Option<bool>, MetrologyError> {
    let flags: Option<Vec<i64>> = text.split_ascii_whitespace().map(|t| t.parse().ok()).collect();
    match flags.as_deref() {
        Some([_, second, _, _, ..]) => Ok(match second {
            0 => Some(false),
            1 => Some(true),
            _ => None,
        }),
        _ => Err(place.not_a_number("Flags", quoted(text), "four or more whole numbers")),
    }
}

pub(super) struct Row {
    pub(super) line: usize,
    pub(super) pass: u32,
    pub(super) target: f64,
    pub(super) deviation: f64,
}

struct RawRow<'t> {
    line: usize,
    pass: u32,
    target_text: &'t str,
    deviation: f64,
}

/// All rows under DEVIATIONS with their targets. Checks the rows against the declared counts.
pub(super) fn rows(document: &Document<'_>, targets: &[f64]) -> Result<Vec<Row>, MetrologyError> {
    let file = document.file;
    let (count_line, text) =
        document.required("RUNS")?.required_value(file, "runcount", "Run-count")?;
    let run_count = Place::new(file, count_line).count("Run-count", text)?;
    let section = document.required("DEVIATIONS")?;
    let raw = raw_rows(section, file, run_count)?;
    let column = TargetColumn::of(&raw, targets);
    let mut seen: HashMap<(u32, u64), usize> = HashMap::new();
    let mut rows = Vec::with_capacity(raw.len());
    for RawRow { line, pass, target_text, deviation } in raw {
        let place = Place::new(file, line);
        let target = column.target(place, target_text, targets)?;
        if let Some(first) = seen.insert((pass, target.to_bits()), line) {
            let found =
                format!("run {pass}, target {} again (first in line {first})", quoted(target_text));
            return Err(place.contradictory("reading", found, "each target once in a run"));
        }
        rows.push(Row { line, pass, target, deviation });
    }
    let expected = u64::from(run_count) * targets.len() as u64;
    if rows.len() as u64 != expected {
        let place = Place::new(file, rows.last().map_or(section.line, |r| r.line));
        let found = format!("{} readings", rows.len());
        let expected = format!("{expected}: Run-count {run_count} x {} targets", targets.len());
        return Err(place.contradictory("DEVIATIONS", found, expected));
    }
    Ok(rows)
}

fn raw_rows<'t>(
    section: &Section<'t>,
    file: &str,
    run_count: u32,
) -> Result<Vec<RawRow<'t>>, MetrologyError> {
    let is_title = |text: &str| {
        key_value(text).is_some_and(|(key, rest)| key == "runtargetdata" && rest.is_empty())
    };
    let mut rows = Vec::new();
    for (index, (line, text)) in section.lines.iter().enumerate() {
        let place = Place::new(file, *line);
        if index == 0 && is_title(text) {
            continue;
        }
        let columns: Vec<&str> = text.split_ascii_whitespace().collect();
        let [pass, target_text, deviation] = columns[..] else {
            let expected = "three columns: run, target, deviation";
            return Err(place.malformed("DEVIATIONS", quoted(text), expected));
        };
        let pass_number = place.count("run", pass)?;
        if pass_number > run_count {
            let expected = format!("a run from 1 to {run_count}, the Run-count");
            return Err(place.contradictory("run", quoted(pass), expected));
        }
        let deviation = place.number("deviation", deviation)?;
        rows.push(RawRow { line: *line, pass: pass_number, target_text, deviation });
    }
    Ok(rows)
}

/// Meaning of the middle column of DEVIATIONS, which is the same for the whole file. It is the number of the target in
/// the list (from 1) if every row permits this, else the target itself.
enum TargetColumn {
    Number,
    Value,
}

impl TargetColumn {
    fn of(rows: &[RawRow<'_>], targets: &[f64]) -> Self {
        let all_values = || rows.iter().all(|row| by_value(row.target_text, targets).is_some());
        if rows.iter().any(|row| by_number(row.target_text, targets).is_none()) && all_values() {
            Self::Value
        } else {
            Self::Number
        }
    }

    fn target(&self, place: Place<'_>, text: &str, targets: &[f64]) -> Result<f64, MetrologyError> {
        let target = match self {
            Self::Number => by_number(text, targets),
            Self::Value => by_value(text, targets),
        };
        target.ok_or_else(|| {
            let expected = format!("a target number from 1 to {}", targets.len());
            place.not_a_number("target", quoted(text), expected)
        })
    }
}

fn by_number(text: &str, targets: &[f64]) -> Option<f64> {
    let digits = text.bytes().all(|b| b.is_ascii_digit());
    let number = text.parse::<usize>().ok().filter(|_| digits)?;
    targets.get(number.checked_sub(1)?).copied()
}

/// The target closest to this value, within the rounding of six decimals.
fn by_value(text: &str, targets: &[f64]) -> Option<f64> {
    const ROUNDING: f64 = 1e-6;
    let value = Place::new("", 0).number("", text).ok()?;
    let near = |target: &&f64| (**target - value).abs() <= ROUNDING;
    let closest = |a: &&f64, b: &&f64| (**a - value).abs().total_cmp(&(**b - value).abs());
    targets.iter().filter(near).min_by(closest).copied()
}

/// Assigns directions and run numbers to the readings, with notes for the user.
///
/// The order of the targets in a pass determines its direction: ascending is forward. The direction is compared with
/// the second flag of the file. A file that states "bidirectional" but has passes of only one order is rejected,
/// because its reverse passes may have been sorted. For any other difference there is a note, and the order of the
/// targets is used. Reverse (even) passes that contain only zeros, beside forward passes with values, are omitted, with
/// a note.
pub(super) fn readings(
    file: &str,
    rows: Vec<Row>,
    targets: &Targets,
) -> Result<(Vec<Reading>, Vec<String>), MetrologyError> {
    let mut passes: BTreeMap<u32, Vec<Row>> = BTreeMap::new();
    for row in rows {
        passes.entry(row.pass).or_default().push(row);
    }
    let mut notes: Vec<String> =
        leave_out_zero_filled(&mut passes, targets.values.len()).into_iter().collect();
    notes.extend(zero_passes(&passes));
    let directions = passes
        .iter()
        .map(|(pass, rows)| Ok((*pass, direction_of(file, *pass, rows, targets)?)))
        .collect::<Result<Vec<_>, MetrologyError>>()?;
    notes.extend(compare_with_flags(file, &directions, targets)?);
    let readings = numbered(&passes, &directions);
    notes.extend(alignment_notes(&readings));
    Ok((readings, notes))
}

fn is_zero(rows: &[Row]) -> bool {
    rows.iter().all(|row| row.deviation == 0.0)
}

fn leave_out_zero_filled(
    passes: &mut BTreeMap<u32, Vec<Row>>,
    target_count: usize,
) -> Option<String> {
    let is_reverse = |pass: &u32| pass.is_multiple_of(2);
    let reverse: Vec<u32> = passes.keys().copied().filter(is_reverse).collect();
    let reverse_is_filled = passes.iter().all(|(pass, rows)| !is_reverse(pass) || is_zero(rows));
    let forward_is_real = passes.iter().any(|(pass, rows)| !is_reverse(pass) && !is_zero(rows));
    if reverse.is_empty() || target_count < 2 || !reverse_is_filled || !forward_is_real {
        return None;
    }
    passes.retain(|pass, _| !is_reverse(pass));
    Some(format!(
        "reverse {} left out: nothing but zeros, as written for a unidirectional test",
        runs_text(&reverse)
    ))
}

fn zero_passes(passes: &BTreeMap<u32, Vec<Row>>) -> Option<String> {
    let zero: Vec<u32> = passes
        .iter()
        .filter(|(_, rows)| rows.len() > 1 && is_zero(rows))
        .map(|(p, _)| *p)
        .collect();
    let suspicious = !zero.is_empty() && zero.len() < passes.len();
    suspicious.then(|| format!("{} kept, though nothing but zeros", runs_text(&zero)))
}

fn direction_of(
    file: &str,
    pass: u32,
    rows: &[Row],
    targets: &Targets,
) -> Result<Direction, MetrologyError> {
    let mut pairs = rows.windows(2);
    if rows.len() < 2 {
        let reverse = targets.unidirectional != Some(true) && pass.is_multiple_of(2);
        return Ok(if reverse { Direction::Negative } else { Direction::Positive });
    }
    let ascends = rows[0].target < rows[1].target;
    match pairs.find(|pair| (pair[0].target < pair[1].target) != ascends) {
        None if ascends => Ok(Direction::Positive),
        None => Ok(Direction::Negative),
        Some(pair) => {
            let found = format!("target {} after {} in run {pass}", pair[1].target, pair[0].target);
            let expected = "the targets of a run in the order of travel, ascending or descending";
            let place = Place::new(file, pair[1].line);
            Err(place.contradictory("order of targets", found, expected))
        }
    }
}

fn compare_with_flags(
    file: &str,
    directions: &[(u32, Direction)],
    targets: &Targets,
) -> Result<Option<String>, MetrologyError> {
    let one_way = directions.windows(2).all(|pair| pair[0].1 == pair[1].1);
    match targets.unidirectional {
        Some(false) if one_way && directions.len() > 1 && directions.iter().any(|(pass, _)| pass.is_multiple_of(2)) => {
            let place = Place::new(file, targets.flags_line);
            let found = format!("flags of a bidirectional test, and all {} runs in one direction", directions.len());
            let expected = "reverse runs in the order of travel, or a second flag of 1";
            Err(place.contradictory("Flags", found, expected))
        }
        Some(true) if !one_way => {
            Ok(Some("the flags say unidirectional, the order of the targets shows both directions: the order is believed".into()))
        }
        _ => Ok(None),
    }
}

/// Readings with their run numbers. The number of a run counts the passes of its direction.
fn numbered(passes: &BTreeMap<u32, Vec<Row>>, directions: &[(u32, Direction)]) -> Vec<Reading> {
    let mut readings = Vec::new();
    let mut runs: BTreeMap<Direction, u32> = BTreeMap::new();
    for (rows, (_, direction)) in passes.values().zip(directions) {
        let run = runs.entry(*direction).or_insert(0);
        *run += 1;
        let reading = |row: &Row| Reading {
            target: row.target,
            run: *run,
            direction: *direction,
            deviation: row.deviation,
        };
        readings.extend(rows.iter().map(reading));
    }
    readings
}

fn runs_text(passes: &[u32]) -> String {
    let list: Vec<String> = passes.iter().map(u32::to_string).collect();
    format!("run{} {}", if passes.len() == 1 { "" } else { "s" }, list.join(", "))
}

/// Reading that the file contains for a disconnected material sensor, °C.
const NO_SENSOR_DEGC: f64 = -10.0;

pub(super) fn environment(
    section: Option<&Section<'_>>,
    file: &str,
) -> Result<Environment, MetrologyError> {
    let mut environment = Environment::default();
    for (line, text) in section.map(|s| s.lines.as_slice()).unwrap_or_default() {
        let Some((key, value)) = key_value(text) else {
            continue;
        };
        if key == "datetime" {
            environment.date_time = Some(value.to_owned()).filter(|v| !v.is_empty());
            continue;
        }
        let Some(field) = field_of(&mut environment, &key) else {
            continue;
        };
        *field = start_end(Place::new(file, *line), text, value)?;
    }
    let connected = |t: &StartEnd| t.start != NO_SENSOR_DEGC && t.end != NO_SENSOR_DEGC;
    for sensor in &mut environment.material_temperature {
        *sensor = sensor.filter(connected);
    }
    Ok(environment)
}

fn field_of<'e>(environment: &'e mut Environment, key: &str) -> Option<&'e mut Option<StartEnd>> {
    let [first, second, third] = &mut environment.material_temperature;
    match key {
        "airtemp" => Some(&mut environment.air_temperature),
        "airpress" => Some(&mut environment.air_pressure),
        "airhumid" => Some(&mut environment.air_humidity),
        "mattemp1" => Some(first),
        "mattemp2" => Some(second),
        "mattemp3" => Some(third),
        "expcoeff" => Some(&mut environment.expansion_coefficient),
        "envfactor" => Some(&mut environment.environment_factor),
        _ => None,
    }
}

fn start_end(
    place: Place<'_>,
    line: &str,
    value: &str,
) -> Result<Option<StartEnd>, MetrologyError> {
    let tokens: Vec<&str> = value.split_ascii_whitespace().collect();
    let (start, end, code) = match tokens[..] {
        [] => return Ok(None),
        [start, end] => (start, end, None),
        [start, end, code] => (start, end, Some(code)),
        _ => {
            return Err(place.malformed("ENVIRONMENT", quoted(line), "start, end and a unit code"));
        }
    };
    let unit_code = match code.map(|c| (c, c.parse::<i64>())) {
        None => None,
        Some((_, Ok(code))) => Some(code),
        Some((text, Err(_))) => {
            return Err(place.not_a_number("unit code", quoted(text), "a whole number"));
        }
    };
    Ok(Some(StartEnd {
        start: place.number("start", start)?,
        end: place.number("end", end)?,
        unit_code,
    }))
}

const TARGETS_PER_LINE: usize = 5;

/// Writes a Renishaw laser file: `.rta` for deviations in µrad, `.rts` for straightness, otherwise `.rtl`.
///
/// Lines end with CRLF. There is one pass per run, forward and backward in turn. Reverse runs are in the order of
/// travel (targets descending). `Run-count` is the number of passes, and the second flag is 1 for one direction only.
/// Targets and µm have six decimals, milliradian nine. The format has only complete runs: if a run lacks a target,
/// counts and rows differ, and [`parse_renishaw`](crate::parse_renishaw) rejects the file. Line breaks in texts become
/// blanks.
pub fn write_renishaw(measurement: &Measurement) -> String {
    let kind = match measurement.unit {
        Some(DeviationUnit::Urad) => RenishawKind::Angular,
        _ if measurement.quantity == Some(Quantity::Straightness) => RenishawKind::Straightness,
        _ => RenishawKind::Linear,
    };
    let targets = measurement.targets();
    let passes = passes(measurement);
    let mut lines = header(measurement, kind);
    lines.extend(target_data(measurement, &targets));
    lines.extend(user_text(measurement));
    lines.extend(["RUNS::".into(), format!("Run-count: {}", passes.len())]);
    lines.extend(deviations(&passes, &targets, kind));
    lines.extend(environment_lines(&measurement.environment));
    lines.push("EOF::".into());
    lines.join("\r\n") + "\r\n"
}

/// Runs in the order of travel: forward 1, backward 1, forward 2, …
fn passes(measurement: &Measurement) -> Vec<Vec<Reading>> {
    let mut keys: Vec<(u32, Direction)> =
        measurement.readings.iter().map(|r| (r.run, r.direction)).collect();
    keys.sort_unstable();
    keys.dedup();
    let pass = |(run, direction): (u32, Direction)| {
        let of_pass =
            measurement.readings.iter().filter(|r| (r.run, r.direction) == (run, direction));
        let mut readings: Vec<Reading> = of_pass.copied().collect();
        readings.sort_by(|a, b| a.target.total_cmp(&b.target));
        if direction == Direction::Negative {
            readings.reverse();
        }
        readings
    };
    keys.into_iter().map(pass).collect()
}

fn header(measurement: &Measurement, kind: RenishawKind) -> Vec<String> {
    let meta = &measurement.metadata;
    vec![
        "HEADER::".into(),
        format!("File type  : {}", kind.file_type()),
        format!("Owner      : {}", one_line(meta.owner.as_ref())),
        format!("Version no : {}", one_line(meta.version.as_ref())),
    ]
}

fn target_data(measurement: &Measurement, targets: &[f64]) -> Vec<String> {
    let mut lines = vec![
        "TARGET DATA::".into(),
        "Filetype  : ISO".into(),
        format!("Target-count: {}", targets.len()),
        "Targets :".into(),
    ];
    for row in targets.chunks(TARGETS_PER_LINE) {
        let numbers: Vec<String> = row.iter().map(|t| format!("{t:.6}")).collect();
        lines.push(numbers.join("  "));
    }
    let both = Direction::BOTH.iter().all(|direction| measurement.has(*direction));
    lines.push(if both { "Flags: 0 0 2 0".into() } else { "Flags: 0 1 2 0".into() });
    lines
}

fn user_text(measurement: &Measurement) -> Vec<String> {
    let meta = &measurement.metadata;
    let texts = [
        ("Machine", &meta.machine),
        ("Serial No", &meta.serial),
        ("Date", &meta.date),
        ("By", &meta.by),
        ("Axis", &meta.axis),
        ("Location", &meta.location),
        ("TITLE", &meta.title),
    ];
    let line = |(key, text): (&str, &Option<String>)| format!("{key}:{}", one_line(text.as_ref()));
    std::iter::once("USER-TEXT::".to_owned()).chain(texts.into_iter().map(line)).collect()
}

fn one_line(text: Option<&String>) -> String {
    text.map(|t| t.replace(char::is_control, " ")).unwrap_or_default()
}

fn deviations(passes: &[Vec<Reading>], targets: &[f64], kind: RenishawKind) -> Vec<String> {
    let mut lines: Vec<String> = vec!["DEVIATIONS::".into(), "Run Target Data:".into()];
    for (pass, readings) in passes.iter().enumerate() {
        for reading in readings {
            let number = 1 + targets.partition_point(|t| *t < reading.target);
            let value = reading.deviation / kind.scale();
            let decimals = match kind {
                RenishawKind::Linear | RenishawKind::Straightness => 6,
                RenishawKind::Angular => 9,
            };
            lines.push(format!("{:>4} {number:>5} {value:>16.decimals$}", pass + 1));
        }
    }
    lines
}

fn environment_lines(environment: &Environment) -> Vec<String> {
    let mut lines: Vec<String> = vec!["ENVIRONMENT::".into()];
    let mut add = |key: &str, value: Option<StartEnd>, decimals: usize| {
        let Some(StartEnd { start, end, unit_code }) = value else {
            return;
        };
        let mut line = format!("{key:<11}: {start:.decimals$} {end:.decimals$}");
        if let Some(code) = unit_code {
            // Writing to a String cannot fail.
            let _ = write!(line, " {code}");
        }
        lines.push(line);
    };
    add("Air temp", environment.air_temperature, 6);
    add("Air press", environment.air_pressure, 6);
    add("Air humid", environment.air_humidity, 6);
    let no_sensor = StartEnd { start: NO_SENSOR_DEGC, end: NO_SENSOR_DEGC, unit_code: Some(0) };
    for (key, sensor) in
        ["Mat temp 1", "Mat temp 2", "Mat temp 3"].iter().zip(environment.material_temperature)
    {
        add(key, Some(sensor.unwrap_or(no_sensor)), 6);
    }
    add("Env factor", environment.environment_factor, 8);
    add("Exp coeff", environment.expansion_coefficient, 6);
    lines.extend(
        environment
            .date_time
            .as_ref()
            .map(|t| format!("{:<11}: {}", "Date Time", one_line(Some(t)))),
    );
    lines
}
