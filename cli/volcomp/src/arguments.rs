//! Arguments that several commands share: machine, positions, limits, and the unit of a measurement file.

use std::{
    fs::{self, File},
    io::{BufReader, Read, Seek, Write},
    path::{Path, PathBuf},
};

use clap::{Args, ValueEnum};
use schemars::JsonSchema;
use serde::Serialize;
use volcomp_document::{
    Column, CsvBatches, CsvRow, CsvTable, InputError, ReadError, read_text, split_head, unit_named,
};
use volcomp_kinematics::State;
use volcomp_metrology::{DeviationUnit, Measurement, ReadingUnit};
use volcomp_model::{Machine, ModelError, Temperatures, axis_of_head};
use volcomp_tables::axis_table::AxisNumbers;
use volcomp_vocabulary::{AxisName, CorrectionLimit, Direction, bounds::PLAUSIBLE_DEGC};

use crate::failure::Failure;

/// The machine and the tool in its spindle.
#[derive(Args)]
pub(crate) struct MachineArguments {
    /// Machine file (TOML)
    #[arg(long, short, value_name = "FILE")]
    pub(crate) machine: PathBuf,
    #[command(flatten)]
    pub(crate) spindle: SpindleArguments,
}

/// The machine and the tool in its spindle, for commands that ignore the errors of the machine.
#[derive(Args)]
pub(crate) struct GeometryArguments {
    /// Machine file (TOML)
    #[arg(long, short, value_name = "FILE")]
    pub(crate) machine: PathBuf,
    /// Tool of the table `[tools]` in the machine file [default: that of `[tool]`]
    #[arg(long)]
    tool: Option<String>,
}

/// The tool in the spindle and the temperatures of the sensors, on which the errors of a machine
/// also depend.
#[derive(Args)]
pub(crate) struct SpindleArguments {
    /// Tool of the table `[tools]` in the machine file [default: that of `[tool]`]
    #[arg(long)]
    pub(crate) tool: Option<String>,
    /// Steady sensor temperatures, °C: NAME=DEGC,…; thermal terms of other sensors are left out
    #[arg(long)]
    pub(crate) temperature: Vec<String>,
}

/// Positions of the axes that a command does not vary.
#[derive(Args)]
pub(crate) struct OthersArguments {
    /// Positions of the axes other than X, Y and Z: A=30,C=-90 (deg, mm); axes not named are at 0
    #[arg(long, allow_hyphen_values = true)]
    at: Option<String>,
}

impl OthersArguments {
    /// The coordinates of the named axes, mm or deg. Adds a note on coordinates outside the travel.
    pub(crate) fn read(
        &self,
        machine: &Machine,
        notes: &mut Vec<String>,
    ) -> Result<Vec<(AxisName, f64)>, Failure> {
        let Some(text) = &self.at else {
            return Ok(Vec::new());
        };
        let others = parse_at(text)?;
        for (name, _) in &others {
            if matches!(name, AxisName::X | AxisName::Y | AxisName::Z) {
                return Err(Failure::Input(format!(
                    "--at: found {name}, which goes over its travel here, expected other axes"
                )));
            }
        }
        let beyond = others.iter().filter_map(|&(name, at)| {
            let axis = machine.axis(name)?;
            let [low, high] = axis.travel;
            let is_within = axis.modulo.is_some() || axis.contains(at);
            let unit = name.kind().coordinate_unit();
            (!is_within).then(|| format!("{name} = {at} {unit}, travel {low} to {high} {unit}"))
        });
        let beyond: Vec<String> = beyond.collect();
        if !beyond.is_empty() {
            notes.push(format!("--at: outside travel: {}", beyond.join("; ")));
        }
        Ok(others)
    }
}

/// The positions to evaluate: one from the command line, or the rows of a CSV file.
#[derive(Args)]
#[group(required = true, multiple = true)]
pub(crate) struct PointArguments {
    /// One position: X=100,Y=200,Z=-50 (mm, deg); axes not named are at 0
    #[arg(long, conflicts_with = "points", allow_hyphen_values = true)]
    pub(crate) at: Option<String>,
    /// CSV file of positions, with axis letters as header, alone or with the unit (X, X mm, C_deg); other columns are
    /// copied
    #[arg(long, value_name = "FILE")]
    pub(crate) points: Option<PathBuf>,
}

