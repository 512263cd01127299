//! TwinCAT TF5280: the ISG CSV, component errors over their axis.

use core::fmt::Write;

use volcomp_document::quoted;
use volcomp_vocabulary::{AxisName, ErrorName};

use super::options::{WriteOptions, Written};
use super::table::{ErrorTable, ErrorTables, from_file_unit};
use super::text::{ExchangeError, FilePosition, Format, TextFile, number, short};

/// Number of decimals of lengths, mm.
const MM: usize = 7;
/// Number of decimals of angles, rad.
const RAD: usize = 10;
/// Number of decimals of positions in mm or deg.
const POSITION: usize = 9;

fn value(name: ErrorName, value: f64) -> String {
    short(value, if name.component.is_angular() { RAD } else { MM })
}

/// Whether a line is the header of a table: an axis and error names.
pub(crate) fn is_head(line: &str) -> bool {
    let mut cells = cells(line);
    let mut next = || cells.next().unwrap_or("");
    next().parse::<AxisName>().is_ok() && next().parse::<ErrorName>().is_ok()
}

fn cells(line: &str) -> impl Iterator<Item = &str> {
    line.split([',', ';', ' ', '\t']).filter(|cell| !cell.is_empty())
}

pub(crate) fn write(errors: &ErrorTables, options: &WriteOptions) -> Written {
    let mut written = Written::default();
    if !errors.locations.is_empty() {
        let names = errors.locations.iter().map(|(name, _)| name.to_string());
        let names: Vec<String> = names.collect();
        written.notes.push(format!(
            "left out, because this format has no known place for it: {}",
            names.join(", ")
        ));
    }
    if errors.curves.is_empty() {
        return written;
    }
    let mut text = String::new();
    for line in options.facts.lines(Format::IsgCsv, &options.axes) {
        let _ = writeln!(text, "// {line}");
    }
    let mut rest: Vec<&ErrorTable> = errors.curves.iter().collect();
    let heads = text.len();
    while let Some(first) = rest.first().copied() {
        let same = |table: &&&ErrorTable| {
            table.name.axis == first.name.axis && table.positions == first.positions
        };
        let group: Vec<&ErrorTable> = rest.iter().filter(same).copied().collect();
        rest.retain(|table| !same(&table));
        if text.len() > heads {
            text += "#\n";
        }
        let names: Vec<String> = group.iter().map(|table| table.name.to_string()).collect();
        let _ = writeln!(text, "{},{}", first.name.axis, names.join(","));
        for (place, at) in first.positions.iter().enumerate() {
            let values: Vec<String> =
                group.iter().map(|table| value(table.name, table.values[place])).collect();
            let _ = writeln!(
                text,
                "{},{}",
                short(first.position_in_file_unit(*at), POSITION),
                values.join(",")
            );
        }
    }
    written.files.push(TextFile { name: "errors.csv".to_owned(), text });
    written
}

pub(crate) fn read(files: &[&TextFile]) -> Result<ErrorTables, ExchangeError> {
    let mut errors = ErrorTables::default();
    for file in files {
        let mut head: Option<Head> = None;
        let mut last = file.at(1);
        for (index, whole) in file.text.lines().enumerate() {
            let text = whole.split("//").next().unwrap_or("").trim();
            if text.starts_with('#') {
                close(last, head.take(), &mut errors)?;
                continue;
            }
            if text.is_empty() {
                continue;
            }
            last = file.at(index + 1);
            let Some((axis, names, rows)) = &mut head else {
                head = Some(head_of(last, text)?);
                continue;
            };
            let row: Option<Vec<f64>> = cells(text).map(number).collect();
            let Some(row) = row.filter(|row| row.len() == names.len() + 1) else {
                let expected = format!("a position of {axis} and {} numbers", names.len());
                return Err(last.error(quoted(text), expected));
            };
            rows.push(row);
        }
        close(last, head.take(), &mut errors)?;
    }
    Ok(errors)
}

type Head = (AxisName, Vec<ErrorName>, Vec<Vec<f64>>);

fn head_of(here: FilePosition<'_>, text: &str) -> Result<Head, ExchangeError> {
    let mut words = cells(text);
    let axis: Option<AxisName> = words.next().and_then(|word| word.parse().ok());
    let Some(axis) = axis else {
        return Err(here.error(quoted(text), "an axis and error names: X EXX EYX"));
    };
    let mut names = Vec::new();
    for word in words {
        if word.parse::<AxisName>().is_ok() {
            return Err(here.error(
                format!("a second axis `{word}`"),
                "one axis: tables over several axes are not read",
            ));
        }
        let name: ErrorName =
            word.parse().map_err(|_| here.error(format!("`{word}`"), "an error name: EXX"))?;
        if name.axis != axis || name.location || names.contains(&name) {
            return Err(here.error(
                format!("{name} in a table over {axis}"),
                "error motions of this axis, each once",
            ));
        }
        names.push(name);
    }
    if names.is_empty() {
        return Err(here.error(format!("`{axis}` alone"), "an axis and error names: X EXX EYX"));
    }
    Ok((axis, names, Vec::new()))
}

fn close(
    here: FilePosition<'_>,
    head: Option<Head>,
    errors: &mut ErrorTables,
) -> Result<(), ExchangeError> {
    let Some((axis, names, rows)) = head else {
        return Ok(());
    };
    let column = |place: usize| rows.iter().map(move |row| row.get(place).copied().unwrap_or(0.0));
    let positions: Vec<f64> = column(0).map(|at| from_file_unit(axis, at)).collect();
    for (place, name) in names.into_iter().enumerate() {
        let table =
            ErrorTable { name, positions: positions.clone(), values: column(place + 1).collect() };
        if let Some(refusal) = table.refusal() {
            return Err(here.error(refusal, "a complete table"));
        }
        if errors.curves.iter().any(|known| known.name == name) {
            return Err(here.error(format!("{name} a second time"), "each error once"));
        }
        errors.curves.push(table);
    }
    Ok(())
}
