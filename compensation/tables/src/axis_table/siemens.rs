//! SINUMERIK 840D: leadscrew errors as `$AA_ENC_COMP` in AX_EEC.INI, all others as `$AN_CEC` in NC_CEC.INI.

use core::fmt::Write;
use std::{cell::RefCell, collections::BTreeMap};

use volcomp_document::quoted;
use volcomp_vocabulary::AxisName;

use super::options::{AxisNumbers, ReadOptions, WriteOptions, Written, numbers_in};
use super::table::{AxisTable, from_file_unit, interpolated};
use super::text::{ExchangeError, FilePosition, Format, TextFile, Warning, fixed, number, short};

pub(crate) fn read(
    files: &[&TextFile],
    options: &ReadOptions,
    warnings: &mut Vec<Warning>,
) -> Result<Vec<AxisTable>, ExchangeError> {
    let mut found = Statements::default();
    for file in files {
        found.take(file, warnings)?;
    }
    let stated = AxisNumbers::stated(std::mem::take(&mut found.stated)).unwrap_or_default();
    let names = AxisNames { options: &options.axes, stated, numbered: RefCell::default() };
    let mut tables = Vec::new();
    leadscrews(&found, &names, options.encoder, &mut tables, warnings)?;
    cross(&found, &names, &mut tables, warnings)?;
    Ok(tables)
}

struct AxisNames<'a> {
    options: &'a AxisNumbers,
    stated: AxisNumbers,
    /// First name found for each axis with a name of a letter and a number, such as X1.
    numbered: RefCell<BTreeMap<AxisName, String>>,
}

impl AxisNames<'_> {
    fn axis(&self, here: FilePosition<'_>, name: &str) -> Result<AxisName, ExchangeError> {
        let bare = name.trim_matches(['(', ')', ' ']).to_ascii_uppercase();
        if let Ok(axis) = bare.parse() {
            return Ok(axis);
        }
        // Default names of machine axes: X1, Y1, Z1.
        let letter = bare.trim_end_matches(|c: char| c.is_ascii_digit());
        if let Ok(axis) = letter.parse() {
            let mut numbered = self.numbered.borrow_mut();
            let other = numbered.entry(axis).or_insert_with(|| bare.clone());
            if *other == bare {
                return Ok(axis);
            }
            let found = format!("axis `{bare}` in addition to `{other}`");
            return Err(here.error(found, "one machine axis of each letter"));
        }
        let number = bare.strip_prefix("AX").and_then(|n| n.parse().ok());
        let of = |number| {
            let stated = self.options.axis(number);
            stated.or_else(|| self.stated.axis(number))
        };
        number.and_then(of).ok_or_else(|| {
            here.error(format!("axis `{bare}`"), "a letter, a letter with a number (X1), or a number whose letter is stated (--axis-numbers X=1,Y=2)")
        })
    }
}

fn leadscrews(
    found: &Statements<'_>,
    names: &AxisNames<'_>,
    encoder: Option<u8>,
    tables: &mut Vec<AxisTable>,
    warnings: &mut Vec<Warning>,
) -> Result<(), ExchangeError> {
    let mut seen: Vec<AxisName> = Vec::new();
    for ((number, axis), parameters) in &found.enc {
        if encoder.is_some_and(|wanted| u32::from(wanted) != *number) {
            continue;
        }
        let name = format!("$AA_ENC_COMP of encoder {number}, axis {axis}");
        let Some(points) = points(&name, parameters, warnings)? else {
            continue;
        };
        let axis = names.axis(parameters.last, axis)?;
        let table = points.table(axis, axis);
        if encoder.is_none() && table.is_zero() {
            continue;
        }
        if seen.contains(&axis) {
            let found = format!("tables of both encoders of axis {axis}");
            let expected = "the encoder that is meant: --encoder 0 or 1";
            return Err(parameters.last.error(found, expected));
        }
        seen.push(axis);
        tables.push(table);
    }
    Ok(())
}

