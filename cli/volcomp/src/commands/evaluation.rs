//! Evaluation of measurement files: quantities against tolerances, and a CSV file with one row per file. If a call
//! names several files, a rejected file does not stop the others.

use std::path::{Path, PathBuf};

use schemars::JsonSchema;
use serde::Serialize;
use volcomp_calibrate::different_machines;
use volcomp_metrology::{
    Decision, DeviationUnit, JudgedQuantity, Metadata, Tolerance, Verdict, parse_tolerances,
};

use super::Answer;
use crate::{
    failure::Failure,
    output::OutputFile,
    table::{folded, or_dash, table, table_text, to_the_left},
};

/// The symbols of ISO 230-4.
pub(crate) const CIRCULAR: [&str; 6] = ["G_ccw", "G_cw", "G_b", "F_max", "F_min", "D"];
/// The symbols of ISO 230-6.
pub(crate) const DIAGONALS: [&str; 5] = ["E_d", "E_d_unidirectional", "B_d", "M_d", "spread"];

/// The common results of every evaluation: quantities, tolerances and notes.
#[derive(Clone, Debug, Serialize, JsonSchema)]
pub(crate) struct Judgement {
    /// The quantities of every requested standard, with uncertainty and tolerance.
    pub(crate) quantities: Vec<JudgedQuantity>,
    /// Decision over all tolerances; null if none is stated.
    pub(crate) decision: Option<Decision>,
    /// Whether every quantity with a tolerance passes; null without tolerances.
    pass: Option<bool>,
    /// Notes on the files and their readings.
    pub(crate) notes: Vec<String>,
}

impl Judgement {
    pub(crate) fn new(quantities: Vec<JudgedQuantity>, notes: Vec<String>) -> Self {
        let decision = Decision::over(&quantities);
        Self { pass: decision.map(|decision| decision.pass), decision, quantities, notes }
    }
}

/// Parses the tolerances of the command line. Only the symbols in `known` are allowed.
pub(crate) fn tolerances(text: Option<&str>, known: &[&str]) -> Result<Vec<Tolerance>, Failure> {
    let Some(text) = text else {
        return Ok(Vec::new());
    };
    parse_tolerances(text, known).map_err(|error| Failure::Input(format!("--{error}")))
}

/// Table of several files, one row per file: the quantities with a limit, and the verdict. If no quantity has a limit,
/// the quantities with a plain symbol are shown. The names of all symbols follow the table.
pub(crate) fn verdicts_text(rows: &[Row]) -> String {
    let all = || (rows.iter()).flat_map(|row| row.found.iter().flat_map(|found| &found.quantities));
    let is_judged = all().any(|quantity| quantity.limit.is_some());
    let is_shown = |quantity: &JudgedQuantity| {
        if is_judged { quantity.limit.is_some() } else { !quantity.symbol.contains('_') }
    };
    let mut symbols: Vec<&str> = Vec::new();
    let mut names: Vec<(&str, &str)> = Vec::new();
    for quantity in all() {
        if is_shown(quantity) && !symbols.contains(&quantity.symbol) {
            symbols.push(quantity.symbol);
        }
        if !names.contains(&(quantity.symbol, quantity.name)) {
            names.push((quantity.symbol, quantity.name));
        }
    }
    let mut heads = vec!["file", "verdict", "unit"];
    heads.extend(&symbols);
    let mut shown = table(&heads);
    to_the_left(&mut shown, &[1, 2]);
    for row in rows {
        let name = std::path::Path::new(&row.file);
        let name = name.file_name().unwrap_or_default().display().to_string();
        let Ok(Judgement { quantities, decision, .. }) = &row.found else {
            shown.add_row([name, "REFUSED".to_owned()]);
            continue;
        };
        let verdict =
            decision.map_or_else(|| "no limits".to_owned(), |d| d.verdict.word().to_uppercase());
        let unit = quantities.first().map_or(DeviationUnit::Um, |q| q.unit);
        let mut cells = vec![name, verdict, unit.to_string()];
        for symbol in &symbols {
            let mut of = quantities.iter();
            let value = of.find(|q| q.symbol == *symbol).and_then(|q| q.value);
            cells.push(or_dash(value, 2));
        }
        shown.add_row(cells);
    }
    let names = names.iter().map(|(symbol, name)| format!("{symbol}: {name}"));
    let names: Vec<String> = names.collect();
    let names = if names.is_empty() {
        String::new()
    } else {
        format!("\n{}", folded(&names.join("; "), ""))
    };
    table_text(&shown) + &names
}

/// The quantities as a table. Columns for uncertainty and limit appear if a quantity has them, and a column of names if
/// requested.
pub(crate) fn quantities_text(quantities: &[JudgedQuantity], with_names: bool) -> String {
    let uncertain = quantities.iter().any(|q| q.uncertainty.is_some());
    let limited = quantities.iter().any(|q| q.limit.is_some());
    let mut heads = vec!["", "value"];
    if uncertain {
        heads.push("U (k=2)");
    }
    if limited {
        heads.extend(["limit", "verdict"]);
    }
    if with_names {
        heads.push("name");
    }
    let mut rows = table(&heads);
    if with_names {
        to_the_left(&mut rows, &[heads.len() - 1]);
    }
    for quantity in quantities {
        let mut row = vec![quantity.symbol.to_owned(), or_dash(quantity.value, 2)];
        if uncertain {
            row.push(or_dash(quantity.uncertainty, 2));
        }
        if limited {
            row.push(or_dash(quantity.limit, 2));
            row.push(quantity.verdict.map_or("", Verdict::word).to_owned());
        }
        if with_names {
            row.push(quantity.name.to_owned());
        }
        rows.add_row(row);
    }
    table_text(&rows)
}

