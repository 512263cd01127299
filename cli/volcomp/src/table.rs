//! Text tables. Numbers are right-aligned, and headers bold on a terminal. Tables have at most 80 columns, or the width
//! of a narrower terminal.

use std::{
    fmt::Write,
    io::{self, BufRead, BufReader, IsTerminal as _, Read, Seek},
    ops::Range,
    sync::OnceLock,
};

use anstyle::Style;
use comfy_table::{CellAlignment, ColumnConstraint, ContentArrangement, Table, presets};

/// Maximum width of a table, columns.
const WIDTH: usize = 80;
/// Minimum terminal width to which tables are fitted, columns. Narrower terminals wrap lines themselves.
const NARROWEST: usize = 30;

/// Maximum line width, columns: the width of the terminal, at most [`WIDTH`]. For files and pipes [`WIDTH`].
fn most() -> usize {
    static MOST: OnceLock<usize> = OnceLock::new();
    *MOST.get_or_init(|| {
        if !std::io::stdout().is_terminal() {
            return WIDTH;
        }
        let stated = std::env::var("COLUMNS").ok();
        let seen = terminal_size::terminal_size().map(|(width, _)| usize::from(width.0));
        width_of_terminal(stated.as_deref(), seen)
    })
}

/// Terminal width, clamped to `NARROWEST..=WIDTH`. A positive `COLUMNS` (`stated`) overrides the width that the
/// terminal reports (`seen`). `WIDTH` if neither is known.
fn width_of_terminal(stated: Option<&str>, seen: Option<usize>) -> usize {
    let stated = stated.and_then(|columns| columns.trim().parse().ok());
    let columns = stated.filter(|columns| *columns > 0).or(seen);
    columns.map_or(WIDTH, |columns| columns.clamp(NARROWEST, WIDTH))
}

pub(crate) const HEAD: Style = Style::new().bold();

/// A table of numbers. The first column is left-aligned, all others are right-aligned.
pub(crate) fn table(header: &[&str]) -> Table {
    let mut table = Table::new();
    table.load_style(presets::NOTHING);
    table.set_header(header.to_vec());
    for column in table.column_iter_mut().skip(1) {
        column.set_cell_alignment(CellAlignment::Right);
    }
    table
}

/// Left-aligns text columns. `columns` holds their indices, from 0.
pub(crate) fn to_the_left(table: &mut Table, columns: &[usize]) {
    for &place in columns {
        if let Some(column) = table.column_mut(place) {
            column.set_cell_alignment(CellAlignment::Left);
        }
    }
}

/// A table as text, without trailing blanks. A table that is too wide is split into several tables below one another,
/// each of which starts with the first column.
pub(crate) fn table_text(table: &Table) -> String {
    table_within(table, most())
}

fn table_within(table: &Table, most: usize) -> String {
    let columns = table.column_iter().count();
    let mut parts = Vec::new();
    let mut from = 1;
    loop {
        // Each part has at least one column, however wide the column is.
        let mut to = (from + 1).min(columns);
        while to < columns && width(&showing(table, from..to + 1)) <= most {
            to += 1;
        }
        let mut part = showing(table, from..to);
        // On a narrow terminal a column that is too wide is wrapped. Files and pipes get it unwrapped.
        if most < WIDTH && width(&part) > most {
            part.set_content_arrangement(ContentArrangement::Dynamic)
                .set_width(u16::try_from(most).unwrap_or(u16::MAX));
        }
        parts.push(text_of(&part));
        if to >= columns {
            return parts.join("\n");
        }
        from = to;
    }
}

/// A table of numbered rows in the layout of [`table_text`]. Its cells are in a file, because [`Table`] needs several
/// hundred bytes per cell.
pub(crate) struct RowTable {
    header: Vec<String>,
    /// Width of the widest cell of each column so far, characters. Index 0 is the row number.
    widths: Vec<usize>,
}

impl RowTable {
    /// Creates a table without rows. `header` holds the column headers after the row number.
    pub(crate) fn new(header: Vec<String>) -> Self {
        let first = std::iter::once(String::new());
        let header: Vec<String> = first.chain(header).collect();
        Self {
            // `Table` gives an empty column the width of a blank.
            widths: header.iter().map(|head| head.chars().count().max(1)).collect(),
            header,
        }
    }

