//! The error of the model over a plane of the work space, for the map of the dashboard.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use volcomp_vocabulary::AxisName;

/// The answer to `GET /api/map`: the error over the travels of two linear axes, the others where they stand. Empty for
/// a machine with fewer than two linear axes.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ErrorMap {
    /// The axis of the columns, then that of the rows.
    pub axes: Vec<MapAxis>,
    /// The length of the position error, µm: rows over the second axis, values in a row over the first, from the lower
    /// to the upper end of the travel.
    pub error_um: Vec<Vec<f64>>,
}

/// One axis of the map.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct MapAxis {
    /// The letter of the axis.
    #[schemars(with = "String")]
    pub name: AxisName,
    /// The ends of its travel, mm.
    pub travel: [f64; 2],
}
