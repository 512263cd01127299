//! Poses and small motions: rigid transforms, rotation vectors, and screw theory (twists, screws, adjoint,
//! exponential).
//!
//! The notation is that of Murray, Li and Sastry, *A Mathematical Introduction to Robotic Manipulation* (1994), chapter
//! 2, in which the linear part comes first.

use core::ops::{Add, Mul, Neg, Sub};

use nalgebra::{Matrix3, Vector3};

use crate::math::{atan2, sin_cos, sqrt};

/// A transform x ↦ `rotation`·x + `translation_mm`.
///
/// In the `exact` form, `rotation` is orthonormal. In the `htm` form it may be a small-angle matrix I + ε^, whose
/// transpose is not its inverse; use [`Pose::inverse`] only for orthonormal poses.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Pose {
    /// Rotation, applied before the translation; a small-angle matrix in the `htm` form.
    pub rotation: Matrix3<f64>,
    /// Translation, applied after the rotation, mm.
    pub translation_mm: Vector3<f64>,
}

impl Pose {
    pub fn identity() -> Self {
        Self { rotation: Matrix3::identity(), translation_mm: Vector3::zeros() }
    }

    pub fn from_translation(translation_mm: Vector3<f64>) -> Self {
        Self { rotation: Matrix3::identity(), translation_mm }
    }

    /// The transform Trans(c) R Trans(−c): `rotation` about the fixed point `point_mm`.
    pub fn about_point(rotation: Matrix3<f64>, point_mm: Vector3<f64>) -> Self {
        Self { rotation, translation_mm: point_mm - rotation * point_mm }
    }

    /// Image of a point under the pose, mm.
    pub fn transform_point(&self, point_mm: &Vector3<f64>) -> Vector3<f64> {
        self.rotation * point_mm + self.translation_mm
    }

    /// The inverse (Rᵀ, −Rᵀp) of an orthonormal pose.
    #[must_use]
    pub fn inverse(&self) -> Self {
        let transposed = self.rotation.transpose();
        Self { rotation: transposed, translation_mm: -(transposed * self.translation_mm) }
    }
}

impl Mul for Pose {
    type Output = Self;

    fn mul(self, right: Self) -> Self {
        Self {
            rotation: self.rotation * right.rotation,
            translation_mm: self.rotation * right.translation_mm + self.translation_mm,
        }
    }
}

/// The rotation matrix exp(r^) of a rotation vector `r_rad` (Rodrigues' formula).
pub fn rotation_from_vector(r_rad: &Vector3<f64>) -> Matrix3<f64> {
    let (sine_quotient, cosine_quotient) = rotation_quotients(r_rad.norm_squared());
    let hat = r_rad.cross_matrix();
    Matrix3::identity() + hat * sine_quotient + hat * hat * cosine_quotient
}

/// The quotients sin θ/θ and (1 − cos θ)/θ² of Rodrigues' formula, computed from θ² in rad².
#[inline]
pub(crate) fn rotation_quotients(angle_squared: f64) -> (f64, f64) {
    // Below 1e-4 rad the closed formulas lose digits; two terms of the series are exact there.
    if angle_squared < 1e-8 {
        (1.0 - angle_squared / 6.0, 0.5 - angle_squared / 24.0)
    } else {
        let angle = sqrt(angle_squared);
        let (sin, cos) = sin_cos(angle);
        (sin / angle, (1.0 - cos) / angle_squared)
    }
}

/// The rotation matrix for a rotation about the unit vector `axis` by `angle_rad`.
pub fn rotation_about_axis(axis: &Vector3<f64>, angle_rad: f64) -> Matrix3<f64> {
    let (sin, cos) = sin_cos(angle_rad);
    rotation_from_sin_cos(axis, sin, cos)
}