    /// Writes a row to the file of rows, and widens `widths` to its cells.
    pub(crate) fn write_row(
        number: usize,
        cells: &[String],
        widths: &mut Vec<usize>,
        rows: &mut Vec<u8>,
    ) {
        let first = number.to_string();
        let own = std::iter::once(&first).chain(cells);
        for (column, cell) in own.enumerate() {
            if column > 0 {
                rows.push(b'\t');
            }
            rows.extend_from_slice(cell.as_bytes());
            let width = cell.chars().count();
            match widths.get_mut(column) {
                Some(widest) => *widest = width.max(*widest),
                None => widths.push(width),
            }
        }
        rows.push(b'\n');
    }

    /// Widens the columns to the given cell widths.
    pub(crate) fn widen(&mut self, widths: &[usize]) {
        for (widest, width) in self.widths.iter_mut().zip(widths) {
            *widest = (*widest).max(*width);
        }
    }

    /// Writes the table of the rows in a file.
    pub(crate) fn write(
        &self,
        rows: &mut (impl Read + Seek),
        out: &mut dyn io::Write,
    ) -> io::Result<()> {
        self.write_within(rows, out, most())
    }

    fn write_within(
        &self,
        rows: &mut (impl Read + Seek),
        out: &mut dyn io::Write,
        most: usize,
    ) -> io::Result<()> {
        let columns = self.header.len();
        let mut from = 1;
        loop {
            let mut to = (from + 1).min(columns);
            while to < columns && self.width(from..to + 1) <= most {
                to += 1;
            }
            let mut line = String::new();
            self.lay_out(&mut line, self.header.iter().map(String::as_str), &(from..to));
            writeln!(out, "{HEAD}{line}{HEAD:#}")?;
            rows.rewind()?;
            let mut rows = BufReader::new(&mut *rows);
            let mut row = String::new();
            while rows.read_line(&mut row)? > 0 {
                self.lay_out(&mut line, row.trim_end().split('\t'), &(from..to));
                writeln!(out, "{line}")?;
                row.clear();
            }
            if to >= columns {
                return Ok(());
            }
            writeln!(out)?;
            from = to;
        }
    }

    /// Width of a line with the first column and a range of the others. Each cell has a blank on both sides; the line
    /// has none at its end.
    fn width(&self, shown: Range<usize>) -> usize {
        let widths = self.widths.get(shown).unwrap_or_default();
        1 + self.widths[0] + widths.iter().map(|width| width + 2).sum::<usize>()
    }

    /// Formats a line with the first column and a range of the others.
    fn lay_out<'c>(
        &self,
        line: &mut String,
        cells: impl Iterator<Item = &'c str>,
        shown: &Range<usize>,
    ) {
        line.clear();
        for (column, (cell, &width)) in cells.zip(&self.widths).enumerate() {
            let _ = match column {
                0 => write!(line, " {cell:<width$} "),
                _ if shown.contains(&column) => write!(line, " {cell:>width$} "),
                _ => continue,
            };
        }
        line.truncate(line.trim_end().len());
    }
}

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
    lines.map(|l| l.trim_end().chars().count()).max().unwrap_or(0)
}

fn text_of(table: &Table) -> String {
    let mut text = String::new();
    for (index, line) in table.lines().enumerate() {
        let line = line.trim_end();
        if index == 0 && !line.is_empty() {
            let _ = writeln!(text, "{HEAD}{line}{HEAD:#}");
        } else {
            text += line;
            text.push('\n');
        }
    }
    text
}

/// Formats a number with `digits` decimals. A value rounded to zero has no sign. A value of 1e12 or more in magnitude
/// is in scientific notation.
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

/// Formats a coordinate, mm or deg, with at most six decimals: a target in inches is no round number of mm.
pub(crate) fn coordinate(value: f64) -> String {
    let text = fixed(value, 6);
    if text.contains('e') {
        return text;
    }
    text.trim_end_matches('0').trim_end_matches('.').to_owned()
}

/// Formats a number with `digits` decimals; a dash for `None`.
pub(crate) fn or_dash(value: Option<f64>, digits: usize) -> String {
    value.map_or_else(|| "-".to_owned(), |value| fixed(value, digits))
}

/// Wraps a sentence at blanks. `indent` precedes the first line; further lines have two more blanks.
pub(crate) fn folded(sentence: &str, indent: &str) -> String {
    folded_within(sentence, indent, most())
}

