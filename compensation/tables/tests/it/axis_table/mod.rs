//! Axis tables from machines through every format, compared with closed forms and the manufacturers' documents.

mod firmware;
mod formats;
mod loss;
mod machine;
mod round_trip;

use volcomp_tables::axis_table::{
    AxisNumbers, AxisTable, Content, ExchangeError, Format, ReadOptions, ReadTables, TextFile,
    WriteOptions, read,
};
use volcomp_tables::vocabulary::AxisName;

/// Axis numbers X = 1, Y = 2, Z = 3, C = 4, A = 5, in the order of a real machine.
pub(crate) fn numbers() -> AxisNumbers {
    use AxisName::{A, C, X, Y, Z};
    AxisNumbers::stated(vec![(X, 1), (Y, 2), (Z, 3), (C, 4), (A, 5)]).expect("each once")
}

pub(crate) fn file(name: &str, text: &str) -> TextFile {
    TextFile { name: name.to_owned(), text: text.to_owned() }
}

pub(crate) fn options() -> ReadOptions {
    ReadOptions { axes: numbers(), ..ReadOptions::default() }
}

pub(crate) fn read_text(
    format: Format,
    name: &str,
    text: &str,
) -> Result<ReadTables, ExchangeError> {
    read(format, &[file(name, text)], &options())
}

pub(crate) fn writing() -> WriteOptions {
    WriteOptions { axes: numbers(), ..WriteOptions::default() }
}

pub(crate) fn of_axes(content: Content) -> Vec<AxisTable> {
    match content {
        Content::Axes(tables) => tables,
        Content::Errors(errors) => panic!("{errors:?}"),
    }
}

pub(crate) fn over(tables: &[AxisTable], input: AxisName, output: AxisName) -> &AxisTable {
    let is_it = |table: &&AxisTable| (table.input, table.output) == (input, output);
    tables.iter().find(is_it).expect("it is there")
}

pub(crate) fn own(axis: AxisName, positions: Vec<f64>, forward: Vec<f64>) -> AxisTable {
    AxisTable { input: axis, output: axis, positions, forward, backward: None, modulo: false }
}

/// Converts mm or deg, as in tables, to mm or rad.
pub(crate) fn inside(axis: AxisName, edge: f64) -> f64 {
    if axis.is_rotary() { edge.to_radians() } else { edge }
}

pub(crate) fn tables(format: Format, name: &str, text: &str) -> (Vec<AxisTable>, Vec<String>) {
    let found = read_text(format, name, text).unwrap_or_else(|error| panic!("{error}"));
    let warnings = found.warnings.iter().map(ToString::to_string);
    (of_axes(found.content), warnings.collect())
}

pub(crate) fn refused(format: Format, name: &str, text: &str) -> String {
    let error = read_text(format, name, text).expect_err("refused");
    error.to_string()
}

/// Positions and forward deviations of a table, mm or deg.
pub(crate) fn edges(table: &AxisTable) -> Vec<(f64, f64)> {
    let nodes = table.positions.iter().zip(&table.forward);
    nodes
        .map(|(at, value)| (table.input_in_file_unit(*at), table.output_in_file_unit(*value)))
        .collect()
}

pub(crate) fn close(found: f64, expected: f64, within: f64) {
    assert!((found - expected).abs() <= within, "found {found}, expected {expected}");
}