fn cross(
    found: &Statements<'_>,
    names: &AxisNames<'_>,
    tables: &mut Vec<AxisTable>,
    warnings: &mut Vec<Warning>,
) -> Result<(), ExchangeError> {
    // Tables for a single direction, stored until the table for the other direction is found.
    let mut halves: BTreeMap<(AxisName, AxisName), [Option<AxisTable>; 2]> = BTreeMap::new();
    for (number, parameters) in &found.cec {
        let here = parameters.last;
        let name = format!("table {number}");
        let Some(points) = points(&name, parameters, warnings)? else {
            continue;
        };
        let axis = |which: &str| -> Result<AxisName, ExchangeError> {
            let Some((text, line)) = parameters.axes.get(which) else {
                let found = format!("{name} without $AN_CEC{which}");
                return Err(here.error(found, "an input and an output axis"));
            };
            names.axis(here.file.at(*line), text)
        };
        if let Some(by) = parameters.number("_MULT_BY_TABLE").filter(|by| *by != 0.0) {
            let text = format!("{name}: multiplied by table {}: left out", by - 1.0);
            warnings.push(here.warning(text));
            continue;
        }
        let (input, output) = (axis("_INPUT_AXIS")?, axis("_OUTPUT_AXIS")?);
        let table = points.table(input, output);
        let direction = parameters.number("_DIRECTION").unwrap_or(0.0);
        let [forward, backward] = halves.entry((input, output)).or_default();
        let place = match direction {
            0.0 => {
                tables.push(table);
                continue;
            }
            1.0 => forward,
            -1.0 => backward,
            found => return Err(here.error(format!("{name} with DIRECTION {found}"), "0, 1 or -1")),
        };
        if place.is_some() {
            let found = format!("a second {} for direction {direction}", table.title());
            return Err(here.error(found, "one"));
        }
        *place = Some(table);
    }
    tables.extend(halves.into_values().filter_map(joined));
    Ok(())
}

/// Joins two unidirectional tables; a missing direction counts as zero.
fn joined(halves: [Option<AxisTable>; 2]) -> Option<AxisTable> {
    let zero =
        |table: &AxisTable| AxisTable { forward: vec![0.0; table.forward.len()], ..table.clone() };
    let (forward, backward) = match halves {
        [Some(forward), Some(backward)] => (forward, backward),
        [Some(forward), None] => (forward.clone(), zero(&forward)),
        [None, Some(backward)] => (zero(&backward), backward),
        [None, None] => return None,
    };
    let mut positions = [&forward.positions[..], &backward.positions].concat();
    positions.sort_by(f64::total_cmp);
    positions.dedup_by(|a, b| (*a - *b).abs() < 1e-9);
    let backward = backward.at_positions(positions.clone()).forward;
    Some(AxisTable { backward: Some(backward), ..forward.at_positions(positions) })
}

enum Statement {
    Metric,
    Inch,
    /// A blank line, or framing such as CHANDATA and M17.
    Nothing,
    /// Another variable of the control.
    Other(String),
    Set {
        name: String,
        index: Vec<String>,
        value: Value,
        has_equals: bool,
    },
}

enum Value {
    Number(f64),
    Axis(String),
}

const EXPECTED: &str = "a statement such as $AN_CEC[0,1]=0.005 or $AA_ENC_COMP[0,1,AX1]=0.005";

fn statement(line: &str) -> Result<Statement, &'static str> {
    let upper = without_number(line.trim()).to_ascii_uppercase();
    match upper.as_str() {
        "METRIC" => return Ok(Statement::Metric),
        "INCH" => return Ok(Statement::Inch),
        "" | "M17" | "M30" | "M02" | "M2" | "STOPRE" => return Ok(Statement::Nothing),
        frame if frame.starts_with("CHANDATA") || frame.starts_with('%') => {
            return Ok(Statement::Nothing);
        }
        other if !other.starts_with('$') => return Err(EXPECTED),
        _ => {}
    }
    let (name, rest) = upper.split_once('[').ok_or(EXPECTED)?;
    let name = name.trim();
    if !(name.starts_with("$AN_CEC") || name.starts_with("$AA_ENC_COMP")) {
        return Ok(Statement::Other(name.to_owned()));
    }
    let (index, rest) = rest.split_once(']').ok_or("a `]` after the index")?;
    let index = index.split([',', '.']).map(|part| part.trim().to_owned()).collect();
    let value = rest.trim();
    let has_equals = value.starts_with('=');
    let value = value.strip_prefix('=').unwrap_or(value).trim();
    let value = match (number(value), value) {
        (Some(number), _) => Value::Number(number),
        (None, "TRUE") => Value::Number(1.0),
        (None, "FALSE") => Value::Number(0.0),
        (None, text) => {
            let inner = text.strip_prefix('(').and_then(|rest| rest.strip_suffix(')'));
            let bare = inner.unwrap_or(text).trim();
            let is_name =
                !bare.is_empty() && bare.bytes().all(|b| b.is_ascii_alphanumeric() || b == b'_');
            if !is_name || bare.as_bytes()[0].is_ascii_digit() {
                return Err("a number, or an axis in brackets, after the index");
            }
            Value::Axis(bare.to_owned())
        }
    };
    Ok(Statement::Set { name: name.to_owned(), index, value, has_equals })
}

