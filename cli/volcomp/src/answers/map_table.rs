//! The JSON document of `volcomp map-table`.

use schemars::JsonSchema;
use serde::Serialize;

use crate::commands::ByAxis;

/// The document of `volcomp map-table`.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct MapTable {
    /// The file that was written.
    pub(crate) file: String,
    /// The size of the file, bytes.
    pub(crate) bytes: usize,
    /// The number of the map.
    pub(crate) counter: u16,
    /// The first 32 bits of the checksum of the machine file, as hexadecimal digits.
    pub(crate) model: String,
    /// The axes that the map goes over, the slowest first.
    pub(crate) grid: Vec<GridAxis>,
    /// The axes that it corrects.
    pub(crate) outputs: Vec<Output>,
    /// Parts of a value in one step of the output.
    pub(crate) scale: u16,
    /// Words of the map.
    pub(crate) words: usize,
    /// Words that the control has for one map.
    pub(crate) capacity: usize,
    /// The largest error between the map and the model, µm.
    pub(crate) error_max_um: f64,
    /// Root of the mean square of that error, µm.
    pub(crate) error_rms_um: f64,
    /// Where the largest error is, mm and deg.
    pub(crate) at: ByAxis,
    /// At how many positions the error was looked at.
    pub(crate) positions: usize,
    /// What rounding to the output's step adds at the most on one axis, µm.
    pub(crate) step_um: f64,
    /// Where the axes stand that the map does not go over, mm and deg.
    pub(crate) held: ByAxis,
    /// How much the correction differs at the most where they stand elsewhere, µm; only where axes are held.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) elsewhere_um: Option<f64>,
    /// The largest change of a correction along an axis, µm for each mm (µm for each deg along a rotary axis).
    pub(crate) steepest_um: f64,
    /// Frames that bring the map into the control.
    pub(crate) frames: usize,
    /// Bytes that this takes, read-back and reports included, without the protocol of the bus.
    pub(crate) transfer_bytes: usize,
    /// How long it takes over the stated link, s.
    pub(crate) transfer_s: f64,
    /// The largest change of the correction for a kelvin at each sensor, µm.
    pub(crate) um_per_k: std::collections::BTreeMap<String, f64>,
    /// The time after which the map is off by the bound, where every sensor goes by the stated rate, s; `null` where no temperature
    /// changes it.
    pub(crate) refresh_s: Option<f64>,
}

/// An axis that a map goes over.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct GridAxis {
    /// Its letter.
    pub(crate) axis: String,
    /// How many lines.
    pub(crate) lines: u16,
    /// Where the first line is, mm or deg.
    pub(crate) first: f64,
    /// From line to line, mm or deg.
    pub(crate) pitch: f64,
}

/// An axis that a map corrects.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct Output {
    /// Its letter.
    pub(crate) axis: String,
    /// The largest correction on the lines, µm.
    pub(crate) largest_um: f64,
}
