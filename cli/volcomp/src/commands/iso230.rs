//! `volcomp iso230`: the evaluation of a positioning test by ISO 230-2.

use std::path::PathBuf;

use clap::ValueEnum;
use serde_json::{Value, json};
use volcomp_metrology::{Approach, DeviationUnit, Iso230Part2, TargetRow, evaluate, read_file};

use super::{Answer, fit::reading, table, table_text};
use crate::failure::Failure;

/// Evaluates a positioning test by ISO 230-2
#[derive(clap::Args)]
pub(crate) struct Arguments {
    /// Measurement file: .csv, .rtl, .rta
    data: PathBuf,
    /// Part of ISO 230: 2 (positioning of an axis)
    #[arg(long, default_value_t = 2, value_parser = clap::value_parser!(u8).range(2..=2))]
    part: u8,
    /// Unit of the deviations; default: what the file says, else um
    #[arg(long)]
    unit: Option<Unit>,
}

#[derive(Clone, Copy, ValueEnum)]
enum Unit {
    Um,
    Urad,
}

pub(crate) fn run(arguments: &Arguments) -> Result<Answer, Failure> {
    let mut measurement = read_file(&arguments.data).map_err(|e| reading(&e))?;
    if let Some(unit) = arguments.unit {
        measurement.unit = Some(match unit {
            Unit::Um => DeviationUnit::Um,
            Unit::Urad => DeviationUnit::Urad,
        });
    }
    let result = evaluate(&measurement).map_err(|e| Failure::input(&e))?;
    let mut notes = measurement.notes;
    notes.extend(result.outlier_hints.iter().map(|hint| hint.text.clone()));
    Ok(Answer {
        json: json(&result, &notes),
        text: text(&result),
        notes,
    })
}

fn unit(result: &Iso230Part2) -> &'static str {
    match result.unit {
        Some(DeviationUnit::Urad) => "urad",
        _ => "um",
    }
}

/// The twelve values, by the names of the JSON document without their unit.
fn values(r: &Iso230Part2) -> [(&'static str, Option<f64>); 12] {
    [
        ("A", r.a),
        ("A_forward", r.a_forward),
        ("A_backward", r.a_backward),
        ("R", r.r),
        ("R_forward", r.r_forward),
        ("R_backward", r.r_backward),
        ("E", r.e),
        ("E_forward", r.e_forward),
        ("E_backward", r.e_backward),
        ("M", r.m),
        ("B", r.b),
        ("mean_B", r.mean_b),
    ]
}

fn json(result: &Iso230Part2, notes: &[String]) -> Value {
    let mut json = json!({ "unit": unit(result) });
    for (name, value) in values(result) {
        json[format!("{name}_um")] = json!(value);
    }
    json["targets"] = result.targets.iter().map(target_json).collect();
    json["hints"] = result.outlier_hints.iter().map(|hint| json!({
        "run": hint.run, "direction": hint.direction.name(), "target": hint.target, "size_um": hint.size, "text": hint.text,
    })).collect();
    json["notes"] = json!(notes);
    json
}

fn target_json(row: &TargetRow) -> Value {
    let direction = |approach: &Option<Approach>| {
        approach
            .as_ref()
            .map(|a| json!({ "n": a.n, "mean_um": a.mean, "s_um": a.s, "R_um": a.repeatability() }))
    };
    json!({
        "target": row.target,
        "forward": direction(&row.forward),
        "backward": direction(&row.backward),
        "mean_um": row.mean,
        "B_um": row.reversal,
        "R_um": row.repeatability,
    })
}

fn number(value: Option<f64>) -> String {
    value.map_or_else(|| "-".to_owned(), |value| format!("{value:.2}"))
}

fn text(result: &Iso230Part2) -> String {
    let mut targets = table(&["target", "mean fwd", "mean bwd", "s fwd", "s bwd", "B", "R"]);
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
    let mut summary = table(&["", "both", "forward", "backward"]);
    let v = values(result).map(|(_, value)| number(value));
    for (name, first) in [
        ("A accuracy", 0),
        ("R repeatability", 3),
        ("E systematic", 6),
    ] {
        summary.add_row([name, &v[first], &v[first + 1], &v[first + 2]]);
    }
    summary.add_row(["M mean deviation", &v[9], "", ""]);
    summary.add_row(["B reversal", &v[10], "", ""]);
    summary.add_row(["mean B", &v[11], "", ""]);
    format!(
        "ISO 230-2, {}\n\n{}\n{}",
        unit(result),
        table_text(&targets),
        table_text(&summary)
    )
}
