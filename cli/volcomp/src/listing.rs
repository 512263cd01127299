//! Answers for any number of positions. Each row is formatted once, for the document or the table, into a temporary
//! file, which is printed at the end. Nothing is printed if a later row fails, and memory use does not grow with the
//! number of rows.

use std::io::{self, Seek, Write};

use rayon::prelude::*;
use serde::Serialize;
use tempfile::SpooledTempFile;

use crate::{
    commands::outside::{Outside, Remarks},
    failure::Failure,
    finite::{first_not_finite, not_finite},
    output,
    table::RowTable,
};

/// Size above which the rows move from memory to a temporary file, bytes.
const IN_MEMORY: usize = 4 << 20;
/// Number of rows that a thread formats at a time.
const CHUNK: usize = 256;

pub(crate) trait Row: Serialize + Sync {
    /// Cells of the table after the row number.
    fn cells(&self) -> Vec<String>;

    /// Errors and axes whose range the position of the row exceeds.
    fn outside(&self) -> &Outside;
}

/// Format of the printed answer.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(crate) enum Print {
    /// The document of a single row.
    Object,
    /// The document with the rows in a list.
    List,
    /// The table of the rows and the remarks on them.
    Table,
}

pub(crate) struct Listing {
    print: Print,
    table: RowTable,
    written: SpooledTempFile,
    rows: usize,
    outside: usize,
    remarks: Remarks,
}

/// Formatted text of consecutive rows, and the column widths that the rows need.
struct Formatted {
    written: Vec<u8>,
    widths: Vec<usize>,
    remarks: Vec<(usize, String)>,
}

impl Listing {
    /// Creates an empty listing. `header` holds the column headers after the row number.
    pub(crate) fn new(json: bool, is_list: bool, header: Vec<String>) -> Self {
        Self {
            print: match (json, is_list) {
                (true, false) => Print::Object,
                (true, true) => Print::List,
                (false, _) => Print::Table,
            },
            table: RowTable::new(header),
            written: SpooledTempFile::new(IN_MEMORY),
            rows: 0,
            outside: 0,
            remarks: Remarks::default(),
        }
    }

    pub(crate) fn rows(&self) -> usize {
        self.rows
    }

    /// Number of rows outside the range of the model.
    pub(crate) fn outside(&self) -> usize {
        self.outside
    }

    /// Appends rows with their remarks. An empty remark is not printed.
    ///
    /// # Errors
    ///
    /// A number of a row is not finite, or the temporary file cannot be written.
    pub(crate) fn extend<R: Row>(
        &mut self,
        rows: &[R],
        remark: impl Fn(&R) -> String + Sync,
    ) -> Result<(), Failure> {
        let (print, before) = (self.print, self.rows);
        let formatted = rows.par_chunks(CHUNK).enumerate().map(|(chunk, rows)| {
            let first = before + chunk * CHUNK;
            Formatted::of(rows, first, print, &remark)
        });
        for formatted in formatted.collect::<Result<Vec<_>, _>>()? {
            self.written.write_all(&formatted.written).map_err(|e| failed(&e))?;
            self.table.widen(&formatted.widths);
            for (row, remark) in formatted.remarks {
                self.remarks.add(row, remark);
            }
        }
        self.rows += rows.len();
        self.outside += rows.iter().filter(|row| !row.outside().is_empty()).count();
        Ok(())
    }

    /// Prints the rows and, below a table, the remarks and the text.
    pub(crate) fn print(&mut self, text: &str) -> Result<(), Failure> {
        self.written.rewind().map_err(|e| failed(&e))?;
        let (written, table) = (&mut self.written, &self.table);
        let [before, after] = match self.print {
            Print::Object => ["", "\n"],
            Print::List => ["{\"points\":[", "]}\n"],
            Print::Table => {
                let remarks = self.remarks.text();
                return output::print_by(|out| {
                    table.write(written, out)?;
                    write!(out, "{remarks}{text}")
                });
            }
        };
        output::print_plain(|out| {
            out.write_all(before.as_bytes())?;
            io::copy(written, out)?;
            out.write_all(after.as_bytes())
        })
    }
}

impl Formatted {
    /// Formats rows. `before` is the number of earlier rows.
    fn of<R: Row>(
        rows: &[R],
        before: usize,
        print: Print,
        remark: &impl Fn(&R) -> String,
    ) -> Result<Self, Failure> {
        let (mut written, mut document) = (Vec::new(), Vec::new());
        let (mut widths, mut remarks) = (Vec::new(), Vec::new());
        for (index, row) in (before..).zip(rows) {
            document.clear();
            let serialized = serde_json::to_writer(&mut document, row);
            serialized.map_err(|e| Failure::Work(format!("the JSON document: {e}")))?;
            // JSON represents a number that is not finite as null.
            if document.windows(4).any(|word| word == b"null")
                && let Some(key) = first_not_finite(row)
            {
                return Err(not_finite(&match print {
                    Print::Object => key,
                    Print::List | Print::Table => format!("points[{index}].{key}"),
                }));
            }
            if print == Print::Table {
                let cells = row.cells();
                RowTable::write_row(index + 1, &cells, &mut widths, &mut written);
                remarks.push((index + 1, remark(row)));
                continue;
            }
            if index > 0 {
                written.push(b',');
            }
            written.extend_from_slice(&document);
        }
        Ok(Self { written, widths, remarks })
    }
}

fn failed(error: &io::Error) -> Failure {
    Failure::Work(format!("temporary file: {error}"))
}
