//! CSV table with a header, whose rows and cells have their location in the file.
//!
//! A column head is a name alone, or a name followed by a unit.

use core::ops::Range;
use std::{
    io::{self, BufRead, Seek, SeekFrom},
    sync::Arc,
};

use csv::{ReaderBuilder, StringRecord, Trim};

use crate::error::{InputError, bounded, quoted};

/// CSV table in memory. The separator is the most frequent of `,`, `;` and the tab in the header. A first line `sep=;`,
/// as written by spreadsheets, has priority. Lines above the header that begin with `#` are skipped.
///
/// If the separator is not a comma, numbers may have a decimal comma. Then no number of the table may have a decimal
/// point.
///
/// Cells may be in double quotes. Blanks around a cell, blank rows and a byte order mark are ignored. Columns are found
/// by name, in any order and case.
#[derive(Clone, Debug)]
pub struct CsvTable {
    file: String,
    text: Arc<str>,
    separator: char,
    decimal_comma_line: Option<usize>,
    header: Record,
    rows: Vec<Record>,
}

#[derive(Clone, Debug)]
struct Record {
    line: usize,
    span: Range<usize>,
    cells: StringRecord,
}

/// Column of a [`CsvTable`], as returned by [`CsvTable::column`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Column(usize);

/// Row of a [`CsvTable`] below its header.
#[derive(Clone, Copy, Debug)]
pub struct CsvRow<'t> {
    table: &'t CsvTable,
    record: &'t Record,
}

#[derive(Clone, Copy, Debug)]
pub struct Cell<'t> {
    row: CsvRow<'t>,
    column: Column,
}

impl CsvTable {
    /// Parses a table. `file` is the name of the file in messages.
    ///
    /// # Errors
    /// There is no header, a row has more or fewer cells than the header (empty cells at the end are ignored), a cell
    /// contains a line break, or a quoted cell is malformed.
    pub fn parse(file: &str, text: &str) -> Result<Self, InputError> {
        let text: Arc<str> = text.into();
        let (start, separator) = start_and_separator(&text);
        let error = |line: usize, span: Range<usize>, message: String| InputError {
            file: file.to_owned(),
            line,
            key: String::new(),
            message,
            span,
            text: text.clone(),
        };
        let mut records = records(&text, start, separator)
            .map_err(|(line, message)| error(line, 0..0, message))?
            .into_iter();
        let Some(header) = records.next() else {
            return Err(error(1, 0..0, "found no rows, expected a header".to_owned()));
        };
        let mut rows = Vec::new();
        for mut record in records {
            if record.cells.iter().all(str::is_empty) {
                continue;
            }
            let columns = header.cells.len();
            if has_line_break(&record.cells) {
                let message = "found a cell of several lines, expected one line a row: is a double quote not closed?";
                return Err(error(record.line, record.span, message.to_owned()));
            }
            if !is_as_wide(&mut record.cells, columns) {
                let row = record.cells.iter().collect::<Vec<_>>();
                let mut message = format!(
                    "found {} in {}, expected {} as in the header",
                    counted(record.cells.len()),
                    quoted(&row.join(&separator.to_string())),
                    counted(columns)
                );
                if separator == ',' && record.cells.len() > columns && has_halves(&record.cells) {
                    message +=
                        "; if numbers have decimal commas, separate the columns by semicolons";
                } else if columns < record.cells.len()
                    && !record.cells.iter().any(|c| is_number(c) || is_number_with_comma(c))
                {
                    message += "; if this is the header, remove the lines above it";
                }
                return Err(error(record.line, record.span, message));
            }
            rows.push(record);
        }
        let has_comma = |record: &&Record| record.cells.iter().any(is_number_with_comma);
        Ok(Self {
            decimal_comma_line: rows
                .iter()
                .find(has_comma)
                .filter(|_| separator != ',')
                .map(|record| record.line),
            file: file.to_owned(),
            separator,
            header,
            rows,
            text,
        })
    }

    /// Separator of the cells: `,`, `;` or the tab.
    pub fn separator(&self) -> char {
        self.separator
    }

    /// Whether numbers in the table have a decimal comma.
    pub fn has_decimal_comma(&self) -> bool {
        self.decimal_comma_line.is_some()
    }

    /// All columns with their names as written in the header. A name may be empty.
    pub fn columns(&self) -> impl Iterator<Item = (Column, &str)> {
        let cells = self.header.cells.iter().enumerate();
        cells.map(|(index, name)| (Column(index), name))
    }