/// The direction each axis came from.
#[derive(Args)]
pub(crate) struct ApproachArguments {
    /// Direction of the last motion, for curves with reversal: X=+,Y=- [default: mean of both]
    #[arg(long, allow_hyphen_values = true)]
    pub(crate) approach: Option<String>,
}

/// One position of `--at`, or many of `--points`.
#[derive(Debug, Serialize, JsonSchema)]
#[serde(untagged)]
#[expect(dead_code, reason = "describes what `Listing` writes row by row")]
pub(crate) enum OneOrMany<T> {
    /// The answer for a single position.
    One(T),
    /// The answers in the order of the rows of the file.
    Many {
        /// One answer for each row.
        points: Vec<T>,
    },
}

/// Maximum number of positions in a [`Batch`].
const BATCH: usize = 4096;

/// The requested positions: a single one, or the positions of a file in the order of its rows.
pub(crate) struct Positions {
    source: Source,
    approach: Vec<(usize, Option<Direction>)>,
    /// The axes of the machine that are at 0 because the user does not name them, in the order of [`AxisName::ALL`].
    unnamed: Vec<AxisName>,
}

enum Source {
    /// The position of the command line; `None` once it was returned.
    One(Option<State>),
    File(Box<PointFile>),
}

#[derive(Default)]
pub(crate) struct Batch {
    pub(crate) states: Vec<State>,
    /// Rows of the positions; `None` for a position of the command line.
    pub(crate) table: Option<CsvTable>,
}

impl Positions {
    /// The next positions; empty after the last one.
    pub(crate) fn next_batch(&mut self, machine: &Machine) -> Result<Batch, Failure> {
        let mut batch = match &mut self.source {
            Source::One(state) => Batch { states: state.take().into_iter().collect(), table: None },
            Source::File(file) => file.next_batch(machine)?,
        };
        for state in &mut batch.states {
            for &(index, direction) in &self.approach {
                state.approach[index] = direction;
            }
        }
        Ok(batch)
    }

    /// The table of the positions without its rows, for its header; `None` for a position of the command line.
    pub(crate) fn head(&self) -> Option<&CsvTable> {
        match &self.source {
            Source::One(_) => None,
            Source::File(file) => Some(file.batches.head()),
        }
    }

    /// Note on the axes at 0 because they are not named. If `count` is 0: note that the file has no position.
    pub(crate) fn note(&self, count: usize) -> Option<String> {
        if count == 0 {
            return Some("--points has no row under its header".to_owned());
        }
        let names: Vec<String> = self.unnamed.iter().map(ToString::to_string).collect();
        let names = (!names.is_empty()).then(|| names.join(", "))?;
        Some(match &self.source {
            Source::One(_) => format!("at 0, as --at does not name them: {names}"),
            Source::File(_) => format!("at 0, as no column is headed by their letters: {names}"),
        })
    }
}

impl MachineArguments {
    pub(crate) fn read(&self) -> Result<(Machine, Temperatures), Failure> {
        self.spindle.read(&self.machine)
    }
}

impl GeometryArguments {
    pub(crate) fn read(&self) -> Result<Machine, Failure> {
        with_tool(&self.machine, self.tool.as_deref())
    }
}

fn with_tool(path: &Path, tool: Option<&str>) -> Result<Machine, Failure> {
    let mut machine = Machine::read(path).map_err(|error| not_compiled(path, error))?;
    if let Some(tool) = tool {
        machine.select_tool(tool)?;
    }
    Ok(machine)
}

impl SpindleArguments {
    pub(crate) fn read(&self, path: &Path) -> Result<(Machine, Temperatures), Failure> {
        let machine = with_tool(path, self.tool.as_deref())?;
        let temperatures = self.temperatures(&machine)?;
        Ok((machine, temperatures))
    }