pub(crate) fn decision_text(judgement: &Judgement) -> String {
    let Some(decision) = judgement.decision else {
        return String::new();
    };
    let of = |verdict: Verdict| {
        let named = (judgement.quantities.iter()).filter(|q| q.verdict == Some(verdict));
        let mut symbols: Vec<&str> = named.map(|q| q.symbol).collect();
        // Two standards may use the same symbol, so list each symbol once.
        let mut seen = std::collections::HashSet::new();
        symbols.retain(|symbol| seen.insert(*symbol));
        symbols.join(", ")
    };
    let rule = match decision.rule {
        "simple" => "Decided by the values alone: no measurement uncertainty is stated",
        "ISO 14253-1" => "Decided by ISO 14253-1, with the measurement uncertainty on top",
        _ => "Decided by ISO 14253-1 where the uncertainty is stated, else by the value alone",
    };
    let worst_first = [Verdict::Fail, Verdict::NotEvaluated, Verdict::Undecided, Verdict::Pass];
    let parts = worst_first.map(|verdict| (verdict, of(verdict)));
    let parts = parts.iter().filter(|(_, named)| !named.is_empty());
    let parts: Vec<String> = parts.map(|(verdict, named)| format!("{verdict} {named}")).collect();
    let verdict = decision.verdict.word().to_uppercase();
    folded(&format!("{verdict}: {}. {rule}.", parts.join("; ")), "")
}

pub(crate) struct Row {
    pub(crate) file: String,
    /// The quantities and their verdicts; `Err` holds the reason why the file was rejected.
    pub(crate) found: Result<Judgement, String>,
}

/// The files that a picture must not overwrite: the readings, and the table of `--csv`.
pub(crate) fn with_csv<'a>(
    files: &'a [PathBuf],
    csv: Option<&'a Path>,
) -> Vec<(&'a Path, &'static str)> {
    let files = files.iter().map(|file| (file.as_path(), "the readings"));
    files.chain(csv.map(|csv| (csv, "--csv"))).collect()
}

pub(crate) fn open_rows(path: &Path, files: &[PathBuf]) -> Result<OutputFile, Failure> {
    OutputFile::open_beside(path, &with_csv(files, None))
}

/// Writes the table with the columns file, unit, quantities, verdict and error.
pub(crate) fn write_rows(output: OutputFile, rows: &[Row]) -> Result<(), Failure> {
    let mut heads: Vec<String> = Vec::new();
    for quantity in rows.iter().flat_map(|row| row.found.iter().flat_map(|found| &found.quantities))
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
            Ok(Judgement { quantities, decision, .. }) => {
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
    output.write_whole(&bytes.map_err(|error| Failure::Work(format!("the table: {error}")))?)
}

/// The column header of a quantity. ASME symbols are prefixed with the standard, because they repeat those of ISO
/// 230-2.
fn head(quantity: &JudgedQuantity) -> String {
    if quantity.standard.starts_with("ASME") {
        format!("ASME_{}", quantity.symbol)
    } else {
        quantity.symbol.to_owned()
    }
}

pub(crate) struct Evaluated<D> {
    pub(crate) document: D,
    pub(crate) text: String,
    pub(crate) metadata: Metadata,
    pub(crate) judgement: Judgement,
}

/// The document of one file, or of several.
#[derive(Debug, Serialize, JsonSchema)]
#[serde(untagged)]
pub(crate) enum Files<D> {
    /// The evaluations of several files, in their order.
    Many {
        /// Evaluation or refusal of each file.
        files: Vec<Self>,
    },
    /// The evaluation of one file.
    One(Box<D>),
    /// A refused file among several.
    Refused(RefusedFile),
}

/// A refused file among several.
#[derive(Clone, Debug, Serialize, JsonSchema)]
pub(crate) struct RefusedFile {
    /// Path as named in the call.
    pub(crate) file: String,
    /// Reason of the refusal.
    pub(crate) error: String,
}

/// Evaluates the files and writes the CSV file with one row per file. If the only file is refused, its error is
/// returned. Of several files the refused ones are listed, and the others are evaluated. An invalid call or a failed
/// operation is always returned as an error.
pub(crate) fn evaluated<D: Serialize>(
    files: &[PathBuf],
    csv: Option<&Path>,
    one: impl Fn(&Path) -> Result<Evaluated<D>, Failure>,
) -> Result<Answer, Failure> {
    let csv = csv.map(|path| open_rows(path, files)).transpose()?;
    let row = |path: &Path, found| Row { file: path.display().to_string(), found };
    if let [only] = files {
        let one = one(only)?;
        let Judgement { decision, notes, .. } = one.judgement.clone();
        if let Some(output) = csv {
            write_rows(output, &[row(only, Ok(one.judgement))])?;
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
        write_rows(output, &rows)?;
    }
    let said: Vec<(String, &Metadata)> =
        (said.iter()).map(|(file, of)| (file.clone(), of)).collect();
    let document = Files::Many { files: all };
    let decisions = rows.iter().filter_map(|row| row.found.as_ref().ok()?.decision);
    let answer = Answer::new(&document, texts.join("\n"), different_machines(&said))?;
    let answer = decisions.fold(answer, |answer, decision| answer.decided(Some(decision)));
    Ok(Answer { failed: some_refused(&refused, files.len()), ..answer })
}

/// The failure returned after all files were read, if some files were refused.
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