    /// Columns with a name that is not empty, and the name as written in the header.
    pub fn names(&self) -> impl Iterator<Item = (Column, &str)> {
        self.columns().filter(|(_, name)| !name.is_empty())
    }

    /// Column with this name; `None` if the header lacks the name.
    ///
    /// # Errors
    /// The header has the name twice.
    pub fn column(&self, name: &str) -> Result<Option<Column>, InputError> {
        let mut named = self.names().filter(|(_, found)| found.eq_ignore_ascii_case(name));
        let first = named.next().map(|(column, _)| column);
        match named.next() {
            Some(_) => Err(self.header_error(format!("column `{name}` appears twice"))),
            None => Ok(first),
        }
    }

    /// Column with this name, which the header must contain.
    ///
    /// # Errors
    /// The header lacks the name or has it twice.
    pub fn require(&self, name: &str) -> Result<Column, InputError> {
        self.column(name)?.ok_or_else(|| {
            let found = self.names().map(|(_, name)| name).collect::<Vec<_>>();
            let found = quoted(&found.join(&self.separator.to_string()));
            self.header_error(format!("found {found}, expected a column `{name}`"))
        })
    }

    /// Names of the columns that are not in `known`, for a note that these columns are ignored.
    pub fn names_besides(&self, known: &[&str]) -> Vec<&str> {
        let is_known = |name: &str| known.iter().any(|known| known.eq_ignore_ascii_case(name));
        let names = self.names().map(|(_, name)| name);
        names.filter(|name| !is_known(name)).collect()
    }

    /// Rows below the header that are not blank, in the order of the file.
    pub fn rows(&self) -> impl ExactSizeIterator<Item = CsvRow<'_>> {
        self.rows.iter().map(|record| CsvRow { table: self, record })
    }

    /// Error with this message, located at the header.
    pub fn header_error(&self, message: impl Into<String>) -> InputError {
        self.error(&self.header, "header", message.into())
    }

    /// Error at the row that begins in `line`, or at the header if no row begins there.
    pub fn error_at(&self, line: usize, message: impl Into<String>) -> InputError {
        match self.rows().find(|row| row.line() == line) {
            Some(row) => row.error(message),
            None => self.header_error(message),
        }
    }

    fn error(&self, record: &Record, key: &str, message: String) -> InputError {
        InputError {
            file: self.file.clone(),
            line: record.line,
            key: key.to_owned(),
            message,
            span: record.span.clone(),
            text: self.text.clone(),
        }
    }
}

/// Reads a CSV file of any length in batches of rows. Each batch is a [`CsvTable`] with the same header.
///
/// Rows and cells are the same as those of [`CsvTable::parse`] for the whole text, but without their location. After an
/// error, parse the whole text to report the location.
#[derive(Debug)]
pub struct CsvBatches<R> {
    reader: csv::Reader<R>,
    head: CsvTable,
    cells: StringRecord,
}

impl<R: BufRead + Seek> CsvBatches<R> {
    /// Reads the header. If the separator is not a comma, also scans all rows once to find out whether numbers have
    /// decimal commas.
    ///
    /// # Errors
    /// The text cannot be read, has no header, or, if all rows are scanned, has a row with more or fewer cells than the
    /// header.
    pub fn open(file: &str, mut text: R) -> io::Result<Self> {
        // Read up to the first line that is neither blank nor a remark.
        let mut top = String::new();
        loop {
            let from = top.len();
            let length = text.read_line(&mut top)?;
            let line = top.get(from..).unwrap_or_default();
            if length == 0 || remarks(line.trim_start_matches('\u{feff}')) == 0 {
                break;
            }
        }
        let (start, separator) = start_and_separator(&top);
        let start = text.seek(SeekFrom::Start(start as u64))?;
        let mut reader = builder(separator).from_reader(text);
        let mut header = StringRecord::new();
        while is_blank(&header) {
            if !reader.read_record(&mut header)? {
                return Err(io::Error::other("found no rows, expected a header"));
            }
        }
        let mut batches = Self {
            reader,
            head: CsvTable {
                file: file.to_owned(),
                text: Arc::default(),
                separator,
                decimal_comma_line: None,
                header: Record::nowhere(header),
                rows: Vec::new(),
            },
            cells: StringRecord::new(),
        };
        if separator != ',' {
            let first = batches.reader.position().clone();
            let mut has_comma = false;
            while batches.read()? {
                has_comma |= batches.cells.iter().any(is_number_with_comma);
            }
            batches.head.decimal_comma_line = has_comma.then_some(0);
            let at = SeekFrom::Start(start + first.byte());
            batches.reader.seek_raw(at, first)?;
        }
        Ok(batches)
    }