/// Removes a block number such as `N120`.
fn without_number(text: &str) -> &str {
    let Some(rest) = text.strip_prefix(['N', 'n']) else {
        return text;
    };
    let digits = rest.bytes().take_while(u8::is_ascii_digit).count();
    if digits == 0 { text } else { rest[digits..].trim_start() }
}

struct Parameters<'a> {
    /// Position for messages about the table: the file of its first statement, and the line of its
    /// last one.
    last: FilePosition<'a>,
    values: BTreeMap<u32, f64>,
    numbers: BTreeMap<String, f64>,
    axes: BTreeMap<String, (String, usize)>,
}

impl<'a> Parameters<'a> {
    fn at(here: FilePosition<'a>) -> Self {
        Self {
            last: here,
            values: BTreeMap::new(),
            numbers: BTreeMap::new(),
            axes: BTreeMap::new(),
        }
    }

    fn number(&self, name: &str) -> Option<f64> {
        self.numbers.get(name).copied()
    }

    fn put(
        &mut self,
        here: FilePosition<'a>,
        (part, point): (&str, u32),
        value: Value,
    ) -> Result<(), ExchangeError> {
        self.last.line = self.last.line.max(here.line);
        match (part, value) {
            ("_INPUT_AXIS" | "_OUTPUT_AXIS", Value::Axis(text)) => {
                let line = here.line.unwrap_or(1);
                self.axes.insert(part.to_owned(), (text, line));
            }
            ("_INPUT_AXIS" | "_OUTPUT_AXIS", Value::Number(number)) => {
                return Err(here.error(number.to_string(), "an axis: (AX1)"));
            }
            (_, Value::Axis(_)) => return Err(here.error("an axis", "a number")),
            ("", Value::Number(number)) => {
                self.values.insert(point, number);
            }
            // Parameters that only newer controls have are stored but not used.
            (_, Value::Number(number)) => {
                self.numbers.insert(part.to_owned(), number);
            }
        }
        Ok(())
    }
}

#[derive(Default)]
struct Statements<'a> {
    cec: BTreeMap<u32, Parameters<'a>>,
    enc: BTreeMap<(u32, String), Parameters<'a>>,
    /// Axis numbers in a header that volcomp wrote.
    stated: Vec<(AxisName, u16)>,
}

impl<'a> Statements<'a> {
    fn stated_in(&mut self, comment: &str) {
        for pair in numbers_in(comment).unwrap_or_default() {
            if !self.stated.contains(&pair) {
                self.stated.push(pair);
            }
        }
    }

    fn take(
        &mut self,
        file: &'a TextFile,
        warnings: &mut Vec<Warning>,
    ) -> Result<(), ExchangeError> {
        let (mut is_metric, mut has_equals_warning) = (false, false);
        for (index, whole) in file.text.lines().enumerate() {
            let here = file.at(index + 1);
            let (text, comment) = whole.split_once(';').unwrap_or((whole, ""));
            self.stated_in(comment);
            let parsed = statement(text);
            match parsed.map_err(|expected| here.error(quoted(text.trim()), expected))? {
                Statement::Metric => is_metric = true,
                Statement::Inch => return Err(here.error("INCH", "METRIC")),
                Statement::Nothing => {}
                Statement::Other(name) => {
                    let text = format!("`{name}` is not part of a compensation table: ignored");
                    warnings.push(here.warning(text));
                }
                Statement::Set { name, index, value, has_equals } => {
                    if !has_equals && !has_equals_warning {
                        has_equals_warning = true;
                        warnings.push(here.warning(
                            "found no `=`: read as if it were there; a control rejects it",
                        ));
                    }
                    self.set(here, (&name, &index), value)?;
                }
            }
        }
        if !is_metric {
            let text = "METRIC is missing: read as mm";
            warnings.push(file.whole().warning(text));
        }
        Ok(())
    }

