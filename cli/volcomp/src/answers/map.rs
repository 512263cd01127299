//! The JSON document of `volcomp map`; the errors at the nodes are in the file that it wrote.

use schemars::JsonSchema;
use serde::Serialize;

use super::{ByAxis, diagonals::Compensated};

/// The document of `volcomp map`.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct Map {
    /// Nodes along the axes of the grid, in the order X, Y, Z.
    pub(crate) counts: Vec<usize>,
    /// How many nodes there are.
    pub(crate) nodes: usize,
    /// Form of the model: exact, htm, twist or compiled.
    pub(crate) model: String,
    /// How far a curve of the compiled machine may be from its source, nm and nrad; only with the compiled form.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) tolerance_nm: Option<f64>,
    /// Length of the largest position error, µm.
    pub(crate) largest_um: f64,
    /// Where the largest position error is, mm.
    pub(crate) at: ByAxis,
    /// The position error there, in workpiece axes, µm.
    pub(crate) position_um: [f64; 3],
    /// The rotation error there, in workpiece axes, µrad.
    pub(crate) rotation_urad: [f64; 3],
    /// The largest standard uncertainty; only with `--uncertainty`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) uncertainty: Option<Uncertainty>,
    /// How the correction was applied; only with `--compensated`, `--truth` or `--resolution`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) compensated: Option<Compensated>,
    /// The file with the field; only with `--output`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) file: Option<String>,
}

/// The node with the largest standard uncertainty (k = 1) of the position error.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct Uncertainty {
    /// How many machines were drawn.
    pub(crate) trials: u64,
    /// Seed of the draws.
    pub(crate) seed: u64,
    /// Length of the standard uncertainty of the position error, µm.
    pub(crate) largest_um: f64,
    /// Where it is, mm.
    pub(crate) at: ByAxis,
    /// Standard uncertainty of the position error there, µm.
    pub(crate) position_um: [f64; 3],
    /// Standard uncertainty of the rotation error there, µrad.
    pub(crate) rotation_urad: [f64; 3],
}