fn folded_within(sentence: &str, indent: &str, most: usize) -> String {
    let mut text = indent.to_owned();
    let mut column = indent.chars().count();
    for (index, word) in sentence.split_whitespace().enumerate() {
        let wide = word.chars().count();
        if index > 0 && column + 1 + wide > most {
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

/// Appends a text to a key and wraps it. Continuation lines are aligned with the start of the text. A text that fits on
/// one line is unchanged.
pub(crate) fn folded_behind(key: &str, text: &str) -> String {
    let indent = key.chars().count();
    let room = most().saturating_sub(indent).max(1);
    if text.chars().count() <= room {
        return format!("{key}{text}\n");
    }
    let rest = folded_within(text, "", room.saturating_sub(2));
    let mut all = String::new();
    for (index, line) in rest.lines().enumerate() {
        let front = if index == 0 { key.to_owned() } else { " ".repeat(indent) };
        let _ = writeln!(all, "{front}{line}");
    }
    all
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_in_a_file_are_laid_out_like_a_table() {
        let header = ["X µm", "a wide head", "C", "residual µm", "axis µrad", "Y"];
        for count in [0, 1, 9, 10, 120] {
            let mut plain = table(&[&[""], &header[..]].concat());
            let mut streamed = RowTable::new(header.map(str::to_owned).to_vec());
            let mut file = io::Cursor::new(Vec::new());
            for row in 1..=count {
                let wide = 10_f64.powi(row % 14) * (-1_f64).powi(row);
                let values = [wide, 0.5, -wide, f64::from(row), wide / 3.0, 1e-9];
                let cells = values.map(|value| fixed(value, 3)).to_vec();
                let number = usize::try_from(row).expect("a row");
                let mut widths = Vec::new();
                RowTable::write_row(number, &cells, &mut widths, file.get_mut());
                streamed.widen(&widths);
                plain.add_row([vec![number.to_string()], cells].concat());
            }
            for most in [80, 50, 36] {
                let mut out = Vec::new();
                let written = streamed.write_within(&mut file, &mut out, most);
                written.expect("memory");
                let out = String::from_utf8(out).expect("text");
                assert_eq!(out, table_within(&plain, most), "{count} {most}");
            }
        }
    }

    #[test]
    fn what_rounds_to_zero_has_no_sign() {
        assert_eq!(fixed(-0.04, 1), "0.0");
        assert_eq!(fixed(-0.06, 1), "-0.1");
        assert_eq!(fixed(-0.0, 0), "0");
        assert!(fixed(f64::NAN, 2).contains("NaN"));
        assert_eq!(fixed(-1.25e300, 2), "-1.25e300");
        assert_eq!(coordinate(19.685 * 25.4), "499.999");
        assert_eq!((coordinate(100.0), coordinate(-0.0)), ("100".to_owned(), "0".to_owned()));
    }

    #[test]
    fn a_narrow_terminal_is_heeded() {
        for (stated, seen, width) in [
            (None, None, 80),
            (Some("50"), None, 50),
            (Some("50"), Some(70), 50),
            (None, Some(70), 70),
            (Some("wide"), Some(70), 70),
            (Some("0"), Some(70), 70),
            (Some("200"), Some(70), 80),
            (None, Some(3), 30),
        ] {
            assert_eq!(width_of_terminal(stated, seen), width, "{stated:?} {seen:?}");
        }
    }

    #[test]
    fn sentences_are_broken_at_the_width() {
        for most in [80, 50] {
            let text = folded_within(&"word ".repeat(60), " ", most);
            let widest = text.lines().map(|line| line.chars().count()).max();
            assert!(widest <= Some(most) && widest > Some(most - 6), "{widest:?}");
            assert_eq!(text.split_whitespace().count(), 60);
        }
    }

    #[test]
    fn a_wide_column_is_wrapped_on_a_narrow_terminal() {
        let mut wide = table(&["", "name"]);
        wide.add_row(["A", &"word ".repeat(16)]);
        let text = anstream::adapter::strip_str(&table_within(&wide, 50)).to_string();
        assert!(text.lines().all(|line| line.chars().count() <= 50), "{text}");
        assert_eq!(text.matches("word").count(), 16);
    }

    #[test]
    fn wide_tables_are_broken_and_lose_nothing() {
        let names: Vec<String> = (0..20).map(|i| format!("column {i}")).collect();
        let mut wide = table(&names.iter().map(String::as_str).collect::<Vec<_>>());
        wide.add_row((0..20).map(|i| format!("{i}.125")));
        let narrow = anstream::adapter::strip_str(&table_within(&wide, 50)).to_string();
        assert!(narrow.lines().all(|line| line.chars().count() <= 50));
        let text = anstream::adapter::strip_str(&table_within(&wide, 80)).to_string();
        assert!(text.lines().all(|line| line.chars().count() <= 80));
        for i in 0..20 {
            assert!(text.contains(&format!("column {i}")) && text.contains(&format!("{i}.125")));
        }
        assert!(text.lines().filter(|line| line.contains("column 0")).count() > 1);
    }
}
