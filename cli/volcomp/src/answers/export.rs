//! The JSON document of `volcomp export`.

use schemars::JsonSchema;
use serde::Serialize;

use crate::commands::ByAxis;

/// The document of `volcomp export`.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct Export {
    /// The format.
    pub(crate) format: String,
    /// The files that were written.
    pub(crate) files: Vec<String>,
    /// The checksum of the machine file, as it stands in the files.
    pub(crate) machine: String,
    /// Where the axes stand that a table does not go over, mm and deg.
    pub(crate) at: ByAxis,
    /// What a number in the files says.
    pub(crate) sign: String,
    /// What the sign rests on, and whether it is proven.
    pub(crate) trust: String,
    /// The tables that were made; what the files do not hold of them stands among the notes.
    pub(crate) tables: Vec<Made>,
    /// What the files do not hold, and what the control has to be told besides.
    pub(crate) notes: Vec<String>,
    /// What the control loses with these files against the model.
    pub(crate) loss: Loss,
}

/// A table that was made.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct Made {
    /// The axis whose position chooses the value.
    pub(crate) input: String,
    /// What the values are of: the letter of the axis that deviates, or the name of an error.
    pub(crate) output: String,
    /// How many positions.
    pub(crate) positions: usize,
    /// The first position, mm or deg.
    pub(crate) first: f64,
    /// The last position, mm or deg.
    pub(crate) last: f64,
    /// Whether the directions of motion have values of their own.
    pub(crate) both_directions: bool,
    /// The largest value, by size.
    pub(crate) largest: f64,
    /// The unit of the largest value: `um` or `urad`.
    pub(crate) unit: String,
}

/// What the control loses.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct Loss {
    /// At how many poses over the travel of all axes, each after positive and after negative motion.
    pub(crate) poses: usize,
    /// All errors together, for each axis that corrects.
    pub(crate) axes: Vec<AxisLoss>,
    /// Each kind of error alone, where the machine has it.
    pub(crate) categories: Vec<CategoryLoss>,
}

/// What is left on one axis.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct AxisLoss {
    /// The axis that corrects.
    pub(crate) axis: String,
    /// The unit of the numbers: `um` or `urad`.
    pub(crate) unit: String,
    /// The largest correction of the model.
    pub(crate) correction: f64,
    /// The largest difference between model and tables.
    pub(crate) largest: f64,
    /// Root of the mean square of that difference.
    pub(crate) rms: f64,
    /// Where the largest is, mm and deg.
    pub(crate) at: ByAxis,
    /// After which motion of all axes: `+`, `-`; `null`: in the mean of both.
    pub(crate) direction: Option<String>,
}

/// What is left of one kind of error.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct CategoryLoss {
    /// `positioning`, `straightness`, `squareness`, `angular`, `second coordinate`, `reversal`, `thermal, 1 K` or `rotary`.
    pub(crate) category: String,
    /// For each axis that corrects.
    pub(crate) axes: Vec<AxisLoss>,
}
