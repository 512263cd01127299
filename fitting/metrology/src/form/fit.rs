//! Fits of circles, lines, planes, cylinders and cones: least squares of the distances, and minimum zones.

use nalgebra::{Matrix4, SMatrix, SVector, Vector2, Vector3, Vector4};

use super::{
    Axis, Cloud, CoordinatePlane, FeatureKind, Form, FormError, MinimumZone, across, rms, signed,
};
use crate::straightness::half_hull;
use crate::text::range;

const CIRCLE: FeatureKind = FeatureKind::Circle;
const ARC_EXPECTED: &str = "points along an arc of a circle";

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
    let cloud = Cloud::of(points_mm, CIRCLE)?;
    cloud.refuse_line(CIRCLE, ARC_EXPECTED)?;
    let refused =
        |found: String| FormError::NotDetermined { feature: CIRCLE, found, expected: ARC_EXPECTED };
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
        feature: CIRCLE,
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

/// Maximum ratio of an extent to the next larger extent, for points of a line or of a plane.
const SLENDER: f64 = 0.5;

/// Evaluates a line in space (`plane` is `None`), or of the points projected to a plane of two coordinates.
pub(super) fn line(
    points_mm: &[[f64; 3]],
    plane: Option<CoordinatePlane>,
) -> Result<Form, FormError> {
    match plane {
        None => line_in_space(points_mm),
        Some(plane) => line_in_plane(points_mm, plane),
    }
}

fn refuse_broad(cloud: &Cloud, feature: FeatureKind) -> Result<(), FormError> {
    let place = usize::from(feature == FeatureKind::Plane);
    let [long, broad] = [cloud.extents[place], cloud.extents[place + 1]];
    if broad <= SLENDER * long {
        return Ok(());
    }
    let (found, expected) = match feature {
        FeatureKind::Plane => ("points as high as they are broad", "points near a plane"),
        _ => ("points as broad as they are long", "points near a line"),
    };
    Err(FormError::NotDetermined { feature, found: found.into(), expected })
}

fn line_in_space(points_mm: &[[f64; 3]]) -> Result<Form, FormError> {
    let cloud = Cloud::of(points_mm, FeatureKind::Line)?;
    refuse_broad(&cloud, FeatureKind::Line)?;
    let w = signed(cloud.directions[0]);
    let distances = cloud.points.iter().map(|p| (p - w * p.dot(&w)).norm());
    let [_, largest] = range(distances.clone());
    Ok(Form {
        deviation_mm: 2.0 * largest * cloud.scale_mm,
        rms_mm: rms(distances) * cloud.scale_mm,
        ..line_along(&cloud, w)
    })
}

/// Line through the mean of the points in the direction `w`, without deviations.
fn line_along(cloud: &Cloud, w: Vector3<f64>) -> Form {
    let along = range(cloud.points.iter().map(|p| p.dot(&w)));
    let at = |s: f64| cloud.in_mm(w * s);
    Form {
        feature: FeatureKind::Line,
        points: cloud.points.len(),
        position_mm: at(0.5 * (along[0] + along[1])),
        direction: w.into(),
        radius_mm: None,
        half_angle_rad: None,
        axis: Some(Axis { ends_mm: along.map(at) }),
        deviation_mm: 0.0,
        rms_mm: 0.0,
        out_of_plane_mm: None,
        minimum_zone: None,
    }
}