    fn temperatures(&self, machine: &Machine) -> Result<Temperatures, Failure> {
        let sensors = machine.thermal().sensors();
        let mut temperatures = Temperatures::new();
        let given = self.temperature.join(",");
        for (name, value) in assignments("--temperature", &given, SENSORS, "NAME=DEGC")? {
            let degc = number("--temperature", name, value, "°C")?;
            if !PLAUSIBLE_DEGC.contains(&degc) {
                return Err(Failure::Input(format!(
                    "--temperature: found `{name}={value}`, expected {} to {} °C",
                    PLAUSIBLE_DEGC.start(),
                    PLAUSIBLE_DEGC.end()
                )));
            }
            if !sensors.contains(&name) {
                let expected = if sensors.is_empty() {
                    "none: the machine file has no thermal terms".to_owned()
                } else {
                    format!("one of: {}", sensors.join(", "))
                };
                let message = format!("--temperature: found sensor `{name}`, expected {expected}");
                return Err(Failure::Input(message));
            }
            if temperatures.insert(name.to_owned(), degc).is_some() {
                return Err(Failure::Input(format!(
                    "--temperature: sensor `{name}` appears twice"
                )));
            }
        }
        Ok(temperatures)
    }
}

/// The positions in the rows of a CSV file, and the note on them. The direction of approach is unknown.
pub(crate) fn states_of(
    machine: &Machine,
    path: &Path,
) -> Result<(Vec<State>, Option<String>), Failure> {
    let arguments = PointArguments { at: None, points: Some(path.to_owned()) };
    let mut positions = arguments.positions(machine, &ApproachArguments { approach: None })?;
    let mut states = Vec::new();
    loop {
        let batch = positions.next_batch(machine)?;
        if batch.states.is_empty() {
            let note = positions.note(states.len());
            return Ok((states, note));
        }
        states.extend(batch.states);
    }
}

/// Parses the three numbers of an option such as `--tip 100,-20,35.5`.
pub(crate) fn three(option: &str, text: &str) -> Result<[f64; 3], Failure> {
    let expected = "three finite numbers with decimal points: 100,-20,35.5";
    numbers(option, text, expected)
}

pub(crate) fn numbers<const N: usize>(
    option: &str,
    text: &str,
    expected: &str,
) -> Result<[f64; N], Failure> {
    let numbers: Option<Vec<f64>> = text
        .split([',', ';'])
        .map(|number| number.trim().parse::<f64>().ok().filter(|x| x.is_finite()))
        .collect();
    numbers
        .and_then(|numbers| numbers.try_into().ok())
        .ok_or_else(|| Failure::Input(format!("{option}: found `{text}`, expected {expected}")))
}

/// Parses `--axis-numbers X=1,C=4`.
pub(crate) fn axis_numbers(text: &str) -> Result<AxisNumbers, Failure> {
    const OPTION: &str = "--axis-numbers";
    let mut numbers = Vec::new();
    for (letter, value) in assignments(OPTION, text, AXES, "X=1")? {
        let name = axis(OPTION, letter)?;
        let number = value.parse::<u16>().ok().filter(|number| *number > 0);
        let number = number.ok_or_else(|| {
            Failure::Input(format!(
                "{OPTION}: found `{name}={value}`, expected a whole number from 1 on"
            ))
        })?;
        numbers.push((name, number));
    }
    AxisNumbers::stated(numbers).ok_or_else(|| {
        Failure::Input(format!("{OPTION}: found `{text}`, expected each axis and each number once"))
    })
}

impl PointArguments {
    pub(crate) fn positions(
        &self,
        machine: &Machine,
        approach: &ApproachArguments,
    ) -> Result<Positions, Failure> {
        let approach = approach.directions(machine)?;
        let (source, named) = match (&self.at, &self.points) {
            (_, Some(path)) => {
                let file = PointFile::open(machine, path)?;
                let named = file.columns.iter().map(|&(name, _)| name).collect();
                (Source::File(Box::new(file)), named)
            }
            (at, None) => {
                let coordinates = parse_at(at.as_deref().unwrap_or_default())?;
                let named: Vec<_> = coordinates.iter().map(|&(name, _)| name).collect();
                (Source::One(Some(machine.state(&coordinates)?)), named)
            }
        };
        let has = |name: &AxisName| machine.axis(*name).is_some() && !named.contains(name);
        Ok(Positions { source, approach, unnamed: AxisName::ALL.into_iter().filter(has).collect() })
    }
}