/// The rotation matrix for a rotation about the unit vector `axis` by an angle with this sine and cosine.
#[expect(clippy::inline_always, reason = "measured: the twist form takes a fifth less")]
#[inline(always)]
pub(crate) fn rotation_from_sin_cos(axis: &Vector3<f64>, sin: f64, cos: f64) -> Matrix3<f64> {
    let s = axis * sin;
    let v = axis * (1.0 - cos);
    Matrix3::new(
        cos + v.x * axis.x,
        v.x * axis.y - s.z,
        v.x * axis.z + s.y,
        v.y * axis.x + s.z,
        cos + v.y * axis.y,
        v.y * axis.z - s.x,
        v.z * axis.x - s.y,
        v.z * axis.y + s.x,
        cos + v.z * axis.z,
    )
}

/// The small-angle rotation matrix I + r^.
pub fn small_rotation(r_rad: &Vector3<f64>) -> Matrix3<f64> {
    Matrix3::new(
        1.0, -r_rad.z, r_rad.y, //
        r_rad.z, 1.0, -r_rad.x, //
        -r_rad.y, r_rad.x, 1.0,
    )
}

/// ½(R − Rᵀ)^∨: for a rotation sin θ times its axis, for a small-angle matrix the rotation vector.
pub fn skew_part(rotation: &Matrix3<f64>) -> Vector3<f64> {
    Vector3::new(
        rotation[(2, 1)] - rotation[(1, 2)],
        rotation[(0, 2)] - rotation[(2, 0)],
        rotation[(1, 0)] - rotation[(0, 1)],
    ) * 0.5
}

/// The rotation vector of a rotation matrix, rad; its length is from 0 to π.
///
/// Small angles have full precision; the arc cosine of the trace would lose half of the digits.
pub fn vector_from_rotation(rotation: &Matrix3<f64>) -> Vector3<f64> {
    let skew = skew_part(rotation);
    let sin = skew.norm();
    let cos = 0.5 * (rotation.trace() - 1.0);
    let angle = atan2(sin, cos);
    if sin < 1e-7 && cos < 0.0 {
        return axis_of_half_turn(rotation) * angle;
    }
    // θ/sin θ = 1 + θ²/6 + …; below 1e-8 rad the second term is below rounding.
    let scale = if sin < 1e-8 { 1.0 } else { angle / sin };
    skew * scale
}

/// The axis of a rotation by about π: the column of R + I with the largest diagonal element, normalised.
fn axis_of_half_turn(rotation: &Matrix3<f64>) -> Vector3<f64> {
    let symmetric = (rotation + rotation.transpose()) * 0.5 + Matrix3::identity();
    let largest = symmetric.diagonal().imax();
    let axis = symmetric.column(largest).normalize();
    let skew = skew_part(rotation);
    if axis.dot(&skew) < 0.0 { -axis } else { axis }
}

/// A twist: an infinitesimal rigid motion, or the constant velocity of a screw motion.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Twist {
    /// Displacement of the point at the origin of the frame, mm.
    pub linear_mm: Vector3<f64>,
    /// Rotation vector, rad.
    pub angular_rad: Vector3<f64>,
}

/// Screw of a joint: a translation, or a rotation about a line with advance along this line.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Screw {
    /// A translation along a unit direction, without rotation.
    Prismatic {
        /// Unit direction of the joint, in MCS.
        direction: Vector3<f64>,
    },
    /// A rotation about a line, with advance along this line if the pitch is not 0.
    Revolute {
        /// Unit direction of the line.
        direction: Vector3<f64>,
        /// Any point on the line, mm.
        point_mm: Vector3<f64>,
        /// Advance along the line, mm per rad.
        pitch_mm: f64,
    },
}

impl Twist {
    pub fn zero() -> Self {
        Self { linear_mm: Vector3::zeros(), angular_rad: Vector3::zeros() }
    }

    /// The twist of a motion that displaces the point `point_mm` by `displacement_mm` and rotates by `rotation_rad`,
    /// for example an error motion that is stated at a point.
    pub fn at_point(
        displacement_mm: Vector3<f64>,
        rotation_rad: Vector3<f64>,
        point_mm: &Vector3<f64>,
    ) -> Self {
        Self {
            linear_mm: displacement_mm - rotation_rad.cross(point_mm),
            angular_rad: rotation_rad,
        }
    }