fn line_in_plane(points_mm: &[[f64; 3]], plane: CoordinatePlane) -> Result<Form, FormError> {
    let normal: Vector3<f64> = plane.normal().into();
    let third = normal.iamax();
    let [below, above] = range(points_mm.iter().map(|p| p[third]));
    // NaN and infinite coordinates are kept, and rejected together with those in the plane.
    let middle = 0.5 * (below + above);
    let is_finite = points_mm.iter().all(|p| p[third].is_finite());
    let image = |p: &[f64; 3]| {
        let mut image = *p;
        if is_finite {
            image[third] = middle;
        }
        image
    };
    let images: Vec<[f64; 3]> = points_mm.iter().map(image).collect();
    let cloud = Cloud::of(&images, FeatureKind::Line)?;
    refuse_broad(&cloud, FeatureKind::Line)?;
    let w = signed(cloud.directions[0]);
    let v = normal.cross(&w);
    let across: Vec<(f64, f64)> = (cloud.points.iter()).map(|p| (p.dot(&w), p.dot(&v))).collect();
    let [low, high] = range(across.iter().map(|p| p.1));
    let strip = narrowest_strip(&across);
    let in_space = |(s, h): (f64, f64)| w * s + v * h;
    Ok(Form {
        deviation_mm: (high - low) * cloud.scale_mm,
        rms_mm: rms(across.iter().map(|p| p.1)) * cloud.scale_mm,
        out_of_plane_mm: Some(above - below),
        minimum_zone: strip.map(|strip| MinimumZone {
            deviation_mm: strip.width * cloud.scale_mm,
            position_mm: cloud.in_mm(in_space(strip.middle)),
            direction: signed(in_space(strip.direction)).into(),
            radii_mm: None,
            contacts: strip.contacts,
        }),
        ..line_along(&cloud, w)
    })
}

struct Strip {
    width: f64,
    middle: (f64, f64),
    direction: (f64, f64),
    contacts: Vec<usize>,
}

/// Finds the narrowest strip between two parallel lines that encloses all points. One of its sides contains an edge of
/// the convex hull, the other side the corner farthest from that edge.
fn narrowest_strip(points: &[(f64, f64)]) -> Option<Strip> {
    let mut sorted = points.to_vec();
    sorted.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.total_cmp(&b.1)));
    let lower = half_hull(sorted.iter().copied());
    let upper = half_hull(sorted.iter().map(|(s, h)| (*s, -h)));
    let upper: Vec<(f64, f64)> = upper.into_iter().map(|(s, h)| (s, -h)).collect();
    let side = |edges: &[(f64, f64)], corners: &[(f64, f64)]| {
        let of_edge = |edge: &[(f64, f64)]| {
            let (a, b) = (edge[0], edge[1]);
            let length = (b.0 - a.0).hypot(b.1 - a.1);
            let direction = ((b.0 - a.0) / length, (b.1 - a.1) / length);
            let height = |p: &(f64, f64)| direction.0 * (p.1 - a.1) - direction.1 * (p.0 - a.0);
            let far = corners.iter().max_by(|p, q| height(p).abs().total_cmp(&height(q).abs()))?;
            Some((height(far).abs(), direction, [a, b, *far]))
        };
        let strips = edges.windows(2).filter_map(of_edge);
        strips.min_by(|p, q| p.0.total_cmp(&q.0))
    };
    let strips = [side(&lower, &upper), side(&upper, &lower)];
    let (width, direction, corners) =
        (strips.into_iter().flatten()).min_by(|p, q| p.0.total_cmp(&q.0))?;
    let [a, _, far] = corners;
    let place = |corner: (f64, f64)| points.iter().position(|p| *p == corner);
    let mut contacts: Vec<usize> = corners.into_iter().filter_map(place).collect();
    contacts.sort_unstable();
    contacts.dedup();
    Some(Strip { width, middle: (0.5 * (a.0 + far.0), 0.5 * (a.1 + far.1)), direction, contacts })
}

pub(super) fn plane(points_mm: &[[f64; 3]]) -> Result<Form, FormError> {
    let cloud = Cloud::of(points_mm, FeatureKind::Plane)?;
    cloud.refuse_line(FeatureKind::Plane, "points that spread over a plane")?;
    refuse_broad(&cloud, FeatureKind::Plane)?;
    let normal = signed(cloud.directions[2]);
    let heights = cloud.points.iter().map(|p| p.dot(&normal));
    let [low, high] = range(heights.clone());
    Ok(Form {
        feature: FeatureKind::Plane,
        points: points_mm.len(),
        position_mm: cloud.in_mm(Vector3::zeros()),
        direction: normal.into(),
        radius_mm: None,
        half_angle_rad: None,
        axis: None,
        deviation_mm: (high - low) * cloud.scale_mm,
        rms_mm: rms(heights) * cloud.scale_mm,
        out_of_plane_mm: None,
        minimum_zone: layer(&cloud, normal),
    })
}

