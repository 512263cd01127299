//! Points relative to their mean and scaled, so that a large offset or the unit does not reduce the precision.

use nalgebra::{Matrix3, SymmetricEigen, Vector3};

use super::{FeatureKind, FormError, LARGEST_MM};

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
