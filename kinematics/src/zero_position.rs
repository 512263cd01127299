//! The zero-position model: every joint by the line of its axis at machine zero, nominal or real.
//!
//! Talyan et al., a five-axis machine calibrated with a ball array: direction cosines and a point of
//! each real axis are the unknowns. They are the location errors of this crate.

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

/// Why screws do not make a chain.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum ZeroPositionError {
    /// Not one screw for each axis.
    #[error("found {found} joints for the structure `{structure}`, expected {expected}")]
    Count {
        /// The structure that was asked for.
        structure: Structure,
        /// How many were given.
        found: usize,
        /// How many axes there are.
        expected: usize,
    },
    /// A turning joint for a sliding axis, or the other way round, or a pitch.
    #[error("axis {axis}: found a {found} joint, expected a {expected} one")]
    Kind {
        /// The axis whose screw does not fit.
        axis: AxisName,
        /// The kind of screw that was given.
        found: &'static str,
        /// The kind of axis that its letter stands for.
        expected: &'static str,
    },
    /// A direction or a point that makes no axis.
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
                (
                    AxisKind::Rotary,
                    Screw::Revolute {
                        direction,
                        point_mm,
                        pitch_mm: 0.0,
                    },
                ) => {
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
    /// The location errors (mm, rad) that put this joint's axis where it really is: ω the smallest
    /// rotation onto the real direction, o the way of `point_mm` to the real line, normal to it.
    ///
    /// A sliding joint has a direction only: o is 0.
    pub fn location_of(&self, real: &Screw) -> ErrorMotion {
        let (direction, point) = match real {
            Screw::Prismatic { direction } => (direction, self.point_mm),
            Screw::Revolute {
                direction,
                point_mm,
                ..
            } => (direction, *point_mm),
        };
        let along = direction.normalize();
        let offset = point - self.point_mm;
        ErrorMotion {
            linear_mm: offset - along * along.dot(&offset),
            angular_rad: smallest_turn(&self.direction, &along),
        }
    }

    /// Where the axis really lies with these location errors (mm, rad).
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

/// The smallest rotation vector that turns one unit vector onto another; of opposite ones half a turn
/// about some normal.
fn smallest_turn(from: &Vector3<f64>, onto: &Vector3<f64>) -> Vector3<f64> {
    let normal = from.cross(onto);
    let (sin, cos) = (normal.norm(), from.dot(onto));
    // The arc tangent keeps every digit of small angles, where an arc cosine would lose half of them.
    let angle_rad = atan2(sin, cos);
    if sin > 0.0 {
        return normal * (angle_rad / sin);
    }
    let least = from.abs().imin();
    let mut other = Vector3::zeros();
    other[least] = 1.0;
    from.cross(&other).normalize() * angle_rad
}
