//! Sections with numbers: targets with their flags, the number of runs, and the deviations.

use std::collections::HashMap;

use volcomp_document::quoted;

use super::document::{Document, Section, key_value};
use crate::MetrologyError;
use crate::number::Place;

pub(super) struct Targets {
    pub(super) values: Vec<f64>,
    /// Whether the second flag declares the test unidirectional; `None` for a value other than 0 and 1.
    pub(super) unidirectional: Option<bool>,
    pub(super) flags_line: usize,
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
