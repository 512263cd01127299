//! Form, position and coaxiality of a feature that was measured point by point: circle, line, plane, cylinder or cone.
//!
//! [`evaluate_form`] fits the least-squares feature to the points, by their perpendicular distances. The form deviation
//! is the range of these distances. For the circle, the plane and the line in a plane it also gives the minimum zone,
//! which is the narrowest ring, layer or strip that encloses all points. The terms are those of ISO 1101 and, for
//! roundness, straightness, flatness and cylindricity, of ISO 12181, 12780, 12781 and
//! 12180. No filter is applied.
//!
//! Points are in mm, in any frame. Results are in mm and rad, in the same frame.

use nalgebra::{Matrix3, SymmetricEigen, Vector3};
use volcomp_document::{Column, CsvTable};

use crate::MetrologyError;
use crate::unit::{not_read, unit_of};

/// Maximum magnitude of a coordinate, mm.
pub const LARGEST_MM: f64 = 1e9;

/// A feature, with the method of its evaluation.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
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

#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
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
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
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

#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
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
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
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
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
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
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize)]
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
        Feature::Circle { plane } => fit::circle(points_mm, plane),
        Feature::Line { plane } => fit::line(points_mm, plane),
        Feature::Plane => fit::plane(points_mm),
        Feature::Cylinder => fit::cylinder(points_mm),
        Feature::Cone => fit::cone(points_mm),
    }
}

#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum FormError {
    #[error(
        "{feature}: found {found} different points, expected at least {expected}: with fewer every form deviation is zero"
    )]
    TooFew {
        feature: FeatureKind,
        /// Number of distinct points.
        found: usize,
        expected: usize,
    },
    #[error(
        "{feature}: point {number}: found {found} mm, expected finite coordinates of at most {} mm",
        LARGEST_MM
    )]
    Coordinate {
        feature: FeatureKind,
        /// Number of the point, from 1.
        number: usize,
        found: f64,
    },
    /// The arrangement of the points does not determine the feature.
    #[error("{feature}: found {found}, expected {expected}")]
    NotDetermined { feature: FeatureKind, found: String, expected: &'static str },
    #[error(
        "datum axis: found the direction {i},{j},{k}, expected finite numbers that are not all zero"
    )]
    Direction { i: f64, j: f64, k: f64 },
}

#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct FormPoints {
    /// Points in the order of the rows, mm.
    pub points_mm: Vec<[f64; 3]>,
    /// Line of each point in the file, from 1.
    pub lines: Vec<usize>,
    /// Notes on ignored columns.
    pub notes: Vec<String>,
}

const NAMES: [&str; 3] = ["x", "y", "z"];

/// Reads points from CSV text. `name` is the name of the file in messages.
///
/// The header has the columns `x`, `y` and `z` in any order, each alone or followed by the unit mm: `x`, `X mm`, `x
/// [mm]`. Other columns are ignored, with a note. Cells are separated by `,`, `;` or tabs. Unless commas separate the
/// cells, numbers may have a decimal comma.
///
/// # Errors
/// A column is missing, repeated or in another unit; a cell is not a finite number of at most [`LARGEST_MM`]; or there
/// is no row. Messages name the file, the line, the column, what was found and what was expected.
pub fn parse_points(text: &str, name: &str) -> Result<FormPoints, MetrologyError> {
    if text.trim().is_empty() {
        return Err(MetrologyError::Empty {
            file: name.into(),
            expected: "the header `x,y,z` and one point a row, in mm".into(),
        });
    }
    let table = CsvTable::parse(name, text)?;
    let mut columns = Vec::new();
    for wanted in NAMES {
        columns.push(column(&table, wanted)?);
    }
    let mut read = FormPoints { points_mm: Vec::new(), lines: Vec::new(), notes: Vec::new() };
    for row in table.rows() {
        let mut point_mm = [0.0; 3];
        for (coordinate, &column) in point_mm.iter_mut().zip(&columns) {
            let cell = row.cell(column);
            *coordinate = cell.number()?;
            if coordinate.abs() > LARGEST_MM {
                let found = cell.text();
                let message = format!("found `{found}`, expected at most {LARGEST_MM} mm");
                return Err(cell.error(message).into());
            }
        }
        read.points_mm.push(point_mm);
        read.lines.push(row.line());
    }
    if read.points_mm.is_empty() {
        let expected = "found no row under the header, expected one point a row";
        return Err(table.header_error(expected).into());
    }
    let is_read = |column: &Column| columns.contains(column);
    let others: Vec<&str> =
        table.names().filter(|(c, _)| !is_read(c)).map(|(_, name)| name).collect();
    read.notes.extend(not_read(&others));
    Ok(read)
}

fn column(table: &CsvTable, wanted: &str) -> Result<Column, MetrologyError> {
    let mut named =
        table.names().filter_map(|(column, head)| Some((column, head, unit_of(head, wanted)?)));
    let Some((column, head, unit)) = named.next() else {
        let heads: Vec<&str> = table.names().map(|(_, name)| name).collect();
        let message = format!(
            "found `{}`, expected columns x, y and z in mm: `{wanted}` is missing",
            heads.join(&table.separator().to_string())
        );
        return Err(table.header_error(message).into());
    };
    if let Some((_, other, _)) = named.next() {
        let message = format!("found columns `{head}` and `{other}`, expected one for {wanted}");
        return Err(table.header_error(message).into());
    }
    if !unit.is_empty() && !unit.eq_ignore_ascii_case("mm") {
        let message =
            format!("found column `{head}` in {unit}, expected mm: {wanted} or {wanted}_mm");
        return Err(table.header_error(message).into());
    }
    Ok(column)
}

