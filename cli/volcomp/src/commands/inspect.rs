use std::path::{Path, PathBuf};

use schemars::JsonSchema;
use serde::Serialize;
use serde_json::{Map, Value};
use volcomp_calibrate::files_below;
use volcomp_metrology::{
    Capture, ChannelLog, Content, DeviationUnit, Environment, FileFormat, KnownReadings,
    Measurement, Metadata, MetrologyError, Quantity, anomalies, axis_kind, errors_named,
    material_compensation, read_content,
};
use volcomp_vocabulary::{AxisKind, Direction};

use super::{
    Answer,
    evaluation::{Files, RefusedFile, some_refused},
    table, table_text,
};
use crate::{
    failure::Failure,
    table::{folded, folded_behind, to_the_left},
};

/// Show the content of measurement files: header, targets, runs, environment, anomalies
///
/// Several files are summarized in a table with a row for each.
#[derive(clap::Args)]
#[command(after_help = "\
Examples:
  volcomp inspect exx.rtl
  volcomp --json inspect exx.rtl eay.rta")]
pub(crate) struct InspectArguments {
    /// Measurement files: .rtl, .rta, .rts, .rtx, .REN, .pos, .csv, .txt, .log, .dat, or folders of them
    #[arg(required = true)]
    files: Vec<PathBuf>,
}

/// Content of one file.
#[derive(Debug, Serialize, JsonSchema)]
#[serde(untagged)]
pub(crate) enum Contents {
    /// Readings at targets.
    Readings(Box<MeasurementSummary>),
    /// A dynamic capture.
    Samples(Box<CaptureSummary>),
    /// A log in which no column is named as target or reading.
    Log(LogSummary),
}

/// A dynamic capture: samples over time, without targets.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct CaptureSummary {
    /// Anomalies of the file, to be checked before the samples are used.
    warnings: Vec<String>,
    /// Path as named in the call.
    file: String,
    /// Always `renishaw-capture`.
    kind: &'static str,
    /// Header of the file: machine, date, operator and title, as far as stated.
    #[serde(flatten)]
    texts: Metadata,
    /// Number of samples in the file.
    samples: usize,
    /// Sample rate; null: not stated.
    sample_rate_hz: Option<f64>,
    /// Duration of the capture; null if the rate is not stated.
    duration_s: Option<f64>,
    /// Smallest sample, in the unit of the program that recorded it; null without samples.
    sample_min: Option<f64>,
    /// Largest sample, in the unit of the program that recorded it; null without samples.
    sample_max: Option<f64>,
}

/// A log of the values of process variables over time.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct LogSummary {
    /// Anomalies of the file, to be checked before the log is used.
    warnings: Vec<String>,
    /// Path as named in the call.
    file: String,
    /// Always `camonitor-log`.
    kind: &'static str,
    /// Date of the first line, as written.
    date: Option<String>,
    /// Duration of the log, s.
    duration_s: f64,
    /// Process variables in the log, with their ranges.
    channels: Vec<Channel>,
}

/// One process variable of a log, with its range.
#[derive(Debug, Serialize, JsonSchema)]
struct Channel {
    /// Name of the process variable.
    name: String,
    /// Number of logged values.
    values: usize,
    /// Smallest logged value; null without numbers.
    min: Option<f64>,
    /// Largest logged value; null without numbers.
    max: Option<f64>,
}

