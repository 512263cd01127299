//! Tables with one row for each target and one column for each run, with heads such as `Target (mm), Run 1 fwd, Run 1
//! bwd, …`.

use std::collections::BTreeSet;

use volcomp_document::{Column, CsvRow, CsvTable, quoted};

use crate::csv_head::{direction_named, inches_without_targets};
use crate::number::{Place, range};
use crate::{DeviationUnit, Direction, MetrologyError, ReadingUnit, TargetUnit};

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
    pub(crate) in_inches: bool,
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
