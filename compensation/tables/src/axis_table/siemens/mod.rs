//! SINUMERIK 840D: leadscrew errors as `$AA_ENC_COMP` in a frame AX_EEC.INI, everything else as `$AN_CEC` in a frame NC_CEC.INI.

mod statement;
mod write;

use std::collections::BTreeMap;

use volcomp_vocabulary::AxisName;

use super::{
    AxisNumbers, AxisTable, ExchangeError, LineError, ReadOptions, TextFile, Warning,
    exchange::deviation_from_edge, table::interpolated,
};
use statement::{Statement, Value, statement};

pub(crate) use write::write;

/// More points no table of a control has.
const MOST_POINTS: f64 = 100_000.0;

/// The parameters of one table, whichever kind.
#[derive(Default)]
struct Parameters<'a> {
    /// The file of the first statement about it.
    file: Option<&'a TextFile>,
    line: usize,
    values: BTreeMap<u32, f64>,
    numbers: BTreeMap<&'static str, f64>,
    axes: BTreeMap<&'static str, (String, usize)>,
}

impl Parameters<'_> {
    fn number(&self, name: &str) -> Option<f64> {
        self.numbers.get(name).copied()
    }
}

/// Everything that stands in the files.
#[derive(Default)]
struct Found<'a> {
    cec: BTreeMap<u32, Parameters<'a>>,
    enc: BTreeMap<(u32, String), Parameters<'a>>,
    /// The axis numbers that a head of volcomp states.
    stated: Vec<(AxisName, u16)>,
}

pub(crate) fn read(
    files: &[&TextFile],
    options: &ReadOptions,
    warnings: &mut Vec<Warning>,
) -> Result<Vec<AxisTable>, ExchangeError> {
    let mut found = Found::default();
    for file in files {
        take(file, &mut found, warnings)?;
    }
    let stated = AxisNumbers::stated(std::mem::take(&mut found.stated)).unwrap_or_default();
    let names = Names {
        options: &options.axes,
        stated,
    };
    let mut tables = Vec::new();
    leadscrews(&found, &names, options.encoder, &mut tables, warnings)?;
    cross(&found, &names, &mut tables, warnings)?;
    Ok(tables)
}

/// The names of axes in the files.
struct Names<'a> {
    options: &'a AxisNumbers,
    stated: AxisNumbers,
}

impl Names<'_> {
    fn axis(&self, file: &TextFile, line: usize, name: &str) -> Result<AxisName, ExchangeError> {
        let bare = name.trim_matches(['(', ')', ' ']).to_ascii_uppercase();
        if let Ok(axis) = bare.parse() {
            return Ok(axis);
        }
        let number = bare
            .strip_prefix("AX")
            .and_then(|digits| digits.parse().ok());
        let known = number.and_then(|number| {
            self.options
                .axis(number)
                .or_else(|| self.stated.axis(number))
        });
        known.ok_or_else(|| {
            LineError::at(
                file,
                line,
                format!("axis `{bare}`"),
                "a letter, or a number whose letter is stated (--axis-numbers X=1,Y=2)",
            )
        })
    }
}

