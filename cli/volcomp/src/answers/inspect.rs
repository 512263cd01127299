//! The JSON document of `volcomp inspect`.

#![expect(clippy::struct_field_names, reason = "the keys are those of the file")]

use schemars::JsonSchema;
use serde::Serialize;
use volcomp_metrology::{
    Capture, ChannelLog, DeviationUnit, FileFormat, Measurement, Metadata, Quantity, StartEnd,
    material_compensation, oddities,
};
use volcomp_vocabulary::Direction;

/// The document of `volcomp inspect`: of one file, or of each.
#[derive(Debug, Serialize, JsonSchema)]
#[serde(untagged)]
pub(crate) enum Inspect {
    /// Of several files, in their order.
    Many {
        /// What each holds.
        files: Vec<OneFile>,
    },
    /// Of one file.
    One(Box<OneFile>),
}

/// What one file holds.
#[derive(Debug, Serialize, JsonSchema)]
#[serde(untagged)]
pub(crate) enum OneFile {
    /// Readings at targets.
    Readings(Box<Readings>),
    /// A dynamic capture.
    Samples(Box<Samples>),
    /// A log of which nobody said which channel is what.
    Log(Log),
    /// A file that is refused, among others.
    Refused(Refused),
}

/// A file that is refused.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct Refused {
    /// The file as it was named in the call.
    pub(crate) file: String,
    /// Why it is refused.
    pub(crate) error: String,
}

/// A dynamic capture: samples over time, without targets.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct Samples {
    /// What is odd, or should be known before the samples are used.
    pub(crate) warnings: Vec<String>,
    /// The file as it was named in the call.
    pub(crate) file: String,
    /// `renishaw-capture`.
    pub(crate) kind: &'static str,
    /// The texts of the header.
    #[serde(flatten)]
    pub(crate) texts: Texts,
    /// Number of samples.
    pub(crate) samples: usize,
    /// Samples a second; null: not stated.
    pub(crate) sample_rate_hz: Option<f64>,
    /// Length of the capture; null where the rate is not stated.
    pub(crate) duration_s: Option<f64>,
    /// The smallest sample, in the unit of the program that captured it.
    pub(crate) sample_min: Option<f64>,
    /// The largest sample.
    pub(crate) sample_max: Option<f64>,
}

/// A log of channels.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct Log {
    /// What is odd, or should be known before the log is used.
    pub(crate) warnings: Vec<String>,
    /// The file as it was named in the call.
    pub(crate) file: String,
    /// `camonitor-log`.
    pub(crate) kind: &'static str,
    /// Date of the first line.
    pub(crate) date: Option<String>,
    /// Length of the log, s.
    pub(crate) duration_s: f64,
    /// The channels.
    pub(crate) channels: Vec<Channel>,
}

/// One channel of a log.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct Channel {
    /// Its name.
    pub(crate) name: String,
    /// Number of values.
    pub(crate) values: usize,
    /// The smallest value.
    pub(crate) min: Option<f64>,
    /// The largest value.
    pub(crate) max: Option<f64>,
}

/// What a file with readings at targets says about itself, and its readings in short.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct Readings {
    /// What is odd, or should be known before the readings are used.
    pub(crate) warnings: Vec<String>,
    /// The file as it was named in the call.
    pub(crate) file: String,
    /// The kind of file: `renishaw-linear`, `table` …
    pub(crate) kind: Option<&'static str>,
    /// The instrument or program that writes such files.
    pub(crate) instrument: Option<&'static str>,
    /// `positioning`, `straightness` or `angle`; null: the file does not say.
    pub(crate) quantity: Option<&'static str>,
    /// How the sign of a deviation is meant.
    pub(crate) sign: Option<&'static str>,
    /// The texts of the header; a text that the file does not state is left out.
    #[serde(flatten)]
    pub(crate) texts: Texts,
    /// `um` or `urad`; null: the file does not say.
    pub(crate) unit: Option<&'static str>,
    /// The targets, mm or deg, ascending.
    pub(crate) targets: Vec<f64>,
    /// Number of runs approached forward.
    pub(crate) runs_forward: usize,
    /// Number of runs approached backward.
    pub(crate) runs_backward: usize,
    /// Number of readings over all targets and runs.
    pub(crate) readings: usize,
    /// The smallest deviation, in the unit of the file.
    pub(crate) deviation_min: Option<f64>,
    /// The largest deviation, in the unit of the file.
    pub(crate) deviation_max: Option<f64>,
    /// How the file states that the readings were brought to 20 °C; null where a file of its kind cannot.
    pub(crate) material_compensation: Option<String>,
    /// The surroundings at the start and the end of the test; only what the file says.
    pub(crate) environment: Environment,
}

