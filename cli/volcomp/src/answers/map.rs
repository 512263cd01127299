//! The JSON document of `volcomp map`; the errors at the nodes are in the file that it wrote.

use schemars::JsonSchema;
use serde::Serialize;

use super::{ByAxis, NotCounted, diagonals::Compensated};

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
    /// Root of the mean square of the length of the position error over all nodes, µm.
    pub(crate) rms_um: f64,
    /// The same after alignment of the workpiece (three shifts and three small rotations by least squares): where the workpiece lies
    /// is a convention and no error, µm.
    pub(crate) form_rms_um: f64,
    /// Length of the largest position error after alignment, µm.
    pub(crate) form_max_um: f64,
    /// The volumetric error over poses of all axes.
    pub(crate) all_axes: AllAxes,
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
    /// The errors that the observations do not determine, which no uncertainty here counts, the one that moves the tool most first.
    pub(crate) not_counted: Vec<NotCounted>,
}

/// The volumetric error over poses of all axes, the same ones each time.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct AllAxes {
    /// How many poses.
    pub(crate) poses: usize,
    /// Root of the mean square of the length of the position error, µm.
    pub(crate) rms_um: f64,
    /// Length of the largest position error, µm.
    pub(crate) max_um: f64,
    /// Root of the mean square after alignment of the workpiece, µm.
    pub(crate) form_rms_um: f64,
    /// Largest error of the tool tip after alignment, searched from the worst poses, µm.
    pub(crate) form_max_um: f64,
    /// The pose of that error, mm and deg.
    pub(crate) at: ByAxis,
    /// Largest tilt of the tool axis after alignment, µrad.
    pub(crate) tilt_max_urad: f64,
    /// Root of the mean square of the rotation error, µrad.
    pub(crate) rms_urad: f64,
    /// The same after alignment, µrad.
    pub(crate) form_rms_urad: f64,
    /// Root of the mean square of the tilt of the tool axis: the part of the rotation error across it, µrad.
    pub(crate) tilt_rms_urad: f64,
    /// The same after alignment, µrad.
    pub(crate) form_tilt_rms_urad: f64,
    /// Root of the mean square of the rotation error about the tool axis, which no tool that turns shows, µrad.
    pub(crate) about_tool_rms_urad: f64,
    /// The same after alignment, µrad.
    pub(crate) form_about_tool_rms_urad: f64,
    /// The standard uncertainty of the errors over these poses; only with `--uncertainty`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) uncertainty: Option<AllAxesUncertainty>,
}

/// The standard uncertainty (k = 1) of the errors over poses of all axes.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct AllAxesUncertainty {
    /// Root of the mean square of its length, position, µm.
    pub(crate) rms_um: f64,
    /// The largest length, position, µm.
    pub(crate) largest_um: f64,
    /// The pose with the largest, mm and deg.
    pub(crate) at: ByAxis,
    /// Root of the mean square of its length, rotation, µrad.
    pub(crate) rms_urad: f64,
    /// The largest length, rotation, µrad.
    pub(crate) largest_urad: f64,
}