/// Finds the thinnest layer between two parallel planes that encloses all points; `None` if the search fails. It is
/// found by a sequence of minimax problems, each of the heights of the points over the previous plane.
fn layer(cloud: &Cloud, start: Vector3<f64>) -> Option<MinimumZone> {
    let thickness_of = |normal: Vector3<f64>| {
        let [low, high] = range(cloud.points.iter().map(|p| p.dot(&normal)));
        high - low
    };
    let mut normal = start;
    let mut thickness = thickness_of(normal);
    let mut found: Option<Minimax> = None;
    for _ in 0..50 {
        let [e1, e2] = across(normal);
        let rows: Vec<Vector3<f64>> =
            (cloud.points.iter()).map(|p| Vector3::new(1.0, p.dot(&e1), p.dot(&e2))).collect();
        let heights: Vec<f64> = cloud.points.iter().map(|p| p.dot(&normal)).collect();
        let linear = minimax(&rows, &heights, 4e-15)?;
        let tilted = (normal - e1 * linear.x.y - e2 * linear.x.z).normalize();
        let there = thickness_of(tilted);
        found = Some(linear);
        let is_thinner = there < thickness;
        if !is_thinner {
            break;
        }
        (normal, thickness) = (tilted, there);
    }
    let [low, high] = range(cloud.points.iter().map(|p| p.dot(&normal)));
    let touching = found?.contacts.into_iter().filter(|c| c.weight > 1e-9);
    let mut contacts: Vec<usize> = touching.map(|contact| contact.row).collect();
    contacts.sort_unstable();
    contacts.dedup();
    let normal = signed(normal);
    let middle = 0.5 * (low + high) * if normal.dot(&start) < 0.0 { -1.0 } else { 1.0 };
    Some(MinimumZone {
        deviation_mm: thickness * cloud.scale_mm,
        position_mm: cloud.in_mm(normal * middle),
        direction: normal.into(),
        radii_mm: None,
        contacts,
    })
}

/// Maximum number of points from which the start of the fit is computed.
const FEW: usize = 200;

/// Number of axis directions that are tried as a start. They are 0.2 rad apart over a hemisphere.
const DIRECTIONS: usize = 120;

/// Surface of revolution with straight sides: a cone (`N` = 6) or, with the angle fixed at 0, a cylinder (`N` = 5).
///
/// Let r be the distance of a point from the axis, and s its position along the axis from `point`. Then its signed
/// distance from the surface is r cos ψ − s sin ψ − h.
#[derive(Clone, Copy)]
struct Conical<const N: usize> {
    point: Vector3<f64>,
    axis: Vector3<f64>,
    across: [Vector3<f64>; 2],
    /// Half angle ψ of the cone, rad; negative if the cone narrows along the axis.
    half_angle: f64,
    /// Distance h of the surface from `point`.
    height: f64,
}

impl<const N: usize> Conical<N> {
    /// Distance r of a point from the axis, and coordinate s of the point along the axis.
    fn polar(&self, point: &Vector3<f64>) -> (f64, f64) {
        let from = point - self.point;
        let s = from.dot(&self.axis);
        ((from - self.axis * s).norm(), s)
    }

    /// Start of the fit for an axis direction: the circle through the projected points, and the mean slope of their
    /// radii along the axis.
    fn start(points: &[Vector3<f64>], axis: Vector3<f64>) -> Option<Self> {
        let [e1, e2] = across(axis);
        let seen = |p: &Vector3<f64>| Vector3::new(p.dot(&e1), p.dot(&e2), p.dot(&axis));
        let seen: Vec<Vector3<f64>> = points.iter().map(seen).collect();
        let circle = FlatCircle::algebraic(&seen)?;
        let n = seen.len() as f64;
        let radii: Vec<f64> = (seen.iter()).map(|p| (p.xy() - circle.centre).norm()).collect();
        let mean_r = radii.iter().sum::<f64>() / n;
        let mean_s = seen.iter().map(|p| p.z).sum::<f64>() / n;
        let (mut up, mut across_up) = (0.0, 0.0);
        for (p, r) in seen.iter().zip(&radii) {
            across_up += (p.z - mean_s) * (p.z - mean_s);
            up += (p.z - mean_s) * (r - mean_r);
        }
        let is_cone = N == 6 && across_up > 0.0;
        let half_angle = if is_cone { (up / across_up).atan() } else { 0.0 };
        Some(Self {
            point: e1 * circle.centre.x + e2 * circle.centre.y,
            axis,
            across: [e1, e2],
            half_angle,
            height: (mean_r - mean_s * half_angle.tan()) * half_angle.cos(),
        })
    }
}

