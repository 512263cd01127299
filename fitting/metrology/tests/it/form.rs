//! Features against closed forms, searches without any idea, published numbers and rigid motions.

use std::f64::consts::TAU;

use proptest::prelude::*;
use rand::SeedableRng as _;
use rand_chacha::ChaCha8Rng;
use volcomp_metrology::form::{
    Axis, CoordinatePlane, DatumAxis, Feature, Form, FormError, evaluate_form,
};

type Point = [f64; 3];

const CIRCLE: Feature = Feature::Circle { plane: None };
const CIRCLE_XY: Feature = Feature::Circle {
    plane: Some(CoordinatePlane::Xy),
};
const LINE_XY: Feature = Feature::Line {
    plane: Some(CoordinatePlane::Xy),
};

/// A rotation and a displacement.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Motion {
    rows: [Point; 3],
    shift: Point,
}

impl Motion {
    /// From any quaternion but zero.
    pub(crate) fn new([w, x, y, z]: [f64; 4], shift: Point) -> Self {
        let n = (w * w + x * x + y * y + z * z).sqrt();
        let [w, x, y, z] = [w / n, x / n, y / n, z / n];
        let rows = [
            [
                1.0 - 2.0 * (y * y + z * z),
                2.0 * (x * y - w * z),
                2.0 * (x * z + w * y),
            ],
            [
                2.0 * (x * y + w * z),
                1.0 - 2.0 * (x * x + z * z),
                2.0 * (y * z - w * x),
            ],
            [
                2.0 * (x * z - w * y),
                2.0 * (y * z + w * x),
                1.0 - 2.0 * (x * x + y * y),
            ],
        ];
        Self { rows, shift }
    }

    fn random(rng: &mut ChaCha8Rng, largest_shift: f64) -> Self {
        let quaternion = std::array::from_fn(|_| rng.random_range(-1.0..1.0));
        let shift = std::array::from_fn(|_| largest_shift * rng.random_range(-1.0..1.0));
        Self::new(quaternion, shift)
    }

    pub(crate) fn turned(&self, p: Point) -> Point {
        self.rows.map(|r| r[0] * p[0] + r[1] * p[1] + r[2] * p[2])
    }

    pub(crate) fn moved(&self, p: Point) -> Point {
        let turned = self.turned(p);
        std::array::from_fn(|k| turned[k] + self.shift[k])
    }

    fn all(&self, points: &[Point]) -> Vec<Point> {
        points.iter().map(|p| self.moved(*p)).collect()
    }
}

fn distance(a: Point, b: Point) -> f64 {
    (0..3).map(|k| (a[k] - b[k]).powi(2)).sum::<f64>().sqrt()
}

/// The sine of the angle between two lines along unit vectors.
fn between(a: Point, b: Point) -> f64 {
    let cross = [
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    ];
    distance(cross, [0.0; 3])
}

#[track_caller]
fn near(found: f64, expected: f64, within: f64) {
    assert!(
        (found - expected).abs() <= within,
        "{found} is not {expected} within {within}"
    );
}

/// Points at radius(t) about the z axis.
fn round(n: usize, radius: impl Fn(f64) -> f64) -> Vec<Point> {
    let angle = |k: usize| TAU * k as f64 / n as f64;
    let point = |t: f64| [radius(t) * t.cos(), radius(t) * t.sin(), 0.0];
    (0..n).map(angle).map(point).collect()
}

#[test]
fn lobes_have_twice_their_amplitude() {
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    for lobes in [2, 3, 4, 5, 7] {
        let motion = Motion::random(&mut rng, 1e5);
        let points = round(840, |t| 50.0 + 0.012 * (f64::from(lobes) * t).cos());
        let form = evaluate_form(&motion.all(&points), CIRCLE).unwrap();
        // Coordinates of 1e5 mm are rounded to 1.5e-11 mm.
        near(form.deviation_mm, 0.024, 2e-10);
        near(form.rms_mm, 0.012 / 2.0_f64.sqrt(), 1e-5);
        let zone = form.minimum_zone.unwrap();
        near(zone.deviation_mm, 0.024, 2e-10);
        let centre = motion.moved([0.0; 3]);
        near(distance(form.position_mm, centre), 0.0, 1e-9);
        near(
            between(form.direction, motion.turned([0.0, 0.0, 1.0])),
            0.0,
            1e-11,
        );
        let [inner, outer] = zone.radii_mm.unwrap();
        near(outer - inner, zone.deviation_mm, 1e-12);
    }
}

