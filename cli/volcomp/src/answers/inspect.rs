//! The JSON document of `volcomp inspect`.

#![expect(clippy::struct_field_names, reason = "the keys are those of the file")]

use schemars::JsonSchema;
use serde::Serialize;
use volcomp_metrology::{DeviationUnit, Measurement, StartEnd};
use volcomp_vocabulary::Direction;

/// The document of `volcomp inspect`: what a measurement file says about itself, and its readings in short.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct Inspect {
    /// The file as it was named in the call.
    pub(crate) file: String,
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

impl Inspect {
    /// The document of a file that was read.
    pub(crate) fn new(file: String, measurement: &Measurement) -> Self {
        let deviations = || measurement.readings.iter().map(|reading| reading.deviation);
        let [runs_forward, runs_backward] =
            Direction::BOTH.map(|direction| measurement.runs(direction).len());
        let metadata = measurement.metadata.clone();
        let surroundings = &measurement.environment;
        let pair = |quantity: Option<StartEnd>| quantity.map(|q| [q.start, q.end]);
        let [first, second, third] = surroundings.material_temperature.map(pair);
        Self {
            file,
            texts: Texts {
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
            },
            unit: measurement.unit.map(DeviationUnit::key),
            targets: measurement.targets(),
            runs_forward,
            runs_backward,
            readings: measurement.readings.len(),
            deviation_min: deviations().reduce(f64::min),
            deviation_max: deviations().reduce(f64::max),
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
