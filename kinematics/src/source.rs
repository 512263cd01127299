//! State of a chain, and the interface that supplies the errors of its axes.

use nalgebra::Vector3;

use volcomp_vocabulary::{Direction, PerAxis};

/// Coordinates and directions of approach of all axes of a chain, in the order of the chain.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct State {
    /// Commanded coordinates: mm for linear axes, rad for rotary axes. Entries beyond the last axis are 0.
    pub q: PerAxis<f64>,
    /// Direction of the last travel of each axis, which selects the branch of a bidirectional curve. `None` is an
    /// unknown direction, for which the mean of both branches applies.
    pub approach: PerAxis<Option<Direction>>,
}

/// Three translations along and three rotations about the axes of the MCS.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct ErrorMotion {
    /// Translations δ = (EXN, EYN, EZN), mm.
    pub linear_mm: Vector3<f64>,
    /// Rotations ε = (EAN, EBN, ECN), rad.
    pub angular_rad: Vector3<f64>,
}

impl ErrorMotion {
    pub const ZERO: Self =
        Self { linear_mm: Vector3::new(0.0, 0.0, 0.0), angular_rad: Vector3::new(0.0, 0.0, 0.0) };

    /// Converts errors in the order of ISO 230-1 (X, Y, Z, A, B, C): three in µm, then three in µrad.
    pub fn from_um_urad(six: [f64; 6]) -> Self {
        Self {
            linear_mm: Vector3::new(six[0], six[1], six[2]) * 1e-3,
            angular_rad: Vector3::new(six[3], six[4], six[5]) * 1e-6,
        }
    }
}

/// Source of the errors of all axes of a chain, by chain index.
///
/// Signs and frames are those of ISO 230-1 as defined in the crate documentation: an error motion is a motion of the
/// tool side relative to the workpiece side; a location error is the displacement of the physical axis line.
pub trait ErrorSource {
    /// The six error motions `E?N` of an axis at a state, mm and rad, stated at the point of the axis.
    fn error_motion(&self, axis: usize, state: &State) -> ErrorMotion;

    /// The location errors `E?0N` of an axis: offset o (mm) and tilt ω (rad) of its line.
    fn location(&self, _axis: usize) -> ErrorMotion {
        ErrorMotion::ZERO
    }

    /// The assembly errors of an axis: offsets (mm), and angles (rad) about the MCS origin.
    fn assembly(&self, _axis: usize) -> ErrorMotion {
        ErrorMotion::ZERO
    }
}

impl Default for ErrorMotion {
    fn default() -> Self {
        Self::ZERO
    }
}

impl<S: ErrorSource + ?Sized> ErrorSource for &S {
    fn error_motion(&self, axis: usize, state: &State) -> ErrorMotion {
        (**self).error_motion(axis, state)
    }
    fn location(&self, axis: usize) -> ErrorMotion {
        (**self).location(axis)
    }
    fn assembly(&self, axis: usize) -> ErrorMotion {
        (**self).assembly(axis)
    }
}
