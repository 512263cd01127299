//! SINUMERIK 840D: leadscrew errors as `$AA_ENC_COMP` in a frame AX_EEC.INI, everything else as `$AN_CEC` in a frame NC_CEC.INI.

mod found;
mod points;
mod statement;
mod write;

use std::{cell::RefCell, collections::BTreeMap};

use volcomp_vocabulary::AxisName;

use super::{AxisNumbers, AxisTable, ExchangeError, LineError, ReadOptions, TextFile, Warning};
use found::{Found, take};
use points::points;

pub(crate) use write::write;

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
        numbered: RefCell::default(),
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
    /// The machine axes with a letter and a number (X1) so far.
    numbered: RefCell<BTreeMap<AxisName, String>>,
}

impl Names<'_> {
    fn axis(&self, file: &TextFile, line: usize, name: &str) -> Result<AxisName, ExchangeError> {
        let bare = name.trim_matches(['(', ')', ' ']).to_ascii_uppercase();
        if let Ok(axis) = bare.parse() {
            return Ok(axis);
        }
        // The names of machine axes as delivered: X1, Y1, Z1.
        let letter = bare.trim_end_matches(|c: char| c.is_ascii_digit());
        if let Ok(axis) = letter.parse() {
            let mut numbered = self.numbered.borrow_mut();
            let other = numbered.entry(axis).or_insert_with(|| bare.clone());
            if *other == bare {
                return Ok(axis);
            }
            return Err(LineError::at(
                file,
                line,
                format!("axis `{bare}` besides `{other}`"),
                "one machine axis of each letter",
            ));
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
                "a letter, a letter with a number (X1), or a number whose letter is stated (--axis-numbers X=1,Y=2)",
            )
        })
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
