//! Evaluations of several files in one call: one that is refused does not hide the others.

use std::path::{Path, PathBuf};

use schemars::JsonSchema;
use serde::Serialize;
use volcomp_calibrate::different_machines;
use volcomp_metrology::Metadata;

use super::Answer;
use super::iso230::{
    judged::{Judgement, verdicts_text},
    rows::{self, Row},
};
use crate::{failure::Failure, table::folded};

/// One file, evaluated.
pub(crate) struct Evaluated<D> {
    pub(crate) document: D,
    pub(crate) text: String,
    /// What the file says of itself.
    pub(crate) metadata: Metadata,
    /// The same as in the document: what stands in its row of the CSV file.
    pub(crate) judgement: Judgement,
}

/// The document of one file, or of several.
#[derive(Debug, Serialize, JsonSchema)]
#[serde(untagged)]
pub(crate) enum Files<D> {
    /// Of several files, in their order.
    Many {
        /// The evaluation of each.
        files: Vec<Self>,
    },
    /// Of one file.
    One(Box<D>),
    /// A file that is refused, among others.
    Refused(RefusedFile),
}

/// A file that is refused, among others.
#[derive(Clone, Debug, Serialize, JsonSchema)]
pub(crate) struct RefusedFile {
    /// The file as it was named in the call.
    pub(crate) file: String,
    /// Why it is refused.
    pub(crate) error: String,
}

/// The answer to a call with these files, and the CSV file with a row for each. With one file what refuses it is the answer; with
/// several the others are still evaluated. A wrong call, or work that failed, ends it in either case.
pub(crate) fn evaluated<D: Serialize>(
    files: &[PathBuf],
    csv: Option<&Path>,
    one: impl Fn(&Path) -> Result<Evaluated<D>, Failure>,
) -> Result<Answer, Failure> {
    let csv = csv.map(|path| rows::open(path, files)).transpose()?;
    let row = |path: &Path, found| Row {
        file: path.display().to_string(),
        found,
    };
    if let [only] = files {
        let one = one(only)?;
        let Judgement {
            decision, notes, ..
        } = one.judgement.clone();
        if let Some(output) = csv {
            rows::write(output, &[row(only, Ok(one.judgement))])?;
        }
        return Ok(Answer::new(&one.document, one.text, notes)?.decided(decision));
    }
    let (mut all, mut texts, mut rows) = (Vec::new(), Vec::new(), Vec::new());
    let (mut refused, mut said) = (Vec::new(), Vec::new());
    for path in files {
        let file = path.display().to_string();
        match one(path) {
            Ok(one) => {
                let notes: String = (one.judgement.notes.iter())
                    .map(|note| folded(&format!("note: {note}"), ""))
                    .collect();
                texts.push(format!("{file}\n{notes}{}", one.text));
                rows.push(row(path, Ok(one.judgement)));
                said.push((file, one.metadata));
                all.push(Files::One(Box::new(one.document)));
            }
            Err(failure @ (Failure::Call(_) | Failure::Work(_))) => return Err(failure),
            Err(failure) => {
                let error = failure.message();
                texts.push(folded(&format!("{file} REFUSED: {error}"), ""));
                rows.push(row(path, Err(error.clone())));
                let file = RefusedFile { file, error };
                refused.push(file.clone());
                all.push(Files::Refused(file));
            }
        }
    }
    texts.push(verdicts_text(&rows));
    if let Some(output) = csv {
        rows::write(output, &rows)?;
    }
    let said: Vec<(String, &Metadata)> =
        (said.iter()).map(|(file, of)| (file.clone(), of)).collect();
    let document = Files::Many { files: all };
    let decisions = rows
        .iter()
        .filter_map(|row| row.found.as_ref().ok()?.decision);
    let answer = Answer::new(&document, texts.join("\n"), different_machines(&said))?;
    let answer = decisions.fold(answer, |answer, decision| answer.decided(Some(decision)));
    Ok(Answer {
        failed: some_refused(&refused, files.len()),
        ..answer
    })
}

/// Why the program fails after all files were read: some, each with its error, were refused.
pub(crate) fn some_refused(refused: &[RefusedFile], count: usize) -> Option<Failure> {
    let first = &refused.first()?.error;
    let files: Vec<&str> = refused.iter().map(|of| of.file.as_str()).collect();
    Some(Failure::input(match files[..] {
        [_] => format!("1 of {count} files are refused: {first}"),
        _ => format!(
            "{} of {count} files are refused: {}; the first one: {first}",
            files.len(),
            files.join(", ")
        ),
    }))
}
