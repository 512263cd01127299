//! Tables of axes: from machines, through every format, against closed forms and the documents of the makers.

mod corpus;
mod fanuc;
mod heidenhain;
mod isg;
mod limits;
mod linuxcnc;
mod loss;
mod machine;
mod round_trip;
mod siemens;

use volcomp_tables::axis_table::{
    AxisNumbers, AxisTable, Content, ExchangeError, Format, ReadOptions, ReadTables, TextFile, read,
};
use volcomp_tables::vocabulary::AxisName;

/// X=1, Y=2, Z=3, C=4, A=5: the order of a real machine.
pub(crate) fn numbers() -> AxisNumbers {
    use AxisName::{A, C, X, Y, Z};
    AxisNumbers::stated(vec![(X, 1), (Y, 2), (Z, 3), (C, 4), (A, 5)]).expect("each once")
}

pub(crate) fn file(name: &str, text: &str) -> TextFile {
    TextFile {
        name: name.to_owned(),
        text: text.to_owned(),
    }
}

pub(crate) fn options() -> ReadOptions {
    ReadOptions {
        axes: numbers(),
        ..ReadOptions::default()
    }
}

pub(crate) fn read_text(
    format: Format,
    name: &str,
    text: &str,
) -> Result<ReadTables, ExchangeError> {
    read(format, &[file(name, text)], &options())
}

/// The tables and the warnings of a text that is read.
pub(crate) fn tables(format: Format, name: &str, text: &str) -> (Vec<AxisTable>, Vec<String>) {
    let found = read_text(format, name, text).unwrap_or_else(|error| panic!("{error}"));
    let Content::Axes(tables) = found.content else {
        panic!("tables of axes")
    };
    (
        tables,
        found.warnings.iter().map(ToString::to_string).collect(),
    )
}

pub(crate) fn refused(format: Format, name: &str, text: &str) -> String {
    read_text(format, name, text)
        .expect_err("refused")
        .to_string()
}

/// mm or deg of a position, and of a deviation.
pub(crate) fn edges(table: &AxisTable) -> Vec<(f64, f64)> {
    let positions = table.positions.iter().map(|at| table.input_at_edge(*at));
    positions
        .zip(
            table
                .forward
                .iter()
                .map(|value| table.output_at_edge(*value)),
        )
        .collect()
}

pub(crate) fn close(found: f64, expected: f64, within: f64) {
    assert!(
        (found - expected).abs() <= within,
        "found {found}, expected {expected}"
    );
}
