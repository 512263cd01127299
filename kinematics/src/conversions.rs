//! Conversions between a chain and its other descriptions: Denavit–Hartenberg tables, and the zero-position model.
//!
//! Tables are in the distal or the proximal convention. In the zero-position model each joint is described by the
//! nominal or actual line of its axis at machine zero.
//!
//! Talyan et al. calibrate a five-axis machine with a ball array. Their unknowns are the direction cosines and a point
//! of each actual axis, which correspond to the location errors of this crate.

use arrayvec::ArrayVec;
use nalgebra::{Matrix3, Vector3};
use volcomp_vocabulary::{AxisKind, AxisName, MAX_AXES};

use crate::chain::{Chain, ErrorMotion, Joint};
use crate::error::ChainError;
use crate::math::atan2;
use crate::pose::{Pose, Screw, rotation_about_axis, rotation_from_vector};
use crate::structure::Structure;

/// Axes at a smaller angle are treated as parallel, rad. Over 10 m this angle is 1 nm.
const PARALLEL_BELOW_RAD: f64 = 1e-10;

/// The order of the four elementary motions of a row of a Denavit–Hartenberg table.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum DhConvention {
    /// A = `Rot_z(θ)` `Trans_z(d)` `Trans_x(a)` `Rot_x(α)`: joint i rotates about or moves along the z axis of the
    /// frame before row i (Denavit and Hartenberg; Paul).
    #[default]
    Distal,
    /// A = `Rot_x(α)` `Trans_x(a)` `Rot_z(θ)` `Trans_z(d)`, also called modified (Craig): joint i rotates about or
    /// moves along the z axis of the frame after row i. The a and α of row i lead from the previous joint to joint i.
    Proximal,
}

/// One row of a Denavit–Hartenberg table at machine zero. The coordinate of a rotary axis is added to θ, that of a
/// linear axis to d.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct DhRow {
    /// Joint angle θ, rad.
    pub theta_rad: f64,
    /// Link offset d, mm.
    pub d_mm: f64,
    /// Link length a, mm.
    pub a_mm: f64,
    /// Link twist α, rad.
    pub alpha_rad: f64,
}

impl DhRow {
    /// Pose A(q) of the row at coordinate `q`, mm or rad.
    pub fn pose(&self, convention: DhConvention, kind: AxisKind, q: f64) -> Pose {
        let (along_z, along_x) = (self.along_z(kind, q), self.along_x());
        match convention {
            DhConvention::Distal => along_z * along_x,
            DhConvention::Proximal => along_x * along_z,
        }
    }

    /// `Rot_z(θ)` `Trans_z(d)` at coordinate `q`, mm or rad. The two motions commute.
    fn along_z(&self, kind: AxisKind, q: f64) -> Pose {
        let (theta, d_mm) = match kind {
            AxisKind::Linear => (self.theta_rad, self.d_mm + q),
            AxisKind::Rotary => (self.theta_rad + q, self.d_mm),
        };
        Pose {
            rotation: rotation_about_axis(&Vector3::z(), theta),
            translation_mm: Vector3::z() * d_mm,
        }
    }

    /// `Trans_x(a)` `Rot_x(α)`. The two motions commute.
    fn along_x(&self) -> Pose {
        Pose {
            rotation: rotation_about_axis(&Vector3::x(), self.alpha_rad),
            translation_mm: Vector3::x() * self.a_mm,
        }
    }
}

/// A Denavit–Hartenberg table: T(q) = base · Π `A_i(q_i)` · tool, from the workpiece to the tool.
///
/// The pose `tool` maps the last frame back to the MCS, so that T(0) is the identity, as for every chain of this crate.
#[derive(Clone, Debug, PartialEq)]
pub struct DhTable {
    pub convention: DhConvention,
    /// The first frame, in MCS at machine zero. In the distal convention its z axis is the axis of the first joint.
    pub base: Pose,
    /// One row for each axis, from the workpiece to the tool.
    pub rows: ArrayVec<DhRow, MAX_AXES>,
}

impl DhTable {
    /// Pose of the MCS in the last frame at machine zero; see [`DhTable`].
    pub fn tool(&self, structure: &Structure) -> Pose {
        let rows = self.rows.iter().zip(structure.axes());
        rows.fold(self.base, |pose, (row, axis)| pose * row.pose(self.convention, axis.kind(), 0.0))
            .inverse()
    }

