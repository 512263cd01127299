//! Cylinders and cones, by least squares of the distances from their surfaces.

use nalgebra::{SVector, Vector3};

use super::{
    Axis, FeatureKind, Form, FormError,
    circle::FlatCircle,
    cloud::{Cloud, across, rms, signed},
    refine::{Refined, Shape, refine},
};
use crate::number::range;

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
