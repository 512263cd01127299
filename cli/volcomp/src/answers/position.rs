//! The JSON documents of `volcomp error` and `volcomp correct`.

use schemars::JsonSchema;
use serde::Serialize;
use volcomp_vocabulary::{AxisName, ErrorName};

use super::{ByAxis, NotCounted, OneOrMany};

/// The document of `volcomp error`.
pub(crate) type Error = OneOrMany<ErrorAt>;

/// The document of `volcomp correct`.
pub(crate) type Correct = OneOrMany<CorrectionAt>;

/// The volumetric error at one position, in workpiece axes.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct ErrorAt {
    /// Actual minus ideal tool tip along X, Y and Z, µm.
    pub(crate) position_um: [f64; 3],
    /// Rotation of the tool about X, Y and Z, µrad.
    pub(crate) rotation_urad: [f64; 3],
    #[serde(flatten)]
    pub(crate) outside: Outside,
}

/// The correction at one commanded position.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct CorrectionAt {
    /// The correction to be added to the command: µm for linear axes, µrad for rotary axes.
    pub(crate) correction: ByAxis,
    /// The standard uncertainty (k = 1) of the correction: µm for linear axes, µrad for rotary axes; only with
    /// `--uncertainty`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) uncertainty: Option<ByAxis>,
    /// The errors that the observations do not determine, which the uncertainty does not count, the one that moves the tool most
    /// first; only with `--uncertainty`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) not_counted: Option<Vec<NotCounted>>,
    /// Error of the tool tip that the correction leaves, in workpiece axes, µm.
    pub(crate) residual_um: [f64; 3],
    /// Error of the tool axis that the correction leaves, in workpiece axes, µrad.
    pub(crate) residual_axis_urad: [f64; 3],
    /// How many Newton steps were taken.
    pub(crate) iterations: usize,
    /// Whether these steps brought what the axes can correct below 1e-5 µm and 1e-4 µrad.
    pub(crate) converged: bool,
    /// Whether a direction of the tool axis cannot be corrected: near a singular pose, or with fewer than two
    /// rotary axes.
    pub(crate) singular: bool,
    /// Whether the pose is within about 6° of a singular one of two rotary axes, where rotary corrections are more
    /// than ten times the error of the tool axis, or leave a direction of it out.
    pub(crate) near_singular: bool,
    /// The commanded position, mm or deg.
    pub(crate) command: ByAxis,
    /// The command with the correction added, mm or deg.
    pub(crate) corrected: ByAxis,
    #[serde(flatten)]
    pub(crate) outside: Outside,
}

/// The errors and axes for which a position is outside of what the model covers.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct Outside {
    /// Errors whose curves are evaluated outside their range, sorted by name.
    #[schemars(with = "Vec<String>")]
    pub(crate) outside_range: Vec<ErrorName>,
    /// Axes that stand outside their travel.
    #[schemars(with = "Vec<String>")]
    pub(crate) outside_travel: Vec<AxisName>,
}
