//! The last minutes of the error without and with correction, for the trend of the dashboard.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// The answer to `GET /api/history`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct History {
    /// How long the history reaches back at the most, s.
    pub span_s: f64,
    /// The points, oldest first.
    pub points: Vec<HistoryPoint>,
}

/// The length of the error at one time. Of the simulated machine it is the true error, else the model's.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct HistoryPoint {
    /// Time since the start of the control thread, s.
    pub at_s: f64,
    /// Length of the position error of the tool tip without correction, µm; null while it was not known.
    pub error_um: Option<f64>,
    /// Length of the position error with the applied correction, µm.
    pub residual_um: Option<f64>,
    /// Length of the direction error of the tool axis without correction, µrad; only with rotary axes.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub error_axis_urad: Option<f64>,
    /// Length of the direction error of the tool axis with the applied correction, µrad; only with rotary axes.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub residual_axis_urad: Option<f64>,
}