/// Published: W. Gander, G. H. Golub, R. Strebel, Least-squares fitting of circles and ellipses, BIT 34 (1994) 558–578:
/// six points, the circle of least distances.
#[test]
fn the_circle_of_gander_golub_and_strebel() {
    let points = [(1, 7), (2, 6), (5, 8), (7, 7), (9, 5), (3, 7)];
    let points = points.map(|(x, y)| [f64::from(x), f64::from(y), 0.0]);
    let form = evaluate_form(&points, CIRCLE_XY).unwrap();
    near(form.position_mm[0], 4.7398, 5e-5);
    near(form.position_mm[1], 2.9835, 5e-5);
    near(form.radius_mm.unwrap(), 4.7142, 5e-5);
}

/// A profile with noise: radius 30, lobes and noise of some hundredths.
fn rough(rng: &mut ChaCha8Rng, n: usize, size: f64) -> Vec<Point> {
    let phase: f64 = rng.random_range(0.0..TAU);
    let noise: Vec<f64> = (0..n).map(|_| rng.random_range(-size..size)).collect();
    let mut points = round(n, |_| 1.0);
    for (k, (point, noise)) in points.iter_mut().zip(noise).enumerate() {
        let r = 30.0 + size * (2.0 * TAU * k as f64 / n as f64 + phase).cos() + noise;
        *point = [4.0 + r * point[0], r * point[1] - 7.0, 0.0];
    }
    points
}

/// Width of the ring about a centre.
fn ring_width(points: &[Point], x: f64, y: f64) -> f64 {
    let radii = points.iter().map(|p| (p[0] - x).hypot(p[1] - y));
    let (low, high) = radii.fold((f64::MAX, f64::MIN), |(l, h), r| (l.min(r), h.max(r)));
    high - low
}

/// Grids about the best centre so far, each finer: on the first one the whole neighbourhood is searched.
fn ring_by_grid(points: &[Point], start: [f64; 2], reach: f64) -> f64 {
    const STEPS: i32 = 40;
    let (mut centre, mut reach) = (start, reach);
    let mut best = ring_width(points, centre[0], centre[1]);
    for _ in 0..40 {
        let middle = centre;
        for i in -STEPS..=STEPS {
            for j in -STEPS..=STEPS {
                let step = reach / f64::from(STEPS);
                let there = [
                    middle[0] + step * f64::from(i),
                    middle[1] + step * f64::from(j),
                ];
                let width = ring_width(points, there[0], there[1]);
                if width < best {
                    (best, centre) = (width, there);
                }
            }
        }
        reach *= 0.5;
    }
    best
}

#[test]
fn the_minimum_zone_ring_is_that_of_a_search_over_grids() {
    let mut rng = ChaCha8Rng::seed_from_u64(2);
    // From profiles of a workpiece to ones that are hardly round.
    for size in [0.003, 0.05, 1.0, 5.0] {
        let points = rough(&mut rng, 37, size);
        let form = evaluate_form(&points, CIRCLE_XY).unwrap();
        let zone = form.minimum_zone.unwrap();
        let searched = ring_by_grid(&points, [4.0, -7.0], 3.0 * size);
        assert!(zone.deviation_mm <= searched + 1e-12, "{size}");
        near(searched, zone.deviation_mm, 1e-6 * size);
        assert!(zone.deviation_mm < form.deviation_mm);
    }
}

/// Of the narrowest ring two points at least touch the outer and two the inner circle, and they alternate: no half plane
/// through the centre separates the outer ones from the inner ones.
#[test]
fn the_contacts_of_a_ring_alternate() {
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    for _ in 0..50 {
        let points = rough(&mut rng, 24, 0.02);
        let zone = evaluate_form(&points, CIRCLE_XY)
            .unwrap()
            .minimum_zone
            .unwrap();
        let [inner, outer] = zone.radii_mm.unwrap();
        let [x, y, _] = zone.position_mm;
        let mut contacts: Vec<(f64, bool)> = Vec::new();
        for &k in &zone.contacts {
            let [dx, dy] = [points[k][0] - x, points[k][1] - y];
            let radius = dx.hypot(dy);
            let is_outer = (radius - outer).abs() < 1e-11;
            assert!(
                is_outer || (radius - inner).abs() < 1e-11,
                "{radius} of {inner} {outer}"
            );
            contacts.push((dy.atan2(dx), is_outer));
        }
        contacts.sort_by(|a, b| a.0.total_cmp(&b.0));
        assert_eq!(contacts.len(), 4);
        for (k, contact) in contacts.iter().enumerate() {
            assert_ne!(contact.1, contacts[(k + 1) % 4].1, "{contacts:?}");
        }
        for point in &points {
            let radius = (point[0] - x).hypot(point[1] - y);
            assert!(inner - 1e-11 < radius && radius < outer + 1e-11);
        }
    }
}

