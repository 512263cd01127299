//! The reasons why a machine file is refused or a machine cannot answer.

use volcomp_document::{InputError, ReadError};
use volcomp_kinematics::{ChainError, NoEffect};
use volcomp_vocabulary::{AxisName, ErrorName};

use crate::provenance::ProvenanceRefusal;

/// Why a machine file is refused or a machine cannot answer.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
#[expect(missing_docs, reason = "the messages say what most fields are")]
pub enum ModelError {
    /// The file cannot be read as text.
    #[error(transparent)]
    Read(#[from] ReadError),
    /// Something in the file is wrong.
    #[error(transparent)]
    Input(#[from] InputError),
    /// The machine has no such axis.
    #[error("machine `{machine}` with structure `{structure}` has no axis {axis}")]
    NoSuchAxis {
        machine: String,
        structure: String,
        axis: AxisName,
    },
    /// The machine file has no such tool.
    #[error(
        "machine `{machine}` has no tool `{tool}`, {}",
        if known.is_empty() {
            "and its file states none in [tools]: without a choice it has the tool of [tool]".to_owned()
        } else {
            format!("expected one of: {known}")
        }
    )]
    NoSuchTool {
        machine: String,
        tool: String,
        known: String,
    },
    /// A coordinate that is no number, or too large for a machine.
    #[error("axis {axis}: coordinate is {found}, expected a finite number from -1e9 to 1e9 {}", axis.kind().coordinate_unit())]
    Coordinate {
        axis: AxisName,
        /// The value that was found, mm or deg.
        found: f64,
    },
    /// A tool tip or a tool axis that no machine can have.
    #[error("{what} is [{}, {}, {}], expected finite numbers up to 1e9, and of a direction not all zero", found[0], found[1], found[2])]
    Target { what: &'static str, found: [f64; 3] },
    /// Two coordinates of one axis.
    #[error("axis {axis} has two coordinates, expected one at the most")]
    AxisTwice { axis: AxisName },
    /// An error motion or a location error that the machine cannot have.
    #[error("{error}: {reason}")]
    Refused {
        error: ErrorName,
        #[source]
        reason: ErrorRefusal,
    },
    /// An assembly error that is no finite number.
    #[error("assembly error of axis {axis} is {found}, expected a finite number of µm or µrad")]
    Assembly { axis: AxisName, found: f64 },
    /// Thermal terms that the machine cannot have.
    #[error(transparent)]
    Thermal(#[from] ThermalRefusal),
    /// Axes that corrections cannot be restricted to.
    #[error(transparent)]
    Correct(#[from] CorrectRefusal),
    /// A provenance that the machine cannot have.
    #[error("provenance: {0}")]
    Provenance(#[from] ProvenanceRefusal),
    /// Geometry that a chain cannot have.
    #[error(transparent)]
    Chain(#[from] ChainError),
    /// The compiled form cannot be made.
    #[error("{machine}: {source}")]
    Compile {
        machine: String,
        source: volcomp_evaluator::EvaluatorError,
    },
    /// More of something than is computed at once.
    #[error("found {found} {what}, expected {most} at the most")]
    TooMany {
        what: &'static str,
        found: usize,
        most: usize,
    },
}

/// Why a machine cannot have an error motion or a location error.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum ErrorRefusal {
    /// A curve is given for a location error.
    #[error("a location error is one number, never a curve")]
    CurveOfLocation,
    /// One number is given as the location error of a name that stands for an error motion.
    #[error("is an error motion, expected a location error E?0N")]
    ErrorMotion,
    /// A number of the curve, its value at an end of the travel, or the location error is NaN, infinite or beyond
    /// [`LARGEST_NUMBER`](volcomp_document::LARGEST_NUMBER).
    #[error("expected finite numbers, also for its values within the travel")]
    NotFinite,
    /// A location error that moves nothing.
    #[error(transparent)]
    NoEffect(#[from] NoEffect),
    /// On an axis with a modulo the curve does not close.
    #[error(
        "first value {first} and last value {last} differ, expected the same: the axis has a modulo"
    )]
    NotClosed {
        /// Value at the first node, µm or µrad.
        first: f64,
        /// Value at the last node, µm or µrad.
        last: f64,
    },
    /// On an axis with a modulo the curve jumps where the axis rolls over.
    #[error(
        "jumps by {:.3} where the axis rolls over, from {first:.3} to {last:.3}, expected at most {largest} µm or µrad: the axis has a modulo, so the curve must close", (last - first).abs()
    )]
    Jumps {
        /// Value on the lower side of the roll-over, µm or µrad.
        first: f64,
        /// Value on its upper side, µm or µrad.
        last: f64,
        /// The largest jump that is allowed, µm or µrad.
        largest: f64,
    },
    /// A grid looks at an axis that the machine does not have.
    #[error("the grid looks at axis number {axis} of the chain, expected one below {axes}")]
    GridAxis {
        /// The place in the chain that the grid names, from 0.
        axis: usize,
        /// How many axes the machine has.
        axes: usize,
    },
}

/// Why thermal terms are refused.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
#[expect(missing_docs, reason = "the messages say what most fields are")]
pub enum ThermalRefusal {
    /// A term of an error that is no error motion of the machine.
    #[error("found \"{found}\", expected an error motion E?N of an axis of `{structure}`")]
    Motion { found: String, structure: String },
    /// A reference temperature that nothing can have.
    #[error(
        "reference temperature is {found} °C, expected {} to {} °C",
        volcomp_vocabulary::bounds::PLAUSIBLE_DEGC.start(),
        volcomp_vocabulary::bounds::PLAUSIBLE_DEGC.end()
    )]
    Reference {
        /// The temperature that was found, °C.
        found: f64,
    },
    /// An expansion of an error that is no length of a linear axis.
    #[error("found expansion of {error}, expected a linear error motion of a linear axis")]
    NotLength { error: ErrorName },
    /// A drift without a sensor.
    #[error("found a drift of {error} without a sensor, expected at least one")]
    NoSensor { error: ErrorName },
    /// A time constant that is negative or no number.
    #[error("found a lag_s of {found} s for {error}, expected 0 s or more")]
    Lag {
        error: ErrorName,
        /// The time constant found, s.
        found: f64,
    },
    /// A number that is NaN or infinite.
    #[error("{what} is {found}, expected a finite number")]
    NotFinite {
        /// The number that is meant, with its unit.
        what: &'static str,
        found: f64,
    },
    /// A margin that is too small, too large or no number.
    #[error("margin_k is {found} K, expected 0.1 to 100 K")]
    Margin {
        /// The margin that was found, K.
        found: f64,
    },
    /// Temperatures that cannot be the range of a test.
    #[error(
        "the terms of {error} have seen {sensor} at {low} to {high} °C, expected two different temperatures, the lower one first"
    )]
    SeenTemperatures {
        error: ErrorName,
        sensor: String,
        /// The first temperature, °C.
        low: f64,
        /// The second temperature, °C.
        high: f64,
    },
    /// Rates that cannot be the range of a test.
    #[error(
        "the terms of {error} have seen {sensor} change by {fall} to {rise} K/min, expected 0 or less, then 0 or more"
    )]
    SeenRates {
        error: ErrorName,
        sensor: String,
        /// The first rate, K/min.
        fall: f64,
        /// The second rate, K/min.
        rise: f64,
    },
    /// What the terms of an error have seen of a sensor is stated more than once.
    #[error("what the terms of {error} have seen of {sensor} stands twice, expected it once")]
    SeenTwice { error: ErrorName, sensor: String },
    /// Something is stated as seen that no term of the error looks at.
    #[error("no thermal term of {error} has the sensor {sensor}, expected one that it has")]
    SeenUnused { error: ErrorName, sensor: String },
    /// Times of holding and fading that are negative or no numbers.
    #[error("found {hold_s} s of holding and {fade_s} s of fading, expected 0 s or more of each")]
    Fading {
        /// Time that a term is held without its sensor, s.
        hold_s: f64,
        /// Time within which it then fades to zero, s.
        fade_s: f64,
    },
}

/// Why corrections cannot be restricted to a list of axes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum CorrectRefusal {
    /// The list names no axis.
    #[error("found no axis, expected at least one that corrections may move")]
    Empty,
    /// An axis is named more than once.
    #[error("axis {axis} stands twice, expected each axis once")]
    Twice {
        /// The axis that is meant.
        axis: AxisName,
    },
}