    /// This table in another convention. The a and α of each row move to the next or the previous row. The motion
    /// before the first joint becomes part of `base`, the motion after the last joint part of [`DhTable::tool`].
    #[must_use]
    pub fn in_convention(&self, convention: DhConvention) -> Self {
        let mut table = self.clone();
        table.convention = convention;
        let x_of = |row: Option<&DhRow>| row.map_or((0.0, 0.0), |row| (row.a_mm, row.alpha_rad));
        match (self.convention, convention) {
            (DhConvention::Distal, DhConvention::Proximal) => {
                for (place, row) in table.rows.iter_mut().enumerate() {
                    let before = place.checked_sub(1).and_then(|place| self.rows.get(place));
                    (row.a_mm, row.alpha_rad) = x_of(before);
                }
            }
            (DhConvention::Proximal, DhConvention::Distal) => {
                for (place, row) in table.rows.iter_mut().enumerate() {
                    (row.a_mm, row.alpha_rad) = x_of(self.rows.get(place + 1));
                }
                if let Some(first) = self.rows.first() {
                    table.base = self.base * first.along_x();
                }
            }
            _ => {}
        }
        table
    }

    /// The chain that this table describes. The point of a linear axis is the origin of the frame before the axis.
    ///
    /// # Errors
    /// The number of rows differs from the number of axes, or a number is not finite.
    pub fn to_chain(&self, structure: Structure) -> Result<Chain, ZeroPositionError> {
        let axes = structure.axes().len();
        if self.rows.len() != axes {
            return Err(ZeroPositionError::Count {
                structure,
                found: self.rows.len(),
                expected: axes,
            });
        }
        let mut chain = Chain::new(structure.clone());
        let table = self.in_convention(DhConvention::Distal);
        let mut frame = table.base;
        for (&axis, row) in structure.axes().iter().zip(&table.rows) {
            let direction: Vector3<f64> = frame.rotation.column(2).into();
            chain.set_direction(axis, direction.into())?;
            chain.set_point(axis, frame.translation_mm.into())?;
            frame = frame * row.pose(DhConvention::Distal, axis.kind(), 0.0);
        }
        Ok(chain)
    }

    /// The table of a chain, in the distal convention. Points of linear axes are lost: a linear axis has no fixed line
    /// and is placed through the origin of the previous frame.
    pub fn of_chain(chain: &Chain) -> Self {
        let joints = chain.joints();
        let mut base = Pose::identity();
        if let Some(first) = joints.first() {
            base = Pose {
                rotation: frame_along(&first.direction),
                translation_mm: match first.kind {
                    AxisKind::Rotary => first.point_mm,
                    AxisKind::Linear => Vector3::zeros(),
                },
            };
        }
        let mut frame = base;
        let mut rows = ArrayVec::new();
        for (index, joint) in joints.iter().enumerate() {
            let row =
                joints.get(index + 1).map_or_else(DhRow::default, |next| row_towards(&frame, next));
            frame = frame * row.pose(DhConvention::Distal, joint.kind, 0.0);
            rows.push(row);
        }
        Self { convention: DhConvention::Distal, base, rows }
    }
}

/// The row that leads from a frame on one axis to a frame on the next axis, along their common normal.
fn row_towards(frame: &Pose, next: &Joint) -> DhRow {
    // In the coordinates of the frame, the previous joint lies along z through the origin.
    let inverse = frame.inverse();
    let direction = inverse.rotation * next.direction;
    let point = match next.kind {
        AxisKind::Rotary => inverse.transform_point(&next.point_mm),
        AxisKind::Linear => Vector3::zeros(),
    };
    let normal = Vector3::new(-direction.y, direction.x, 0.0);
    let sin_alpha = normal.norm();
    if sin_alpha < PARALLEL_BELOW_RAD {
        let alpha_rad = if direction.z < 0.0 { core::f64::consts::PI } else { 0.0 };
        let across = point.xy().norm();
        let theta_rad = if across > 0.0 { atan2(point.y, point.x) } else { 0.0 };
        return DhRow { theta_rad, d_mm: 0.0, a_mm: across, alpha_rad };
    }
    let normal = normal / sin_alpha;
    let a_mm = normal.dot(&point);
    // Signed distance along the next axis from its point to the foot of the common normal. Projected onto the plane
    // normal to z, this foot is at a·normal.
    let along = -(point - normal * a_mm).dot(&direction.xy().push(0.0)) / (sin_alpha * sin_alpha);
    DhRow {
        theta_rad: atan2(normal.y, normal.x),
        d_mm: point.z + along * direction.z,
        a_mm,
        alpha_rad: atan2(sin_alpha, direction.z),
    }
}

/// Right-handed frame whose third column is the unit direction `z`. For +Z it is the frame of the MCS.
fn frame_along(z: &Vector3<f64>) -> Matrix3<f64> {
    let seed = if z.x.abs() < 0.9 { Vector3::x() } else { Vector3::y() };
    let y = z.cross(&seed).normalize();
    Matrix3::from_columns(&[y.cross(z), y, *z])
}

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