#[test]
fn an_arc_has_its_circle() {
    let mut rng = ChaCha8Rng::seed_from_u64(4);
    for degrees in [3.0_f64, 20.0, 90.0, 200.0] {
        let motion = Motion::random(&mut rng, 1e3);
        let points: Vec<Point> = (0..40)
            .map(|k| (degrees * f64::from(k) / 39.0).to_radians())
            .map(|t| [80.0 * t.cos(), 80.0 * t.sin(), 0.0])
            .collect();
        let form = evaluate_form(&motion.all(&points), CIRCLE).unwrap();
        let within = if degrees < 10.0 { 1e-6 } else { 1e-9 };
        near(form.radius_mm.unwrap(), 80.0, within);
        near(
            distance(form.position_mm, motion.moved([0.0; 3])),
            0.0,
            within,
        );
    }
}

#[test]
fn a_saddle_is_twice_its_height() {
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    for saddle in [|x: f64, y: f64| x * x - y * y, |x: f64, y: f64| x * y] {
        let motion = Motion::random(&mut rng, 1e5);
        let mut points = Vec::new();
        for i in -10..=10 {
            for j in -10..=10 {
                let (x, y) = (f64::from(i) / 10.0, f64::from(j) / 10.0);
                points.push(motion.moved([300.0 * x, 200.0 * y, 0.015 * saddle(x, y)]));
            }
        }
        let form = evaluate_form(&points, Feature::Plane).unwrap();
        near(form.deviation_mm, 0.030, 2e-10);
        let zone = form.minimum_zone.unwrap();
        near(zone.deviation_mm, 0.030, 2e-10);
        near(
            between(form.direction, motion.turned([0.0, 0.0, 1.0])),
            0.0,
            1e-12,
        );
    }
}

