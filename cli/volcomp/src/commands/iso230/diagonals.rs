//! Part 6: measured body and face diagonals.

use std::{fmt::Write as _, path::Path};

use schemars::JsonSchema;
use serde::Serialize;
use volcomp_metrology::{
    DIAGONAL_NAMES, DeviationUnit, Diagonal, Iso230Part6, Measurement, StandardQuantity,
    evaluate_diagonals, judged, read_file,
};
use volcomp_report::measured_diagonals_picture;

use super::Iso230Arguments;
use crate::{
    arguments::{self, numbers},
    commands::{
        Answer,
        evaluation::{
            DIAGONALS, Judgement, RefusedFile, Row, decision_text, open_rows, quantities_text,
            some_refused, tolerances, write_rows,
        },
        fixed, table, table_text,
    },
    failure::Failure,
    table::{folded, or_dash},
};

/// Options of diagonals.
#[derive(clap::Args)]
#[command(next_help_heading = "Diagonals (--part 6)")]
pub(super) struct DiagonalOptions {
    /// Diagonal of each file, in order: PPP,NPP,PNP,PPN [default: by title or name of the file]
    #[arg(long, value_name = "NAMES")]
    diagonals: Option<String>,
    /// Edges of the box along X, Y and Z, mm, to estimate squareness
    #[arg(long, value_name = "X,Y,Z")]
    box_mm: Option<String>,
}

impl DiagonalOptions {
    pub(super) fn given(&self) -> Option<&'static str> {
        match (&self.diagonals, &self.box_mm) {
            (Some(_), _) => Some("--diagonals"),
            (_, Some(_)) => Some("--box-mm"),
            _ => None,
        }
    }

    /// The diagonals named on the command line. Empty if the files name them.
    fn named(&self, count: usize) -> Result<Vec<Diagonal>, Failure> {
        let Some(text) = &self.diagonals else {
            return Ok(Vec::new());
        };
        let mut named = Vec::new();
        for name in text.split(',') {
            named.push(Diagonal::named(name).ok_or_else(|| {
                Failure::Input(format!(
                    "--diagonals: found `{}`, expected one of {}",
                    name.trim(),
                    DIAGONAL_NAMES.join(", ")
                ))
            })?);
        }
        if named.len() != count {
            return Err(Failure::Input(format!(
                "--diagonals: found {} names, expected one for each of {count} files",
                named.len()
            )));
        }
        Ok(named)
    }
}

/// Measured diagonals, with their tolerances.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct MeasuredDiagonals {
    #[serde(flatten)]
    found: Iso230Part6,
    /// Refused files; the others are evaluated.
    refused: Vec<RefusedFile>,
    /// E_d, B_d, M_d and the spread over all diagonals.
    #[serde(flatten)]
    judgement: Judgement,
}

pub(super) fn run(arguments: &Iso230Arguments) -> Result<Answer, Failure> {
    let options = &arguments.diagonals;
    let tolerances = tolerances(arguments.tolerance.as_deref(), &DIAGONALS)?;
    let named = options.named(arguments.files.len())?;
    let edges = match &options.box_mm {
        Some(text) => Some(numbers("--box-mm", text, "three lengths in mm: 800,600,500")?),
        None => None,
    };
    let csv = match &arguments.csv {
        Some(path) => Some(open_rows(path, &arguments.files)?),
        None => None,
    };
    let plot = arguments.plot_file()?;
    let (mut notes, mut measured, mut refused) = (Vec::new(), Vec::new(), Vec::new());
    for (index, path) in arguments.files.iter().enumerate() {
        match read(path, arguments, named.get(index).copied()) {
            Ok(one) => measured.push(one),
            Err(failure) if arguments.files.len() == 1 => return Err(failure),
            Err(failure) => refused
                .push(RefusedFile { file: path.display().to_string(), error: failure.message() }),
        }
    }
    if measured.is_empty() {
        let reasons: Vec<&str> = refused.iter().map(|r| r.error.as_str()).collect();
        return Err(Failure::Input(reasons.join("; ")));
    }
    for (diagonal, measurement) in &measured {
        let all = measurement.notes.iter();
        notes.extend(all.map(|note| format!("{diagonal}: {note}")));
    }
    let pairs: Vec<(Diagonal, &Measurement)> = measured.iter().map(|(d, m)| (*d, m)).collect();
    let found = evaluate_diagonals(&pairs, edges)?;
    for m in &found.diagonals {
        let hints = m.result.outlier_hints.iter();
        notes.extend(hints.map(|hint| format!("{}: {}", m.diagonal, hint.text)));
    }
    if !found.lacking.is_empty() {
        let lacking: Vec<&str> = found.lacking.iter().map(|d| d.name()).collect();
        notes.push(format!(
            "{} not measured: the largest values are those of the others, and nothing is hinted at",
            lacking.join(", ")
        ));
    } else if edges.is_none() {
        notes.push(
            "with the edges of the box, --box-mm, the diagonals hint at squareness".to_owned(),
        );
    }
    let none = |_: &str| None;
    let unit = DeviationUnit::Um;
    let quantities = judged("ISO 230-6", found.quantities(), unit, &tolerances, none);
    if let Some(output) = csv {
        write_rows(output, &rows_of(&found, &refused))?;
    }
    if let Some(plot) = plot {
        plot.write(&measured_diagonals_picture(&found, &quantities))?;
    }
    let failed = some_refused(&refused, arguments.files.len());
    let document =
        MeasuredDiagonals { found, refused, judgement: Judgement::new(quantities, notes) };
    let text = text(&document) + &decision_text(&document.judgement);
    let notes = document.judgement.notes.clone();
    let answer = Answer::new(&document, text, notes)?.decided(document.judgement.decision);
    Ok(Answer { failed, ..answer })
}

