//! The two files.

use core::fmt::Write;

use super::super::{
    AxisTable, ExchangeError, Format, TextFile, WriteOptions, Written,
    exchange::even,
    text::{fixed, short},
};

const FORMAT: Format = Format::Siemens840d;
/// Decimals of positions and steps.
const DECIMALS: usize = 9;

pub(crate) fn write(
    tables: &[AxisTable],
    options: &WriteOptions,
) -> Result<Written, ExchangeError> {
    let mut written = Written::default();
    if options.encoder > 1 {
        return Err(ExchangeError::Wish {
            what: "--encoder".to_owned(),
            found: options.encoder.to_string(),
            expected: "0 or 1".to_owned(),
        });
    }
    let own: Vec<&AxisTable> = tables.iter().filter(|table| table.is_own()).collect();
    let crossed: Vec<&AxisTable> = tables.iter().filter(|table| !table.is_own()).collect();
    if !own.is_empty() {
        let mut text = head(options);
        for table in &own {
            leadscrew(&mut text, table, options)?;
        }
        text += "M17\n";
        written.files.push(TextFile {
            name: "AX_EEC.INI".to_owned(),
            text,
        });
        let most = own
            .iter()
            .map(|table| table.positions.len())
            .max()
            .unwrap_or(0);
        written.notes.push(format!(
            "MD38000 of each axis has to be {most} at the least; tables are loaded while MD32700 is 0"
        ));
        if own.iter().any(|table| table.backward.is_some()) {
            written.notes.push("$AA_ENC_COMP does not know directions: it holds the mean, and half of the reversal is left on either side".to_owned());
        }
    }
    if !crossed.is_empty() {
        let mut text = head(options);
        let (mut number, mut points) = (0_usize, 0_usize);
        for table in &crossed {
            let (first, step) = even(FORMAT, table)?;
            let mut write = |values: &[f64], direction: i8| -> Result<(), ExchangeError> {
                let values: Vec<f64> = values
                    .iter()
                    .map(|value| table.output_at_edge(*value))
                    .collect();
                cec(
                    &mut text,
                    number,
                    table,
                    &values,
                    (first, step),
                    direction,
                    options,
                )?;
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
        written.files.push(TextFile {
            name: "NC_CEC.INI".to_owned(),
            text,
        });
        written.notes.push(format!(
            "MD18342[0] to MD18342[{}] have to be {points} at the least; tables are loaded while MD32710 is 0",
            number.saturating_sub(1)
        ));
    }
    Ok(written)
}

fn head(options: &WriteOptions) -> String {
    let mut text = String::new();
    for line in options.facts.lines(FORMAT, options) {
        // Writing to a string does not fail.
        let _ = writeln!(text, "; {}", line.replace(';', ","));
    }
    text += "METRIC\n\nCHANDATA(1)\n";
    text
}

fn axis(
    table: &AxisTable,
    name: volcomp_vocabulary::AxisName,
    options: &WriteOptions,
) -> Result<String, ExchangeError> {
    let number = options
        .axes
        .number(name)
        .ok_or_else(|| ExchangeError::Unfit {
            format: FORMAT,
            what: format!("table {} over {}", table.output, table.input),
            found: format!("axis {name} without a number"),
            expected: format!("its number in the control: --axis-numbers {name}=1"),
        })?;
    Ok(format!("AX{number}"))
}

/// Decimals of a value: 1 nm, or some 2e-9 rad.
fn decimals(table: &AxisTable) -> usize {
    if table.output.is_rotary() { 7 } else { 6 }
}

fn leadscrew(
    text: &mut String,
    table: &AxisTable,
    options: &WriteOptions,
) -> Result<(), ExchangeError> {
    let (first, step) = even(FORMAT, table)?;
    let (e, name) = (options.encoder, axis(table, table.input, options)?);
    for (point, value) in table.mean().iter().enumerate() {
        let value = fixed(table.output_at_edge(*value), decimals(table));
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

/// MIN and MAX, a whole number of steps apart.
fn ends(table: &AxisTable, first: f64, step: f64) -> (String, String) {
    let last = first + step * (table.positions.len().saturating_sub(1)) as f64;
    (short(first, DECIMALS), short(last, DECIMALS))
}

fn cec(
    text: &mut String,
    number: usize,
    table: &AxisTable,
    values: &[f64],
    (first, step): (f64, f64),
    direction: i8,
    options: &WriteOptions,
) -> Result<(), ExchangeError> {
    for (point, value) in values.iter().enumerate() {
        let _ = writeln!(
            text,
            "$AN_CEC[{number},{point}]={}",
            fixed(*value, decimals(table))
        );
    }
    let (min, max) = ends(table, first, step);
    let mut put = |name: &str, value: String| {
        let _ = writeln!(text, "$AN_CEC_{name}[{number}]={value}");
    };
    put("INPUT_NCU", "1".to_owned());
    put(
        "INPUT_AXIS",
        format!("({})", axis(table, table.input, options)?),
    );
    put("OUTPUT_NCU", "1".to_owned());
    put(
        "OUTPUT_AXIS",
        format!("({})", axis(table, table.output, options)?),
    );
    put("STEP", short(step, DECIMALS));
    put("MIN", min);
    put("MAX", max);
    put("DIRECTION", direction.to_string());
    put("MULT_BY_TABLE", "0".to_owned());
    put("IS_MODULO", u8::from(table.modulo).to_string());
    put("TYPE", "0".to_owned());
    Ok(())
}
