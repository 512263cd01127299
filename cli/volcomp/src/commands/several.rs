//! Evaluations of several files in one call: one that is refused does not hide the others.

use std::path::{Path, PathBuf};

use serde::Serialize;

use super::Answer;
use super::iso230::rows::{self, Row};
use crate::{
    answers::quantity::{Decision, Quantity},
    failure::Failure,
    table::folded,
};

/// One file, evaluated.
pub(crate) struct Evaluated<D> {
    pub(crate) document: D,
    pub(crate) text: String,
    pub(crate) notes: Vec<String>,
    /// What stands in its row of the CSV file.
    pub(crate) found: (Vec<Quantity>, Option<Decision>),
}

/// The documents that stand for several files.
pub(crate) struct Documents<D> {
    /// Of a file, and why it is refused.
    pub(crate) refused: fn(String, String) -> D,
    /// Of all files.
    pub(crate) many: fn(Vec<D>) -> D,
}

/// The answer to a call with these files, and the CSV file with a row for each. With one file what refuses it is the answer; with
/// several the others are still evaluated. A wrong call, or work that failed, ends it in either case.
pub(crate) fn evaluated<D: Serialize>(
    files: &[PathBuf],
    csv: Option<&Path>,
    documents: &Documents<D>,
    one: impl Fn(&Path) -> Result<Evaluated<D>, Failure>,
) -> Result<Answer, Failure> {
    let csv = csv.map(|path| rows::open(path, files)).transpose()?;
    let row = |path: &Path, found| Row {
        file: path.display().to_string(),
        found,
    };
    if let [only] = files {
        let one = one(only)?;
        if let Some(output) = csv {
            rows::write(output, &[row(only, Ok(one.found))])?;
        }
        return Answer::new(&one.document, one.text, one.notes);
    }
    let (mut all, mut texts, mut rows, mut refused) = (Vec::new(), Vec::new(), Vec::new(), 0);
    for path in files {
        let file = path.display().to_string();
        match one(path) {
            Ok(one) => {
                let notes: String = (one.notes.iter())
                    .map(|note| folded(&format!("note: {note}"), ""))
                    .collect();
                texts.push(format!("{file}\n{notes}{}", one.text));
                rows.push(row(path, Ok(one.found)));
                all.push(one.document);
            }
            Err(failure @ (Failure::Call(_) | Failure::Work(_))) => return Err(failure),
            Err(failure) => {
                refused += 1;
                let error = failure.message();
                texts.push(folded(&format!("{file} REFUSED: {error}"), ""));
                rows.push(row(path, Err(error.clone())));
                all.push((documents.refused)(file, error));
            }
        }
    }
    if let Some(output) = csv {
        rows::write(output, &rows)?;
    }
    let document = (documents.many)(all);
    let answer = Answer::new(&document, texts.join("\n"), Vec::new())?;
    Ok(Answer {
        failed: some_refused(refused, files.len()),
        ..answer
    })
}

/// Why the program fails after all files were read: some were refused.
pub(crate) fn some_refused(refused: usize, count: usize) -> Option<Failure> {
    (refused > 0).then(|| {
        Failure::input(format_args!(
            "{refused} of {count} files are refused, see above"
        ))
    })
}
