//! Why a chain cannot be built, and why it cannot have an error.

use volcomp_vocabulary::{AxisName, ErrorName};

use crate::structure::Structure;

/// Why a chain cannot be built, or cannot have an error.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum ChainError {
    /// The chain has no such axis.
    #[error("the structure `{structure}` has no axis {axis}")]
    NoSuchAxis {
        /// The axis asked for.
        axis: AxisName,
        /// The structure that was searched.
        structure: Structure,
    },
    /// A direction that is zero or not finite.
    #[error("{what} is [{}, {}, {}], expected finite numbers, not all zero", found[0], found[1], found[2])]
    Direction {
        /// Which direction was set: of an axis or of the tool.
        what: &'static str,
        /// The vector that was given.
        found: [f64; 3],
    },
    /// A point that is not finite.
    #[error("{what} is [{}, {}, {}], expected finite numbers", found[0], found[1], found[2])]
    Point {
        /// Which point was set: of an axis, the tool tip or the workpiece origin.
        what: &'static str,
        /// The vector that was given, mm.
        found: [f64; 3],
    },
    /// A value of an error that is NaN or infinite.
    #[error("{error} is {found}, expected a finite number of {}", error.component.symbol())]
    NotFinite {
        /// The error that was to be set.
        error: ErrorName,
        /// The value that was given, µm or µrad.
        found: f64,
    },
    /// A location error that moves nothing.
    #[error("{error} {reason}")]
    NoEffect {
        /// The error that was to be set.
        error: ErrorName,
        /// Why it moves nothing, and what takes its place.
        reason: NoEffect,
    },
}

/// Why a location error of an axis moves nothing.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum NoEffect {
    /// A location offset of a linear axis moves nothing.
    #[error("has no effect; put a zero offset into the constant of {constant}")]
    OffsetOfLinearAxis {
        /// The error motion whose constant means the same.
        constant: ErrorName,
    },
    /// A location error along a rotary axis, or about it, moves nothing.
    #[error(
        "lies along the axis itself and has no effect; put a zero offset into the constant of {constant}"
    )]
    AlongRotaryAxis {
        /// The error motion whose constant means the same.
        constant: ErrorName,
    },
    /// A tilt of a linear axis about itself moves nothing.
    #[error(
        "turns the axis about itself and has no effect; put a zero offset into the constant of {constant}"
    )]
    AboutLinearAxis {
        /// The error motion whose constant means the same.
        constant: ErrorName,
    },
}
