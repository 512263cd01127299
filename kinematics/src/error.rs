//! Why a chain cannot be built.

use volcomp_vocabulary::AxisName;

use crate::structure::Structure;

/// Why a chain cannot be built.
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
}