impl ApproachArguments {
    fn directions(&self, machine: &Machine) -> Result<Vec<(usize, Option<Direction>)>, Failure> {
        let mut directions = Vec::new();
        let given = self.approach.as_deref().unwrap_or_default();
        for (name, sign) in assignments("--approach", given, AXES, "X=+ or X=-")? {
            let direction = match sign {
                "+" => Some(Direction::Positive),
                "-" => Some(Direction::Negative),
                _ => {
                    let message =
                        format!("--approach: found `{name}={sign}`, expected {name}=+ or {name}=-");
                    return Err(Failure::Input(message));
                }
            };
            let index = machine.index_of(axis("--approach", name)?)?;
            if directions.iter().any(|&(other, _)| other == index) {
                return Err(Failure::Input(format!("--approach: axis {name} appears twice")));
            }
            directions.push((index, direction));
        }
        Ok(directions)
    }
}

/// Returns another failure instead of invalid UTF-8 if the file is a compiled machine.
fn not_compiled(path: &Path, error: ModelError) -> Failure {
    let starts_with_magic = || {
        let mut start = [0; 8];
        let read = File::open(path).and_then(|mut file| file.read_exact(&mut start));
        read.is_ok() && start == *b"VOLCOMPM"
    };
    match error {
        ModelError::Read(ReadError::Encoding { .. }) if starts_with_magic() => Failure::in_file(
            path,
            "found a compiled machine (volcomp compile), expected a machine file (TOML)",
        ),
        other => other.into(),
    }
}

/// Parses the coordinates of `--at`, mm or deg. At least one axis is required.
pub(crate) fn parse_at(text: &str) -> Result<Vec<(AxisName, f64)>, Failure> {
    let at = by_axis("--at", text)?;
    if at.is_empty() {
        let message = "--at: found no axis, expected X=100 for each axis that is not at 0";
        return Err(Failure::Input(message.to_owned()));
    }
    Ok(at)
}

/// Parses numbers by axis, such as `X=100,Y=200`. An axis may appear once.
pub(crate) fn by_axis(option: &str, text: &str) -> Result<Vec<(AxisName, f64)>, Failure> {
    let mut found: Vec<(AxisName, f64)> = Vec::new();
    for (letter, value) in assignments(option, text, AXES, "X=100")? {
        let name = axis(option, letter)?;
        if found.iter().any(|&(other, _)| other == name) {
            return Err(Failure::Input(format!("{option}: axis {name} appears twice")));
        }
        let unit = name.kind().coordinate_unit();
        found.push((name, number(option, letter, value, unit)?));
    }
    Ok(found)
}

const AXES: &[char] = &[',', ';', ' ', '\t', '\n'];

/// Separators of sensor assignments. A blank does not separate, because sensor names may contain blanks.
const SENSORS: &[char] = &[',', ';'];

/// Parses a list of assignments into names and values. Any of the `separators` separates assignments; blanks around
/// names and values are ignored. `example` is a valid assignment for messages.
fn assignments<'a>(
    option: &str,
    text: &'a str,
    separators: &[char],
    example: &str,
) -> Result<Vec<(&'a str, &'a str)>, Failure> {
    let is_separator = |c: char| separators.contains(&c);
    let is_between = |c: char| c.is_whitespace() || is_separator(c);
    let mut found: Vec<(&str, &str)> = Vec::new();
    let mut rest = text.trim_matches(is_between);
    while !rest.is_empty() {
        let (name, behind) = match rest.find(|c| c == '=' || is_separator(c)) {
            Some(end) => rest.split_at(end),
            None => (rest, ""),
        };
        let name = name.trim_end();
        let Some(behind) = behind.trim_start().strip_prefix('=') else {
            return Err(Failure::Input(no_assignment(option, name, &found, example)));
        };
        let behind = behind.trim_start();
        let (value, behind) = behind.split_at(behind.find(is_separator).unwrap_or(behind.len()));
        if name.is_empty() {
            let message = format!("{option}: found `={value}`, expected {example}");
            return Err(Failure::Input(message));
        }
        found.push((name, value.trim_end()));
        rest = behind.trim_start_matches(is_between);
    }
    Ok(found)
}

/// Message about a word without `=`. Digits after a number are probably the decimals after a decimal comma.
fn no_assignment(option: &str, word: &str, before: &[(&str, &str)], example: &str) -> String {
    if let Some((name, value)) = before.last()
        && word.bytes().all(|byte| byte.is_ascii_digit())
        && value.parse::<i64>().is_ok()
    {
        return format!(
            "{option}: found `{name}={value},{word}`, expected a decimal point: {name}={value}.{word}"
        );
    }
    format!("{option}: found `{word}`, expected {example}")
}

