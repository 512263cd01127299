//! State of a chain, and the interface through which its errors are supplied.

use nalgebra::Vector3;

use volcomp_vocabulary::{Direction, PerAxis};

/// Coordinates of all axes of a chain, in chain order.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct State {
    /// Commanded coordinates: mm for linear axes, rad for rotary ones. Entries beyond the chain are 0.
    pub q: PerAxis<f64>,
    /// The direction of the last travel of each axis; it selects the branch of a bidirectional curve. `None`: unknown, the mean of both branches.
    pub approach: PerAxis<Option<Direction>>,
}

/// Three translations and three rotations along and about the axes of the MCS.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct ErrorMotion {
    /// δ = (EXN, EYN, EZN), mm.
    pub linear_mm: Vector3<f64>,
    /// ε = (EAN, EBN, ECN), rad.
    pub angular_rad: Vector3<f64>,
}

impl ErrorMotion {
    /// No error.
    pub const ZERO: Self =
        Self { linear_mm: Vector3::new(0.0, 0.0, 0.0), angular_rad: Vector3::new(0.0, 0.0, 0.0) };

    /// From three linear errors in µm and three angular errors in µrad, the order of ISO 230-1:
    /// X, Y, Z, A, B, C.
    pub fn from_um_urad(six: [f64; 6]) -> Self {
        Self {
            linear_mm: Vector3::new(six[0], six[1], six[2]) * 1e-3,
            angular_rad: Vector3::new(six[3], six[4], six[5]) * 1e-6,
        }
    }
}

/// The errors of the axes of one chain, by chain index.
///
/// Signs and frames are those of ISO 230-1 as defined in the crate documentation: an error motion is the motion of the tool side relative
/// to the workpiece side; a location error is the physical location of the axis line.
pub trait ErrorSource {
    /// The six error motions `E?N` of an axis at a state (mm, rad), stated at the axis's point.
    fn error_motion(&self, axis: usize, state: &State) -> ErrorMotion;

    /// The location errors `E?0N` of an axis: offset o of its line (mm) and its tilt ω (rad).
    fn location(&self, _axis: usize) -> ErrorMotion {
        ErrorMotion::ZERO
    }

    /// The assembly errors of an axis: offsets (mm) and angles (rad) about the MCS origin.
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
