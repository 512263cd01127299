//! The CSV file of evaluations: a row for each file.

use std::path::{Path, PathBuf};

use volcomp_metrology::JudgedQuantity;

use super::judged::Judgement;
use crate::{failure::Failure, output::OutputFile};

/// What one file came to.
pub(crate) struct Row {
    /// The file as it was named in the call.
    pub(crate) file: String,
    /// Its quantities, or why it is refused.
    pub(crate) found: Result<Judgement, String>,
}

/// An output that must be none of the files that are read.
pub(crate) fn open(path: &Path, files: &[PathBuf]) -> Result<OutputFile, Failure> {
    let inputs: Vec<(&Path, &str)> = files
        .iter()
        .map(|f| (f.as_path(), "the readings"))
        .collect();
    OutputFile::open_beside(path, &inputs)
}

/// Writes the table: file, unit, a column for each quantity, verdict, error.
pub(crate) fn write(mut output: OutputFile, rows: &[Row]) -> Result<(), Failure> {
    let mut heads: Vec<String> = Vec::new();
    for quantity in rows
        .iter()
        .flat_map(|row| row.found.iter().flat_map(|found| &found.quantities))
    {
        let head = head(quantity);
        if !heads.contains(&head) {
            heads.push(head);
        }
    }
    let mut table = csv::Writer::from_writer(Vec::new());
    let mut line = |cells: Vec<String>| {
        let written = table.write_record(&cells);
        written.map_err(|error| Failure::Work(format!("the table: {error}")))
    };
    let names = ["file".to_owned(), "unit".to_owned()].into_iter();
    let last = ["verdict".to_owned(), "error".to_owned()];
    line(names.chain(heads.iter().cloned()).chain(last).collect())?;
    for row in rows {
        let mut cells = vec![row.file.clone()];
        match &row.found {
            Ok(Judgement {
                quantities,
                decision,
                ..
            }) => {
                cells.push(quantities.first().map_or("", |q| q.unit.key()).to_owned());
                for name in &heads {
                    let value = quantities.iter().find(|q| head(q) == *name);
                    let value = value.and_then(|q| q.value);
                    cells.push(value.map_or_else(String::new, |v| v.to_string()));
                }
                cells.push(decision.map_or("", |d| d.verdict.word()).to_owned());
                cells.push(String::new());
            }
            Err(error) => {
                cells.extend(std::iter::repeat_n(String::new(), heads.len() + 2));
                cells.push(error.clone());
            }
        }
        line(cells)?;
    }
    let bytes = table.into_inner();
    output.append(&bytes.map_err(|error| Failure::Work(format!("the table: {error}")))?)?;
    output.finish()
}

/// The symbol; of ASME with the standard before it, since it has those of ISO 230-2.
fn head(quantity: &JudgedQuantity) -> String {
    if quantity.standard.starts_with("ASME") {
        format!("ASME_{}", quantity.symbol)
    } else {
        quantity.symbol.to_owned()
    }
}
