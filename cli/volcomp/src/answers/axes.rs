//! The JSON documents of `volcomp axes` and `volcomp dh`.

use schemars::JsonSchema;
use serde::Serialize;
use volcomp_vocabulary::{AxisKind, AxisName};

use crate::commands::ByAxis;

/// The document of `volcomp axes`: where the axes stand for a tip and a direction of the tool.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct Axes {
    /// Every solution within travel, mm and deg, those with the least turns first.
    pub(crate) solutions: Vec<ByAxis>,
    /// Whether at this pose a rotary axis has no part in the direction of the tool, or linear axes are dependent.
    pub(crate) singular: bool,
    /// The rotary axes without a part in it, and the linear axes that are dependent.
    #[schemars(with = "Vec<String>")]
    pub(crate) free: Vec<AxisName>,
    /// For each of these the ranges in which it may stand, mm or deg, so that all other axes are within their travels: of a rotary axis
    /// of one turn. There is a solution for each range, where a rotary axis is nearest to 0. Empty for linear axes of several
    /// dependent moves.
    pub(crate) free_ranges: Vec<Vec<[f64; 2]>>,
    /// The moves of linear axes, mm, that leave the tip where it is; the largest is 1.
    pub(crate) dependent_moves: Vec<ByAxis>,
    /// Axes that would leave their travel in further solutions.
    #[schemars(with = "Vec<String>")]
    pub(crate) outside_travel: Vec<AxisName>,
    /// The reason why no travel would do; null where there is a solution, or one outside travel.
    pub(crate) unreachable: Option<String>,
}

/// The document of `volcomp dh`: the Denavit–Hartenberg table of a machine at machine zero.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct Dh {
    /// `distal` or `proximal`.
    pub(crate) convention: String,
    /// The joints from the workpiece to the tool: R turns, T slides.
    pub(crate) joints: String,
    /// The frame before the first row, in the machine coordinate system.
    pub(crate) base: Frame,
    /// One row for each axis, from the workpiece to the tool.
    pub(crate) rows: Vec<Row>,
    /// The machine coordinate system in the last frame, so that at machine zero the product of all is nothing.
    pub(crate) tool: Frame,
}

/// A frame by its origin and two of its axes.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct Frame {
    /// The origin, mm.
    pub(crate) point_mm: [f64; 3],
    /// Direction of its x axis.
    pub(crate) x: [f64; 3],
    /// Direction of its z axis.
    pub(crate) z: [f64; 3],
}

/// One row of the table at machine zero.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct Row {
    /// The axis, whose coordinate adds to `theta_deg` (rotary) or `d_mm` (linear).
    #[schemars(with = "String")]
    pub(crate) axis: AxisName,
    /// `linear` or `rotary`.
    #[schemars(with = "String")]
    pub(crate) kind: AxisKind,
    /// Joint angle θ, deg.
    pub(crate) theta_deg: f64,
    /// Link offset d, mm.
    pub(crate) d_mm: f64,
    /// Link length a, mm.
    pub(crate) a_mm: f64,
    /// Link twist α, deg.
    pub(crate) alpha_deg: f64,
}