/// Header and summary of a file with readings at targets.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct MeasurementSummary {
    /// Anomalies of the file, to be checked before the readings are used.
    warnings: Vec<String>,
    /// Path as named in the call.
    file: String,
    /// Format of the file; null: not recognised.
    kind: Option<FileFormat>,
    /// The instrument or program that writes this format; null: not known.
    instrument: Option<&'static str>,
    /// Measured quantity; null: not stated.
    quantity: Option<Quantity>,
    /// Meaning of a positive deviation.
    sign: Option<&'static str>,
    /// Header of the file: machine, date, operator and title, as far as stated.
    #[serde(flatten)]
    texts: Metadata,
    /// Unit of the deviations; null: not stated.
    unit: Option<DeviationUnit>,
    /// The targets, mm or deg, ascending.
    targets: Vec<f64>,
    /// Number of runs in the positive direction of approach.
    runs_forward: usize,
    /// Number of runs in the negative direction of approach.
    runs_backward: usize,
    /// Number of readings over all targets and runs.
    readings: usize,
    /// The smallest deviation, in the unit of the file.
    deviation_min: Option<f64>,
    /// The largest deviation, in the unit of the file.
    deviation_max: Option<f64>,
    /// How the file states that the readings were corrected to 20 °C; null if this kind of file
    /// cannot state it.
    material_compensation: Option<String>,
    /// Environment at the start and the end of the test, as far as stated.
    environment: Environment,
}

impl CaptureSummary {
    fn new(file: String, capture: &Capture) -> Self {
        let samples = || capture.samples.iter().copied();
        Self {
            warnings: capture.notes.clone(),
            file,
            kind: "renishaw-capture",
            texts: capture.metadata.clone(),
            samples: capture.samples.len(),
            sample_rate_hz: capture.sample_rate_hz,
            duration_s: capture.duration_s(),
            sample_min: samples().reduce(f64::min),
            sample_max: samples().reduce(f64::max),
        }
    }
}

impl LogSummary {
    fn new(file: String, log: &ChannelLog) -> Self {
        let mut warnings = vec![
            "which channel is the target and which the reading is not known: state it in `channels`".to_owned(),
        ];
        warnings.extend(log.notes.iter().cloned());
        let channel = |channel: &volcomp_metrology::Channel| {
            let values = || channel.samples.iter().map(|(_, value)| *value);
            Channel {
                name: channel.name.clone(),
                values: channel.samples.len(),
                min: values().reduce(f64::min),
                max: values().reduce(f64::max),
            }
        };
        Self {
            warnings,
            file,
            kind: "camonitor-log",
            date: log.date.clone(),
            duration_s: log.duration_s(),
            channels: log.channels.iter().map(channel).collect(),
        }
    }
}

impl MeasurementSummary {
    fn new(file: String, measurement: &Measurement) -> Self {
        let deviations = || measurement.readings.iter().map(|reading| reading.deviation);
        let [runs_forward, runs_backward] =
            Direction::BOTH.map(|direction| measurement.runs(direction).len());
        let environment = &measurement.environment;
        let format = measurement.format;
        // The expansion of the material affects only positioning readings.
        let is_laser = measurement.quantity == Some(Quantity::Positioning)
            && format != Some(FileFormat::ApiPos);
        Self {
            warnings: anomalies(measurement),
            file,
            kind: format,
            instrument: format.map(FileFormat::instrument),
            quantity: measurement.quantity,
            sign: format.map(FileFormat::sign),
            texts: measurement.metadata.clone(),
            unit: measurement.unit,
            targets: measurement.targets(),
            runs_forward,
            runs_backward,
            readings: measurement.readings.len(),
            deviation_min: deviations().reduce(f64::min),
            deviation_max: deviations().reduce(f64::max),
            material_compensation: is_laser.then(|| material_compensation(environment)),
            environment: environment.clone(),
        }
    }
}