pub(crate) fn axis(option: &str, name: &str) -> Result<AxisName, Failure> {
    name.to_ascii_uppercase().parse().map_err(|_| {
        Failure::Input(format!("{option}: found axis `{name}`, expected one of X Y Z A B C U V W"))
    })
}

fn number(option: &str, name: &str, text: &str, unit: &str) -> Result<f64, Failure> {
    let number = text.parse::<f64>().ok().filter(|number| number.is_finite());
    number.ok_or_else(|| {
        Failure::Input(format!(
            "{option}: found `{name}={text}`, expected a finite number of {unit}, without the unit"
        ))
    })
}

/// A table of positions, one state per row. The table is read in batches, because a file may have any number of rows.
struct PointFile {
    path: PathBuf,
    /// The same file, which is read again to find the line of an error.
    text: File,
    batches: CsvBatches<BufReader<File>>,
    /// The axes with a column of coordinates.
    columns: Vec<(AxisName, Column)>,
}

/// Suffixes of the axis letter in the columns that `volcomp correct` adds.
const OF_A_CORRECTION: [&str; 4] =
    ["_corrected_mm", "_corrected_deg", "_correction_um", "_correction_urad"];

#[derive(Debug, PartialEq, Eq)]
enum Head<'a> {
    /// Coordinates of an axis, mm or deg.
    Coordinates(AxisName),
    /// An axis letter with a known unit that is no unit of coordinates.
    OtherUnit(AxisName, &'a str),
    /// An axis letter followed by no known unit: positions in an unknown unit, or another quantity.
    Unclear(AxisName),
    Other,
}

impl PointFile {
    /// Opens a file with axis letters in its header and one position per row.
    fn open(machine: &Machine, path: &Path) -> Result<Self, Failure> {
        let name = path.display().to_string();
        let text = rewindable(path)?;
        let opened =
            text.try_clone().and_then(|text| CsvBatches::open(&name, BufReader::new(text)));
        let batches =
            opened.map_err(|e| refused(machine, path, &text, Failure::in_file(path, e)))?;
        let columns = columns(batches.head(), machine)
            .map_err(|e| refused(machine, path, &text, e.into()))?;
        Ok(Self { path: path.to_owned(), text, batches, columns })
    }

    fn next_batch(&mut self, machine: &Machine) -> Result<Batch, Failure> {
        let refused = |failure| refused(machine, &self.path, &self.text, failure);
        let table = self.batches.next_rows(BATCH);
        let table = table.map_err(|e| refused(Failure::in_file(&self.path, e)))?;
        Ok(Batch {
            states: states(&table, &self.columns, machine).map_err(refused)?,
            table: Some(table),
        })
    }
}

/// Opens a file that can be read several times. A pipe is copied to a temporary file.
fn rewindable(path: &Path) -> Result<File, Failure> {
    if fs::metadata(path).is_ok_and(|of| of.is_file())
        && let Ok(file) = File::open(path)
    {
        return Ok(file);
    }
    let text = read_text(path)?;
    let copied = tempfile::tempfile().and_then(|mut file| {
        file.write_all(text.as_bytes())?;
        file.rewind()?;
        Ok(file)
    });
    copied.map_err(|error| Failure::Work(format!("temporary file: {error}")))
}

/// Parses the whole file again to find the line of a failure. Returns `failure` itself if the file has no error.
fn refused(machine: &Machine, path: &Path, mut text: &File, failure: Failure) -> Failure {
    let mut bytes = Vec::new();
    let read = text.rewind().and_then(|()| text.read_to_end(&mut bytes));
    let whole = || -> Result<(), Failure> {
        read.map_err(|error| Failure::work_on(path, &error))?;
        let text = match String::from_utf8(bytes) {
            Ok(text) => text,
            // The file was a pipe, which has been read as text before.
            Err(_) => read_text(path)?,
        };
        let table = CsvTable::parse(&path.display().to_string(), &text)?;
        states(&table, &columns(&table, machine)?, machine)?;
        Ok(())
    };
    whole().err().unwrap_or(failure)
}

/// The columns of coordinates. Each column belongs to an axis of the machine.
fn columns(table: &CsvTable, machine: &Machine) -> Result<Vec<(AxisName, Column)>, InputError> {
    let columns = coordinates(table, machine)?;
    for &(name, _) in &columns {
        machine.index_of(name).map_err(|e| table.header_error(e.to_string()))?;
    }
    Ok(columns)
}