impl<const N: usize> Shape<N> for Conical<N> {
    fn distance(&self, point: &Vector3<f64>) -> (f64, SVector<f64, N>) {
        let (sin, cos) = self.half_angle.sin_cos();
        let from = point - self.point;
        let s = from.dot(&self.axis);
        let beside = from - self.axis * s;
        let r = beside.norm();
        let u = if r > 0.0 { beside / r } else { beside };
        let [u1, u2] = self.across.map(|e| u.dot(&e));
        let tilt = s * cos + r * sin;
        let derivatives = [-cos * u1, -cos * u2, -tilt * u1, -tilt * u2, -1.0, -r * sin - s * cos];
        let derivatives = SVector::from_fn(|k, _| derivatives[k]);
        (r * cos - s * sin - self.height, derivatives)
    }

    fn moved(&self, by: &SVector<f64, N>) -> Self {
        let [e1, e2] = self.across;
        let axis = (self.axis + e1 * by[2] + e2 * by[3]).normalize();
        Self {
            point: self.point + e1 * by[0] + e2 * by[1],
            axis,
            across: across(axis),
            half_angle: self.half_angle + if N == 6 { by[5] } else { 0.0 },
            height: self.height + by[4],
        }
    }
}

/// Evenly spaced unit vectors over a hemisphere (Fibonacci spiral).
fn directions() -> impl Iterator<Item = Vector3<f64>> {
    let golden = std::f64::consts::PI * (3.0 - 5.0_f64.sqrt());
    (0..DIRECTIONS).map(move |k| {
        let z = (k as f64 + 0.5) / DIRECTIONS as f64;
        let (sin, cos) = (golden * k as f64).sin_cos();
        let r = (1.0 - z * z).sqrt();
        Vector3::new(r * cos, r * sin, z)
    })
}

/// Selects at most `FEW` points in an aperiodic order. If points are measured in turn at a few heights, every n-th
/// point may be at the same height.
fn few(points: &[Vector3<f64>]) -> Vec<Vector3<f64>> {
    // The steps are prime, so they alias only with a period that is a multiple of the step.
    const STEP: usize = 7919;
    const OTHER: usize = 7907;
    if points.len() <= FEW {
        return points.to_vec();
    }
    let step = if points.len().is_multiple_of(STEP) { OTHER } else { STEP };
    (0..FEW).map(|k| points[k * step % points.len()]).collect()
}

/// Best of the surfaces that are fitted from every start direction.
fn best<const N: usize>(
    cloud: &Cloud,
    is_possible: impl Fn(&Conical<N>, &[Vector3<f64>]) -> bool,
) -> Option<Refined<Conical<N>, N>> {
    let few = few(&cloud.points);
    let starts = cloud.directions.into_iter().chain(directions());
    let found = starts.filter_map(|axis| {
        let found = refine(Conical::<N>::start(&few, axis)?, &few, 60);
        is_possible(&found.shape, &few).then_some(found)
    });
    let best = found.min_by(|a, b| a.squares.total_cmp(&b.squares))?;
    let fit = refine(best.shape, &cloud.points, 200);
    (fit.has_settled() && is_possible(&fit.shape, &cloud.points)).then_some(fit)
}

/// Maximum radius, and maximum distance of an apex, relative to the extent of the points.
const FAR: f64 = 1e5;

impl<const N: usize> Refined<Conical<N>, N> {
    fn is_determined(&self) -> bool {
        self.determined > 1e-8
    }
}

