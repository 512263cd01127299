//! The JSON documents of `volcomp sensitivity` and `volcomp expression`.

use std::collections::BTreeMap;

use schemars::JsonSchema;
use serde::Serialize;

/// The document of `volcomp sensitivity`: what each error does over many positions.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct Sensitivity {
    /// How many positions were looked at.
    pub(crate) positions: usize,
    /// Whether the effects are those of the values in the machine file, the largest first (`--values`); else of 1 µm or
    /// 1 µrad of each error.
    pub(crate) values: bool,
    /// Each error: six error motions of each axis, and its location errors or, with `--assembly`, its assembly errors
    /// `SXX` to `SCX`.
    pub(crate) errors: Vec<Effect>,
    /// Errors that are one motion of the tool at every position, however many there are of it.
    pub(crate) groups: Vec<Vec<String>>,
    /// The names of these motions by frame or line, in the order of `groups`.
    pub(crate) motions: Vec<String>,
    /// How many combinations of the errors position and orientation of the tool can tell apart.
    pub(crate) rank: usize,
    /// A column counts as a combination of others when less than this part of it is left beside them.
    pub(crate) tolerance: f64,
    /// Combinations of the errors (µm and µrad, of unit length) that move the tool at no position. An error motion is a
    /// constant here: `EXC constant`.
    pub(crate) indistinguishable: Vec<BTreeMap<String, f64>>,
}

/// What 1 µm or 1 µrad of one error does; with `--values` what its value does.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct Effect {
    /// The error.
    pub(crate) name: String,
    /// Root mean square of the displacement of the tool tip over the positions, µm.
    pub(crate) position_rms_um: f64,
    /// The largest displacement, µm.
    pub(crate) position_max_um: f64,
    /// Root mean square of the rotation of the tool, µrad.
    pub(crate) orientation_rms_urad: f64,
    /// The largest rotation, µrad.
    pub(crate) orientation_max_urad: f64,
    /// Part of the mean square of the displacement when none of the errors knows of another, 0 to 1.
    pub(crate) share: f64,
}

/// The document of `volcomp expression`: the first-order volumetric error, lengths in mm and angles in rad.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct Expression {
    /// Displacement of the tool tip along X, Y and Z (`dX dY dZ`), then rotation of the tool about them (`dA dB dC`).
    pub(crate) formulas: Vec<Formula>,
    /// The coordinates of the tool tip at machine zero that stand in the formulas, mm.
    pub(crate) tool_mm: BTreeMap<String, f64>,
}

/// One component of the volumetric error.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct Formula {
    /// The left side.
    pub(crate) name: String,
    /// The whole formula in a form that Python and spreadsheets read.
    pub(crate) text: String,
    /// The same in LaTeX, for an `align` environment.
    pub(crate) latex: String,
    /// The errors by their levers.
    pub(crate) terms: Vec<Term>,
}

/// Errors that act through the same lever.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct Term {
    /// The lever, mm, or a number without unit.
    pub(crate) lever: String,
    /// The errors, with a minus sign before those that count negative.
    pub(crate) errors: Vec<String>,
}
