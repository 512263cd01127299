//! Circles: least-squares circle and minimum zone.

use nalgebra::{SVector, Vector2, Vector3};

use super::{
    Axis, CoordinatePlane, FeatureKind, Form, FormError, MinimumZone,
    cloud::{Cloud, across, rms, signed},
    minimax::{Minimax, minimax},
    refine::{Shape, refine},
};
use crate::number::range;

const FEATURE: FeatureKind = FeatureKind::Circle;
const EXPECTED: &str = "points along an arc of a circle";

/// Maximum radius relative to the extent of the points. Above it the arc counts as a straight line.
const LARGEST_RADIUS: f64 = 1e6;

/// Circle in the plane of the first two coordinates.
#[derive(Clone, Copy)]
pub(super) struct FlatCircle {
    pub(super) centre: Vector2<f64>,
    pub(super) radius: f64,
}

impl FlatCircle {
    /// Circle from the linear least-squares problem x² + y² − 2 a x − 2 b y − c, which is near the circle of
    /// least-squares distances; `None` if the points are on a line.
    pub(super) fn algebraic(points: &[Vector3<f64>]) -> Option<Self> {
        let n = points.len() as f64;
        let mean = points.iter().map(Vector3::xy).sum::<Vector2<f64>>() / n;
        let mut matrix = nalgebra::Matrix2::zeros();
        let mut right = Vector2::zeros();
        let mut squares = 0.0;
        for point in points {
            let p = point.xy() - mean;
            matrix += p * p.transpose();
            right += p * (0.5 * p.norm_squared());
            squares += p.norm_squared();
        }
        if matrix.determinant() <= 1e-14 * squares * squares {
            return None;
        }
        let from_mean = matrix.lu().solve(&right)?;
        Some(Self {
            centre: mean + from_mean,
            radius: (from_mean.norm_squared() + squares / n).sqrt(),
        })
    }
}

impl Shape<3> for FlatCircle {
    fn distance(&self, point: &Vector3<f64>) -> (f64, SVector<f64, 3>) {
        let from_centre = point.xy() - self.centre;
        let r = from_centre.norm();
        let u = if r > 0.0 { from_centre / r } else { from_centre };
        (r - self.radius, SVector::from([-u.x, -u.y, -1.0]))
    }

    fn moved(&self, by: &SVector<f64, 3>) -> Self {
        Self { centre: self.centre + by.xy(), radius: self.radius + by.z }
    }
}

pub(super) fn circle(
    points_mm: &[[f64; 3]],
    plane: Option<CoordinatePlane>,
) -> Result<Form, FormError> {
    let cloud = Cloud::of(points_mm, FEATURE)?;
    cloud.refuse_line(FEATURE, EXPECTED)?;
    let refused =
        |found: String| FormError::NotDetermined { feature: FEATURE, found, expected: EXPECTED };
    let normal = match plane {
        Some(plane) => plane.normal().into(),
        None if cloud.extents[2] > 0.5 * cloud.extents[1] => {
            return Err(refused("points that do not lie near a plane".into()));
        }
        None => signed(cloud.directions[2]),
    };
    let [e1, e2] = across(normal);
    let flat: Vec<Vector3<f64>> = (cloud.points.iter())
        .map(|p| Vector3::new(p.dot(&e1), p.dot(&e2), p.dot(&normal)))
        .collect();
    let on_a_line = || refused("points on one straight line in the plane of the circle".into());
    let start = FlatCircle::algebraic(&flat).ok_or_else(on_a_line)?;
    let fit = refine(start, &flat, 200);
    let found = fit.shape;
    let is_bent = found.radius.abs() < LARGEST_RADIUS && fit.determined > 1e-9;
    if !is_bent {
        return Err(on_a_line());
    }
    if !fit.has_settled() {
        return Err(refused("points through which no circle is the best".into()));
    }
    let back = |centre: Vector2<f64>| cloud.in_mm(e1 * centre.x + e2 * centre.y);
    let distances = || flat.iter().map(|p| found.distance(p).0);
    let [low, high] = range(distances());
    let [below, above] = range(flat.iter().map(|p| p.z));
    let ring = ring(&flat, found.centre);
    Ok(Form {
        feature: FEATURE,
        points: points_mm.len(),
        position_mm: back(found.centre),
        direction: normal.into(),
        radius_mm: Some(found.radius * cloud.scale_mm),
        half_angle_rad: None,
        axis: Some(Axis::point(back(found.centre))),
        deviation_mm: (high - low) * cloud.scale_mm,
        rms_mm: rms(distances()) * cloud.scale_mm,
        out_of_plane_mm: Some((above - below) * cloud.scale_mm),
        minimum_zone: ring.map(|ring| MinimumZone {
            deviation_mm: (ring.radii[1] - ring.radii[0]) * cloud.scale_mm,
            position_mm: back(ring.centre),
            direction: normal.into(),
            radii_mm: Some(ring.radii.map(|radius| radius * cloud.scale_mm)),
            contacts: ring.contacts,
        }),
    })
}

