//! Form, position and coaxiality of a feature that was measured point by point: circle, line, plane, cylinder or cone.
//!
//! [`evaluate_form`] fits the least-squares feature to the points, by their perpendicular distances. The form deviation
//! is the range of these distances. For the circle, the plane and the line in a plane it also gives the minimum zone,
//! which is the narrowest ring, layer or strip that encloses all points. The terms are those of ISO 1101 and, for
//! roundness, straightness, flatness and cylindricity, of ISO 12181, 12780, 12781 and
//! 12180. No filter is applied.
//!
//! Points are in mm, in any frame. Results are in mm and rad, in the same frame.

mod circle;
mod cloud;
mod conical;
mod error;
mod minimax;
mod points;
mod refine;
mod straight;

use nalgebra::Vector3;

pub use error::FormError;
pub use points::{FormPoints, parse_points};

/// Maximum magnitude of a coordinate, mm.
pub const LARGEST_MM: f64 = 1e9;

/// A feature, with the method of its evaluation.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum Feature {
    /// Circle: roundness by least squares (LSC) and by the minimum zone (MZC).
    Circle {
        /// Plane to which the circle is parallel. `None`: the least-squares plane of the points.
        plane: Option<CoordinatePlane>,
    },
    /// Line: straightness.
    Line {
        /// Plane in which straightness is evaluated, by least squares and by the minimum zone. `None`: straightness in
        /// space, which is the diameter of the cylinder about the least-squares line that encloses all points.
        plane: Option<CoordinatePlane>,
    },
    /// Plane: flatness by least squares and by the minimum zone.
    Plane,
    /// Cylinder: cylindricity by least squares.
    Cylinder,
    /// Cone: form deviation by least squares.
    Cone,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum FeatureKind {
    Circle,
    Line,
    Plane,
    Cylinder,
    Cone,
}

impl FeatureKind {
    /// Minimum number of distinct points, which is one more than determines the feature.
    pub const fn fewest_points(self) -> usize {
        match self {
            Self::Line => 3,
            Self::Circle | Self::Plane => 4,
            Self::Cylinder => 6,
            Self::Cone => 7,
        }
    }
}

impl std::fmt::Display for FeatureKind {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::Circle => "circle",
            Self::Line => "line",
            Self::Plane => "plane",
            Self::Cylinder => "cylinder",
            Self::Cone => "cone",
        })
    }
}

/// Plane of two coordinate axes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum CoordinatePlane {
    /// Normal along z.
    Xy,
    /// Normal along x.
    Yz,
    /// Normal along y.
    Zx,
}

impl CoordinatePlane {
    /// Unit normal, along the third axis.
    pub const fn normal(self) -> [f64; 3] {
        match self {
            Self::Xy => [0.0, 0.0, 1.0],
            Self::Yz => [1.0, 0.0, 0.0],
            Self::Zx => [0.0, 1.0, 0.0],
        }
    }
}

#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Form {
    pub feature: FeatureKind,
    pub points: usize,
    /// Position of the feature, mm: the centre of a circle, the apex of a cone, the mean of the points of a plane, or
    /// the middle of the axis of a line or cylinder over the extent of the points.
    pub position_mm: [f64; 3],
    /// Unit vector along the line or axis, or normal to the plane or to the plane of the circle. For a cone it points
    /// from the apex into the cone. For other features its largest component is positive.
    pub direction: [f64; 3],
    /// Radius of a circle or cylinder, mm.
    pub radius_mm: Option<f64>,
    /// Half angle at the apex of the cone, rad.
    pub half_angle_rad: Option<f64>,
    /// Axis of the feature over the extent of the points: the centre of a circle, or the line itself; `None` for a
    /// plane.
    pub axis: Option<Axis>,
    /// Form deviation, mm: the range of the distances from the least-squares feature. For a line in space it is the
    /// diameter of the cylinder about the least-squares line that encloses all points.
    pub deviation_mm: f64,
    /// Root mean square of the distances from the least-squares feature, mm.
    pub rms_mm: f64,
    /// For a circle, or a line in a plane: range of the points perpendicular to that plane, mm. It is not part of the
    /// form deviation.
    pub out_of_plane_mm: Option<f64>,
    /// Minimum zone of a circle, a plane or a line in a plane. `None` for other features, and for a circle whose
    /// narrowest ring becomes a straight strip, which happens for short arcs.
    pub minimum_zone: Option<MinimumZone>,
}