    /// The header, as a table without rows.
    pub fn head(&self) -> &CsvTable {
        &self.head
    }

    /// Returns the next rows, at most `most`. At the end of the text, returns a table without rows.
    ///
    /// # Errors
    /// The text cannot be read, or a row has more or fewer cells than the header.
    pub fn next_rows(&mut self, most: usize) -> io::Result<CsvTable> {
        let mut table = self.head.clone();
        while table.rows.len() < most && self.read()? {
            table.rows.push(Record::nowhere(self.cells.clone()));
        }
        Ok(table)
    }

    /// Reads the next row that is not blank into `cells`. Returns `false` at the end of the text.
    fn read(&mut self) -> io::Result<bool> {
        while self.reader.read_record(&mut self.cells)? {
            if self.cells.iter().all(str::is_empty) {
                continue;
            }
            if has_line_break(&self.cells)
                || !is_as_wide(&mut self.cells, self.head.header.cells.len())
            {
                return Err(io::Error::other("a row is not as wide as the header"));
            }
            return Ok(true);
        }
        Ok(false)
    }
}

impl Record {
    fn nowhere(cells: StringRecord) -> Self {
        Self { line: 0, span: 0..0, cells }
    }
}

impl<'t> CsvRow<'t> {
    /// Line of the row in the file, from 1.
    pub fn line(&self) -> usize {
        self.record.line
    }

    /// Cell of this row in a column of the table.
    pub fn cell(&self, column: Column) -> Cell<'t> {
        Cell { row: *self, column }
    }

    /// Error with this message, located at this row.
    pub fn error(&self, message: impl Into<String>) -> InputError {
        self.table.error(self.record, "row", message.into())
    }
}

impl<'t> Cell<'t> {
    /// Text of the cell without surrounding blanks. The text is empty if the column belongs to another table with more
    /// columns.
    pub fn text(&self) -> &'t str {
        let record: &'t Record = self.row.record;
        record.cells.get(self.column.0).unwrap_or_default()
    }

    /// Line of the cell in the file, from 1.
    pub fn line(&self) -> usize {
        self.row.line()
    }

    /// Text of the cell. If the table has decimal commas, the comma is replaced by a point.
    ///
    /// # Errors
    /// The table has decimal commas and this cell has a point, which may separate thousands.
    pub fn decimal_text(&self) -> Result<String, InputError> {
        let text = self.text();
        match self.row.table.decimal_comma_line {
            Some(_) if !text.contains('.') => Ok(text.replacen(',', ".", 1)),
            Some(line) => Err(self.error(format!(
                "found {}, expected a number with a decimal comma as in line {line}",
                quoted(text)
            ))),
            None => Ok(text.to_owned()),
        }
    }

    /// Parses the cell as a finite number with a magnitude of at most [`LARGEST_NUMBER`](crate::LARGEST_NUMBER).
    ///
    /// # Errors
    /// Any other text, including `nan` and `inf`.
    pub fn number(&self) -> Result<f64, InputError> {
        let number = self.decimal_text()?.parse::<f64>().ok();
        bounded(number).map_err(|expected| {
            let found = quoted(self.text());
            self.error(format!("found {found}, expected {expected}"))
        })
    }

    /// Error with this message, located at this cell.
    pub fn error(&self, message: impl Into<String>) -> InputError {
        let table = self.row.table;
        let name = table.header.cells.get(self.column.0).unwrap_or_default();
        table.error(self.row.record, name, message.into())
    }
}

/// Whether a cell contains a line break. A double quote that is not closed causes this, and the cell then contains the
/// rows after it.
fn has_line_break(cells: &StringRecord) -> bool {
    cells.iter().any(|cell| cell.contains(['\n', '\r']))
}

/// Byte at which the table starts in the text, and separator of its cells.
fn start_and_separator(text: &str) -> (usize, char) {
    let start = if text.starts_with('\u{feff}') { 3 } else { 0 };
    let start = start + remarks(text.get(start..).unwrap_or_default());
    let rest = text.get(start..).unwrap_or_default();
    let first = rest.lines().next().unwrap_or_default();
    match first.trim().strip_prefix("sep=") {
        Some(";") => (start + first.len(), ';'),
        Some(",") => (start + first.len(), ','),
        // `trim` removes a tab after `sep=`.
        Some("" | "\t") => (start + first.len(), '\t'),
        _ => {
            let header = rest.lines().find(|line| !line.trim().is_empty());
            (start, separator_of(header.unwrap_or_default()))
        }
    }
}

