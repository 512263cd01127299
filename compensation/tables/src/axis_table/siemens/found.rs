//! What stands in the files, statement by statement.

use std::collections::BTreeMap;

use volcomp_vocabulary::AxisName;

use super::super::{ExchangeError, LineError, TextFile, Warning, facts::numbers_in};
use super::statement::{Statement, Value, statement};

/// The parameters of one table, whichever kind.
#[derive(Default)]
pub(super) struct Parameters<'a> {
    /// The file of the first statement about it.
    pub(super) file: Option<&'a TextFile>,
    pub(super) line: usize,
    pub(super) values: BTreeMap<u32, f64>,
    pub(super) numbers: BTreeMap<&'static str, f64>,
    pub(super) axes: BTreeMap<&'static str, (String, usize)>,
}

impl Parameters<'_> {
    pub(super) fn number(&self, name: &str) -> Option<f64> {
        self.numbers.get(name).copied()
    }
}

/// Everything that stands in the files.
#[derive(Default)]
pub(super) struct Found<'a> {
    pub(super) cec: BTreeMap<u32, Parameters<'a>>,
    pub(super) enc: BTreeMap<(u32, String), Parameters<'a>>,
    /// The axis numbers that a head of volcomp states.
    pub(super) stated: Vec<(AxisName, u16)>,
}

impl Found<'_> {
    /// The axis numbers of a comment.
    fn stated_in(&mut self, comment: &str) {
        for pair in numbers_in(comment).unwrap_or_default() {
            if !self.stated.contains(&pair) {
                self.stated.push(pair);
            }
        }
    }
}

pub(super) fn take<'a>(
    file: &'a TextFile,
    found: &mut Found<'a>,
    warnings: &mut Vec<Warning>,
) -> Result<(), ExchangeError> {
    let (mut is_metric, mut has_equals_warning) = (false, false);
    for (index, whole) in file.text.lines().enumerate() {
        let line = index + 1;
        let (text, comment) = whole.split_once(';').unwrap_or((whole, ""));
        found.stated_in(comment);
        let Some(statement) = statement(text).map_err(|expected| {
            LineError::at(file, line, volcomp_document::quoted(text.trim()), expected)
        })?
        else {
            continue;
        };
        let (name, index, value) = match statement {
            Statement::Metric => {
                is_metric = true;
                continue;
            }
            Statement::Inch => return Err(LineError::at(file, line, "INCH", "METRIC")),
            Statement::Frame => continue,
            Statement::Other(name) => {
                warnings.push(Warning::at(
                    file,
                    line,
                    format!("`{name}` is no part of a compensation table: passed over"),
                ));
                continue;
            }
            Statement::Set {
                name,
                index,
                value,
                has_equals,
            } => {
                if !has_equals && !has_equals_warning {
                    has_equals_warning = true;
                    warnings.push(Warning::at(
                        file,
                        line,
                        "found no `=`: read as if it stood there; a control refuses it",
                    ));
                }
                (name, index, value)
            }
        };
        set(found, file, line, (&name, &index), value)?;
    }
    if !is_metric {
        warnings.push(Warning::whole(
            file,
            "METRIC does not stand in it: taken as mm",
        ));
    }
    Ok(())
}

/// Puts one value to its table.
fn set<'a>(
    found: &mut Found<'a>,
    file: &'a TextFile,
    line: usize,
    (name, index): (&str, &[String]),
    value: Value,
) -> Result<(), ExchangeError> {
    let wrong_index = |expected: &str| {
        LineError::at(
            file,
            line,
            format!("the index [{}]", index.join(",")),
            expected,
        )
    };
    let whole = |text: &str| text.parse::<u32>().ok();
    if let Some(part) = name.strip_prefix("$AN_CEC") {
        let (table, point) = match (part, index) {
            ("", [table, point]) => (whole(table), whole(point)),
            ("", _) => (None, None),
            (_, [table]) => (whole(table), Some(0)),
            _ => (None, None),
        };
        let (Some(table), Some(point)) = (table, point) else {
            return Err(wrong_index(
                "[table,point] for a value and [table] for everything else, whole numbers",
            ));
        };
        let parameters = found.cec.entry(table).or_default();
        parameters.file.get_or_insert(file);
        parameters.line = parameters.line.max(line);
        put(parameters, part, point, value, file, line)?;
    } else if let Some(part) = name.strip_prefix("$AA_ENC_COMP") {
        let (encoder, point, axis) = match (part, index) {
            ("", [encoder, point, axis]) => (whole(encoder), whole(point), axis),
            (_, [encoder, axis]) if !part.is_empty() => (whole(encoder), Some(0), axis),
            _ => {
                return Err(wrong_index(
                    "[encoder,point,axis] for a value and [encoder,axis] for everything else",
                ));
            }
        };
        let (Some(encoder), Some(point)) = (encoder, point) else {
            return Err(wrong_index("whole numbers for encoder and point"));
        };
        let key = (encoder, axis.to_ascii_uppercase());
        let parameters = found.enc.entry(key).or_default();
        parameters.file.get_or_insert(file);
        parameters.line = parameters.line.max(line);
        put(parameters, part, point, value, file, line)?;
    }
    Ok(())
}

fn put(
    parameters: &mut Parameters<'_>,
    part: &str,
    point: u32,
    value: Value,
    file: &TextFile,
    line: usize,
) -> Result<(), ExchangeError> {
    const NUMBERS: [&str; 9] = [
        "_STEP",
        "_MIN",
        "_MAX",
        "_DIRECTION",
        "_MULT_BY_TABLE",
        "_IS_MODULO",
        "_TYPE",
        "_INPUT_NCU",
        "_OUTPUT_NCU",
    ];
    const AXES: [&str; 2] = ["_INPUT_AXIS", "_OUTPUT_AXIS"];
    if let Some(name) = AXES.into_iter().find(|name| *name == part) {
        let text = match value {
            Value::Axis(text) => text,
            Value::Number(number) => {
                return Err(LineError::at(
                    file,
                    line,
                    number.to_string(),
                    "an axis: (AX1)",
                ));
            }
        };
        parameters.axes.insert(name, (text, line));
        return Ok(());
    }
    let Value::Number(number) = value else {
        return Err(LineError::at(file, line, "an axis", "a number"));
    };
    if part.is_empty() {
        parameters.values.insert(point, number);
        return Ok(());
    }
    // What a newer control states besides counts for nothing here.
    if let Some(name) = NUMBERS.into_iter().find(|name| *name == part) {
        parameters.numbers.insert(name, number);
    }
    Ok(())
}