pub(super) fn cylinder(points_mm: &[[f64; 3]]) -> Result<Form, FormError> {
    const FEATURE: FeatureKind = FeatureKind::Cylinder;
    const EXPECTED: &str = "points around the axis and along it";
    let cloud = Cloud::of(points_mm, FEATURE)?;
    cloud.refuse_line(FEATURE, EXPECTED)?;
    cloud.refuse_plane(FEATURE, EXPECTED)?;
    let refused = || FormError::NotDetermined {
        feature: FEATURE,
        found: "points that determine no cylinder".into(),
        expected: EXPECTED,
    };
    let possible = |c: &Conical<5>, _: &[Vector3<f64>]| c.height > 0.0 && c.height < FAR;
    let fit = best(&cloud, possible).ok_or_else(refused)?;
    if !fit.is_determined() {
        return Err(refused());
    }
    let found = fit.shape;
    let axis = signed(found.axis);
    let from_axis = |s: f64| found.point + axis * s;
    let along = range(cloud.points.iter().map(|p| (p - found.point).dot(&axis)));
    Ok(Form {
        radius_mm: Some(found.height * cloud.scale_mm),
        position_mm: cloud.in_mm(from_axis(0.5 * (along[0] + along[1]))),
        ..form(&cloud, FEATURE, &found, axis, along.map(from_axis))
    })
}

pub(super) fn cone(points_mm: &[[f64; 3]]) -> Result<Form, FormError> {
    const FEATURE: FeatureKind = FeatureKind::Cone;
    const EXPECTED: &str = "points around the axis and along it, on one side of the apex";
    let cloud = Cloud::of(points_mm, FEATURE)?;
    cloud.refuse_line(FEATURE, EXPECTED)?;
    cloud.refuse_plane(FEATURE, EXPECTED)?;
    let refused = |found: &str, expected| FormError::NotDetermined {
        feature: FEATURE,
        found: found.into(),
        expected,
    };
    let nothing = || refused("points that determine no cone", EXPECTED);
    let fit = best(&cloud, on_one_side).ok_or_else(nothing)?;
    let found = fit.shape;
    let (sin, cos) = found.half_angle.sin_cos();
    if sin.abs() * FAR < found.height.abs() {
        let expected = "a cone: for this shape ask for a cylinder";
        return Err(refused("sides that are parallel", expected));
    }
    if cos < 1.0 / FAR || !fit.is_determined() {
        return Err(nothing());
    }
    // The direction points from the apex into the cone.
    let axis = found.axis * sin.signum();
    let apex = found.point - found.axis * (found.height / sin);
    let along = range(cloud.points.iter().map(|p| (p - apex).dot(&axis)));
    Ok(Form {
        half_angle_rad: Some(found.half_angle.abs()),
        position_mm: cloud.in_mm(apex),
        ..form(&cloud, FEATURE, &found, axis, along.map(|s| apex + axis * s))
    })
}

/// Whether all points are on the same side of the apex, within their scatter.
fn on_one_side(cone: &Conical<6>, points: &[Vector3<f64>]) -> bool {
    let (sin, cos) = cone.half_angle.sin_cos();
    if cos <= 0.0 {
        return false;
    }
    // Position of the apex along the generator line, from the foot of the perpendicular of `point`. The sign of a
    // position relative to it is the side.
    let apex = -cone.height * cos / sin;
    let scatter = rms(points.iter().map(|p| cone.distance(p).0));
    points.iter().all(|point| {
        let (r, s) = cone.polar(point);
        let from_apex = (s * cos + r * sin - apex) * sin.signum();
        sin == 0.0 || from_apex >= -(3.0 * scatter + 1e-9)
    })
}

fn form<const N: usize>(
    cloud: &Cloud,
    feature: FeatureKind,
    found: &Conical<N>,
    axis: Vector3<f64>,
    ends: [Vector3<f64>; 2],
) -> Form {
    let distances = || cloud.points.iter().map(|p| found.distance(p).0);
    let [low, high] = range(distances());
    Form {
        feature,
        points: cloud.points.len(),
        position_mm: [0.0; 3],
        direction: axis.into(),
        radius_mm: None,
        half_angle_rad: None,
        axis: Some(Axis { ends_mm: ends.map(|end| cloud.in_mm(end)) }),
        deviation_mm: (high - low) * cloud.scale_mm,
        rms_mm: rms(distances()) * cloud.scale_mm,
        out_of_plane_mm: None,
        minimum_zone: None,
    }
}

/// Solution x of the minimax problem, which minimises the largest |b − A x|.
pub(super) struct Minimax {
    pub(super) x: Vector3<f64>,
    /// Largest |b − A x|.
    pub(super) largest: f64,
    /// Contact rows, each with the sign of b − A x and a weight. The weights are at least 0 and have the sum 1. The
    /// signed, weighted sum of the rows of A is zero, which proves that no other x is better.
    pub(super) contacts: [Contact; 4],
}

