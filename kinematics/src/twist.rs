//! Screw theory: twists, screws, the adjoint and the exponential.
//!
//! After Murray, Li and Sastry, *A Mathematical Introduction to Robotic Manipulation* (1994), chapter 2; the linear part comes first.

use core::ops::{Add, Mul, Neg, Sub};

use nalgebra::{Matrix3, Vector3};

use crate::{
    math::sqrt,
    pose::{Pose, rotation_from_vector, vector_from_rotation},
};

/// A twist: an infinitesimal or scaled rigid motion.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Twist {
    /// Motion of the point that coincides with the origin of the frame, mm.
    pub linear_mm: Vector3<f64>,
    /// Rotation vector of the twist, rad.
    pub angular_rad: Vector3<f64>,
}

/// The screw of a joint: a translation, or a rotation about a line with an advance along it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Screw {
    /// A translation along a unit direction, without rotation.
    Prismatic {
        /// Unit direction of the joint, in MCS.
        direction: Vector3<f64>,
    },
    /// A rotation about a line.
    Revolute {
        /// Unit direction of the line.
        direction: Vector3<f64>,
        /// Any point of the line, mm.
        point_mm: Vector3<f64>,
        /// Advance, mm per rad.
        pitch_mm: f64,
    },
}

impl Twist {
    /// The zero twist.
    pub fn zero() -> Self {
        Self { linear_mm: Vector3::zeros(), angular_rad: Vector3::zeros() }
    }

    /// The twist of a motion that displaces `point_mm` by `displacement_mm` while it rotates by `rotation_rad`: the contribution of an
    /// error motion stated at a point.
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

    /// The displacement that this twist gives to a point, mm, to first order: v + ω × p.
    pub fn displacement_mm(&self, point_mm: &Vector3<f64>) -> Vector3<f64> {
        self.linear_mm + self.angular_rad.cross(point_mm)
    }

    /// The adjoint action of a pose: the same motion expressed in the frame that `pose` maps into, ω′ = Rω, v′ = Rv + p × Rω.
    #[must_use]
    pub fn adjoint(&self, pose: &Pose) -> Self {
        let angular_rad = pose.rotation * self.angular_rad;
        Self {
            linear_mm: pose.rotation * self.linear_mm + pose.translation_mm.cross(&angular_rad),
            angular_rad,
        }
    }

    /// The Lie bracket `[self, other]`.
    #[must_use]
    pub fn bracket(&self, other: &Self) -> Self {
        Self {
            linear_mm: self.angular_rad.cross(&other.linear_mm)
                - other.angular_rad.cross(&self.linear_mm),
            angular_rad: self.angular_rad.cross(&other.angular_rad),
        }
    }

    /// The exponential: the pose reached by this twist in unit time.
    pub fn exp(&self) -> Pose {
        Pose {
            rotation: rotation_from_vector(&self.angular_rad),
            translation_mm: left_jacobian(&self.angular_rad) * self.linear_mm,
        }
    }

    /// The twist whose exponential is `pose`, for rotations below π.
    ///
    /// `None` for a rotation by π, where the logarithm has two values.
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
    /// The twist of this screw for one unit of its coordinate.
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

/// (1/θ)∫exp: the matrix V with exp(v, ω) = (exp(ω^), V v).
fn left_jacobian(r_rad: &Vector3<f64>) -> Matrix3<f64> {
    let angle_squared = r_rad.norm_squared();
    // Series below 1e-2 rad, where (θ − sin θ)/θ³ cancels; the next term is below 1e-16.
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
