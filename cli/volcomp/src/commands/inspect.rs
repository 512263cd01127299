//! `volcomp inspect`: what a measurement file holds.

use std::{fmt::Write, path::PathBuf};

use serde_json::{Map, Value};
use volcomp_metrology::{Measurement, read_file};
use volcomp_vocabulary::AxisName;

use super::Answer;
use crate::{answers::inspect::Inspect, failure::Failure};

/// Shows what a measurement file holds: texts, targets, runs, surroundings
#[derive(clap::Args)]
pub(crate) struct Arguments {
    /// Measurement file: .rtl, .rta or .csv
    file: PathBuf,
}

pub(crate) fn run(arguments: &Arguments) -> Result<Answer, Failure> {
    let measurement = read_file(&arguments.file)?;
    let document = Inspect::new(arguments.file.display().to_string(), &measurement);
    let answer = Answer::new(&document, String::new(), measurement.notes.clone())?;
    let entries = answer.json.as_object().cloned().unwrap_or_default();
    Ok(Answer {
        text: text(&entries, &measurement),
        ..answer
    })
}

/// The document, a line for each key.
fn text(document: &Map<String, Value>, measurement: &Measurement) -> String {
    let mut text = String::new();
    // Writing to a String cannot fail.
    let mut line = |key: &str, shown: String| {
        let _ = writeln!(text, " {:<24}{shown}", key.replace('_', " "));
    };
    for (key, value) in document {
        match (key.as_str(), value) {
            ("targets", Value::Array(targets)) => {
                line(key, targets_text(targets, target_unit(measurement)));
            }
            ("unit", Value::String(_)) => {
                let unit = measurement.unit.map(|unit| unit.to_string());
                line(key, unit.unwrap_or_default());
            }
            ("deviation_min" | "deviation_max", Value::Number(deviation)) => {
                let unit = measurement.unit.map(|unit| format!(" {unit}"));
                let deviation = deviation.as_f64().unwrap_or_default();
                line(key, format!("{deviation:.2}{}", unit.unwrap_or_default()));
            }
            (_, Value::Object(quantities)) => {
                for (name, value) in quantities {
                    line(name, plain(value));
                }
            }
            (_, Value::Null) => line(key, "not stated".to_owned()),
            (_, other) => line(key, plain(other)),
        }
    }
    text
}

/// mm or deg by the axis that the file names; nothing where it names none.
fn target_unit(measurement: &Measurement) -> &'static str {
    let axis = measurement.metadata.axis.as_deref();
    match axis.and_then(|axis| axis.trim().parse::<AxisName>().ok()) {
        Some(axis) if axis.is_rotary() => " deg",
        Some(_) => " mm",
        None => "",
    }
}

fn targets_text(targets: &[Value], unit: &str) -> String {
    match targets {
        [first, .., last] => format!("{} from {first} to {last}{unit}", targets.len()),
        _ => plain(&Value::Array(targets.to_vec())),
    }
}

fn plain(value: &Value) -> String {
    match value {
        Value::String(text) => text.clone(),
        Value::Array(pair) => pair.iter().map(plain).collect::<Vec<_>>().join(" to "),
        other => other.to_string(),
    }
}