fn states(
    table: &CsvTable,
    columns: &[(AxisName, Column)],
    machine: &Machine,
) -> Result<Vec<State>, Failure> {
    let state = |row: CsvRow<'_>| {
        let mut coordinates = Vec::new();
        for &(name, column) in columns {
            coordinates.push((name, row.cell(column).number()?));
        }
        Ok(machine.state(&coordinates)?)
    };
    table.rows().map(state).collect()
}

/// The column of each axis that the header names. If there is a column `X`, a column `x` is another quantity, as in
/// files of targets. An axis letter in another or an unknown unit is an error if the axis has no column of positions,
/// because the axis must not silently be at 0.
fn coordinates(table: &CsvTable, machine: &Machine) -> Result<Vec<(AxisName, Column)>, InputError> {
    let is_small = |text: &str| text.starts_with(|letter: char| letter.is_ascii_lowercase());
    let mut found: Vec<(AxisName, Column, &str)> = Vec::new();
    for (column, text) in table.names() {
        if let Head::Coordinates(name) = head(text) {
            found.push((name, column, text));
        }
    }
    let has_large: Vec<AxisName> =
        found.iter().filter(|(_, _, text)| !is_small(text)).map(|(name, _, _)| *name).collect();
    found.retain(|(name, _, text)| !(is_small(text) && has_large.contains(name)));
    let mut columns: Vec<(AxisName, Column)> = Vec::new();
    for (place, &(name, column, text)) in found.iter().enumerate() {
        if let Some((_, _, first)) = found[..place].iter().find(|(axis, _, _)| *axis == name) {
            return Err(table.header_error(if *first == text {
                format!("column `{text}` appears twice")
            } else {
                format!(
                    "found columns `{first}` and `{text}`, expected one with positions of {name}"
                )
            }));
        }
        columns.push((name, column));
    }
    for (_, text) in table.names() {
        let (name, in_unit) = match head(text) {
            Head::OtherUnit(name, unit) => (name, format!(" with the unit `{unit}`")),
            Head::Unclear(name) if machine.axis(name).is_some() => (name, String::new()),
            _ => continue,
        };
        if columns.iter().all(|(axis, _)| *axis != name) {
            let expected = name.kind().coordinate_unit();
            return Err(table.header_error(format!(
                "found column `{text}`{in_unit}, expected positions of {name} in {expected}: {name} or {name}_{expected}"
            )));
        }
    }
    if columns.is_empty() {
        let expected = "found no axis letter, expected at least one of X Y Z A B C U V W, alone or with its unit: X, X mm, X_mm, C_deg";
        return Err(table.header_error(expected));
    }
    Ok(columns)
}

/// Parses a column header: an axis letter in upper or lower case, alone or with a unit: `X`, `X mm`, `x_mm`, `X [mm]`,
/// `C (deg)`.
fn head(text: &str) -> Head<'_> {
    let mut letters = text.chars();
    let first = letters.next().map(|letter| letter.to_ascii_uppercase());
    let (Some(name), rest) = (first.and_then(AxisName::from_letter), letters.as_str()) else {
        return Head::Other;
    };
    let unit = split_head(text).1;
    // A letter that continues as a word, such as `Zone` or `amount`, is no axis.
    let is_word = rest.starts_with(char::is_alphabetic);
    if is_word || OF_A_CORRECTION.contains(&rest) {
        Head::Other
    } else if axis_of_head(&format!("{name}{rest}")) == Some(name) {
        Head::Coordinates(name)
    } else if unit_named(unit).is_some() {
        Head::OtherUnit(name, unit)
    } else {
        Head::Unclear(name)
    }
}

pub(crate) const RAISE_LIMIT: &str = ", or allow more with --limit-um";

/// The option of the commands that write corrections.
#[derive(clap::Args)]
pub(crate) struct LimitArgument {
    /// Largest correction of an axis: µm for linear, µrad for rotary axes, at most 2000; above it nothing is written
    #[arg(long, value_name = "UM", default_value_t = 250.0, allow_negative_numbers = true)]
    limit_um: f64,
}

impl LimitArgument {
    pub(crate) fn limit(&self) -> Result<CorrectionLimit, Failure> {
        CorrectionLimit::new(self.limit_um)
            .map_err(|error| Failure::Input(format!("--limit-um: {error}")))
    }
}

