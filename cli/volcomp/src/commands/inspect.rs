//! `volcomp inspect`: what a measurement file holds.

use std::{fmt::Write, path::PathBuf};

use serde_json::{Map, Value, json};
use volcomp_metrology::{DeviationUnit, Measurement, Metadata, StartEnd, read_file};
use volcomp_vocabulary::Direction;

use super::Answer;
use crate::failure::Failure;

/// What a measurement file holds: texts, targets, runs, surroundings
#[derive(clap::Args)]
pub(crate) struct Arguments {
    /// Measurement file: .rtl, .rta or .csv
    file: PathBuf,
}

pub(crate) fn run(arguments: &Arguments) -> Result<Answer, Failure> {
    let measurement = read_file(&arguments.file).map_err(Failure::input)?;
    let mut document = Map::new();
    document.insert("file".into(), json!(arguments.file.display().to_string()));
    document.extend(texts(&measurement.metadata));
    document.extend(readings(&measurement));
    document.insert(
        "environment".into(),
        Value::Object(surroundings(&measurement)),
    );
    Ok(Answer {
        text: text(&document),
        json: Value::Object(document),
        notes: measurement.notes,
    })
}

fn texts(metadata: &Metadata) -> Map<String, Value> {
    let named = [
        ("format", &metadata.format),
        ("owner", &metadata.owner),
        ("version", &metadata.version),
        ("machine", &metadata.machine),
        ("serial", &metadata.serial),
        ("date", &metadata.date),
        ("by", &metadata.by),
        ("axis", &metadata.axis),
        ("location", &metadata.location),
        ("title", &metadata.title),
    ];
    let there = named.into_iter().filter_map(|(key, text)| {
        let text = text.as_ref()?;
        Some((key.to_owned(), json!(text)))
    });
    there.collect()
}

fn readings(measurement: &Measurement) -> Map<String, Value> {
    let deviations = measurement.readings.iter().map(|r| r.deviation);
    let [forward, backward] =
        Direction::BOTH.map(|direction| json!(measurement.runs(direction).len()));
    let unit = measurement.unit.map(|unit| match unit {
        DeviationUnit::Um => "um",
        DeviationUnit::Urad => "urad",
    });
    let entries = [
        ("unit", json!(unit)),
        ("targets", json!(measurement.targets())),
        ("runs_forward", forward),
        ("runs_backward", backward),
        ("readings", json!(measurement.readings.len())),
        ("deviation_min", json!(deviations.clone().reduce(f64::min))),
        ("deviation_max", json!(deviations.reduce(f64::max))),
    ];
    entries
        .map(|(key, value)| (key.to_owned(), value))
        .into_iter()
        .collect()
}

fn surroundings(measurement: &Measurement) -> Map<String, Value> {
    let e = &measurement.environment;
    let [first, second, third] = e.material_temperature;
    let quantities = [
        ("air_temperature", e.air_temperature),
        ("air_pressure", e.air_pressure),
        ("air_humidity", e.air_humidity),
        ("material_temperature_1", first),
        ("material_temperature_2", second),
        ("material_temperature_3", third),
        ("expansion_coefficient", e.expansion_coefficient),
        ("environment_factor", e.environment_factor),
    ];
    let there = quantities.into_iter().filter_map(|(key, quantity)| {
        let StartEnd { start, end, .. } = quantity?;
        Some((key.to_owned(), json!([start, end])))
    });
    let mut map: Map<String, Value> = there.collect();
    if let Some(time) = &e.date_time {
        map.insert("date_time".into(), json!(time));
    }
    map
}

/// The document, a line for each key.
fn text(document: &Map<String, Value>) -> String {
    let mut text = String::new();
    // Writing to a String cannot fail.
    let mut line = |key: &str, shown: String| {
        let _ = writeln!(text, " {:<24}{shown}", key.replace('_', " "));
    };
    for (key, value) in document {
        match value {
            Value::Array(targets) => line(key, targets_text(targets)),
            Value::Object(quantities) => {
                for (name, value) in quantities {
                    line(name, plain(value));
                }
            }
            Value::Null => line(key, "not stated".to_owned()),
            other => line(key, plain(other)),
        }
    }
    text
}

fn targets_text(targets: &[Value]) -> String {
    match targets {
        [first, .., last] => format!("{} from {first} to {last}", targets.len()),
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