/// The width of a polyhedron lies between a face and a corner or between two edges: all of them are tried.
fn thinnest_layer(points: &[Point]) -> f64 {
    let minus = |a: Point, b: Point| [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
    let mut edges = Vec::new();
    for (k, &a) in points.iter().enumerate() {
        edges.extend(points[k + 1..].iter().map(|&b| minus(a, b)));
    }
    let mut best = f64::MAX;
    for (k, a) in edges.iter().enumerate() {
        for b in &edges[k + 1..] {
            let n = [
                a[1] * b[2] - a[2] * b[1],
                a[2] * b[0] - a[0] * b[2],
                a[0] * b[1] - a[1] * b[0],
            ];
            let length = distance(n, [0.0; 3]);
            if length < 1e-9 {
                continue;
            }
            let heights = points
                .iter()
                .map(|p| (p[0] * n[0] + p[1] * n[1] + p[2] * n[2]) / length);
            let (low, high) = heights.fold((f64::MAX, f64::MIN), |(l, h), x| (l.min(x), h.max(x)));
            best = best.min(high - low);
        }
    }
    best
}

#[test]
fn flatness_is_the_width_of_the_hull() {
    let mut rng = ChaCha8Rng::seed_from_u64(6);
    for height in [0.01, 1.0, 10.0] {
        for _ in 0..5 {
            let motion = Motion::random(&mut rng, 1e3);
            let mut number = |size: f64| rng.random_range(-size..size);
            let points: Vec<Point> = (0..12)
                .map(|_| [number(100.0), number(60.0), number(height)])
                .collect();
            let points = motion.all(&points);
            let form = evaluate_form(&points, Feature::Plane).unwrap();
            let zone = form.minimum_zone.unwrap();
            near(zone.deviation_mm, thinnest_layer(&points), 1e-9);
            assert!(zone.deviation_mm <= form.deviation_mm);
            assert!(zone.contacts.len() <= 4 && zone.contacts.len() >= 3);
        }
    }
}

#[test]
fn straightness_in_a_plane_is_the_narrowest_of_all_strips() {
    let mut rng = ChaCha8Rng::seed_from_u64(7);
    for height in [0.01, 3.0] {
        for _ in 0..10 {
            let slope: f64 = rng.random_range(-1.5..1.5);
            let mut number = |size: f64| rng.random_range(-size..size);
            let points: Vec<Point> = (0..30)
                .map(|_| (number(100.0), number(height)))
                .map(|(s, h)| {
                    [
                        s * slope.cos() - h * slope.sin() + 9e4,
                        s * slope.sin() + h * slope.cos(),
                        5.0,
                    ]
                })
                .collect();
            let form = evaluate_form(&points, LINE_XY).unwrap();
            let mut best = f64::MAX;
            for (k, a) in points.iter().enumerate() {
                for b in &points[k + 1..] {
                    let n = [a[1] - b[1], b[0] - a[0]];
                    let heights = points
                        .iter()
                        .map(|p| (p[0] - a[0]) * n[0] + (p[1] - a[1]) * n[1]);
                    let (l, h) =
                        heights.fold((f64::MAX, f64::MIN), |(l, h), x| (l.min(x), h.max(x)));
                    best = best.min((h - l) / n[0].hypot(n[1]));
                }
            }
            let zone = form.minimum_zone.unwrap();
            near(zone.deviation_mm, best, 1e-9);
            assert!(zone.deviation_mm <= form.deviation_mm);
            assert_eq!(zone.contacts.len(), 3);
            near(zone.direction[2], 0.0, 0.0);
            // The middle of the strip is half its width from every contact.
            let [x, y, _] = zone.position_mm;
            for k in zone.contacts {
                let across =
                    (points[k][0] - x) * zone.direction[1] - (points[k][1] - y) * zone.direction[0];
                near(across.abs(), 0.5 * zone.deviation_mm, 1e-9);
            }
        }
    }
}

#[test]
fn a_helix_about_a_line_has_its_diameter() {
    let motion = Motion::random(&mut ChaCha8Rng::seed_from_u64(8), 1e5);
    // Two threads opposite each other, so that the line of least squares is in their middle.
    let threads = [0.004, -0.004].into_iter();
    let points: Vec<Point> = threads
        .flat_map(|r| (0..400).map(move |k| (r, f64::from(k))))
        .map(|(r, s)| [r * (s / 6.0).cos(), r * (s / 6.0).sin(), 3.0 * s])
        .map(|p| motion.moved(p))
        .collect();
    let form = evaluate_form(&points, Feature::Line { plane: None }).unwrap();
    near(form.deviation_mm, 0.008, 1e-10);
    near(form.axis.unwrap().length_mm(), 1197.0, 1e-9);
    assert_eq!(form.minimum_zone, None);

    // A step to one side and back is symmetric, so that the line of least squares is known: the mean.
    let step = [(0.0, 0.01), (100.0, -0.01), (200.0, -0.01), (300.0, 0.01)];
    let points = step.map(|(s, h)| [s, 0.0, h]);
    let form = evaluate_form(&points, Feature::Line { plane: None }).unwrap();
    near(form.deviation_mm, 0.02, 1e-14);
    near(form.rms_mm, 0.01, 1e-14);
    for (found, expected) in form.position_mm.iter().zip([150.0, 0.0, 0.0]) {
        near(*found, expected, 1e-12);
    }
}

/// Points on a cone of half angle `psi` with its apex at the origin, from s to s + length along z; for psi = 0 a cylinder
/// of radius `radius`.
fn conical(
    rng: &mut ChaCha8Rng,
    n: usize,
    psi: f64,
    radius: f64,
    length: f64,
    turn: f64,
) -> Vec<Point> {
    let from = if psi > 0.0 { radius / psi.tan() } else { 0.0 };
    (0..n)
        .map(|_| {
            let (s, t) = (
                from + length * rng.random_range(0.0..1.0),
                turn * rng.random_range(0.0..1.0),
            );
            let r = if psi > 0.0 { s * psi.tan() } else { radius };
            [r * t.cos(), r * t.sin(), s]
        })
        .collect()
}

#[test]
fn tilted_cylinders_are_recovered() {
    let mut rng = ChaCha8Rng::seed_from_u64(9);
    for (length, turn) in [(100.0, TAU), (5.0, TAU), (800.0, TAU), (60.0, 2.0)] {
        for _ in 0..8 {
            let motion = Motion::random(&mut rng, 500.0);
            let points = motion.all(&conical(&mut rng, 60, 0.0, 20.0, length, turn));
            let form = evaluate_form(&points, Feature::Cylinder).unwrap();
            near(form.radius_mm.unwrap(), 20.0, 1e-9);
            near(
                between(form.direction, motion.turned([0.0, 0.0, 1.0])),
                0.0,
                1e-9,
            );
            let axis =
                DatumAxis::new(motion.moved([0.0; 3]), motion.turned([0.0, 0.0, 1.0])).unwrap();
            near(form.axis.unwrap().coaxiality_mm(&axis), 0.0, 1e-9);
            near(form.deviation_mm, 0.0, 1e-9);
        }
    }
}

#[test]
fn tilted_cones_are_recovered() {
    let mut rng = ChaCha8Rng::seed_from_u64(10);
    for degrees in [1.0_f64, 8.0, 30.0, 45.0, 70.0] {
        for turn in [TAU, 2.5] {
            for _ in 0..4 {
                let motion = Motion::random(&mut rng, 500.0);
                let psi = degrees.to_radians();
                let points = motion.all(&conical(&mut rng, 60, psi, 15.0, 40.0, turn));
                let form = evaluate_form(&points, Feature::Cone).unwrap();
                near(form.half_angle_rad.unwrap(), psi, 1e-9);
                // From the apex into the cone, with the sign.
                near(
                    distance(form.direction, motion.turned([0.0, 0.0, 1.0])),
                    0.0,
                    1e-9,
                );
                // The apex of a slender cone is far from the points.
                near(
                    distance(form.position_mm, motion.moved([0.0; 3])),
                    0.0,
                    1e-9 / psi.sin(),
                );
                near(form.deviation_mm, 0.0, 1e-9);
            }
        }
    }
}

#[test]
fn a_large_offset_costs_no_more_than_its_rounding() {
    let mut rng = ChaCha8Rng::seed_from_u64(11);
    for (feature, psi) in [(Feature::Cylinder, 0.0), (Feature::Cone, 0.4)] {
        let mut points = conical(&mut rng, 200, psi, 20.0, 70.0, TAU);
        for point in &mut points {
            for x in point {
                // A multiple of 2⁻²⁰ mm is the same number with and without the offset.
                *x = ((*x + 0.01 * rng.random_range(-1.0..1.0)) * 1048576.0).round() / 1048576.0;
            }
        }
        let here = evaluate_form(&points, feature).unwrap();
        let far: Vec<Point> = points
            .iter()
            .map(|p| [p[0] + 1e5, p[1] - 1e5, p[2] + 1e5])
            .collect();
        let there = evaluate_form(&far, feature).unwrap();
        near(there.deviation_mm, here.deviation_mm, 1e-10);
        near(there.rms_mm, here.rms_mm, 1e-11);
        near(distance(there.direction, here.direction), 0.0, 1e-12);
    }
}

#[test]
fn coaxiality_is_twice_the_largest_distance() {
    let datum = DatumAxis::new([10.0, 0.0, 0.0], [0.0, 0.0, 7.0]).unwrap();
    // At z = 0 the axis is 0.01 off, at z = 100 0.03.
    let axis = Axis {
        ends_mm: [[10.01, 0.0, 0.0], [10.0, 0.03, 100.0]],
    };
    near(axis.coaxiality_mm(&datum), 0.06, 1e-14);
    // A cylinder that leans by 1 mrad about the middle of its 80 mm, 0.005 mm beside the datum.
    let lean = |s: f64| [10.005, 1e-3 * s];
    let mut points = Vec::new();
    for s in [-40.0, -20.0, 0.0, 20.0, 40.0] {
        points.extend(round(24, |_| 12.0).into_iter().map(|[x, y, _]| {
            let (sin, cos) = 1e-3_f64.atan().sin_cos();
            let [x0, _] = lean(s);
            [x0 + x, y * cos + s * sin, s * cos - y * sin]
        }));
    }
    let form = evaluate_form(&points, Feature::Cylinder).unwrap();
    let farthest = 0.005_f64.hypot(40.0 * 1e-3_f64.atan().sin());
    near(
        form.axis.unwrap().coaxiality_mm(&datum),
        2.0 * farthest,
        1e-9,
    );
    // The centre of a circle: its distance from the datum in the plane of the circle.
    let circle: Vec<Point> = round(12, |_| 5.0)
        .iter()
        .map(|p| [p[0] + 10.003, p[1] + 0.004, 9.0])
        .collect();
    let circle = evaluate_form(&circle, CIRCLE).unwrap();
    near(circle.axis.unwrap().coaxiality_mm(&datum), 0.010, 1e-10);
    assert!(evaluate_form(&points, CIRCLE_XY).is_ok());
    let none = DatumAxis::new([0.0; 3], [0.0; 3]).unwrap_err();
    assert!(matches!(none, FormError::Direction { .. }));
}

#[test]
fn two_circles_determine_the_cone_on_one_side_of_its_apex() {
    let ring = |r: f64, z: f64| {
        round(16, move |_| r)
            .into_iter()
            .map(move |p| [p[0], p[1], z])
    };
    let points: Vec<Point> = ring(10.0, 10.0).chain(ring(20.0, 20.0)).collect();
    let form = evaluate_form(&points, Feature::Cone).unwrap();
    near(form.half_angle_rad.unwrap().to_degrees(), 45.0, 1e-9);
    near(distance(form.position_mm, [0.0; 3]), 0.0, 1e-9);
}

/// A feature with some roughness.
fn any_feature(rng: &mut ChaCha8Rng) -> Vec<(Feature, Vec<Point>)> {
    let mut roughen = |points: Vec<Point>| -> Vec<Point> {
        let noise = |x: f64, rng: &mut ChaCha8Rng| x + rng.random_range(-0.02..0.02);
        points
            .into_iter()
            .map(|p| p.map(|x| noise(x, rng)))
            .collect()
    };
    let plane = (0..30).map(|k| [f64::from(k % 6) * 20.0, f64::from(k / 6) * 30.0, 0.0]);
    let line = (0..20).map(|k| [f64::from(k) * 10.0, 0.0, 0.0]);
    let mut seeded = ChaCha8Rng::seed_from_u64(12);
    vec![
        (CIRCLE, roughen(round(25, |_| 40.0))),
        (Feature::Plane, roughen(plane.collect())),
        (Feature::Line { plane: None }, roughen(line.collect())),
        (
            Feature::Cylinder,
            roughen(conical(&mut seeded, 40, 0.0, 20.0, 70.0, TAU)),
        ),
        (
            Feature::Cone,
            roughen(conical(&mut seeded, 40, 0.5, 20.0, 70.0, TAU)),
        ),
    ]
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(8))]
    #[test]
    fn rigid_motions_move_the_feature_and_nothing_else(
        seed in 0_u64..1000,
        quaternion in prop::array::uniform4(-1.0_f64..1.0).prop_filter("no rotation", |q| q.iter().any(|x| x.abs() > 0.1)),
        shift in prop::array::uniform3(-1e4_f64..1e4),
    ) {
        let motion = Motion::new(quaternion, shift);
        for (feature, points) in any_feature(&mut ChaCha8Rng::seed_from_u64(seed)) {
            let here = evaluate_form(&points, feature).unwrap();
            let there = evaluate_form(&motion.all(&points), feature).unwrap();
            let close = |a: f64, b: f64, within: f64| (a - b).abs() < within;
            prop_assert!(close(here.deviation_mm, there.deviation_mm, 1e-9), "{feature:?}");
            prop_assert!(close(here.rms_mm, there.rms_mm, 1e-10));
            prop_assert!(distance(motion.moved(here.position_mm), there.position_mm) < 1e-8, "{feature:?}");
            prop_assert!(between(motion.turned(here.direction), there.direction) < 1e-9);
            let zone = |form: &Form| form.minimum_zone.clone().map(|zone| (zone.deviation_mm, zone.contacts));
            match (zone(&here), zone(&there)) {
                (None, None) => {}
                (Some((a, contacts)), Some((b, same))) => {
                    prop_assert!(close(a, b, 1e-9), "{feature:?}");
                    prop_assert_eq!(contacts, same);
                }
                _ => prop_assert!(false),
            }
        }
    }
}
