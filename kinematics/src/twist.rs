//! Screw theory: twists, screws, adjoint and exponential.
//!
//! The notation is that of Murray, Li and Sastry, *A Mathematical Introduction to Robotic Manipulation* (1994), chapter
//! 2, in which the linear part comes first.

use core::ops::{Add, Mul, Neg, Sub};

use nalgebra::{Matrix3, Vector3};

use crate::{
    math::sqrt,
    pose::{Pose, rotation_from_vector, vector_from_rotation},
};

/// A twist: a rigid motion that is infinitesimal or scaled.
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

    /// The Lie bracket `[self, other]`.
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
