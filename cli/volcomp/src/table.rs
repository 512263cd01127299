//! Tables for people: numbers to the right, heads in bold on a terminal, never wider than 80 columns.

use std::fmt::Write;

use anstyle::Style;
use comfy_table::{CellAlignment, ColumnConstraint, Table, presets};

/// How wide a table may be.
const WIDTH: usize = 80;

/// Heads of tables and of parts of an answer.
pub(crate) const HEAD: Style = Style::new().bold();

/// A table of numbers: first column left, the others right.
pub(crate) fn table(header: &[&str]) -> Table {
    let mut table = Table::new();
    table.load_style(presets::NOTHING);
    table.set_header(header.to_vec());
    for column in table.column_iter_mut().skip(1) {
        column.set_cell_alignment(CellAlignment::Right);
    }
    table
}

/// Aligns columns of words to the left, by their places from 0.
pub(crate) fn to_the_left(table: &mut Table, columns: &[usize]) {
    for &place in columns {
        if let Some(column) = table.column_mut(place) {
            column.set_cell_alignment(CellAlignment::Left);
        }
    }
}

/// A table as text, without blanks at the ends of lines. One that is wider than 80 columns is broken into several
/// below one another, each with the first column in front.
pub(crate) fn table_text(table: &Table) -> String {
    let columns = table.column_iter().count();
    let mut parts = Vec::new();
    let mut from = 1;
    loop {
        // At least one column each time, however wide it is.
        let mut to = (from + 1).min(columns);
        while to < columns && width(&showing(table, from..to + 1)) <= WIDTH {
            to += 1;
        }
        parts.push(text_of(&showing(table, from..to)));
        if to >= columns {
            return parts.join("\n");
        }
        from = to;
    }
}

/// The first column and a range of the others.
fn showing(table: &Table, shown: std::ops::Range<usize>) -> Table {
    let mut part = table.clone();
    for (index, column) in part.column_iter_mut().enumerate().skip(1) {
        if !shown.contains(&index) {
            column.set_constraint(ColumnConstraint::Hidden);
        }
    }
    part
}

fn width(table: &Table) -> usize {
    let lines = table.lines();
    lines
        .map(|l| l.trim_end().chars().count())
        .max()
        .unwrap_or(0)
}

fn text_of(table: &Table) -> String {
    let mut text = String::new();
    for (index, line) in table.lines().enumerate() {
        let line = line.trim_end();
        if index == 0 && !line.is_empty() {
            // Writing to a string never fails.
            let _ = writeln!(text, "{HEAD}{line}{HEAD:#}");
        } else {
            text += line;
            text.push('\n');
        }
    }
    text
}

/// A number with so many digits behind the point; one that rounds to zero has no sign, and one of more than twelve
/// digits before the point stands as a power of ten.
pub(crate) fn fixed(value: f64, digits: usize) -> String {
    if value.is_finite() && value.abs() >= 1e12 {
        return format!("{value:.digits$e}");
    }
    let text = format!("{value:.digits$}");
    match text.strip_prefix('-') {
        Some(size) if size.chars().all(|c| matches!(c, '0' | '.')) => size.to_owned(),
        _ => text,
    }
}

/// A sentence broken at blanks so that no line is wider than 80 columns; `indent` stands in front of the first line,
/// and two blanks more in front of the others.
pub(crate) fn folded(sentence: &str, indent: &str) -> String {
    let mut text = indent.to_owned();
    let mut column = indent.chars().count();
    for (index, word) in sentence.split_whitespace().enumerate() {
        let wide = word.chars().count();
        if index > 0 && column + 1 + wide > WIDTH {
            // Writing to a string never fails.
            let _ = write!(text, "\n{indent}  ");
            column = indent.chars().count() + 2;
        } else if index > 0 {
            text.push(' ');
            column += 1;
        }
        text += word;
        column += wide;
    }
    text + "\n"
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_rounds_to_zero_has_no_sign() {
        assert_eq!(fixed(-0.04, 1), "0.0");
        assert_eq!(fixed(-0.06, 1), "-0.1");
        assert_eq!(fixed(-0.0, 0), "0");
        assert!(fixed(f64::NAN, 2).contains("NaN"));
        assert_eq!(fixed(-1.25e300, 2), "-1.25e300");
    }

    #[test]
    fn sentences_are_broken_at_eighty_columns() {
        let text = folded(&"word ".repeat(60), " ");
        assert!(text.lines().all(|line| line.chars().count() <= WIDTH));
        assert_eq!(text.split_whitespace().count(), 60);
    }

    #[test]
    fn wide_tables_are_broken_and_lose_nothing() {
        let names: Vec<String> = (0..20).map(|i| format!("column {i}")).collect();
        let mut wide = table(&names.iter().map(String::as_str).collect::<Vec<_>>());
        wide.add_row((0..20).map(|i| format!("{i}.125")));
        let text = anstream::adapter::strip_str(&table_text(&wide)).to_string();
        assert!(text.lines().all(|line| line.chars().count() <= WIDTH));
        for i in 0..20 {
            assert!(text.contains(&format!("column {i}")) && text.contains(&format!("{i}.125")));
        }
        assert!(
            text.lines()
                .filter(|line| line.contains("column 0"))
                .count()
                > 1
        );
    }
}