/// Number of bytes of the leading lines that are blank or begin with `#`.
fn remarks(text: &str) -> usize {
    let mut length = 0;
    for line in text.split_inclusive('\n') {
        if !line.starts_with('#') && !line.trim().is_empty() {
            break;
        }
        length += line.len();
    }
    length
}

fn separator_of(header: &str) -> char {
    let mut counts = [(',', 0), ('\t', 0), (';', 0)];
    let mut is_quoted = false;
    for character in header.chars() {
        if character == '"' {
            is_quoted = !is_quoted;
        }
        for (separator, count) in &mut counts {
            if character == *separator && !is_quoted {
                *count += 1;
            }
        }
    }
    let most = counts.into_iter().max_by_key(|(_, count)| *count);
    most.filter(|(_, count)| *count > 0).map_or(',', |(separator, _)| separator)
}

/// Whether a record comes from a blank line: it has at most one cell, and that cell is empty.
fn is_blank(cells: &StringRecord) -> bool {
    cells.len() <= 1 && cells.get(0).is_none_or(str::is_empty)
}

fn builder(separator: char) -> ReaderBuilder {
    let mut builder = ReaderBuilder::new();
    builder
        .has_headers(false)
        .flexible(true)
        .trim(Trim::All)
        // Each of the separators `,`, `;` and tab is a single byte.
        .delimiter(u8::try_from(separator).unwrap_or(b','));
    builder
}

/// Removes empty cells beyond the columns of the header. Returns whether the row then has as many cells as the header.
fn is_as_wide(cells: &mut StringRecord, columns: usize) -> bool {
    if cells.iter().skip(columns).all(str::is_empty) {
        cells.truncate(columns);
    }
    cells.len() == columns
}

/// All records from byte `start` on, with their lines and byte ranges. Errors: the line and message of a syntax error.
fn records(text: &str, start: usize, separator: char) -> Result<Vec<Record>, (usize, String)> {
    let mut reader =
        builder(separator).from_reader(text.get(start..).unwrap_or_default().as_bytes());
    let bytes = text.as_bytes();
    let mut records = Vec::new();
    let mut cells = StringRecord::new();
    let (mut counted, mut line) = (0, 1);
    loop {
        match reader.read_record(&mut cells) {
            Ok(false) => return Ok(records),
            Ok(true) => {}
            Err(error) => return Err((line, error.to_string())),
        }
        let byte = |position: u64| start + usize::try_from(position).unwrap_or(usize::MAX - start);
        let from = byte(cells.position().map_or(0, csv::Position::byte));
        let to = byte(reader.position().byte());
        // The reported position may be that of blank lines before the record, so leading line ends are skipped.
        let record = bytes.get(from..to).unwrap_or_default();
        let is_break = |byte: &&u8| matches!(byte, b'\n' | b'\r');
        let from = from + record.iter().take_while(is_break).count();
        let to = to - record.iter().rev().take_while(is_break).count();
        let passed = bytes.get(counted..from).unwrap_or_default();
        line += passed.split(|&byte| byte == b'\n').count() - 1;
        counted = from;
        if is_blank(&cells) {
            continue;
        }
        records.push(Record { line, span: from..to.max(from), cells: cells.clone() });
    }
}

fn is_number(cell: &str) -> bool {
    cell.parse::<f64>().is_ok()
}

/// Whether a cell is a number with one comma and no point, such as `-12,5`.
fn is_number_with_comma(cell: &str) -> bool {
    cell.matches(',').count() == 1 && !cell.contains('.') && is_number(&cell.replacen(',', ".", 1))
}

/// Whether two neighbouring cells may be the two parts of a number with a decimal comma, such as `12` and `5`.
fn has_halves(cells: &StringRecord) -> bool {
    let is_whole = |cell: &str| {
        let digits = cell.strip_prefix(['-', '+']).unwrap_or(cell);
        !digits.is_empty() && digits.bytes().all(|byte| byte.is_ascii_digit())
    };
    let behind = cells.iter().skip(1);
    let mut pairs = cells.iter().zip(behind);
    pairs.any(|(whole, part)| is_whole(whole) && is_whole(part) && !part.starts_with(['-', '+']))
}

