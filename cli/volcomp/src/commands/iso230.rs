//! `volcomp iso230`: the evaluation of a positioning test by ISO 230-2.

use std::path::PathBuf;

use volcomp_metrology::{Approach, DeviationUnit, Iso230Part2, Measurement, evaluate, read_file};
use volcomp_vocabulary::Direction;

use super::{Answer, fixed, table, table_text};
use crate::{
    answers::iso230::Iso230,
    failure::Failure,
    unit::{self, Unit},
};

/// Evaluates a positioning test by ISO 230-2
#[derive(clap::Args)]
pub(crate) struct Arguments {
    /// Measurement file: .csv, .rtl, .rta, .pos, a report or a log
    data: PathBuf,
    /// Part of ISO 230: 2 (positioning of an axis)
    #[arg(long, default_value_t = 2, value_parser = clap::value_parser!(u8).range(2..=2))]
    part: u8,
    /// Unit of the deviations in a file that does not state it (.csv), without it µm; the answer is in µm or µrad
    #[arg(long)]
    unit: Option<Unit>,
}

pub(crate) fn run(arguments: &Arguments) -> Result<Answer, Failure> {
    let mut measurement = read_file(&arguments.data)?;
    let unit = unit::apply(&arguments.data, &mut measurement, arguments.unit)?;
    let result = evaluate(&measurement)?;
    let few_runs = few_runs_note(&measurement);
    let mut notes = measurement.notes;
    notes.extend(few_runs);
    notes.extend(result.outlier_hints.iter().map(|hint| hint.text.clone()));
    let document = Iso230::new(&result, unit, notes.clone());
    Answer::new(&document, text(&result, unit), notes)
}

/// What the number of runs does not allow to evaluate, or allows with less confidence than the standard asks for.
fn few_runs_note(measurement: &Measurement) -> Option<String> {
    /// ISO 230-2, test of axes up to 2 m: five approaches of each target in each direction.
    const ASKED_FOR: usize = 5;
    let runs = Direction::BOTH.map(|direction| measurement.runs(direction).len());
    let fewest = runs.into_iter().filter(|runs| *runs > 0).min()?;
    if fewest < 2 {
        Some(format!(
            "A and R need at least two runs in a direction; ISO 230-2 asks for {ASKED_FOR} in each direction on axes up to 2 m"
        ))
    } else if fewest < ASKED_FOR {
        Some(format!(
            "{fewest} runs in a direction: ISO 230-2 asks for {ASKED_FOR} in each direction on axes up to 2 m"
        ))
    } else {
        None
    }
}

fn number(value: Option<f64>) -> String {
    value.map_or_else(|| "-".to_owned(), |value| fixed(value, 2))
}

fn text(result: &Iso230Part2, unit: DeviationUnit) -> String {
    let mut targets = table(&["target", "mean ↑", "mean ↓", "s ↑", "s ↓", "B", "R"]);
    for row in &result.targets {
        let mean = |a: &Option<Approach>| number(a.as_ref().map(|a| a.mean));
        let s = |a: &Option<Approach>| number(a.as_ref().and_then(|a| a.s));
        targets.add_row([
            row.target.to_string(),
            mean(&row.forward),
            mean(&row.backward),
            s(&row.forward),
            s(&row.backward),
            number(row.reversal),
            number(row.repeatability),
        ]);
    }
    let mut summary = table(&["", "both", "forward ↑", "backward ↓"]);
    let r = result;
    for (name, values) in [
        ("A accuracy", [r.a, r.a_forward, r.a_backward]),
        ("R repeatability", [r.r, r.r_forward, r.r_backward]),
        ("E systematic deviation", [r.e, r.e_forward, r.e_backward]),
    ] {
        let [both, forward, backward] = values.map(number);
        summary.add_row([name, &both, &forward, &backward]);
    }
    for (name, value) in [
        ("M mean deviation", r.m),
        ("B reversal value", r.b),
        ("mean reversal value", r.mean_b),
    ] {
        summary.add_row([name, &number(value), "", ""]);
    }
    format!(
        "ISO 230-2, all values in {unit}\n\n{}\n{}",
        table_text(&targets),
        table_text(&summary)
    )
}