/// A unit of deviations; the names are the values of `--unit`.
#[derive(Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(crate) enum Unit {
    Mm,
    Um,
    Nm,
    Deg,
    Arcsec,
    Rad,
    Mrad,
    Urad,
}

impl Unit {
    fn of_readings(self) -> ReadingUnit {
        match self {
            Self::Mm => ReadingUnit::Mm,
            Self::Um => ReadingUnit::Um,
            Self::Nm => ReadingUnit::Nm,
            Self::Deg => ReadingUnit::Deg,
            Self::Arcsec => ReadingUnit::Arcsec,
            Self::Rad => ReadingUnit::Rad,
            Self::Mrad => ReadingUnit::Mrad,
            Self::Urad => ReadingUnit::Urad,
        }
    }

    fn key(self) -> String {
        self.to_possible_value().map_or_else(String::new, |value| value.get_name().to_owned())
    }
}

/// The note that a file does not state its unit, with a hint if the values look like mm.
fn not_stated(measurement: &Measurement) -> String {
    /// Maximum deviation that is implausibly small for a machine tool, µm.
    const TOO_SMALL: f64 = 0.1;
    let sizes = measurement.readings.iter().map(|r| r.deviation.abs());
    let largest = sizes.fold(0.0, f64::max);
    let hint = if largest > 0.0 && largest < TOO_SMALL {
        format!("; all are below {TOO_SMALL}: are they mm?")
    } else {
        String::new()
    };
    format!(
        "the unit of the deviations is not stated, taken as µm: state it with --unit, or in the header as `deviation µm`{hint}"
    )
}

/// Converts the deviations of a file to µm or µrad. `stated` is the unit of a file without a unit; it may repeat the
/// unit of the file, but not change it. If neither states a unit, µm is assumed.
pub(crate) fn apply(
    file: &Path,
    measurement: &mut Measurement,
    stated: Option<Unit>,
) -> Result<DeviationUnit, Failure> {
    let Some(stated) = stated else {
        if measurement.unit.is_none() {
            let note = not_stated(measurement);
            measurement.notes.push(note);
        }
        return Ok(measurement.unit.unwrap_or(DeviationUnit::Um));
    };
    let unit = stated.of_readings();
    measurement.convert_from(unit).map_err(|found| {
        Failure::in_file(
            file,
            format_args!("found deviations in {found}, expected {unit} (--unit {})", stated.key()),
        )
    })?;
    Ok(unit.deviation_unit())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_of_sensors_may_have_blanks() {
        let given = "bed left = 20,column=21 ";
        let sensors = assignments("--temperature", given, SENSORS, "NAME=°C");
        let expected = vec![("bed left", "20"), ("column", "21")];
        assert_eq!(sensors.ok(), Some(expected));
    }

    #[test]
    fn heads_are_letters_alone_or_with_their_unit() {
        let (x, c) = (AxisName::X, AxisName::C);
        for text in ["X", "x", "X mm", "X_mm", "x [mm]", "X (MM)", "X/mm", "X, mm"] {
            assert_eq!(head(text), Head::Coordinates(x), "{text}");
        }
        for text in ["C", "C deg", "C_deg", "c [°]", "C°"] {
            assert_eq!(head(text), Head::Coordinates(c), "{text}");
        }
        for (text, name, unit) in [
            ("X in", x, "in"),
            ("X_um", x, "um"),
            ("X [µm]", x, "µm"),
            ("C rad", c, "rad"),
            ("C_mm", c, "mm"),
            ("X deg", x, "deg"),
        ] {
            assert_eq!(head(text), Head::OtherUnit(name, unit), "{text}");
        }
        for text in [
            "X_inches",
            "X_mil",
            "X(thou)",
            "X [dm]",
            "X 1/1000in",
            "X:",
            "X'",
            "X1",
            "X#mm",
            "X remark",
            "X_corrected_in",
        ] {
            assert_eq!(head(text), Head::Unclear(x), "{text}");
        }
        for text in [
            "",
            "N",
            "Xmm",
            "Zone",
            "amount",
            "X_corrected_mm",
            "X_correction_um",
            "error_x_um",
            "uncertainty_x_um",
            "µ",
        ] {
            assert_eq!(head(text), Head::Other, "{text}");
        }
    }
}
