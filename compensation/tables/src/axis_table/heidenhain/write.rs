//! The files.

use core::fmt::Write;

use volcomp_vocabulary::AxisName;

use super::super::{
    AxisTable, ExchangeError, Format, TextFile, Written, exchange::edge_of, text::signed,
};
use super::{DECIMALS, MOST_LINES, turn::Held};

fn unfit(format: Format, table: &AxisTable, found: String, expected: String) -> ExchangeError {
    ExchangeError::Unfit {
        format,
        what: format!("table {} over {}", table.output, table.input),
        found,
        expected,
    }
}

/// What every HEIDENHAIN table has to keep.
fn check(format: Format, table: &AxisTable) -> Result<(), ExchangeError> {
    let count = table.positions.len();
    if count > MOST_LINES {
        let expected = format!("{MOST_LINES} at the most: take a larger step");
        return Err(unfit(format, table, format!("{count} positions"), expected));
    }
    Ok(())
}

pub(crate) fn write_tnc640(tables: &[AxisTable]) -> Result<Written, ExchangeError> {
    const FORMAT: Format = Format::HeidenhainTnc640;
    let mut written = Written::default();
    let held = Held::of(tables);
    held.tell(&mut written);
    let tables = &held.tables;
    let mut inputs: Vec<AxisName> = tables.iter().map(|table| table.input).collect();
    inputs.sort_unstable_by_key(|axis| axis.index());
    inputs.dedup();
    let mut averaged = Vec::new();
    for &input in &inputs {
        let mut of: Vec<&AxisTable> = tables
            .iter()
            .map(AsRef::as_ref)
            .filter(|table: &&AxisTable| table.input == input)
            .collect();
        of.sort_by_key(|table| table.output.index());
        for table in &of {
            check(FORMAT, table)?;
            if of
                .first()
                .is_some_and(|first| first.positions != table.positions)
            {
                return Err(unfit(
                    FORMAT,
                    table,
                    "other positions".to_owned(),
                    format!("those of the other tables over {input}"),
                ));
            }
            if table.backward.is_some() && !table.is_own() {
                averaged.push(format!("{} over {}", table.output, table.input));
            }
        }
        let Some(first) = of.first() else { continue };
        let backlash = of
            .iter()
            .find(|table| table.is_own())
            .and_then(|table| table.backward.as_ref().map(|b| (*table, b)));
        let mut text = format!("BEGIN AXIS_{input}.COM MM\n");
        let mut head = vec!["NR".to_owned(), "AXISPOS".to_owned()];
        if backlash.is_some() {
            head.push("BACKLASH".to_owned());
        }
        head.extend(of.iter().map(|table| table.output.to_string()));
        row(&mut text, &head);
        let columns: Vec<Vec<f64>> = of
            .iter()
            .map(|table| {
                if table.is_own() {
                    table.forward.clone()
                } else {
                    table.mean()
                }
            })
            .collect();
        for (place, at) in edge_of(first).enumerate() {
            let mut cells = vec![place.to_string(), signed(at, DECIMALS)];
            if let Some((table, values)) = backlash {
                cells.push(signed(table.output_at_edge(values[place]), DECIMALS));
            }
            let values = of.iter().zip(&columns);
            cells.extend(
                values.map(|(table, column)| signed(table.output_at_edge(column[place]), DECIMALS)),
            );
            row(&mut text, &cells);
        }
        text += "[END]\n";
        written.files.push(TextFile {
            name: format!("AXIS_{input}.COM"),
            text,
        });
    }
    if inputs.is_empty() {
        return Ok(written);
    }
    let mut text = "BEGIN CONFIG.CMA MM\n".to_owned();
    let names: Vec<String> = inputs.iter().map(ToString::to_string).collect();
    row(
        &mut text,
        &[&["NR".to_owned(), "ACTIVE".to_owned()][..], &names].concat(),
    );
    let files: Vec<String> = inputs.iter().map(|axis| format!("AXIS_{axis}")).collect();
    row(
        &mut text,
        &[&["0".to_owned(), "*".to_owned()][..], &files].concat(),
    );
    text += "[END]\n";
    written.files.push(TextFile {
        name: "CONFIG.CMA".to_owned(),
        text,
    });
    if !averaged.is_empty() {
        written.notes.push(format!("in the mean of both directions, as a .COM has one column of values after negative motion: {}", averaged.join(", ")));
    }
    Ok(written)
}

fn row(text: &mut String, cells: &[String]) {
    let mut line = String::new();
    for cell in cells {
        // Writing to a string does not fail.
        let _ = write!(line, "{cell:<14}");
    }
    text.push_str(line.trim_end());
    text.push('\n');
}