/// The texts in the header of a measurement file.
#[derive(Debug, Serialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub(crate) struct Texts {
    /// File type of the header: `rtl` or `rta`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) format: Option<String>,
    /// The program that wrote the file.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) owner: Option<String>,
    /// Version of that program or format.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) version: Option<String>,
    /// The machine that was measured.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) machine: Option<String>,
    /// Serial number of the machine.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) serial: Option<String>,
    /// Date of the test, as written.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) date: Option<String>,
    /// The person who measured.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) by: Option<String>,
    /// The axis that was measured.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) axis: Option<String>,
    /// Where the machine stands.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) location: Option<String>,
    /// Title of the test.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) title: Option<String>,
}

/// The surroundings during the test, each at its start and end, in the units of the file.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct Environment {
    /// Temperature of the air, °C in the files known.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) air_temperature: Option<[f64; 2]>,
    /// Pressure of the air, kPa in the files known.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) air_pressure: Option<[f64; 2]>,
    /// Relative humidity of the air, %.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) air_humidity: Option<[f64; 2]>,
    /// Temperature of the first material sensor, °C.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) material_temperature_1: Option<[f64; 2]>,
    /// Temperature of the second material sensor, °C.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) material_temperature_2: Option<[f64; 2]>,
    /// Temperature of the third material sensor, °C.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) material_temperature_3: Option<[f64; 2]>,
    /// Expansion coefficient of the material, µm/(m·K).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) expansion_coefficient: Option<[f64; 2]>,
    /// Environment factor: wavelength of the laser in air, µm / 2.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) environment_factor: Option<[f64; 2]>,
    /// Start and end of the test, as written.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) date_time: Option<String>,
}

impl Texts {
    fn of(metadata: Metadata) -> Self {
        Self {
            format: metadata.format,
            owner: metadata.owner,
            version: metadata.version,
            machine: metadata.machine,
            serial: metadata.serial,
            date: metadata.date,
            by: metadata.by,
            axis: metadata.axis,
            location: metadata.location,
            title: metadata.title,
        }
    }
}

impl Samples {
    /// The document of a capture that was read.
    pub(crate) fn new(file: String, capture: &Capture) -> Self {
        let samples = || capture.samples.iter().copied();
        Self {
            warnings: capture.notes.clone(),
            file,
            kind: "renishaw-capture",
            texts: Texts::of(capture.metadata.clone()),
            samples: capture.samples.len(),
            sample_rate_hz: capture.sample_rate_hz,
            duration_s: capture.duration_s(),
            sample_min: samples().reduce(f64::min),
            sample_max: samples().reduce(f64::max),
        }
    }
}

impl Log {
    /// The document of a log that was read.
    pub(crate) fn new(file: String, log: &ChannelLog) -> Self {
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

impl Readings {
    /// The document of a file that was read.
    pub(crate) fn new(file: String, measurement: &Measurement) -> Self {
        let deviations = || measurement.readings.iter().map(|reading| reading.deviation);
        let [runs_forward, runs_backward] =
            Direction::BOTH.map(|direction| measurement.runs(direction).len());
        let surroundings = &measurement.environment;
        let pair = |quantity: Option<StartEnd>| quantity.map(|q| [q.start, q.end]);
        let [first, second, third] = surroundings.material_temperature.map(pair);
        let format = measurement.format;
        // Straightness and angles do not grow with the material.
        let is_laser = measurement.quantity == Some(Quantity::Positioning)
            && format != Some(FileFormat::ApiPos);
        Self {
            warnings: oddities(measurement),
            file,
            kind: format.map(FileFormat::key),
            instrument: format.map(FileFormat::instrument),
            quantity: measurement.quantity.map(Quantity::key),
            sign: format.map(FileFormat::sign),
            texts: Texts::of(measurement.metadata.clone()),
            unit: measurement.unit.map(DeviationUnit::key),
            targets: measurement.targets(),
            runs_forward,
            runs_backward,
            readings: measurement.readings.len(),
            deviation_min: deviations().reduce(f64::min),
            deviation_max: deviations().reduce(f64::max),
            material_compensation: is_laser.then(|| material_compensation(surroundings)),
            environment: Environment {
                air_temperature: pair(surroundings.air_temperature),
                air_pressure: pair(surroundings.air_pressure),
                air_humidity: pair(surroundings.air_humidity),
                material_temperature_1: first,
                material_temperature_2: second,
                material_temperature_3: third,
                expansion_coefficient: pair(surroundings.expansion_coefficient),
                environment_factor: pair(surroundings.environment_factor),
                date_time: surroundings.date_time.clone(),
            },
        }
    }
}