    fn set(
        &mut self,
        here: FilePosition<'a>,
        (name, index): (&str, &[String]),
        value: Value,
    ) -> Result<(), ExchangeError> {
        let wrong = |expected: &str| {
            let found = format!("the index [{}]", index.join(","));
            here.error(found, expected)
        };
        let whole = |text: &str| text.parse::<u32>().ok();
        let new = || Parameters::at(here);
        if let Some(part) = name.strip_prefix("$AN_CEC") {
            let (table, point) = match (part, index) {
                ("", [table, point]) => (whole(table), whole(point)),
                ("", _) => (None, None),
                (_, [table]) => (whole(table), Some(0)),
                _ => (None, None),
            };
            let (Some(table), Some(point)) = (table, point) else {
                return Err(wrong(
                    "[table,point] for a value and [table] for everything else, whole numbers",
                ));
            };
            let parameters = self.cec.entry(table).or_insert_with(new);
            parameters.put(here, (part, point), value)?;
        } else if let Some(part) = name.strip_prefix("$AA_ENC_COMP") {
            let (encoder, point, axis) = match (part, index) {
                ("", [encoder, point, axis]) => (whole(encoder), whole(point), axis),
                (_, [encoder, axis]) if !part.is_empty() => (whole(encoder), Some(0), axis),
                _ => {
                    return Err(wrong(
                        "[encoder,point,axis] for a value and [encoder,axis] for everything else",
                    ));
                }
            };
            let (Some(encoder), Some(point)) = (encoder, point) else {
                return Err(wrong("whole numbers for encoder and point"));
            };
            let key = (encoder, axis.to_ascii_uppercase());
            let parameters = self.enc.entry(key).or_insert_with(new);
            parameters.put(here, (part, point), value)?;
        }
        Ok(())
    }
}

const MAX_POINTS: f64 = 100_000.0;

/// Points of a table: positions in mm or deg, values as in the file.
struct Points {
    positions: Vec<f64>,
    values: Vec<f64>,
    modulo: bool,
}

/// Positions of a table from `min` to `max`, mm or deg. `last` is the index of the last point; `is_whole` states
/// whether `max` is a whole number of steps from `min`.
struct Extent {
    min: f64,
    max: f64,
    step: f64,
    last: u32,
    is_whole: bool,
}

fn extent(
    name: &str,
    parameters: &Parameters<'_>,
    warnings: &mut Vec<Warning>,
) -> Result<Option<Extent>, ExchangeError> {
    let here = parameters.last;
    let used = parameters.values.values().any(|value| *value != 0.0);
    let step = parameters.number("_STEP").unwrap_or(0.0);
    if step == 0.0 {
        let though = if used { ", though it has values" } else { "" };
        let text = format!("{name}: not defined, its step is 0{though}: left out");
        warnings.push(here.warning(text));
        return Ok(None);
    }
    let (Some(min), Some(max)) = (parameters.number("_MIN"), parameters.number("_MAX")) else {
        return Err(here.error(format!("{name} without MIN or MAX"), "both"));
    };
    if step < 0.0
        || max < min
        || (max - min) / step > MAX_POINTS
        || (max > min && (max - min) / step < 1e-3)
    {
        let found = format!("{name} from {min} to {max} in steps of {step}");
        let expected =
            "a step above 0, MAX above MIN, and a number of points that a control can have";
        return Err(here.error(found, expected));
    }
    if max == min {
        let text = format!("{name}: MIN and MAX are both {min}: left out");
        warnings.push(here.warning(text));
        return Ok(None);
    }
    let parts = (max - min) / step;
    let is_whole = (parts - parts.round()).abs() < 1e-6;
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "above 0, at most MAX_POINTS"
    )]
    let last = if is_whole { parts.round() } else { parts.ceil() } as u32;
    Ok(Some(Extent { min, max, step, last, is_whole }))
}

