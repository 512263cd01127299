//! Answers for any number of positions, one row each, with remarks on the rows.
//!
//! Each row is formatted once, for the document or the table, into a temporary file, which is printed at the end.
//! Nothing is printed if a later row fails, and memory use does not grow with the number of rows.

use std::io::{self, Seek, Write};

use rayon::prelude::*;
use schemars::JsonSchema;
use serde::Serialize;
use tempfile::SpooledTempFile;
use volcomp_kinematics::State;
use volcomp_model::Machine;
use volcomp_vocabulary::{AxisName, ErrorName};

use crate::{
    failure::Failure,
    output::{self, first_not_finite, not_finite},
    table::{RowTable, folded},
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

/// Errors and axes whose range the position exceeds.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct Outside {
    /// Errors whose curves are evaluated outside their range, sorted by name.
    pub(crate) outside_range: Vec<ErrorName>,
    /// Axes outside their travel.
    pub(crate) outside_travel: Vec<AxisName>,
}

pub(crate) fn outside(machine: &Machine, state: &State) -> Outside {
    let mut outside_travel = machine.outside_travel(state);
    outside_travel.sort_unstable();
    Outside { outside_range: machine.outside_range(state), outside_travel }
}

impl Outside {
    /// True if the position is within all ranges and travels.
    pub(crate) fn is_empty(&self) -> bool {
        self.outside_range.is_empty() && self.outside_travel.is_empty()
    }

    /// Text such as `outside travel Z, range EZY EZZ`; empty if the position is within all ranges and travels.
    pub(crate) fn words(&self) -> String {
        let parts =
            [("travel", joined(&self.outside_travel)), ("range", joined(&self.outside_range))];
        let said = parts.into_iter().filter(|(_, names)| !names.is_empty());
        let said: Vec<String> = said.map(|(of, names)| format!("{of} {names}")).collect();
        if said.is_empty() {
            return String::new();
        }
        format!("outside {}", said.join(", "))
    }
}

/// Note that `count` positions are outside the range of the model; `None` if `count` is 0.
pub(crate) fn outside_note(count: usize) -> Option<String> {
    let positions = match count {
        0 => return None,
        1 => "one position lies".to_owned(),
        more => format!("{more} positions lie"),
    };
    Some(format!(
        "{positions} beyond an axis's travel or an error's measured range: the errors there are those at the end of the range"
    ))
}

pub(crate) fn joined<T: ToString>(names: &[T]) -> String {
    let names: Vec<String> = names.iter().map(ToString::to_string).collect();
    names.join(" ")
}

/// The remarks on the rows of a table, printed below the table. Rows with the same remark are grouped, in the order of
/// first occurrence.
#[derive(Default)]
pub(crate) struct Remarks(Vec<(String, Vec<[usize; 2]>)>);

impl Remarks {
    /// Adds the remark on a row. An empty text is no remark.
    pub(crate) fn add(&mut self, row: usize, remark: String) {
        if remark.is_empty() {
            return;
        }
        match self.0.iter_mut().find(|(known, _)| *known == remark) {
            Some((_, runs)) => match runs.last_mut() {
                Some([_, last]) if *last + 1 == row => *last = row,
                _ => runs.push([row, row]),
            },
            None => self.0.push((remark, vec![[row, row]])),
        }
    }

    /// The lines below the table; empty if there are no remarks.
    pub(crate) fn text(&self) -> String {
        let lines = self.0.iter().map(|(remark, runs)| {
            let plural =
                if matches!(runs[..], [[first, last]] if first == last) { "" } else { "s" };
            folded(&format!("row{plural} {}: {remark}", ranges(runs)), " ")
        });
        let lines: String = lines.collect();
        if lines.is_empty() {
            return lines;
        }
        format!("\n{lines}")
    }
}

/// Formats runs of consecutive numbers, each given by its first and last number: `1, 3-7`.
fn ranges(runs: &[[usize; 2]]) -> String {
    let runs = runs.iter().map(|[first, last]| match last - first {
        0 => first.to_string(),
        1 => format!("{first}, {last}"),
        _ => format!("{first}-{last}"),
    });
    runs.collect::<Vec<_>>().join(", ")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_with_one_remark_stand_together() {
        let text = |rows: &[&str]| {
            let mut remarks = Remarks::default();
            for (row, remark) in (1..).zip(rows) {
                remarks.add(row, (*remark).to_owned());
            }
            remarks.text()
        };
        assert_eq!(
            text(&["", "a", "a", "a", "b", "", "a", "b", "b"]),
            "\n rows 2-4, 7: a\n rows 5, 8, 9: b\n"
        );
        assert_eq!(text(&["", "", "c"]), "\n row 3: c\n");
        assert_eq!(text(&["", ""]), "");
    }
}