pub(crate) fn run(arguments: &InspectArguments) -> Result<Answer, Failure> {
    if let [only] = &arguments.files[..]
        && !only.is_dir()
    {
        let content = read_content(only, None)?;
        let (document, text) = one(only.display().to_string(), &content)?;
        return Answer::new(&Files::One(Box::new(document)), text, Vec::new());
    }
    let (mut files, mut texts, mut refused) = (Vec::new(), Vec::new(), Vec::new());
    let (mut others, mut overview) = (Others::default(), Overview::default());
    let mut not_read = Vec::new();
    for (path, is_named) in paths(&arguments.files)? {
        let file = path.display().to_string();
        match read_content(&path, None) {
            Ok(mut content) => {
                if let Content::Measurement(measurement) = &mut content {
                    measurement.notes.splice(0..0, others.compare(&file, measurement));
                }
                overview.add(&path, &content);
                let (document, text) = one(file, &content)?;
                files.push(Files::One(Box::new(document)));
                texts.push(text);
            }
            // A folder may also contain notes and pictures, so unreadable files of a folder are only listed.
            Err(MetrologyError::Extension { .. }) if !is_named => not_read.push(file),
            Err(error) => {
                texts.push(refused_text(&file, &error));
                overview.add_refused(&path);
                let error = error.to_string();
                let file = RefusedFile { file, error };
                refused.push(file.clone());
                files.push(Files::Refused(file));
            }
        }
    }
    let count = files.len();
    texts.push(overview.text());
    let notes = if not_read.is_empty() {
        Vec::new()
    } else {
        let not_read = not_read.join(", ");
        vec![format!("no measurement files by their names, and not read: {not_read}")]
    };
    let answer = Answer::new(&Files::Many { files }, texts.join("\n"), notes)?;
    Ok(Answer { failed: some_refused(&refused, count), ..answer })
}

/// The files to read, and whether the command line names each. A folder is replaced by all files below it.
fn paths(named: &[PathBuf]) -> Result<Vec<(PathBuf, bool)>, Failure> {
    let mut all = Vec::new();
    for path in named {
        if !path.is_dir() {
            all.push((path.clone(), true));
            continue;
        }
        let files = files_below(path, &[], usize::MAX)
            .map_err(|error| Failure::in_file(path, format_args!("cannot be searched: {error}")))?;
        if files.is_empty() {
            return Err(Failure::in_file(path, "found a folder without files"));
        }
        all.extend(files.into_iter().map(|file| (file, false)));
    }
    Ok(all)
}

#[derive(Default)]
struct Overview {
    rows: Vec<[String; 7]>,
}

impl Overview {
    fn add(&mut self, path: &Path, content: &Content) {
        let file = file_name(path);
        let row = match content {
            Content::Measurement(measurement) => {
                let targets = measurement.targets();
                let range = match targets[..] {
                    [first, .., last] => {
                        format!("{first} to {last}{}", short_unit(measurement))
                    }
                    _ => String::new(),
                };
                let [forward, backward] =
                    Direction::BOTH.map(|direction| measurement.runs(direction).len());
                let metadata = &measurement.metadata;
                [
                    file,
                    error_of(path, measurement),
                    metadata.machine.clone().unwrap_or_default(),
                    metadata.serial.clone().unwrap_or_default(),
                    format!("{forward} + {backward}"),
                    targets.len().to_string(),
                    range,
                ]
            }
            Content::Capture(_) => row_of(file, "capture"),
            Content::Log(_) => row_of(file, "log"),
        };
        self.rows.push(row);
    }

    fn add_refused(&mut self, path: &Path) {
        self.rows.push(row_of(file_name(path), "REFUSED"));
    }

    fn text(&self) -> String {
        let mut rows =
            table(&["file", "error", "machine", "serial", "runs ↑ + ↓", "targets", "range"]);
        to_the_left(&mut rows, &[1, 2, 3]);
        for row in &self.rows {
            rows.add_row(row);
        }
        table_text(&rows)
    }
}

fn row_of(file: String, what: &str) -> [String; 7] {
    let mut row: [String; 7] = Default::default();
    [row[0], row[1]] = [file, what.to_owned()];
    row
}

fn file_name(path: &Path) -> String {
    path.file_name().unwrap_or_default().display().to_string()
}

/// The error named in the file name and title. Several names are joined, with a question mark. Without a name: the axis
/// stated in the file.
fn error_of(path: &Path, measurement: &Measurement) -> String {
    let stem = path.file_stem().unwrap_or_default().to_string_lossy();
    let title = measurement.metadata.title.as_deref().unwrap_or_default();
    let mut named = errors_named(&stem);
    named.extend(errors_named(title));
    named.dedup();
    let axis = || measurement.metadata.axis.clone().unwrap_or_default();
    match named[..] {
        [only] => only.to_string(),
        [] => axis(),
        _ => {
            let names: Vec<String> = named.iter().map(ToString::to_string).collect();
            format!("{}?", names.join("/"))
        }
    }
}