fn points(
    name: &str,
    parameters: &Parameters<'_>,
    warnings: &mut Vec<Warning>,
) -> Result<Option<Points>, ExchangeError> {
    let Some(extent) = extent(name, parameters, warnings)? else {
        return Ok(None);
    };
    let Extent { min, max, step, last, is_whole } = extent;
    let here = parameters.last;
    let mut positions = Vec::new();
    let mut values = Vec::new();
    for point in 0..=last {
        let Some(value) = parameters.values.get(&point) else {
            let found = format!("{name} without point {point}");
            let expected = format!("points 0 to {last}: the value of the control there is unknown");
            return Err(here.error(found, expected));
        };
        positions.push(min + step * f64::from(point));
        values.push(*value);
    }
    if !is_whole {
        let beyond = min + step * f64::from(last);
        warnings.push(here.warning(format!(
                "{name}: (MAX - MIN) / STEP is {}, no whole number. Point {last} is read as being at {beyond}, and the value at MAX = {max} \
                 applies beyond it; the author may have meant point {last} to be at {max}",
                (max - min) / step
            )));
        let at_end = interpolated(&positions, &values, max);
        positions.pop();
        values.pop();
        positions.push(max);
        values.push(at_end);
    }
    let behind = parameters.values.range(last + 1..);
    let unused = behind.filter(|(_, value)| **value != 0.0).count();
    if unused > 0 {
        warnings.push(here.warning(format!(
            "{name}: {unused} values after point {last} are not 0, and are not used"
        )));
    }
    let modulo =
        match parameters.number("_IS_MODULO").unwrap_or(0.0) {
            0.0 => false,
            1.0 => true,
            -1.0 => {
                warnings.push(here.warning(format!(
                    "{name}: IS_MODULO is -1: read as 1; a control expects 0 or 1"
                )));
                true
            }
            found => return Err(here.error(format!("{name} with IS_MODULO {found}"), "0 or 1")),
        };
    Ok(Some(Points { positions, values, modulo }))
}

impl Points {
    fn table(self, input: AxisName, output: AxisName) -> AxisTable {
        AxisTable {
            input,
            output,
            positions: all_from_file_unit(input, &self.positions),
            forward: all_from_file_unit(output, &self.values),
            backward: None,
            modulo: self.modulo,
        }
    }
}

fn all_from_file_unit(axis: AxisName, values: &[f64]) -> Vec<f64> {
    values.iter().map(|value| from_file_unit(axis, *value)).collect()
}

const FORMAT: Format = Format::Siemens840d;
const DECIMALS: usize = 9;

pub(crate) fn write(
    tables: &[AxisTable],
    options: &WriteOptions,
) -> Result<Written, ExchangeError> {
    let mut written = Written::default();
    if options.encoder > 1 {
        return Err(ExchangeError::option("--encoder", &options.encoder, "0 or 1"));
    }
    let (own, crossed): (Vec<_>, Vec<_>) = tables.iter().partition(|table| table.is_own());
    if !own.is_empty() {
        let mut text = head(options);
        let backlashes = backlashes(&own, options)?;
        for line in &backlashes {
            let _ = writeln!(text, "; {line}");
        }
        for table in &own {
            leadscrew(&mut text, table, options)?;
        }
        text += "M17\n";
        written.files.push(TextFile { name: "AX_EEC.INI".to_owned(), text });
        let points = own.iter().map(|table| table.positions.len());
        let most = points.max().unwrap_or(0);
        written.notes.push(format!(
            "MD38000 of each axis must be at least {most}; tables are loaded while MD32700 is 0"
        ));
        if !backlashes.is_empty() {
            written.notes.push(format!(
                "$AA_ENC_COMP has no directions: it holds the mean, and half of the reversal value remains in either direction, unless MD32450 takes it: {}",
                backlashes.join("; ")
            ));
        }
    }
    if !crossed.is_empty() {
        let mut text = head(options);
        let (mut number, mut points) = (0_usize, 0_usize);
        for table in &crossed {
            let (first, step) = table.even(FORMAT)?;
            let mut write = |values: &[f64], direction: i8| -> Result<(), ExchangeError> {
                let direction = (direction, values);
                cec(&mut text, number, table, (first, step), direction, options)?;
                points = points.max(values.len());
                number += 1;
                Ok(())
            };
            match &table.backward {
                None => write(&table.forward, 0)?,
                Some(backward) => {
                    write(&table.forward, 1)?;
                    write(backward, -1)?;
                }
            }
        }
        text += "M17\n";
        written.files.push(TextFile { name: "NC_CEC.INI".to_owned(), text });
        written.notes.push(format!(
            "MD18342[0] to MD18342[{}] must be at least {points}; tables are loaded while MD32710 is 0",
            number.saturating_sub(1)
        ));
    }
    Ok(written)
}

