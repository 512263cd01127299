//! `volcomp iso230`: the evaluation of a positioning test by ISO 230-2.

use std::path::{Path, PathBuf};

use clap::ValueEnum;
use volcomp_metrology::{Approach, DeviationUnit, Iso230Part2, Measurement, evaluate, read_file};

use super::{Answer, fixed, table, table_text};
use crate::{answers::iso230::Iso230, failure::Failure};

/// Evaluates a positioning test by ISO 230-2
#[derive(clap::Args)]
pub(crate) struct Arguments {
    /// Measurement file: .csv, .rtl, .rta
    data: PathBuf,
    /// Part of ISO 230: 2 (positioning of an axis)
    #[arg(long, default_value_t = 2, value_parser = clap::value_parser!(u8).range(2..=2))]
    part: u8,
    /// Unit of the deviations of a file that does not state it (.csv); without it, µm
    #[arg(long)]
    unit: Option<Unit>,
}

#[derive(Clone, Copy, ValueEnum)]
enum Unit {
    Um,
    Urad,
}

impl From<Unit> for DeviationUnit {
    fn from(unit: Unit) -> Self {
        match unit {
            Unit::Um => Self::Um,
            Unit::Urad => Self::Urad,
        }
    }
}

pub(crate) fn run(arguments: &Arguments) -> Result<Answer, Failure> {
    let measurement = read_file(&arguments.data)?;
    let unit = unit_of(&arguments.data, &measurement, arguments.unit)?;
    let result = evaluate(&measurement)?;
    let mut notes = measurement.notes;
    notes.extend(result.outlier_hints.iter().map(|hint| hint.text.clone()));
    let document = Iso230::new(&result, unit, notes.clone());
    Answer::new(&document, text(&result, unit), notes)
}

/// The unit that the file states, else the one asked for, else µm. The option never turns angles into lengths.
fn unit_of(
    file: &Path,
    measurement: &Measurement,
    asked: Option<Unit>,
) -> Result<DeviationUnit, Failure> {
    let asked = asked.map(DeviationUnit::from);
    match (measurement.unit, asked) {
        (Some(found), Some(asked)) if found != asked => Err(Failure::in_file(
            file,
            format_args!(
                "found deviations in {found}, expected {asked} (--unit {})",
                asked.key()
            ),
        )),
        (Some(found), _) => Ok(found),
        (None, asked) => Ok(asked.unwrap_or(DeviationUnit::Um)),
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
