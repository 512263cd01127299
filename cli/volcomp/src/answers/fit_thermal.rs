//! The JSON document of `volcomp fit-thermal`.

use std::collections::BTreeMap;

use schemars::JsonSchema;
use serde::Serialize;

/// The document of `volcomp fit-thermal`.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct FitThermal {
    /// One entry for each displacement that was fitted.
    pub(crate) displacements: Vec<Displacement>,
    /// Share of the time that was fitted; the rest was predicted.
    pub(crate) train: f64,
    /// The temperature columns, without `_degc`.
    pub(crate) sensors: Vec<String>,
}

/// One displacement. A column in µm fills the keys that end in `_um`, one in µrad those in `_urad`.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct Displacement {
    /// The name of the column in the file.
    pub(crate) name: String,
    /// Ridge regression on the temperatures as they are.
    pub(crate) baseline: Prediction,
    /// The same with time constants.
    pub(crate) fit: Prediction,
    /// The drift terms, fitted on the whole time.
    pub(crate) drift: Vec<DriftTerm>,
    /// The constant that belongs to the terms, µm.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) constant_um: Option<f64>,
    /// The constant that belongs to the terms, µrad.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) constant_urad: Option<f64>,
    /// The drift terms as they stand in a machine file.
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
    /// The worst stretch of the prediction.
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
    /// Weight of each sensor, µm/K or µrad/K.
    pub(crate) sensors: BTreeMap<String, f64>,
}
