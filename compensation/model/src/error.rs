use volcomp_document::{InputError, ReadError};
use volcomp_kinematics::{ChainError, NoEffect};
use volcomp_vocabulary::{AxisName, ErrorName};

use crate::provenance::ProvenanceRefusal;

/// Why a machine file is rejected or a machine cannot be evaluated.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ModelError {
    /// The file cannot be read as text.
    #[error(transparent)]
    Read(#[from] ReadError),
    /// The file contains an invalid value.
    #[error(transparent)]
    Input(#[from] InputError),
    #[error("machine `{machine}` with structure `{structure}` has no axis {axis}")]
    NoSuchAxis { machine: String, structure: String, axis: AxisName },
    #[error(
        "machine `{machine}` has no tool `{tool}`, {}",
        if known.is_empty() {
            "and its file states none in [tools]: without a choice it has the tool of [tool]".to_owned()
        } else {
            format!("expected one of: {known}")
        }
    )]
    NoSuchTool { machine: String, tool: String, known: String },
    #[error("axis {axis}: coordinate is {found}, expected a finite number from -1e9 to 1e9 {}", axis.kind().coordinate_unit())]
    Coordinate {
        axis: AxisName,
        /// The rejected value, mm or deg.
        found: f64,
    },
    #[error("{what} is [{}, {}, {}], expected finite numbers up to 1e9, and of a direction not all zero", found[0], found[1], found[2])]
    Target { what: &'static str, found: [f64; 3] },
    #[error("axis {axis} has two coordinates, expected at most one")]
    AxisTwice { axis: AxisName },
    /// An error motion or a location error is invalid for this machine.
    #[error("{error}: {reason}")]
    Refused {
        error: ErrorName,
        #[source]
        reason: ErrorRefusal,
    },
    #[error("assembly error of axis {axis} is {found}, expected a finite number of µm or µrad")]
    Assembly { axis: AxisName, found: f64 },
    /// Thermal terms that are invalid for this machine.
    #[error(transparent)]
    Thermal(#[from] ThermalRefusal),
    /// The list of axes for corrections is invalid.
    #[error(transparent)]
    Correct(#[from] CorrectRefusal),
    /// Provenance that is invalid for this machine.
    #[error("provenance: {0}")]
    Provenance(#[from] ProvenanceRefusal),
    /// No kinematic chain can be built from the geometry.
    #[error(transparent)]
    Chain(#[from] ChainError),
    /// The machine cannot be compiled.
    #[error("{machine}: {source}")]
    Compile { machine: String, source: volcomp_evaluator::EvaluatorError },
    #[error("found {found} {what}, expected at most {most}")]
    TooMany { what: &'static str, found: usize, most: usize },
}

/// Why an error motion or a location error is rejected.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum ErrorRefusal {
    #[error("a location error is one number, never a curve")]
    CurveOfLocation,
    #[error("is an error motion, expected a location error E?0N")]
    ErrorMotion,
    /// A number of the curve, its value at an end of the travel, or the location error is NaN, infinite or beyond
    /// [`LARGEST_NUMBER`](volcomp_document::LARGEST_NUMBER).
    #[error("expected finite numbers, also for its values within the travel")]
    NotFinite,
    #[error(transparent)]
    NoEffect(#[from] NoEffect),
    /// On an axis with `modulo`, the curve does not close.
    #[error(
        "first value {first} and last value {last} differ, expected the same: the axis has a modulo"
    )]
    NotClosed {
        /// Value at the first node, µm or µrad.
        first: f64,
        /// Value at the last node, µm or µrad.
        last: f64,
    },
    /// On an axis with `modulo`, the curve jumps at the roll-over.
    #[error(
        "jumps by {:.3} where the axis rolls over, from {first:.3} to {last:.3}, expected at most {largest} µm or µrad: the axis has a modulo, so the curve must close", (last - first).abs()
    )]
    Jumps {
        /// Value on the lower side of the roll-over, µm or µrad.
        first: f64,
        /// Value on the upper side of the roll-over, µm or µrad.
        last: f64,
        /// Maximum allowed jump, µm or µrad.
        largest: f64,
    },
    #[error("the grid depends on axis number {axis} of the chain, expected a number below {axes}")]
    GridAxis {
        /// Index in the chain that the grid names, from 0.
        axis: usize,
        /// Number of axes of the machine.
        axes: usize,
    },
}

/// Why thermal terms are rejected.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum ThermalRefusal {
    /// A term belongs to an error that is not an error motion of the machine.
    #[error("found \"{found}\", expected an error motion E?N of an axis of `{structure}`")]
    Motion { found: String, structure: String },
    #[error(
        "reference temperature is {found} °C, expected {} to {} °C",
        volcomp_vocabulary::bounds::PLAUSIBLE_DEGC.start(),
        volcomp_vocabulary::bounds::PLAUSIBLE_DEGC.end()
    )]
    Reference {
        /// The rejected temperature, °C.
        found: f64,
    },
    #[error("found expansion of {error}, expected a linear error motion of a linear axis")]
    NotLength { error: ErrorName },
    #[error("found a drift of {error} without a sensor, expected at least one")]
    NoSensor { error: ErrorName },
    #[error("found a lag_s of {found} s for {error}, expected 0 s or more")]
    Lag {
        error: ErrorName,
        /// The rejected time constant, s.
        found: f64,
    },
    #[error("{what} is {found}, expected a finite number")]
    NotFinite {
        /// The rejected quantity, with its unit.
        what: &'static str,
        found: f64,
    },
    /// A margin is out of range or not a number.
    #[error("margin_k is {found} K, expected 0.1 to 100 K")]
    Margin {
        /// The rejected margin, K.
        found: f64,
    },
    #[error(
        "the terms of {error} have seen {sensor} at {low} to {high} °C, expected two different temperatures, the lower one first"
    )]
    SeenTemperatures {
        error: ErrorName,
        sensor: String,
        /// Lower end of the rejected range, °C.
        low: f64,
        /// Upper end of the rejected range, °C.
        high: f64,
    },
    #[error(
        "the terms of {error} have seen {sensor} change by {fall} to {rise} K/min, expected 0 or less, then 0 or more"
    )]
    SeenRates {
        error: ErrorName,
        sensor: String,
        /// Lower end of the rejected range, K/min.
        fall: f64,
        /// Upper end of the rejected range, K/min.
        rise: f64,
    },
    #[error("the tested range of {sensor} for {error} appears twice, expected it once")]
    SeenTwice { error: ErrorName, sensor: String },
    #[error("no thermal term of {error} has the sensor {sensor}, expected one that it has")]
    SeenUnused { error: ErrorName, sensor: String },
    #[error("found {hold_s} s of holding and {fade_s} s of fading, expected 0 s or more of each")]
    Fading {
        /// Time for which a term is held while its sensor is missing, s.
        hold_s: f64,
        /// Time over which the term then fades to zero, s.
        fade_s: f64,
    },
}

/// Why a list of axes for corrections is rejected.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum CorrectRefusal {
    #[error("found no axis, expected at least one that corrections may move")]
    Empty,
    #[error("axis {axis} appears twice, expected each axis once")]
    Twice {
        /// The axis that is listed twice.
        axis: AxisName,
    },
}
