//! `volcomp inspect`: what measurement files hold.

use std::{fmt::Write, path::PathBuf};

use serde_json::{Map, Value};
use volcomp_metrology::{
    Content, Measurement, MetrologyError, SeenReadings, axis_kind, read_content,
};
use volcomp_vocabulary::AxisKind;

use super::{Answer, several::some_refused};
use crate::{
    answers::inspect::{Inspect, Log, OneFile, Readings, Refused, Samples},
    failure::Failure,
    table::folded,
};

/// Shows what measurement files hold: oddities, texts, targets, runs, surroundings
#[derive(clap::Args)]
pub(crate) struct Arguments {
    /// Measurement files: .rtl, .rta, .rts, .rtx, .REN, .pos, .csv, .txt, .log, .dat
    #[arg(required = true)]
    files: Vec<PathBuf>,
}

pub(crate) fn run(arguments: &Arguments) -> Result<Answer, Failure> {
    if let [only] = &arguments.files[..] {
        let content = read_content(only, None)?;
        let (document, text) = one(only.display().to_string(), &content)?;
        return Answer::new(&Inspect::One(Box::new(document)), text, Vec::new());
    }
    let (mut files, mut texts, mut refused) = (Vec::new(), Vec::new(), 0);
    let mut others = Others::default();
    for path in &arguments.files {
        let file = path.display().to_string();
        match read_content(path, None) {
            Ok(mut content) => {
                if let Content::Measurement(measurement) = &mut content {
                    measurement
                        .notes
                        .splice(0..0, others.compare(&file, measurement));
                }
                let (document, text) = one(file, &content)?;
                files.push(document);
                texts.push(text);
            }
            Err(error) => {
                refused += 1;
                texts.push(refused_text(&file, &error));
                let error = error.to_string();
                files.push(OneFile::Refused(Refused { file, error }));
            }
        }
    }
    let count = files.len();
    let answer = Answer::new(&Inspect::Many { files }, texts.join("\n"), Vec::new())?;
    Ok(Answer {
        failed: some_refused(refused, count),
        ..answer
    })
}

/// What the files before said.
#[derive(Default)]
struct Others {
    readings: SeenReadings<String>,
    serial: Option<(String, String)>,
}

impl Others {
    /// Warnings about a file that only the others show.
    fn compare(&mut self, file: &str, measurement: &Measurement) -> Vec<String> {
        let mut warnings = Vec::new();
        if let Some(other) = self.readings.before(measurement, file.to_owned()) {
            warnings.push(format!(
                "it has the same readings as {other}: is it one test under two names?"
            ));
        }
        if let Some(serial) = &measurement.metadata.serial {
            match &self.serial {
                Some((other, of)) if other != serial => warnings.push(format!(
                    "it states the serial number {serial}, {of} states {other}"
                )),
                Some(_) => {}
                None => self.serial = Some((serial.clone(), file.to_owned())),
            }
        }
        warnings
    }
}

fn refused_text(file: &str, error: &MetrologyError) -> String {
    let refused = folded(&format!("REFUSED: {error}"), " ");
    format!("{refused} {:<24}{file}\n", "file")
}

fn one(file: String, content: &Content) -> Result<(OneFile, String), Failure> {
    let (document, measurement) = match content {
        Content::Measurement(measurement) => {
            let readings = Readings::new(file, measurement);
            (OneFile::Readings(Box::new(readings)), Some(&**measurement))
        }
        Content::Capture(capture) => (
            OneFile::Samples(Box::new(Samples::new(file, capture))),
            None,
        ),
        Content::Log(log) => (OneFile::Log(Log::new(file, log)), None),
    };
    let value = serde_json::to_value(&document)
        .map_err(|e| Failure::Work(format!("the JSON document: {e}")))?;
    let entries = value.as_object().cloned().unwrap_or_default();
    Ok((document, text(&entries, measurement)))
}

/// The document, a line for each key, warnings first.
fn text(document: &Map<String, Value>, measurement: Option<&Measurement>) -> String {
    let mut text = String::new();
    let warnings = document.get("warnings").and_then(Value::as_array);
    for warning in warnings.into_iter().flatten() {
        text += &folded(&format!("WARNING: {}", plain(warning)), " ");
    }
    let unit = measurement.and_then(|measurement| measurement.unit);
    // Writing to a String cannot fail.
    let mut line = |key: &str, shown: String| {
        let _ = writeln!(text, " {:<24}{shown}", key.replace('_', " "));
    };
    for (key, value) in document {
        match (key.as_str(), value) {
            // The former stand above; what a kind of file cannot state is not worth a line.
            ("warnings", _) | ("material_compensation", Value::Null) => {}
            ("channels", Value::Array(channels)) => {
                for channel in channels {
                    let said = format!(
                        "{}: {} values from {} to {}",
                        plain(&channel["name"]),
                        channel["values"],
                        channel["min"],
                        channel["max"]
                    );
                    line("channel", said);
                }
            }
            ("targets", Value::Array(targets)) => {
                let unit = measurement.map_or("", target_unit);
                line(key, targets_text(targets, unit));
            }
            ("unit", Value::String(_)) => {
                line(key, unit.map(|unit| unit.to_string()).unwrap_or_default());
            }
            ("deviation_min" | "deviation_max", Value::Number(deviation)) => {
                let unit = unit.map(|unit| format!(" {unit}"));
                let deviation = deviation.as_f64().unwrap_or_default();
                line(key, format!("{deviation:.2}{}", unit.unwrap_or_default()));
            }
            (_, Value::Object(quantities)) => {
                for (name, value) in quantities {
                    line(name, format!("{}{}", plain(value), surroundings_unit(name)));
                }
            }
            (_, Value::Null) => line(key, "not stated".to_owned()),
            (_, other) => line(key, plain(other)),
        }
    }
    text
}

/// mm or deg where the file tells the kind of the axis, else both.
fn target_unit(measurement: &Measurement) -> &'static str {
    match axis_kind(measurement) {
        Some(AxisKind::Rotary) => " deg",
        Some(AxisKind::Linear) => " mm",
        None => " (mm, or deg of a rotary axis)",
    }
}

/// The unit of a quantity of the surroundings, as the document describes it.
fn surroundings_unit(name: &str) -> &'static str {
    match name {
        "air_temperature" => " °C",
        "air_pressure" => " kPa",
        "air_humidity" => " %",
        "expansion_coefficient" => " µm/(m·K)",
        "environment_factor" => " µm",
        name if name.starts_with("material_temperature") => " °C",
        _ => "",
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
