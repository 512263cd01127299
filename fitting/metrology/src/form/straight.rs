//! Lines and planes, by least squares and by minimum zones.

use nalgebra::Vector3;

use super::{
    Axis, CoordinatePlane, FeatureKind, Form, FormError, MinimumZone,
    cloud::{Cloud, across, rms, signed},
    minimax::{Minimax, minimax},
};
use crate::number::range;
use crate::reference_line::half_hull;

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