/// A row with the largest |b − A x|.
#[derive(Clone, Copy)]
pub(super) struct Contact {
    pub(super) row: usize,
    pub(super) sign: f64,
    pub(super) weight: f64,
}

/// Solves the problem; `None` if the rows determine fewer than three unknowns. Residuals that differ by at most
/// `rounding` count as equal.
///
/// Each exchange of a contact row increases the largest |b − A x| over the four contacts. The iteration ends when no
/// other row exceeds it.
fn minimax(rows: &[Vector3<f64>], b: &[f64], rounding: f64) -> Option<Minimax> {
    let mut contacts = first_contacts(rows, b)?;
    // Exchanges without gain could cycle. Bland's rule prevents this after a number of exchanges.
    let patience = 100;
    for exchange in 0..1000 {
        let bland = exchange > patience;
        let matrix = Matrix4::from_fn(|k, column| {
            let Contact { row, sign, .. } = contacts[k];
            if column < 3 { rows[row][column] } else { sign }
        });
        let solver = matrix.lu();
        let solution = solver.solve(&Vector4::from_fn(|k, _| b[contacts[k].row]))?;
        let (x, largest) = (solution.xyz(), solution.w);
        let transposed = matrix.transpose().lu();
        let weights = transposed.solve(&Vector4::w())?;
        for (contact, weight) in contacts.iter_mut().zip(&weights) {
            contact.weight = contact.sign * weight;
        }
        let residual = |row: usize| b[row] - rows[row].dot(&x);
        let mut outside = (0..rows.len()).filter(|&row| residual(row).abs() > largest + rounding);
        let entering = if bland {
            outside.next()
        } else {
            outside.max_by(|&p, &q| residual(p).abs().total_cmp(&residual(q).abs()))
        };
        let Some(row) = entering else {
            return Some(Minimax { x, largest, contacts });
        };
        let sign = residual(row).signum();
        let column = (rows[row] * sign).push(1.0);
        let changes = transposed.solve(&column)?;
        let ratio = |k: usize| {
            let change = contacts[k].sign * changes[k];
            (change > 1e-12).then(|| contacts[k].weight.max(0.0) / change)
        };
        // The changes have the sum 1, so at least one of them is positive.
        let leaving =
            (0..4).filter_map(|k| ratio(k).map(|ratio| (k, ratio))).min_by(|(k, p), (l, q)| {
                p.total_cmp(q).then(contacts[*k].row.cmp(&contacts[*l].row))
            })?;
        contacts[leaving.0] = Contact { row, sign, weight: 0.0 };
    }
    None
}

/// Initial contacts: the three rows that determine the unknowns best, and the row with the largest residual of their
/// solution.
fn first_contacts(rows: &[Vector3<f64>], b: &[f64]) -> Option<[Contact; 4]> {
    let mut left: Vec<Vector3<f64>> = rows.to_vec();
    let mut chosen = [0; 3];
    for place in &mut chosen {
        let by_length =
            |&p: &usize, &q: &usize| left[p].norm_squared().total_cmp(&left[q].norm_squared());
        let pivot = (0..left.len()).max_by(by_length)?;
        let length = left[pivot].norm();
        if length < 1e-9 {
            return None;
        }
        let direction = left[pivot] / length;
        for row in &mut left {
            *row -= direction * direction.dot(row);
        }
        *place = pivot;
    }
    let of_three = nalgebra::Matrix3::from_fn(|k, column| rows[chosen[k]][column]);
    let x = of_three.lu().solve(&Vector3::from(chosen.map(|row| b[row])))?;
    let residual = |row: usize| b[row] - rows[row].dot(&x);
    let others = (0..rows.len()).filter(|row| !chosen.contains(row));
    let fourth = others.max_by(|&p, &q| residual(p).abs().total_cmp(&residual(q).abs()))?;
    // Express the fourth row as a combination of the other three. With the opposite signs, the signed sum of the four
    // rows is zero.
    let shares = of_three.transpose().lu().solve(&rows[fourth])?;
    let turn = if residual(fourth) < 0.0 { -1.0 } else { 1.0 };
    let contact = |row: usize, share: f64| Contact {
        row,
        sign: turn * if share < 0.0 { -1.0 } else { 1.0 },
        weight: 0.0,
    };
    Some([
        contact(chosen[0], -shares[0]),
        contact(chosen[1], -shares[1]),
        contact(chosen[2], -shares[2]),
        contact(fourth, 1.0),
    ])
}