/// Narrowest zone that encloses all points: a ring, a layer between two planes, or a strip between two lines.
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct MinimumZone {
    /// Width of the zone, mm, which is the roundness, flatness or straightness.
    pub deviation_mm: f64,
    /// Centre of the ring, or a point in the middle of the layer or strip, mm.
    pub position_mm: [f64; 3],
    /// Unit vector normal to the ring or layer, or along the strip.
    pub direction: [f64; 3],
    /// Inner and outer radius of the ring, mm.
    pub radii_mm: Option<[f64; 2]>,
    /// Indices, from 0, of the points on both borders that prevent the zone from becoming narrower.
    pub contacts: Vec<usize>,
}

/// Segment of the axis of a feature.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Axis {
    /// The two ends, mm. For a circle both are the centre.
    pub ends_mm: [[f64; 3]; 2],
}

impl Axis {
    fn point(point_mm: [f64; 3]) -> Self {
        Self { ends_mm: [point_mm; 2] }
    }

    /// Length of the segment, mm.
    pub fn length_mm(&self) -> f64 {
        let [from, to] = self.ends_mm.map(Vector3::from);
        (to - from).norm()
    }

    /// Coaxiality deviation from a datum axis (concentricity for the centre of a circle), mm. It is the diameter of the
    /// cylinder about the datum axis that encloses the segment, and so twice the largest distance of the segment from
    /// the datum axis.
    pub fn coaxiality_mm(&self, datum: &DatumAxis) -> f64 {
        // The distance from a line is a convex function along another line, so it is largest at an end.
        let distances = self.ends_mm.map(|end| datum.distance_mm(end));
        2.0 * distances[0].max(distances[1])
    }
}

/// Datum axis, of infinite length.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
pub struct DatumAxis {
    point_mm: [f64; 3],
    direction: [f64; 3],
}

impl DatumAxis {
    /// Creates a datum axis through a point (mm). The length of the direction is ignored.
    ///
    /// # Errors
    /// A direction of zero, a number that is not finite, or a coordinate beyond [`LARGEST_MM`].
    pub fn new(point_mm: [f64; 3], direction: [f64; 3]) -> Result<Self, FormError> {
        let [i, j, k] = direction;
        let largest = Vector3::from(direction).amax();
        let is_point = point_mm.iter().all(|x| x.abs() <= LARGEST_MM);
        if !(largest > 0.0 && largest.is_finite() && is_point) {
            return Err(FormError::Direction { i, j, k });
        }
        // First divide by the largest component, because squares of tiny or huge numbers underflow or overflow.
        let unit = (Vector3::from(direction) / largest).normalize();
        Ok(Self { point_mm, direction: unit.into() })
    }

    /// Distance of a point from the axis, mm.
    pub fn distance_mm(&self, point_mm: [f64; 3]) -> f64 {
        let from = Vector3::from(point_mm) - Vector3::from(self.point_mm);
        from.cross(&Vector3::from(self.direction)).norm()
    }
}

/// Evaluates a feature from points in mm.
///
/// # Errors
/// Too few distinct points ([`FeatureKind::fewest_points`]), coordinates that are not finite or beyond [`LARGEST_MM`],
/// or points that do not determine the feature, for example because they are on one line, in one plane, or not around
/// an axis.
pub fn evaluate_form(points_mm: &[[f64; 3]], feature: Feature) -> Result<Form, FormError> {
    match feature {
        Feature::Circle { plane } => circle::circle(points_mm, plane),
        Feature::Line { plane } => straight::line(points_mm, plane),
        Feature::Plane => straight::plane(points_mm),
        Feature::Cylinder => conical::cylinder(points_mm),
        Feature::Cone => conical::cone(points_mm),
    }
}