/// Lines for MD32450 with the backlash of each axis that has a reversal value: mean of backward − forward. The backlash
/// is positive if the encoder leads the machine part, as in Siemens's description of MD32450.
fn backlashes(own: &[&AxisTable], options: &WriteOptions) -> Result<Vec<String>, ExchangeError> {
    let mut lines = Vec::new();
    for table in own {
        let Some(backward) = &table.backward else {
            continue;
        };
        let differences = backward.iter().zip(&table.forward).map(|(back, fore)| back - fore);
        let mean = differences.sum::<f64>() / backward.len().max(1) as f64;
        lines.push(format!(
            "MD32450 $MA_BACKLASH[{},{}]: add {} {} to the value with which the axis was measured",
            options.encoder,
            axis(table, table.input, options)?,
            fixed(table.output_in_file_unit(mean), decimals(table)),
            table.input.kind().coordinate_unit()
        ));
    }
    Ok(lines)
}

fn head(options: &WriteOptions) -> String {
    let mut text = String::new();
    for line in options.facts.lines(FORMAT, &options.axes) {
        let _ = writeln!(text, "; {}", line.replace(';', ","));
    }
    text += "METRIC\n\nCHANDATA(1)\n";
    text
}

fn axis(
    table: &AxisTable,
    name: AxisName,
    options: &WriteOptions,
) -> Result<String, ExchangeError> {
    let number = options.axes.number(name).ok_or_else(|| {
        ExchangeError::not_representable(
            FORMAT,
            table.title(),
            format!("axis {name} without a number"),
            format!("its number in the control: --axis-numbers {name}=1"),
        )
    })?;
    Ok(format!("AX{number}"))
}

/// Number of decimals of a value: 1 nm, or about 2e-9 rad.
fn decimals(table: &AxisTable) -> usize {
    if table.output.is_rotary() { 7 } else { 6 }
}

fn leadscrew(
    text: &mut String,
    table: &AxisTable,
    options: &WriteOptions,
) -> Result<(), ExchangeError> {
    let (first, step) = table.even(FORMAT)?;
    let (e, name) = (options.encoder, axis(table, table.input, options)?);
    for (point, value) in table.mean().iter().enumerate() {
        let value = fixed(table.output_in_file_unit(*value), decimals(table));
        let _ = writeln!(text, "$AA_ENC_COMP[{e},{point},{name}]={value}");
    }
    let (min, max) = ends(table, first, step);
    let _ = writeln!(
        text,
        "$AA_ENC_COMP_STEP[{e},{name}]={}\n$AA_ENC_COMP_MIN[{e},{name}]={min}\n$AA_ENC_COMP_MAX[{e},{name}]={max}\n$AA_ENC_COMP_IS_MODULO[{e},{name}]={}",
        short(step, DECIMALS),
        u8::from(table.modulo)
    );
    Ok(())
}

/// MIN and MAX as text, a whole number of steps apart.
fn ends(table: &AxisTable, first: f64, step: f64) -> (String, String) {
    let last = first + step * (table.positions.len().saturating_sub(1)) as f64;
    (short(first, DECIMALS), short(last, DECIMALS))
}

fn cec(
    text: &mut String,
    number: usize,
    table: &AxisTable,
    (first, step): (f64, f64),
    (direction, values): (i8, &[f64]),
    options: &WriteOptions,
) -> Result<(), ExchangeError> {
    for (point, value) in values.iter().enumerate() {
        let value = fixed(table.output_in_file_unit(*value), decimals(table));
        let _ = writeln!(text, "$AN_CEC[{number},{point}]={value}");
    }
    let (min, max) = ends(table, first, step);
    let mut put = |name: &str, value: String| {
        let _ = writeln!(text, "$AN_CEC_{name}[{number}]={value}");
    };
    let input = axis(table, table.input, options)?;
    let output = axis(table, table.output, options)?;
    put("INPUT_NCU", "1".to_owned());
    put("INPUT_AXIS", format!("({input})"));
    put("OUTPUT_NCU", "1".to_owned());
    put("OUTPUT_AXIS", format!("({output})"));
    put("STEP", short(step, DECIMALS));
    put("MIN", min);
    put("MAX", max);
    put("DIRECTION", direction.to_string());
    put("MULT_BY_TABLE", "0".to_owned());
    put("IS_MODULO", u8::from(table.modulo).to_string());
    put("TYPE", "0".to_owned());
    Ok(())
}
