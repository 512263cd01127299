//! The JSON document of `volcomp diagonals`.

use schemars::JsonSchema;
use serde::Serialize;

/// The document of `volcomp diagonals`: letters are the direction of motion of X, Y and Z (P positive, N negative).
#[derive(Debug, Serialize, JsonSchema)]
#[serde(rename_all = "UPPERCASE")]
pub(crate) struct Diagonals {
    pub(crate) ppp: Diagonal,
    pub(crate) npp: Diagonal,
    pub(crate) pnp: Diagonal,
    pub(crate) ppn: Diagonal,
    /// How the correction was applied; only with `--compensated`, `--truth` or `--resolution`.
    #[serde(rename = "compensated", skip_serializing_if = "Option::is_none")]
    pub(crate) compensated: Option<Compensated>,
}

/// One body diagonal of ISO 230-6.
#[derive(Debug, Default, Serialize, JsonSchema)]
pub(crate) struct Diagonal {
    /// Deviation along the diagonal at each target, zero at the first, µm.
    pub(crate) deviation_um: Vec<f64>,
    /// Largest minus smallest deviation, µm.
    pub(crate) range_um: f64,
}

/// How a correction was applied before the errors were computed.
#[derive(Clone, Debug, Serialize, JsonSchema)]
pub(crate) struct Compensated {
    /// The machine file whose errors act on the corrected command; null: the model itself, which proves nothing.
    pub(crate) truth: Option<String>,
    /// Step to which the correction of linear axes is rounded, µm; null: not rounded.
    pub(crate) resolution_um: Option<f64>,
    /// Step to which the correction of rotary axes is rounded, µrad; the same number as that of linear axes.
    pub(crate) resolution_urad: Option<f64>,
}