struct Ring {
    centre: Vector2<f64>,
    radii: [f64; 2],
    /// Indices of the points on both circles that prevent the ring from becoming narrower.
    contacts: Vec<usize>,
}

/// Narrowest ring between two concentric circles that encloses all points; `None` if the ring becomes a straight strip.
/// It is found by a sequence of linear minimax problems. The first is about the least-squares centre, each next one
/// about the previous solution.
///
/// The search stops when a linear problem gives no improvement. The weights of its contact points then prove that no
/// small motion of the centre makes the ring narrower. Because distances are convex functions of the centre, the centre
/// of another narrowest ring could only be far away, by a considerable part of the radius.
fn ring(points: &[Vector3<f64>], start: Vector2<f64>) -> Option<Ring> {
    let radii_about = |centre: Vector2<f64>| range(points.iter().map(|p| (p.xy() - centre).norm()));
    let width_about = |centre: Vector2<f64>| {
        let [inner, outer] = radii_about(centre);
        outer - inner
    };
    let mut centre = start;
    let mut width = width_about(centre);
    let mut found: Option<Minimax> = None;
    for _ in 0..200 {
        let [inner, outer] = radii_about(centre);
        let middle = 0.5 * (inner + outer);
        let (mut rows, mut b) = (Vec::new(), Vec::new());
        for point in points {
            let from_centre = point.xy() - centre;
            let r = from_centre.norm();
            // If a point is at the centre, its direction is undefined.
            let u = if r > 0.0 { from_centre / r } else { from_centre };
            rows.push(Vector3::new(1.0, u.x, u.y));
            b.push(r - middle);
        }
        let rounding = 4e-15 * outer.max(1.0);
        let linear = minimax(&rows, &b, rounding)?;
        let gain = width - 2.0 * linear.largest;
        let step = linear.x.yz();
        found = Some(linear);
        if gain <= 4.0 * rounding {
            break;
        }
        // Shorten the step towards the linear optimum until the true ring is narrower.
        let mut share = f64::min(1.0, 0.5 * middle / step.norm());
        let better = loop {
            let there = centre + step * share;
            let width_there = width_about(there);
            if width_there < width {
                break Some((there, width_there));
            }
            share *= 0.5;
            if share < 1e-12 {
                break None;
            }
        };
        let Some(better) = better else { break };
        (centre, width) = better;
        if outer > LARGEST_RADIUS {
            return None;
        }
    }
    let touching = found?.contacts.into_iter().filter(|c| c.weight > 1e-9);
    let mut contacts: Vec<usize> = touching.map(|contact| contact.row).collect();
    contacts.sort_unstable();
    contacts.dedup();
    Some(Ring { centre, radii: radii_about(centre), contacts })
}
