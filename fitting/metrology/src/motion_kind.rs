//! The kind of an error motion with respect to its axis: positioning, straightness, or a rotation.

use volcomp_vocabulary::{AxisKind, ErrorName};

/// The kind of an error motion with respect to its axis, which decides how it is measured and which reference is
/// removed from its readings.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum MotionKind {
    /// The deviation of the coordinate itself: EXX of a linear axis, ECC of a rotary one.
    Positioning,
    /// A deviation of a linear axis across its direction: EYX.
    Straightness,
    /// An angular error of a linear axis (EAX), or any error of a rotary axis but its positioning (EXC, EAC).
    Other,
}

impl MotionKind {
    /// The kind of an error motion; the component of a location error is taken as that of a motion.
    pub fn of(error: ErrorName) -> Self {
        let own = error.component.mcs_index() == error.axis.mcs_index();
        match (error.axis.kind(), error.component.is_angular()) {
            (AxisKind::Linear, false) | (AxisKind::Rotary, true) if own => Self::Positioning,
            (AxisKind::Linear, false) => Self::Straightness,
            _ => Self::Other,
        }
    }
}