/// Surface or curve with `N` parameters.
pub(super) trait Shape<const N: usize>: Clone {
    /// Signed distance of a point, and its derivatives with respect to the parameters of [`moved`](Self::moved) at
    /// zero.
    fn distance(&self, point: &Vector3<f64>) -> (f64, SVector<f64, N>);
    fn moved(&self, by: &SVector<f64, N>) -> Self;
}

pub(super) struct Refined<S, const N: usize> {
    pub(super) shape: S,
    pub(super) squares: f64,
    /// Square root of the ratio of the smallest to the largest eigenvalue of the normal equations, after scaling each
    /// parameter to a diagonal of 1. It is 0 if the points do not determine the parameters.
    pub(super) determined: f64,
    step: f64,
}

impl<S, const N: usize> Refined<S, N> {
    fn has_settled(&self) -> bool {
        self.step < 1e-6
    }
}

struct Normal<const N: usize> {
    matrix: SMatrix<f64, N, N>,
    gradient: SVector<f64, N>,
    squares: f64,
}

impl<const N: usize> Normal<N> {
    fn of(shape: &impl Shape<N>, points: &[Vector3<f64>]) -> Self {
        let mut sum = Self { matrix: SMatrix::zeros(), gradient: SVector::zeros(), squares: 0.0 };
        for point in points {
            let (distance, derivatives) = shape.distance(point);
            sum.matrix += derivatives * derivatives.transpose();
            sum.gradient += derivatives * distance;
            sum.squares += distance * distance;
        }
        sum
    }

    /// Solves for the step, after increasing the diagonal by the fraction `damping`.
    fn step(&self, damping: f64) -> Option<SVector<f64, N>> {
        let mut matrix = self.matrix;
        for k in 0..N {
            matrix[(k, k)] *= 1.0 + damping;
        }
        let step = -matrix.cholesky()?.solve(&self.gradient);
        step.iter().all(|x| x.is_finite()).then_some(step)
    }

    fn determined(&self) -> f64 {
        let scale = SVector::<f64, N>::from_fn(|k, _| self.matrix[(k, k)].sqrt());
        let is_seen = |x: &f64| *x > 0.0;
        if !scale.iter().all(is_seen) {
            return 0.0;
        }
        let scaled = self.matrix.component_div(&(scale * scale.transpose()));
        // The singular values of a symmetric matrix are the magnitudes of its eigenvalues.
        let values =
            nalgebra::DMatrix::from_column_slice(N, N, scaled.as_slice()).singular_values();
        (values.min() / values.max()).sqrt()
    }
}

fn refine<S: Shape<N>, const N: usize>(
    start: S,
    points: &[Vector3<f64>],
    most_steps: usize,
) -> Refined<S, N> {
    let mut shape = start;
    let mut normal = Normal::of(&shape, points);
    let mut damping = 1e-3;
    for _ in 0..most_steps {
        let Some(step) = normal.step(damping) else {
            damping = 10.0 * f64::max(damping, 1e-12);
            if damping > 1e12 {
                break;
            }
            continue;
        };
        if step.norm() < 1e-8 {
            break;
        }
        let moved = shape.moved(&step);
        let there = Normal::of(&moved, points);
        if there.squares < normal.squares {
            (shape, normal) = (moved, there);
            damping *= 0.1;
        } else {
            damping *= 10.0;
        }
        if damping > 1e12 {
            break;
        }
    }
    // At its minimum the sum of squares is flat to half of the digits, but the gradient is not.
    let mut last = f64::INFINITY;
    for _ in 0..60 {
        let Some(step) = normal.step(0.0) else { break };
        let length = step.norm();
        let is_closing_in = length < 0.7 * last && length <= 1e-2;
        if !is_closing_in {
            break;
        }
        shape = shape.moved(&step);
        normal = Normal::of(&shape, points);
        last = length;
        if length < 1e-16 {
            break;
        }
    }
    Refined { shape, squares: normal.squares, determined: normal.determined(), step: last }
}