    /// Displacement of a point by this twist to first order, mm: v + ω × p.
    pub fn displacement_mm(&self, point_mm: &Vector3<f64>) -> Vector3<f64> {
        self.linear_mm + self.angular_rad.cross(point_mm)
    }

    /// The adjoint: the same motion expressed in the frame into which `pose` maps, ω′ = Rω, v′ = Rv + p × Rω.
    #[must_use]
    pub fn adjoint(&self, pose: &Pose) -> Self {
        let angular_rad = pose.rotation * self.angular_rad;
        Self {
            linear_mm: pose.rotation * self.linear_mm + pose.translation_mm.cross(&angular_rad),
            angular_rad,
        }
    }

    /// The Lie bracket `[self, other]`: linear part ω₁ × v₂ − ω₂ × v₁, angular part ω₁ × ω₂.
    #[must_use]
    pub fn bracket(&self, other: &Self) -> Self {
        Self {
            linear_mm: self.angular_rad.cross(&other.linear_mm)
                - other.angular_rad.cross(&self.linear_mm),
            angular_rad: self.angular_rad.cross(&other.angular_rad),
        }
    }

    /// The exponential: the pose that this twist reaches in unit time.
    pub fn exp(&self) -> Pose {
        Pose {
            rotation: rotation_from_vector(&self.angular_rad),
            translation_mm: left_jacobian(&self.angular_rad) * self.linear_mm,
        }
    }

    /// The twist whose exponential is `pose`; its rotation is below π.
    ///
    /// `None` for a rotation by π, for which two twists exist.
    pub fn log(pose: &Pose) -> Option<Self> {
        let angular_rad = vector_from_rotation(&pose.rotation);
        if (angular_rad.norm() - core::f64::consts::PI).abs() < 1e-9 {
            return None;
        }
        let inverse = left_jacobian(&angular_rad).try_inverse()?;
        Some(Self { linear_mm: inverse * pose.translation_mm, angular_rad })
    }
}

impl Screw {
    /// The twist of this screw for one unit (mm or rad) of the joint coordinate.
    pub fn twist(&self) -> Twist {
        match *self {
            Self::Prismatic { direction } => {
                Twist { linear_mm: direction, angular_rad: Vector3::zeros() }
            }
            Self::Revolute { direction, point_mm, pitch_mm } => {
                Twist::at_point(direction * pitch_mm, direction, &point_mm)
            }
        }
    }
}

/// The matrix V in exp(v, ω) = (exp(ω^), V·v): the integral of exp(s·ω^) over s from 0 to 1.
fn left_jacobian(r_rad: &Vector3<f64>) -> Matrix3<f64> {
    let angle_squared = r_rad.norm_squared();
    // Below 1e-2 rad, (θ − sin θ)/θ³ loses digits by cancellation, and the error of this series is below 1e-16.
    let (first, second) = if angle_squared < 1e-4 {
        (
            0.5 - angle_squared / 24.0 * (1.0 - angle_squared / 30.0),
            1.0 / 6.0 - angle_squared / 120.0 * (1.0 - angle_squared / 42.0),
        )
    } else {
        let angle = sqrt(angle_squared);
        let (sin, cos) = crate::math::sin_cos(angle);
        ((1.0 - cos) / angle_squared, (angle - sin) / (angle_squared * angle))
    };
    let hat = r_rad.cross_matrix();
    Matrix3::identity() + hat * first + hat * hat * second
}

impl Add for Twist {
    type Output = Self;
    fn add(self, other: Self) -> Self {
        Self {
            linear_mm: self.linear_mm + other.linear_mm,
            angular_rad: self.angular_rad + other.angular_rad,
        }
    }
}

impl Sub for Twist {
    type Output = Self;
    fn sub(self, other: Self) -> Self {
        self + -other
    }
}

impl Neg for Twist {
    type Output = Self;
    fn neg(self) -> Self {
        self * -1.0
    }
}

impl Mul<f64> for Twist {
    type Output = Self;
    fn mul(self, factor: f64) -> Self {
        Self { linear_mm: self.linear_mm * factor, angular_rad: self.angular_rad * factor }
    }
}
