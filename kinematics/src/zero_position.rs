//! The zero-position model: every joint is given by the line of its axis at machine zero, nominal or actual.
//!
//! Talyan et al. calibrate a five-axis machine with a ball array: the direction cosines and a point of each actual axis are the unknowns.
//! They correspond to the location errors of this crate.

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

/// Why no chain can be built from screws.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum ZeroPositionError {
    /// The number of screws differs from the number of axes.
    #[error("found {found} joints for the structure `{structure}`, expected {expected}")]
    Count {
        /// The requested structure.
        structure: Structure,
        /// Number of screws given.
        found: usize,
        /// Number of axes.
        expected: usize,
    },
    /// A revolute joint for a linear axis, a prismatic one for a rotary axis, or a pitch.
    #[error("axis {axis}: found a {found} joint, expected a {expected} one")]
    Kind {
        /// The axis whose screw does not match.
        axis: AxisName,
        /// The given kind of screw.
        found: &'static str,
        /// The kind of axis that the letter names.
        expected: &'static str,
    },
    /// An invalid direction or point.
    #[error(transparent)]
    Chain(#[from] ChainError),
}

impl Chain {
    /// The chain whose joints are these screws (mm, MCS at machine zero), one for each axis from the
    /// workpiece to the tool; tool and workpiece as in [`Chain::new`].
    ///
    /// # Errors
    /// [`ZeroPositionError`].
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
    /// The location errors (mm, rad) that move this joint's axis to its actual line: ω is the smallest rotation onto the actual direction,
    /// o the vector from `point_mm` to the actual line, normal to it.
    ///
    /// A linear joint has a direction only: o is 0.
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

    /// The actual line of the axis with these location errors (mm, rad).
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

/// The smallest rotation vector that rotates one unit vector onto another; for opposite vectors half a turn about some normal.
fn smallest_turn(from: &Vector3<f64>, onto: &Vector3<f64>) -> Vector3<f64> {
    let normal = from.cross(onto);
    let (sin, cos) = (normal.norm(), from.dot(onto));
    // The arc tangent keeps full precision at small angles, where an arc cosine would lose half of the digits.
    let angle_rad = atan2(sin, cos);
    if sin > 0.0 {
        return normal * (angle_rad / sin);
    }
    let least = from.abs().imin();
    let mut other = Vector3::zeros();
    other[least] = 1.0;
    from.cross(&other).normalize() * angle_rad
}
