//! CSV, the format of volcomp.

use core::fmt::Write;

use volcomp_document::CsvTable;
use volcomp_vocabulary::{AxisName, Displacement};

use super::options::{WriteOptions, Written};
use super::table::{AxisTable, from_file_unit};
use super::text::{ExchangeError, Format, TextFile, number, short};

const HEAD: &str = "input,output,position,forward,backward,modulo";

pub(crate) fn write(tables: &[AxisTable], options: &WriteOptions) -> Written {
    if tables.is_empty() {
        return Written::default();
    }
    let mut text = String::new();
    for line in options.facts.lines(Format::Csv, &options.axes) {
        let _ = writeln!(text, "# {line}");
    }
    text += HEAD;
    text.push('\n');
    for table in tables {
        let kind = table.output.kind();
        let micro = |value: f64| short(Displacement::new(kind, value).um_or_urad(), 6);
        for (place, at) in table.positions.iter().enumerate() {
            let forward = table.forward.get(place).copied().unwrap_or(0.0);
            let backward = table.backward.as_ref().and_then(|values| values.get(place));
            let _ = writeln!(
                text,
                "{},{},{},{},{},{}",
                table.input,
                table.output,
                short(table.input_in_file_unit(*at), 9),
                micro(forward),
                backward.map_or_else(String::new, |value| micro(*value)),
                u8::from(table.modulo)
            );
        }
    }
    let name = "tables.csv".to_owned();
    Written { files: vec![TextFile { name, text }], ..Written::default() }
}

/// Replaces comment lines by blank ones, which keeps the line numbers.
fn without_comments(text: &str) -> String {
    let lines = text.lines().map(|line| if line.trim_start().starts_with('#') { "" } else { line });
    lines.collect::<Vec<_>>().join("\n")
}

pub(crate) fn read(files: &[&TextFile]) -> Result<Vec<AxisTable>, ExchangeError> {
    let mut tables: Vec<AxisTable> = Vec::new();
    for file in files {
        read_file(file, &mut tables)?;
    }
    Ok(tables)
}

fn read_file(file: &TextFile, tables: &mut Vec<AxisTable>) -> Result<(), ExchangeError> {
    let csv = CsvTable::parse(&file.name, &without_comments(&file.text))?;
    let [input, output, position, forward, backward, modulo] =
        ["input", "output", "position", "forward", "backward", "modulo"]
            .map(|name| csv.require(name));
    let (input, output, position) = (input?, output?, position?);
    let (forward, backward, modulo) = (forward?, backward?, modulo?);
    let mut last_line = 1;
    for row in csv.rows() {
        last_line = row.line();
        let here = file.at(last_line);
        let axis = |column| -> Result<AxisName, ExchangeError> {
            let text: &str = row.cell(column).text();
            let expected = "an axis: one of X Y Z A B C U V W";
            text.trim().parse().map_err(|_| here.error(format!("`{text}`"), expected))
        };
        let (input, output) = (axis(input)?, axis(output)?);
        let value = |column| -> Result<f64, ExchangeError> {
            let text = row.cell(column).text();
            number(text).ok_or_else(|| here.error(format!("`{text}`"), "a number"))
        };
        let micro = |um: f64| Displacement::from_micro(output.kind(), um).mm_or_rad();
        let at = from_file_unit(input, value(position)?);
        let forward = micro(value(forward)?);
        let backward = match row.cell(backward).text().trim() {
            "" => None,
            _ => Some(micro(value(backward)?)),
        };
        let modulo = match row.cell(modulo).text().trim() {
            "0" => false,
            "1" => true,
            found => return Err(here.error(format!("`{found}`"), "modulo 0 or 1")),
        };
        let is_same = |table: &AxisTable| (table.input, table.output) == (input, output);
        let is_known = tables.iter().any(is_same);
        match tables.last_mut().filter(|table| is_same(table)) {
            Some(table) => {
                if table.positions.last().is_some_and(|last| *last >= at) {
                    return Err(
                        here.error("a position that does not increase", "increasing positions")
                    );
                }
                if table.backward.is_some() != backward.is_some() || table.modulo != modulo {
                    return Err(here.error(
                        "a different kind of row than before",
                        "`backward` in every row of a table or in none, and one value of `modulo`",
                    ));
                }
                table.positions.push(at);
                table.forward.push(forward);
                if let (Some(values), Some(value)) = (&mut table.backward, backward) {
                    values.push(value);
                }
            }
            None if is_known => {
                let found = format!("more rows of {output} over {input}");
                return Err(here.error(found, "all rows of a table together"));
            }
            None => tables.push(AxisTable {
                input,
                output,
                positions: vec![at],
                forward: vec![forward],
                backward: backward.map(|value| vec![value]),
                modulo,
            }),
        }
    }
    match tables.iter().find_map(AxisTable::refusal) {
        Some(refusal) => Err(file.at(last_line).error(refusal, "complete tables")),
        None => Ok(()),
    }
}