fn counted(columns: usize) -> String {
    let plural = if columns == 1 { "" } else { "s" };
    format!("{columns} column{plural}")
}

/// Units and their spellings, in lower case. The case of a spelling is ignored.
const UNITS: [(&str, &[&str]); 14] = [
    ("mm", &["mm"]),
    // Lower case does not turn the micro sign into the Greek letter, so both are listed.
    ("um", &["um", "µm", "μm", "micron", "microns"]),
    ("nm", &["nm"]),
    ("cm", &["cm"]),
    ("m", &["m"]),
    ("in", &["in", "inch"]),
    ("ft", &["ft"]),
    ("deg", &["deg", "°"]),
    ("rad", &["rad"]),
    ("mrad", &["mrad"]),
    ("urad", &["urad", "µrad", "μrad"]),
    ("arcsec", &["arcsec"]),
    ("gon", &["gon"]),
    ("degc", &["degc", "°c"]),
];

/// Splits a column head after its first word. Returns the name and the remaining text (a unit, or empty) without
/// surrounding blanks and punctuation: `X` and `mm` for `X mm`, `dx` and `um` for `dx_um`, `C` and `deg` for `C (deg)`.
pub fn split_head(head: &str) -> (&str, &str) {
    let is_mark = |c: char| c.is_whitespace() || "_-/,:.[](){}".contains(c);
    let end = head.find(|c: char| !c.is_alphanumeric());
    let (name, behind) = head.split_at(end.unwrap_or(head.len()));
    (name, behind.trim_matches(is_mark))
}

/// Splits a head that ends in a known unit into name and unit: `dz` and `um` for `dz_um` and `dz [µm]`, `spindle front`
/// and `degc` for `spindle front °C`. `None` if the head does not end in a known unit.
pub fn split_unit(head: &str) -> Option<(&str, &'static str)> {
    let is_mark = |c: char| c.is_whitespace() || "_-/,:.[](){}".contains(c);
    let (name, behind) = split_head(head);
    let (name, unit) = if let Some(unit) = unit_named(behind) {
        (name, unit)
    } else {
        // The name itself may contain blanks and punctuation.
        let head = head.trim_end_matches(is_mark);
        let (name, behind) = head.rsplit_once(is_mark)?;
        (name.trim_end_matches(is_mark), unit_named(behind)?)
    };
    (!name.is_empty()).then_some((name, unit))
}

/// Name of the unit with this spelling, such as `um` for `µm` and `deg` for `°`; `None` for an unknown unit.
pub fn unit_named(text: &str) -> Option<&'static str> {
    let small = text.to_lowercase();
    let is_it = |(_, names): &&(&str, &[&str])| names.contains(&small.as_str());
    UNITS.iter().find(is_it).map(|(unit, _)| *unit)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn heads_are_names_alone_or_with_a_unit() {
        for (head, name, behind) in [
            ("target", "target", ""),
            ("Target mm", "Target", "mm"),
            ("dx_um", "dx", "um"),
            ("deviation [µm]", "deviation", "µm"),
            ("C°", "C", "°"),
            ("X, mm", "X", "mm"),
            ("dead_length_mm", "dead", "length_mm"),
            ("targetµ", "targetµ", ""),
            ("", "", ""),
            ("_mm", "", "mm"),
        ] {
            assert_eq!(split_head(head), (name, behind), "{head}");
        }
    }

    #[test]
    fn names_may_have_marks_before_their_unit() {
        for (head, expected) in [
            ("dz_um", Some(("dz", "um"))),
            ("dz µm", Some(("dz", "um"))),
            ("rot [µrad]", Some(("rot", "urad"))),
            ("spindle_front_degc", Some(("spindle_front", "degc"))),
            ("spindle front °C", Some(("spindle front", "degc"))),
            ("spindle front [°C]", Some(("spindle front", "degc"))),
            ("t1°C", Some(("t1", "degc"))),
            ("time_s", None),
            ("dz", None),
            ("um", None),
            ("_um", None),
            ("µm", None),
            ("", None),
        ] {
            assert_eq!(split_unit(head), expected, "{head}");
        }
    }

    #[test]
    fn units_have_several_names() {
        for (text, unit) in [
            ("MM", Some("mm")),
            ("µm", Some("um")),
            ("Microns", Some("um")),
            ("μrad", Some("urad")),
            ("°", Some("deg")),
            ("inch", Some("in")),
            ("", None),
            ("thou", None),
        ] {
            assert_eq!(unit_named(text), unit, "{text}");
        }
    }
}
