//! The JSON document of `volcomp fit-thermal`.

use std::collections::BTreeMap;

use schemars::JsonSchema;
use serde::Serialize;

/// The document of `volcomp fit-thermal`.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct FitThermal {
    /// One entry for each displacement that was fitted.
    pub(crate) displacements: Vec<Displacement>,
    /// Share of the rows, the first ones, that terms were found from to be judged; the others were predicted. Of a single file
    /// only.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) train: Option<f64>,
    /// The temperature columns, without `_degc`.
    pub(crate) sensors: Vec<String>,
}

/// One displacement. A column in µm fills the keys that end in `_um`, one in µrad those in `_urad`.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct Displacement {
    /// The name of the column in the file.
    pub(crate) name: String,
    /// The error that it is; null where the call does not say it, and the terms have a gap.
    pub(crate) error: Option<String>,
    /// Whether the terms predict better than no terms, and no worse than regression without time constants (`baseline`), by what the
    /// tests can tell.
    pub(crate) recommended: bool,
    /// Root mean square of the displacement itself where it is predicted, µm.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) without_terms_rms_um: Option<f64>,
    /// Root mean square of the displacement itself where it is predicted, µrad.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) without_terms_rms_urad: Option<f64>,
    /// Ridge regression on the temperatures as they are.
    pub(crate) baseline: Prediction,
    /// Regression on all sensors with many time constants, as a measure of what few terms lose; of a single file only.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) dense: Option<Prediction>,
    /// Few terms with time constants. What the temperatures may have done between the rows is part of its errors, and of those in
    /// `left_out`.
    pub(crate) fit: Prediction,
    /// The error in each file that was left out; empty for a single file.
    pub(crate) left_out: Vec<LeftOut>,
    /// The numbers of the terms, found from everything.
    pub(crate) numbers: Vec<Number>,
    /// The error of validation against the number of numbers, many first.
    pub(crate) sizes: Vec<Size>,
    /// The drift terms, found from everything.
    pub(crate) drift: Vec<DriftTerm>,
    /// The expansion terms, found from everything; only where an axis was moved.
    pub(crate) expansion: Vec<ExpansionTerm>,
    /// The temperatures and rates that the sensors of the terms have shown.
    pub(crate) seen: Vec<Seen>,
    /// The constant that belongs to the terms, µm.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) constant_um: Option<f64>,
    /// The constant that belongs to the terms, µrad.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) constant_urad: Option<f64>,
    /// How far the constants of the files and positions are apart, µm.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) constant_spread_um: Option<f64>,
    /// How far the constants of the files and positions are apart, µrad.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) constant_spread_urad: Option<f64>,
    /// The terms as they stand in a machine file; where `error` is null each `error` in it is a gap to be filled in.
    pub(crate) toml: String,
}

/// How well a fit predicts the part of the time that it has not seen.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct Prediction {
    /// Root mean square error of the prediction, µm.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) rms_um: Option<f64>,
    /// Root mean square error of the prediction, µrad.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) rms_urad: Option<f64>,
    /// The stretch with the largest error, of ten of equally many rows; of a single file only.
    pub(crate) worst_segment: Option<Segment>,
    /// Root mean square error with which penalty, time constants and sensors were chosen, µm.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) forward_rms_um: Option<f64>,
    /// Root mean square error with which penalty, time constants and sensors were chosen, µrad.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) forward_rms_urad: Option<f64>,
    /// Ridge penalties of the models that are averaged.
    pub(crate) penalties: Vec<f64>,
    /// Time constants of the drift terms, s.
    pub(crate) lags_s: Vec<f64>,
    /// Sensors with a weight.
    pub(crate) sensors: Vec<String>,
}

/// A stretch of time and the error of its prediction.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct Segment {
    /// The start of the stretch, s in the time of the file.
    pub(crate) from_s: f64,
    /// The end of the stretch, s in the time of the file.
    pub(crate) to_s: f64,
    /// Root mean square error, µm.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) rms_um: Option<f64>,
    /// Root mean square error, µrad.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) rms_urad: Option<f64>,
}

/// One `[[thermal.drift]]` of a machine file.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct DriftTerm {
    /// Time constant of the first-order lag, s.
    pub(crate) lag_s: f64,
    /// Weight of each sensor, a factor of the drift.
    pub(crate) sensors: BTreeMap<String, f64>,
    /// The drift of a weight of 1, µm/K.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) um_per_k: Option<f64>,
    /// The drift of a weight of 1, µrad/K.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) urad_per_k: Option<f64>,
}

/// One `[[thermal.expansion]]` of a machine file.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct ExpansionTerm {
    /// Name of the sensor.
    pub(crate) sensor: String,
    /// The expansion, µm/(m·K).
    pub(crate) um_per_m_k: f64,
    /// The coordinate at which nothing moves, mm.
    pub(crate) fixed_mm: f64,
}

/// The error in a file that was left out.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct LeftOut {
    /// The file as it was named in the call.
    pub(crate) file: String,
    /// Root mean square error, µm.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) rms_um: Option<f64>,
    /// Root mean square error, µrad.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) rms_urad: Option<f64>,
}

/// One number of the terms. It and its standard uncertainty (k = 1) fill the keys of its unit.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct Number {
    /// Name of the sensor.
    pub(crate) sensor: String,
    /// Time constant of the lag, s; not there for an expansion.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) lag_s: Option<f64>,
    /// Drift, µm/K.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) um_per_k: Option<f64>,
    /// Drift, µrad/K.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) urad_per_k: Option<f64>,
    /// Expansion, µm/(m·K).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) um_per_m_k: Option<f64>,
    /// Standard uncertainty of the drift, µm/K.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) uncertainty_um_per_k: Option<f64>,
    /// Standard uncertainty of the drift, µrad/K.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) uncertainty_urad_per_k: Option<f64>,
    /// Standard uncertainty of the expansion, µm/(m·K).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) uncertainty_um_per_m_k: Option<f64>,
}

/// The error of validation with so many numbers.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct Size {
    /// How many numbers.
    pub(crate) numbers: usize,
    /// Root mean square error of validation, µm.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) rms_um: Option<f64>,
    /// Root mean square error of validation, µrad.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) rms_urad: Option<f64>,
    /// Standard error of it over the files or stretches of time, µm.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) standard_error_um: Option<f64>,
    /// Standard error of it over the files or stretches of time, µrad.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) standard_error_urad: Option<f64>,
}

/// What a sensor has shown in the tests.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct Seen {
    /// Name of the sensor.
    pub(crate) sensor: String,
    /// Lowest and highest temperature, °C.
    pub(crate) degc: [f64; 2],
    /// Fastest fall and rise, K/min, smoothed over ten minutes.
    pub(crate) k_per_min: [f64; 2],
}
