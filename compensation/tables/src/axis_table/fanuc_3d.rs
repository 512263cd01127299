//! The grid of a 3-D compensation as a table: the parameters that hold it in a FANUC are not known.

use core::fmt::Write;

use volcomp_document::CsvTable;
use volcomp_vocabulary::AxisName;

use super::{
    ExchangeError, Format, GridTable, LineError, TextFile, WriteOptions, Written,
    csv::without_comments,
    grid_table::{MOST_LINES, node_at, nodes},
    text::{number, short},
};

pub(crate) fn write(grid: &GridTable, options: &WriteOptions) -> Result<Written, ExchangeError> {
    let outputs = grid.outputs().len();
    if let Some((axis, lines)) = grid
        .axes()
        .iter()
        .zip(grid.lines())
        .find(|(_, lines)| lines.len() > MOST_LINES)
    {
        return Err(ExchangeError::Unfit {
            format: Format::Fanuc3d,
            what: format!("axis {axis}"),
            found: format!("{} lines", lines.len()),
            expected: format!("{MOST_LINES} at the most"),
        });
    }
    let mut written = Written::default();
    if grid.values().iter().all(|value| value.abs() < 1e-9) {
        return Ok(written);
    }
    let mut text = String::new();
    for line in options.facts.lines(Format::Fanuc3d, options) {
        // Writing to a string does not fail.
        let _ = writeln!(text, "# {line}");
    }
    let axes: Vec<String> = grid.axes().iter().map(ToString::to_string).collect();
    let deviations: Vec<String> = grid
        .outputs()
        .iter()
        .map(|axis| format!("deviation {axis}"))
        .collect();
    let _ = writeln!(text, "{}", [axes, deviations].concat().join(","));
    for node in 0..grid.nodes() {
        let at = grid.node(node).into_iter().map(|mm| short(mm, 9));
        let values = grid.values()[node * outputs..][..outputs]
            .iter()
            .map(|mm| short(mm * 1e3, 6));
        let _ = writeln!(text, "{}", at.chain(values).collect::<Vec<_>>().join(","));
    }
    written.files.push(TextFile {
        name: "grid.csv".to_owned(),
        text,
    });
    written.notes.push(
        "linear within each cell, along each axis (trilinear); the mean of both directions"
            .to_owned(),
    );
    Ok(written)
}

pub(crate) fn read(files: &[&TextFile]) -> Result<GridTable, ExchangeError> {
    let [file] = files else {
        return Err(ExchangeError::NoCurves(format!(
            "found {} files, expected one with a grid",
            files.len()
        )));
    };
    let csv = CsvTable::parse(&file.name, &without_comments(&file.text))?;
    let (mut axes, mut outputs, mut columns): (Vec<AxisName>, Vec<AxisName>, Vec<_>) =
        (Vec::new(), Vec::new(), Vec::new());
    for (column, name) in csv.columns() {
        let (into, letter) = match name.trim().strip_prefix("deviation ") {
            Some(letter) => (&mut outputs, letter),
            None => (&mut axes, name),
        };
        let axis: AxisName = letter.trim().parse().map_err(|_| {
            LineError::at(
                file,
                csv.header_line(),
                format!("the column `{name}`"),
                "an axis, or deviation and an axis",
            )
        })?;
        if into.contains(&axis) || axis.is_rotary() {
            return Err(LineError::at(
                file,
                csv.header_line(),
                format!("the column `{name}`"),
                "each linear axis once",
            ));
        }
        into.push(axis);
        columns.push((column, name.trim().starts_with("deviation ")));
    }
    if axes.is_empty() || axes.len() > 3 || outputs.is_empty() || outputs.len() > 3 {
        return Err(LineError::at(
            file,
            csv.header_line(),
            "the columns",
            "one to three axes and as many deviations",
        ));
    }
    let mut rows: Vec<(Vec<f64>, Vec<f64>, usize)> = Vec::new();
    for row in csv.rows() {
        let (mut at, mut values) = (Vec::new(), Vec::new());
        for (column, is_value) in &columns {
            let text = row.cell(*column).text();
            let found = number(text).ok_or_else(|| {
                LineError::at(file, row.line(), volcomp_document::quoted(text), "a number")
            })?;
            if *is_value {
                values.push(found * 1e-3);
            } else {
                at.push(found);
            }
        }
        rows.push((at, values, row.line()));
    }
    let lines: Vec<Vec<f64>> = (0..axes.len())
        .map(|axis| {
            let mut lines: Vec<f64> = rows.iter().map(|(at, _, _)| at[axis]).collect();
            lines.sort_by(f64::total_cmp);
            lines.dedup();
            lines
        })
        .collect();
    if nodes(&lines) != rows.len() || lines.iter().any(|lines| lines.len() < 2) {
        return Err(LineError::whole(
            file,
            format!("{} rows", rows.len()),
            "a row for each node of a grid of 2 lines along each axis at the least",
        ));
    }
    let mut all = Vec::with_capacity(rows.len() * outputs.len());
    for (node, (at, values, line)) in rows.into_iter().enumerate() {
        let expected = node_at(&lines, node);
        if at != expected {
            return Err(LineError::at(
                file,
                line,
                "another node",
                format!("the node {expected:?}"),
            ));
        }
        all.extend(values);
    }
    Ok(GridTable::new(axes, lines, outputs, all)?)
}