fn read(
    path: &Path,
    arguments: &Iso230Arguments,
    named: Option<Diagonal>,
) -> Result<(Diagonal, Measurement), Failure> {
    let mut measurement = read_file(path)?;
    let in_words = || {
        let title = measurement.metadata.title.as_deref();
        let axis = measurement.metadata.axis.as_deref();
        let name = path.file_stem().map(|stem| stem.display().to_string());
        let texts = [title.map(str::to_owned), axis.map(str::to_owned), name];
        texts.into_iter().flatten().find_map(|t| Diagonal::in_text(&t))
    };
    let Some(diagonal) = named.or_else(in_words) else {
        return Err(Failure::in_file(
            path,
            format_args!(
                "found no name of a diagonal in title and file name, expected one of {}, or --diagonals",
                DIAGONAL_NAMES.join(", ")
            ),
        ));
    };
    if arguments::apply(path, &mut measurement, arguments.unit)? == DeviationUnit::Urad {
        return Err(Failure::in_file(path, "found angles, expected deviations along a diagonal"));
    }
    Ok((diagonal, measurement))
}

fn rows_of(found: &Iso230Part6, refused: &[RefusedFile]) -> Vec<Row> {
    let good = found.diagonals.iter().map(|m| {
        let values = [
            ("E", "systematic deviation", m.result.e),
            ("E_forward", "systematic deviation, forward", m.result.e_forward),
            ("E_backward", "systematic deviation, backward", m.result.e_backward),
            ("B", "reversal value", m.result.b),
            ("M", "mean deviation", m.result.m),
            ("growth", "growth over the length", Some(m.growth_um)),
        ];
        let quantities =
            values.map(|(symbol, name, value)| StandardQuantity { symbol, name, value });
        let quantities = judged("ISO 230-6", quantities, DeviationUnit::Um, &[], |_| None);
        Row { file: m.file.clone(), found: Ok(Judgement::new(quantities, Vec::new())) }
    });
    let bad = refused.iter().map(|r| Row { file: r.file.clone(), found: Err(r.error.clone()) });
    good.chain(bad).collect()
}

fn text(document: &MeasuredDiagonals) -> String {
    let mut rows = table(&["", "length mm", "E", "E ↑", "E ↓", "B", "M", "growth"]);
    for m in &document.found.diagonals {
        rows.add_row([
            m.diagonal.name().to_owned(),
            fixed(m.length_mm, 2),
            or_dash(m.result.e, 2),
            or_dash(m.result.e_forward, 2),
            or_dash(m.result.e_backward, 2),
            or_dash(m.result.b, 2),
            or_dash(m.result.m, 2),
            fixed(m.growth_um, 2),
        ]);
    }
    let mut text = format!(
        "ISO 230-6, all values in µm\n\n{}\n{}\nin common {} µm/m\n",
        table_text(&rows),
        quantities_text(&document.judgement.quantities, true),
        fixed(document.found.scale_um_per_m, 2)
    );
    for hint in &document.found.squareness {
        let _ = writeln!(text, "hint: {} {} µrad", hint.error, fixed(hint.urad, 1));
    }
    for refused in &document.refused {
        text += &folded(&format!("{} REFUSED: {}", refused.file, refused.error), "");
    }
    text
}
