use core::fmt;

use volcomp_vocabulary::{AxisName, ErrorName};

use crate::structure::{Side, Structure};

/// Why a chain or one of its error values is invalid.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum ChainError {
    #[error("the structure `{structure}` has no axis {axis}")]
    NoSuchAxis { axis: AxisName, structure: Structure },
    #[error("axis {axis} has no value, expected one for each axis of `{structure}`")]
    AxisMissing { axis: AxisName, structure: Structure },
    #[error("axis {axis} has two values, expected one")]
    AxisTwice { axis: AxisName },
    #[error("{what} is [{}, {}, {}], expected finite numbers, not all zero", found[0], found[1], found[2])]
    Direction { what: &'static str, found: [f64; 3] },
    #[error("{what} is [{}, {}, {}], expected finite numbers", found[0], found[1], found[2])]
    Point {
        what: &'static str,
        /// The rejected vector, mm.
        found: [f64; 3],
    },
    #[error(
        "axis {axis} is linear: its error motions ride with its carriage, expected a rotary axis"
    )]
    MotionFrame { axis: AxisName },
    #[error("{error} is {found}, expected a finite number of {}", error.component.symbol())]
    NotFinite {
        error: ErrorName,
        /// The rejected value, µm or µrad.
        found: f64,
    },
    /// A location error that changes no pose, such as an offset along a rotary axis.
    #[error("{error} {reason}")]
    NoEffect { error: ErrorName, reason: NoEffect },
}

/// Reason why a location error of an axis has no effect. It names the error motion that describes the same deviation by
/// a constant.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum NoEffect {
    /// Offset of a linear axis, which has a direction but no line.
    #[error("has no effect; put a zero offset into {0}")]
    OffsetOfLinearAxis(InsteadConstant),
    /// Offset along a rotary axis, or rotation about it.
    #[error("lies along the axis itself and has no effect; put {} into {}", .0.offset(), .0)]
    AlongRotaryAxis(InsteadConstant),
    /// Rotation of a linear axis about its own direction.
    #[error("turns the axis about itself and has no effect; put a constant roll into {0}")]
    AboutLinearAxis(InsteadConstant),
}

/// Error motion in which to enter a constant instead of a location error without effect.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct InsteadConstant {
    pub error: ErrorName,
    /// The side of the axis. A location error states where the axis lies, an error motion states how the tool moves
    /// relative to the workpiece. The constant therefore has the opposite sign for an axis on the workpiece side.
    pub side: Side,
}

impl InsteadConstant {
    fn offset(self) -> &'static str {
        if self.error.component.is_angular() { "a zero offset" } else { "a shift along it" }
    }
}

impl fmt::Display for InsteadConstant {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { error, side } = self;
        write!(f, "the constant of {error}, ")?;
        match side {
            Side::Tool => f.write_str("with the same sign"),
            Side::Workpiece => {
                write!(f, "with the opposite sign since {} carries the workpiece", error.axis)
            }
        }
    }
}