#[derive(Default)]
struct Others {
    readings: KnownReadings<String>,
    serial: Option<(String, String)>,
}

impl Others {
    fn compare(&mut self, file: &str, measurement: &Measurement) -> Vec<String> {
        let mut warnings = Vec::new();
        if let Some(other) = self.readings.before(measurement, file.to_owned()) {
            warnings.push(format!(
                "it has the same readings as {other}: is it one test under two names?"
            ));
        }
        if let Some(serial) = &measurement.metadata.serial {
            match &self.serial {
                Some((other, of)) if other != serial => warnings
                    .push(format!("it states the serial number {serial}, {of} states {other}")),
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

fn one(file: String, content: &Content) -> Result<(Contents, String), Failure> {
    let (document, measurement) = match content {
        Content::Measurement(measurement) => {
            let readings = MeasurementSummary::new(file, measurement);
            (Contents::Readings(Box::new(readings)), Some(&**measurement))
        }
        Content::Capture(capture) => {
            (Contents::Samples(Box::new(CaptureSummary::new(file, capture))), None)
        }
        Content::Log(log) => (Contents::Log(LogSummary::new(file, log)), None),
    };
    let value = serde_json::to_value(&document)
        .map_err(|e| Failure::Work(format!("the JSON document: {e}")))?;
    let entries = value.as_object().cloned().unwrap_or_default();
    Ok((document, text(&entries, measurement)))
}

/// The document with one line per key, and the warnings first.
fn text(document: &Map<String, Value>, measurement: Option<&Measurement>) -> String {
    let mut text = String::new();
    let warnings = document.get("warnings").and_then(Value::as_array);
    for warning in warnings.into_iter().flatten() {
        text += &folded(&format!("WARNING: {}", plain(warning)), " ");
    }
    let unit = measurement.and_then(|measurement| measurement.unit);
    let mut line = |key: &str, shown: String| {
        text += &folded_behind(&format!(" {:<24}", key.replace('_', " ")), &shown);
    };
    for (key, value) in document {
        match (key.as_str(), value) {
            // Warnings are printed above. Keys that this kind of file cannot state are omitted.
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
                    let unit = surroundings_unit(name);
                    let Value::Array(sensors) = value else {
                        line(name, format!("{}{unit}", plain(value)));
                        continue;
                    };
                    for (index, value) in sensors.iter().enumerate() {
                        if !value.is_null() {
                            let sensor = index + 1;
                            line(&format!("{name} {sensor}"), format!("{}{unit}", plain(value)));
                        }
                    }
                }
            }
            (_, Value::Null) => line(key, "not stated".to_owned()),
            (_, other) => line(key, plain(other)),
        }
    }
    text
}

/// The unit of the targets: mm or deg if the file determines the kind of axis, otherwise both.
fn target_unit(measurement: &Measurement) -> &'static str {
    match axis_kind(measurement) {
        Some(AxisKind::Rotary) => " deg",
        Some(AxisKind::Linear) => " mm",
        None => " (mm, or deg of a rotary axis)",
    }
}

/// The unit of the targets for a table cell; empty if the file does not determine the kind of axis.
fn short_unit(measurement: &Measurement) -> &'static str {
    axis_kind(measurement).map_or("", |_| target_unit(measurement))
}

fn surroundings_unit(name: &str) -> &'static str {
    match name {
        "air_temperature" | "material_temperature" => " °C",
        "air_pressure" => " kPa",
        "air_humidity" => " %",
        "expansion_coefficient" => " µm/(m·K)",
        "environment_factor" => " µm",
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
        Value::Array(all) => all.iter().map(plain).collect::<Vec<_>>().join(" to "),
        Value::Object(pair) => {
            let ends = ["start", "end"].map(|end| pair.get(end).map_or_else(String::new, plain));
            ends.join(" to ")
        }
        other => other.to_string(),
    }
}
