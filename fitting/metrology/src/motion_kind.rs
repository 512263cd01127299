//! The kind of an error motion with respect to its axis: positioning, straightness, or a rotation.

use volcomp_vocabulary::{AxisKind, ErrorName};

/// Kind of an error motion with respect to its axis. It determines the method of measurement and the reference that is removed from the readings.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum MotionKind {
    /// Deviation of the coordinate itself: EXX of a linear axis, ECC of a rotary one.
    Positioning,
    /// Deviation of a linear axis perpendicular to its direction: EYX.
    Straightness,
    /// Angular error of a linear axis (EAX), or any error of a rotary axis except its positioning (EXC, EAC).
    Other,
}

impl MotionKind {
    /// Kind of an error motion; the component of a location error is treated like that of a motion.
    pub fn of(error: ErrorName) -> Self {
        let own = error.component.mcs_index() == error.axis.mcs_index();
        match (error.axis.kind(), error.component.is_angular()) {
            (AxisKind::Linear, false) | (AxisKind::Rotary, true) if own => Self::Positioning,
            (AxisKind::Linear, false) => Self::Straightness,
            _ => Self::Other,
        }
    }
}