fn take<'a>(
    file: &'a TextFile,
    found: &mut Found<'a>,
    warnings: &mut Vec<Warning>,
) -> Result<(), ExchangeError> {
    let (mut is_metric, mut has_equals_warning) = (false, false);
    for (index, whole) in file.text.lines().enumerate() {
        let line = index + 1;
        let (text, comment) = whole.split_once(';').unwrap_or((whole, ""));
        if let Some(numbers) = comment.trim().strip_prefix("Axis numbers:") {
            let pairs = numbers.split_whitespace().filter_map(|pair| {
                let (name, number) = pair.split_once('=')?;
                Some((name.parse().ok()?, number.parse().ok()?))
            });
            for pair in pairs {
                if !found.stated.contains(&pair) {
                    found.stated.push(pair);
                }
            }
        }
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
            let (table, point) = match (part, index.as_slice()) {
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
            let (encoder, point, axis) = match (part, index.as_slice()) {
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
    }
    if !is_metric {
        warnings.push(Warning::whole(
            file,
            "METRIC does not stand in it: taken as mm",
        ));
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

/// The points of a table: positions in mm or deg, values as they stand; `None` where it is not defined.
struct Points {
    positions: Vec<f64>,
    values: Vec<f64>,
    modulo: bool,
}

fn points(
    name: &str,
    parameters: &Parameters<'_>,
    warnings: &mut Vec<Warning>,
) -> Result<Option<Points>, ExchangeError> {
    // A table has a statement, and that stands in a file.
    let Some(file) = parameters.file else {
        return Ok(None);
    };
    let line = parameters.line;
    let used = parameters.values.values().any(|value| *value != 0.0);
    let step = parameters.number("_STEP").unwrap_or(0.0);
    if step == 0.0 {
        let though = if used { ", though it has values" } else { "" };
        warnings.push(Warning::at(
            file,
            line,
            format!("{name}: not defined, its step is 0{though}: left out"),
        ));
        return Ok(None);
    }
    let (Some(min), Some(max)) = (parameters.number("_MIN"), parameters.number("_MAX")) else {
        return Err(LineError::at(
            file,
            line,
            format!("{name} without MIN or MAX"),
            "both",
        ));
    };
    if step < 0.0 || max < min || (max - min) / step > MOST_POINTS {
        let found = format!("{name} from {min} to {max} in steps of {step}");
        return Err(LineError::at(
            file,
            line,
            found,
            "a step above 0, MAX above MIN, and points that a control has",
        ));
    }
    if max == min {
        warnings.push(Warning::at(
            file,
            line,
            format!("{name}: MIN and MAX are both {min}: left out"),
        ));
        return Ok(None);
    }
    let parts = (max - min) / step;
    let is_whole = (parts - parts.round()).abs() < 1e-6;
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "above 0, MOST_POINTS at the most"
    )]
    let last = if is_whole {
        parts.round()
    } else {
        parts.ceil()
    } as u32;
    let mut positions = Vec::new();
    let mut values = Vec::new();
    for point in 0..=last {
        let Some(value) = parameters.values.get(&point) else {
            let found = format!("{name} without point {point}");
            return Err(LineError::at(
                file,
                line,
                found,
                format!("points 0 to {last}: what the control holds there is not known"),
            ));
        };
        positions.push(min + step * f64::from(point));
        values.push(*value);
    }
    if !is_whole {
        let beyond = min + step * f64::from(last);
        warnings.push(Warning::at(
            file,
            line,
            format!(
                "{name}: (MAX - MIN) / STEP is {parts}, no whole number. Point {last} is taken to stand at {beyond}, and the value at MAX = {max} \
                 is held from there on; whoever made it may have meant point {last} to stand at {max}"
            ),
        ));
        let at_end = interpolated(&positions, &values, max);
        positions.pop();
        values.pop();
        positions.push(max);
        values.push(at_end);
    }
    let unused = parameters
        .values
        .range(last + 1..)
        .filter(|(_, value)| **value != 0.0)
        .count();
    if unused > 0 {
        warnings.push(Warning::at(
            file,
            line,
            format!("{name}: {unused} values behind point {last} are not 0, and are not used"),
        ));
    }
    let modulo = match parameters.number("_IS_MODULO").unwrap_or(0.0) {
        0.0 => false,
        1.0 => true,
        -1.0 => {
            warnings.push(Warning::at(
                file,
                line,
                format!("{name}: IS_MODULO is -1: read as 1; a control expects 0 or 1"),
            ));
            true
        }
        found => {
            return Err(LineError::at(
                file,
                line,
                format!("{name} with IS_MODULO {found}"),
                "0 or 1",
            ));
        }
    };
    Ok(Some(Points {
        positions,
        values,
        modulo,
    }))
}

impl Points {
    fn table(self, input: AxisName, output: AxisName) -> AxisTable {
        AxisTable {
            input,
            output,
            positions: self
                .positions
                .iter()
                .map(|at| AxisTable::input_from_edge(input, *at))
                .collect(),
            forward: self
                .values
                .iter()
                .map(|value| deviation_from_edge(output, *value))
                .collect(),
            backward: None,
            modulo: self.modulo,
        }
    }
}

fn leadscrews(
    found: &Found<'_>,
    names: &Names<'_>,
    encoder: Option<u8>,
    tables: &mut Vec<AxisTable>,
    warnings: &mut Vec<Warning>,
) -> Result<(), ExchangeError> {
    let mut seen: Vec<AxisName> = Vec::new();
    for ((number, axis), parameters) in &found.enc {
        let Some(file) = parameters.file else {
            continue;
        };
        if encoder.is_some_and(|wanted| u32::from(wanted) != *number) {
            continue;
        }
        let name = format!("$AA_ENC_COMP of encoder {number}, axis {axis}");
        let Some(points) = points(&name, parameters, warnings)? else {
            continue;
        };
        let axis = names.axis(file, parameters.line, axis)?;
        let table = points.table(axis, axis);
        if encoder.is_none() && table.is_nothing() {
            continue;
        }
        if seen.contains(&axis) {
            let found = format!("tables of both encoders of axis {axis}");
            return Err(LineError::at(
                file,
                parameters.line,
                found,
                "the encoder that is meant: --encoder 0 or 1",
            ));
        }
        seen.push(axis);
        tables.push(table);
    }
    Ok(())
}

fn cross(
    found: &Found<'_>,
    names: &Names<'_>,
    tables: &mut Vec<AxisTable>,
    warnings: &mut Vec<Warning>,
) -> Result<(), ExchangeError> {
    /// A table for one direction alone, until the one for the other is there.
    struct Half {
        forward: Option<AxisTable>,
        backward: Option<AxisTable>,
    }
    let mut halves: BTreeMap<(AxisName, AxisName), Half> = BTreeMap::new();
    for (number, parameters) in &found.cec {
        let Some(file) = parameters.file else {
            continue;
        };
        let name = format!("table {number}");
        let Some(points) = points(&name, parameters, warnings)? else {
            continue;
        };
        let line = parameters.line;
        let axis = |which: &'static str| -> Result<AxisName, ExchangeError> {
            let Some((text, line)) = parameters.axes.get(which) else {
                return Err(LineError::at(
                    file,
                    line,
                    format!("{name} without $AN_CEC{which}"),
                    "an input and an output axis",
                ));
            };
            names.axis(file, *line, text)
        };
        if let Some(by) = parameters.number("_MULT_BY_TABLE").filter(|by| *by != 0.0) {
            warnings.push(Warning::at(
                file,
                line,
                format!("{name}: multiplied by table {}: left out", by - 1.0),
            ));
            continue;
        }
        let (input, output) = (axis("_INPUT_AXIS")?, axis("_OUTPUT_AXIS")?);
        let table = points.table(input, output);
        let direction = parameters.number("_DIRECTION").unwrap_or(0.0);
        if direction == 0.0 {
            tables.push(table);
            continue;
        }
        let half = halves.entry((input, output)).or_insert(Half {
            forward: None,
            backward: None,
        });
        let place = match direction {
            1.0 => &mut half.forward,
            -1.0 => &mut half.backward,
            found => {
                return Err(LineError::at(
                    file,
                    line,
                    format!("{name} with DIRECTION {found}"),
                    "0, 1 or -1",
                ));
            }
        };
        if place.is_some() {
            let found = format!("a second table {output} over {input} for direction {direction}");
            return Err(LineError::at(file, line, found, "one"));
        }
        *place = Some(table);
    }
    for half in halves.into_values() {
        tables.extend(joined(half.forward, half.backward));
    }
    Ok(())
}

/// One table of two directions; the direction without one has none of the deviation.
fn joined(forward: Option<AxisTable>, backward: Option<AxisTable>) -> Option<AxisTable> {
    let zero = |table: &AxisTable| AxisTable {
        forward: vec![0.0; table.forward.len()],
        ..table.clone()
    };
    let (forward, backward) = match (forward, backward) {
        (Some(forward), Some(backward)) => (forward, backward),
        (Some(forward), None) => (forward.clone(), zero(&forward)),
        (None, Some(backward)) => (zero(&backward), backward),
        (None, None) => return None,
    };
    let mut positions: Vec<f64> = forward
        .positions
        .iter()
        .chain(&backward.positions)
        .copied()
        .collect();
    positions.sort_by(f64::total_cmp);
    positions.dedup_by(|a, b| (*a - *b).abs() < 1e-9);
    let backward = backward.at_positions(positions.clone()).forward;
    Some(AxisTable {
        backward: Some(backward),
        ..forward.at_positions(positions)
    })
}