/// Ratio of two principal extents below which the smaller extent is rounding error.
const ROUNDING: f64 = 1e-7;

/// Points minus their mean, divided by a power of two so that their extent is about 1.
pub(super) struct Cloud {
    mean_mm: Vector3<f64>,
    pub(super) scale_mm: f64,
    pub(super) points: Vec<Vector3<f64>>,
    /// Unit vectors of the principal directions, by descending extent.
    pub(super) directions: [Vector3<f64>; 3],
    /// Root mean square extents along the principal directions.
    pub(super) extents: [f64; 3],
}

impl Cloud {
    pub(super) fn of(points_mm: &[[f64; 3]], feature: FeatureKind) -> Result<Self, FormError> {
        for (index, point) in points_mm.iter().enumerate() {
            if let Some(&found) = point.iter().find(|x| x.is_nan() || x.abs() > LARGEST_MM) {
                let number = index + 1;
                return Err(FormError::Coordinate { feature, number, found });
            }
        }
        let (found, expected) = (different(points_mm), feature.fewest_points());
        if found < expected {
            return Err(FormError::TooFew { feature, found, expected });
        }
        // Differences from a nearby point keep the digits that sums of large coordinates would lose.
        let first = Vector3::from(points_mm[0]);
        let n = points_mm.len() as f64;
        let from_first = points_mm.iter().map(|p| Vector3::from(*p) - first);
        let shift = from_first.clone().sum::<Vector3<f64>>() / n;
        let centred: Vec<Vector3<f64>> = from_first.map(|p| p - shift).collect();
        // The points differ, so their extent is positive. Dividing by a power of two is exact.
        let rms = (centred.iter().map(Vector3::norm_squared).sum::<f64>() / n).sqrt();
        let scale_mm = rms.log2().ceil().exp2();
        let points: Vec<Vector3<f64>> = centred.iter().map(|p| p / scale_mm).collect();
        let moments: Matrix3<f64> = points.iter().map(|p| p * p.transpose()).sum();
        let eigen = SymmetricEigen::new(moments / n);
        let mut order = [0, 1, 2];
        order.sort_by(|&a, &b| eigen.eigenvalues[b].total_cmp(&eigen.eigenvalues[a]));
        Ok(Self {
            mean_mm: first + shift,
            scale_mm,
            points,
            directions: order.map(|k| eigen.eigenvectors.column(k).into_owned()),
            extents: order.map(|k| eigen.eigenvalues[k].max(0.0).sqrt()),
        })
    }

    /// Rejects collinear points, which do not determine the requested feature.
    pub(super) fn refuse_line(
        &self,
        feature: FeatureKind,
        expected: &'static str,
    ) -> Result<(), FormError> {
        if self.extents[1] > ROUNDING * self.extents[0] {
            return Ok(());
        }
        Err(FormError::NotDetermined {
            feature,
            found: "points on one straight line".into(),
            expected,
        })
    }

    pub(super) fn refuse_plane(
        &self,
        feature: FeatureKind,
        expected: &'static str,
    ) -> Result<(), FormError> {
        if self.extents[2] > ROUNDING * self.extents[0] {
            return Ok(());
        }
        Err(FormError::NotDetermined { feature, found: "points in one plane".into(), expected })
    }

    /// Converts a scaled point to the frame of the file, mm.
    pub(super) fn in_mm(&self, point: Vector3<f64>) -> [f64; 3] {
        (self.mean_mm + point * self.scale_mm).into()
    }
}

/// Two unit vectors that are perpendicular to the unit vector `w` and to each other, and form a right-handed system
/// with it.
pub(super) fn across(w: Vector3<f64>) -> [Vector3<f64>; 2] {
    let helper = Vector3::ith(w.iamin(), 1.0);
    let first = w.cross(&helper).normalize();
    [first, w.cross(&first)]
}

/// The vector, or its opposite, so that its largest component is positive.
pub(super) fn signed(direction: Vector3<f64>) -> Vector3<f64> {
    let sign = if direction[direction.iamax()] < 0.0 { -1.0 } else { 1.0 };
    // Adding 0 turns −0 into 0.
    direction.map(|x| sign * x + 0.0)
}

pub(super) fn rms(values: impl ExactSizeIterator<Item = f64>) -> f64 {
    let n = values.len() as f64;
    (values.map(|x| x * x).sum::<f64>() / n).sqrt()
}

fn different(points_mm: &[[f64; 3]]) -> usize {
    let mut sorted = points_mm.to_vec();
    sorted.sort_by(|a, b| {
        let by_coordinate = a.iter().zip(b).map(|(x, y)| x.total_cmp(y));
        by_coordinate.fold(std::cmp::Ordering::Equal, std::cmp::Ordering::then)
    });
    sorted.dedup();
    sorted.len()
}
mod fit;
