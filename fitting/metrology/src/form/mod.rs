//! Form, position and coaxiality of a feature measured point by point: circle, line, plane, cylinder, cone.
//!
//! [`evaluate_form`] lays the feature of least squared distances through points (distances at right angles to it) and
//! states the form deviation about it: the range of the distances from it. Of the circle, the plane and the line in a plane
//! it gives the minimum zone too, the narrowest ring, layer or strip that holds all points. The terms are those of
//! ISO 1101 and, for roundness, straightness, flatness and cylindricity, of ISO 12181, 12780, 12781 and 12180. No filter is
//! applied.
//!
//! Points are in mm in any frame; answers are in mm and rad in the same frame.

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

/// The largest coordinate that is evaluated, mm.
pub const LARGEST_MM: f64 = 1e9;

/// A feature, and how it is evaluated.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum Feature {
    /// A circle: roundness by least squares (LSC) and by the minimum zone (MZC).
    Circle {
        /// The plane that the circle is parallel to; `None`: the least-squares plane of the points.
        plane: Option<CoordinatePlane>,
    },
    /// A line: straightness.
    Line {
        /// The plane in which straightness is evaluated, by least squares and the minimum zone; `None`: in space, as the
        /// diameter of the cylinder about the least-squares line that holds all points.
        plane: Option<CoordinatePlane>,
    },
    /// A plane: flatness by least squares and by the minimum zone.
    Plane,
    /// A cylinder: cylindricity by least squares.
    Cylinder,
    /// A cone: form deviation by least squares.
    Cone,
}

/// The kind of a [`Feature`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum FeatureKind {
    /// A circle.
    Circle,
    /// A straight line.
    Line,
    /// A plane.
    Plane,
    /// A cylinder.
    Cylinder,
    /// A cone.
    Cone,
}

impl FeatureKind {
    /// The smallest number of different points that is evaluated: one more than determine the feature.
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

/// A plane of two coordinates.
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
    /// The unit vector at right angles to the plane.
    pub const fn normal(self) -> [f64; 3] {
        match self {
            Self::Xy => [0.0, 0.0, 1.0],
            Self::Yz => [1.0, 0.0, 0.0],
            Self::Zx => [0.0, 1.0, 0.0],
        }
    }
}

/// A feature as it was measured.
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Form {
    /// The feature.
    pub feature: FeatureKind,
    /// The number of points.
    pub points: usize,
    /// Centre of the circle, apex of the cone, mean of the points of a plane; of a line or cylinder the middle of its axis
    /// over the extent of the points. mm.
    pub position_mm: [f64; 3],
    /// Unit vector: along the line or the axis, at right angles to the plane or the plane of the circle. Of a cone it goes
    /// from the apex into the cone; of all others its largest component is positive.
    pub direction: [f64; 3],
    /// Radius of the circle or cylinder, mm.
    pub radius_mm: Option<f64>,
    /// Half of the angle at the apex of the cone, rad.
    pub half_angle_rad: Option<f64>,
    /// The axis over the extent of the points: the centre of a circle, the line itself; `None` for a plane.
    pub axis: Option<Axis>,
    /// Form deviation about the feature of least squares, mm: the range of the distances from it. Of a line in space the
    /// diameter of the cylinder about it that holds all points.
    pub deviation_mm: f64,
    /// Root mean square of the distances from the feature of least squares, mm.
    pub rms_mm: f64,
    /// Of a circle, or a line in a plane: the range of the points at right angles to that plane, which is not part of the
    /// deviation. mm.
    pub out_of_plane_mm: Option<f64>,
    /// The minimum zone of a circle, a plane or a line in a plane; `None` for others, and for a circle where the narrowest
    /// ring becomes a straight strip, as it does for short arcs.
    pub minimum_zone: Option<MinimumZone>,
}

/// The narrowest zone that holds all points: a ring, a layer between two planes, a strip between two lines.
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct MinimumZone {
    /// Its width, mm: roundness, flatness or straightness.
    pub deviation_mm: f64,
    /// The centre of the ring, or a point in the middle of the layer or strip, mm.
    pub position_mm: [f64; 3],
    /// At right angles to the ring or layer, along the strip.
    pub direction: [f64; 3],
    /// Inner and outer radius of the ring, mm.
    pub radii_mm: Option<[f64; 2]>,
    /// The points (from 0) on both borders that hold the zone from becoming narrower.
    pub contacts: Vec<usize>,
}

/// A piece of an axis.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Axis {
    /// Its two ends, mm; the same point twice for the centre of a circle.
    pub ends_mm: [[f64; 3]; 2],
}

impl Axis {
    fn point(point_mm: [f64; 3]) -> Self {
        Self {
            ends_mm: [point_mm; 2],
        }
    }

    /// The length of the piece, mm.
    pub fn length_mm(&self) -> f64 {
        let [from, to] = self.ends_mm.map(Vector3::from);
        (to - from).norm()
    }

    /// The coaxiality deviation from a datum axis (concentricity for the centre of a circle), mm: the diameter of the
    /// cylinder about the datum axis that holds the piece, twice its largest distance from the datum axis.
    pub fn coaxiality_mm(&self, datum: &DatumAxis) -> f64 {
        // The distance from a line is a convex function along another: it is largest at an end.
        let distances = self.ends_mm.map(|end| datum.distance_mm(end));
        2.0 * distances[0].max(distances[1])
    }
}

/// A datum axis, without end.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
pub struct DatumAxis {
    point_mm: [f64; 3],
    direction: [f64; 3],
}

impl DatumAxis {
    /// The axis through a point (mm) in a direction of any length.
    ///
    /// # Errors
    /// The direction is zero, or a number is not finite or a coordinate beyond [`LARGEST_MM`].
    pub fn new(point_mm: [f64; 3], direction: [f64; 3]) -> Result<Self, FormError> {
        let [i, j, k] = direction;
        let largest = Vector3::from(direction).amax();
        let is_point = point_mm.iter().all(|x| x.abs() <= LARGEST_MM);
        if !(largest > 0.0 && largest.is_finite() && is_point) {
            return Err(FormError::Direction { i, j, k });
        }
        // Divided by its largest component first, as squares of tiny or huge numbers are none.
        let unit = (Vector3::from(direction) / largest).normalize();
        Ok(Self {
            point_mm,
            direction: unit.into(),
        })
    }

    /// The distance of a point from the axis, mm.
    pub fn distance_mm(&self, point_mm: [f64; 3]) -> f64 {
        let from = Vector3::from(point_mm) - Vector3::from(self.point_mm);
        from.cross(&Vector3::from(self.direction)).norm()
    }
}

/// Lays a feature through points in mm.
///
/// # Errors
/// Too few different points ([`FeatureKind::fewest_points`]), coordinates that are not finite or beyond [`LARGEST_MM`],
/// points that do not determine the feature: on one line or in one plane, as high as broad, around no axis.
pub fn evaluate_form(points_mm: &[[f64; 3]], feature: Feature) -> Result<Form, FormError> {
    match feature {
        Feature::Circle { plane } => circle::circle(points_mm, plane),
        Feature::Line { plane } => straight::line(points_mm, plane),
        Feature::Plane => straight::plane(points_mm),
        Feature::Cylinder => conical::cylinder(points_mm),
        Feature::Cone => conical::cone(points_mm),
    }
}
