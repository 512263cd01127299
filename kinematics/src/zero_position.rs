//! The zero-position model: each joint is described by the nominal or actual line of its axis at machine zero.
//!
//! Talyan et al. calibrate a five-axis machine with a ball array. Their unknowns are the direction cosines and a point
//! of each actual axis, which correspond to the location errors of this crate.

use nalgebra::Vector3;

use crate::{
    chain::{Chain, Joint},
    error::ChainError,
    math::atan2,
    pose::rotation_from_vector,
    source::ErrorMotion,
    structure::Structure,
    twist::Screw,
};
use volcomp_vocabulary::{AxisKind, AxisName};

/// Why a chain cannot be built from screws.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum ZeroPositionError {
    /// The number of screws differs from the number of axes.
    #[error("found {found} joints for the structure `{structure}`, expected {expected}")]
    Count {
        structure: Structure,
        /// Number of screws found.
        found: usize,
        /// Number of axes of the structure.
        expected: usize,
    },
    /// A revolute screw for a linear axis, a prismatic screw for a rotary axis, or a screw with a pitch.
    #[error("axis {axis}: found a {found} joint, expected a {expected} one")]
    Kind {
        /// The axis whose screw has the wrong kind.
        axis: AxisName,
        /// Kind of the given screw: `sliding`, `turning` or `helical`.
        found: &'static str,
        /// Kind of screw that the axis letter requires.
        expected: &'static str,
    },
    /// An invalid direction or point.
    #[error(transparent)]
    Chain(#[from] ChainError),
}

impl Chain {
    /// Builds a chain from one screw for each axis (mm, MCS at machine zero), from the workpiece to the tool. Tool and
    /// workpiece are as in [`Chain::new`].
    ///
    /// # Errors
    /// The number or the kind of the screws does not match the structure, or a direction or point is invalid.
    pub fn from_screws(structure: Structure, screws: &[Screw]) -> Result<Self, ZeroPositionError> {
        let axes = structure.axes().len();
        if screws.len() != axes {
            return Err(ZeroPositionError::Count {
                structure,
                found: screws.len(),
                expected: axes,
            });
        }
        let mut chain = Self::new(structure.clone());
        for (&axis, screw) in structure.axes().iter().zip(screws) {
            match (axis.kind(), screw) {
                (AxisKind::Linear, Screw::Prismatic { direction }) => {
                    chain.set_direction(axis, (*direction).into())?;
                }
                (AxisKind::Rotary, Screw::Revolute { direction, point_mm, pitch_mm: 0.0 }) => {
                    chain.set_direction(axis, (*direction).into())?;
                    chain.set_point(axis, (*point_mm).into())?;
                }
                (kind, screw) => {
                    return Err(ZeroPositionError::Kind {
                        axis,
                        found: screw_kind(screw),
                        expected: match kind {
                            AxisKind::Linear => "sliding",
                            AxisKind::Rotary => "turning",
                        },
                    });
                }
            }
        }
        Ok(chain)
    }

    /// The screws of the joints, mm in MCS at machine zero, from the workpiece to the tool.
    pub fn screws(&self) -> impl Iterator<Item = Screw> + '_ {
        self.joints().iter().map(Joint::screw)
    }
}

fn screw_kind(screw: &Screw) -> &'static str {
    match screw {
        Screw::Prismatic { .. } => "sliding",
        Screw::Revolute { pitch_mm: 0.0, .. } => "turning",
        Screw::Revolute { .. } => "helical",
    }
}

impl Joint {
    /// Location errors (mm, rad) that move the axis of this joint to its actual line. The tilt ω is the smallest
    /// rotation onto the actual direction; the offset o is normal to the actual line and leads from `point_mm` to this
    /// line.
    ///
    /// For a linear joint, which has a direction but no line, o is 0.
    pub fn location_of(&self, real: &Screw) -> ErrorMotion {
        let (direction, point) = match real {
            Screw::Prismatic { direction } => (direction, self.point_mm),
            Screw::Revolute { direction, point_mm, .. } => (direction, *point_mm),
        };
        let along = direction.normalize();
        let offset = point - self.point_mm;
        ErrorMotion {
            linear_mm: offset - along * along.dot(&offset),
            angular_rad: smallest_turn(&self.direction, &along),
        }
    }

    /// The actual screw of the axis with these location errors (mm, rad).
    pub fn real_screw(&self, location: &ErrorMotion) -> Screw {
        let direction = rotation_from_vector(&location.angular_rad) * self.direction;
        match self.kind {
            AxisKind::Linear => Screw::Prismatic { direction },
            AxisKind::Rotary => Screw::Revolute {
                direction,
                point_mm: self.point_mm + location.linear_mm,
                pitch_mm: 0.0,
            },
        }
    }
}

/// The smallest rotation vector (rad) that rotates one unit vector onto another. For opposite vectors it is half a turn
/// about an arbitrary normal.
fn smallest_turn(from: &Vector3<f64>, onto: &Vector3<f64>) -> Vector3<f64> {
    let normal = from.cross(onto);
    let (sin, cos) = (normal.norm(), from.dot(onto));
    // The arc tangent has full precision at small angles; an arc cosine would lose half of the digits.
    let angle_rad = atan2(sin, cos);
    if sin > 0.0 {
        return normal * (angle_rad / sin);
    }
    let least = from.abs().imin();
    let mut other = Vector3::zeros();
    other[least] = 1.0;
    from.cross(&other).normalize() * angle_rad
}
