//! Tests of circles, planes and lines against closed forms, brute-force searches and published values.

use std::f64::consts::TAU;

use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;
use volcomp_metrology::form::{CoordinatePlane, Feature, evaluate_form};

use crate::samples::near;

pub(crate) type Point = [f64; 3];

pub(crate) const CIRCLE: Feature = Feature::Circle { plane: None };
pub(crate) const CIRCLE_XY: Feature = Feature::Circle { plane: Some(CoordinatePlane::Xy) };
const LINE_XY: Feature = Feature::Line { plane: Some(CoordinatePlane::Xy) };

#[derive(Clone, Copy, Debug)]
pub(crate) struct Motion {
    rows: [Point; 3],
    shift: Point,
}

impl Motion {
    /// A rigid motion: the rotation of any non-zero quaternion, followed by a shift in mm.
    pub(crate) fn new([w, x, y, z]: [f64; 4], shift: Point) -> Self {
        let n = (w * w + x * x + y * y + z * z).sqrt();
        let [w, x, y, z] = [w / n, x / n, y / n, z / n];
        let rows = [
            [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)],
            [2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)],
            [2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)],
        ];
        Self { rows, shift }
    }

    pub(crate) fn random(rng: &mut ChaCha8Rng, largest_shift: f64) -> Self {
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

    pub(crate) fn all(&self, points: &[Point]) -> Vec<Point> {
        points.iter().map(|p| self.moved(*p)).collect()
    }
}

pub(crate) fn distance(a: Point, b: Point) -> f64 {
    (0..3).map(|k| (a[k] - b[k]).powi(2)).sum::<f64>().sqrt()
}

/// Sine of the angle between two unit vectors.
pub(crate) fn between(a: Point, b: Point) -> f64 {
    let cross = [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
    distance(cross, [0.0; 3])
}

/// `n` points at the distance `radius(t)` from the z axis, where t is the angle in rad.
pub(crate) fn round(n: usize, radius: impl Fn(f64) -> f64) -> Vec<Point> {
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
        // Coordinates of 1e5 mm have rounding errors of 1.5e-11 mm.
        near(form.deviation_mm, 0.024, 2e-10);
        near(form.rms_mm, 0.012 / 2.0_f64.sqrt(), 1e-5);
        let zone = form.minimum_zone.unwrap();
        near(zone.deviation_mm, 0.024, 2e-10);
        let centre = motion.moved([0.0; 3]);
        near(distance(form.position_mm, centre), 0.0, 1e-9);
        near(between(form.direction, motion.turned([0.0, 0.0, 1.0])), 0.0, 1e-11);
        let [inner, outer] = zone.radii_mm.unwrap();
        near(outer - inner, zone.deviation_mm, 1e-12);
    }
}

/// Six points and their least-squares circle, published by W. Gander, G. H. Golub, R. Strebel, Least-squares fitting of
/// circles and ellipses, BIT 34 (1994) 558–578.
#[test]
fn the_circle_of_gander_golub_and_strebel() {
    let points = [(1, 7), (2, 6), (5, 8), (7, 7), (9, 5), (3, 7)];
    let points = points.map(|(x, y)| [f64::from(x), f64::from(y), 0.0]);
    let form = evaluate_form(&points, CIRCLE_XY).unwrap();
    near(form.position_mm[0], 4.7398, 5e-5);
    near(form.position_mm[1], 2.9835, 5e-5);
    near(form.radius_mm.unwrap(), 4.7142, 5e-5);
}

/// A circular profile of radius 30 mm with lobes and noise of magnitude `size` (mm).
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

fn ring_width(points: &[Point], x: f64, y: f64) -> f64 {
    let radii = points.iter().map(|p| (p[0] - x).hypot(p[1] - y));
    let (low, high) = radii.fold((f64::MAX, f64::MIN), |(l, h), r| (l.min(r), h.max(r)));
    high - low
}

/// Width of the narrowest ring by grid search: each grid is about the best centre so far and finer than the previous
/// one; the first extends by `reach` from `start`.
fn ring_by_grid(points: &[Point], start: [f64; 2], reach: f64) -> f64 {
    const STEPS: i32 = 40;
    let (mut centre, mut reach) = (start, reach);
    let mut best = ring_width(points, centre[0], centre[1]);
    for _ in 0..40 {
        let middle = centre;
        for i in -STEPS..=STEPS {
            for j in -STEPS..=STEPS {
                let step = reach / f64::from(STEPS);
                let there = [middle[0] + step * f64::from(i), middle[1] + step * f64::from(j)];
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
    // From workpiece profiles to profiles that are hardly round.
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

/// Two contacts of the narrowest ring are on the outer circle and two on the inner circle. They alternate: no line
/// through the centre separates the outer contacts from the inner ones.
#[test]
fn the_contacts_of_a_ring_alternate() {
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    for _ in 0..50 {
        let points = rough(&mut rng, 24, 0.02);
        let zone = evaluate_form(&points, CIRCLE_XY).unwrap().minimum_zone.unwrap();
        let [inner, outer] = zone.radii_mm.unwrap();
        let [x, y, _] = zone.position_mm;
        let mut contacts: Vec<(f64, bool)> = Vec::new();
        for &k in &zone.contacts {
            let [dx, dy] = [points[k][0] - x, points[k][1] - y];
            let radius = dx.hypot(dy);
            let is_outer = (radius - outer).abs() < 1e-11;
            assert!(is_outer || (radius - inner).abs() < 1e-11, "{radius} of {inner} {outer}");
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
        near(distance(form.position_mm, motion.moved([0.0; 3])), 0.0, within);
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
        near(between(form.direction, motion.turned([0.0, 0.0, 1.0])), 0.0, 1e-12);
    }
}

/// The smallest width of a polyhedron: the minimum over all pairs of a face and a corner, and of two edges.
fn thinnest_layer(points: &[Point]) -> f64 {
    let minus = |a: Point, b: Point| [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
    let mut edges = Vec::new();
    for (k, &a) in points.iter().enumerate() {
        edges.extend(points[k + 1..].iter().map(|&b| minus(a, b)));
    }
    let mut best = f64::MAX;
    for (k, a) in edges.iter().enumerate() {
        for b in &edges[k + 1..] {
            let n =
                [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
            let length = distance(n, [0.0; 3]);
            if length < 1e-9 {
                continue;
            }
            let heights = points.iter().map(|p| (p[0] * n[0] + p[1] * n[1] + p[2] * n[2]) / length);
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
            let points: Vec<Point> =
                (0..12).map(|_| [number(100.0), number(60.0), number(height)]).collect();
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
                    let heights =
                        points.iter().map(|p| (p[0] - a[0]) * n[0] + (p[1] - a[1]) * n[1]);
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
            // The centre line of the strip is half its width from each contact.
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
    // Two opposite helices, so that the least-squares line is midway between them.
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

    // A symmetric step to one side and back: the least-squares line is the mean.
    let step = [(0.0, 0.01), (100.0, -0.01), (200.0, -0.01), (300.0, 0.01)];
    let points = step.map(|(s, h)| [s, 0.0, h]);
    let form = evaluate_form(&points, Feature::Line { plane: None }).unwrap();
    near(form.deviation_mm, 0.02, 1e-14);
    near(form.rms_mm, 0.01, 1e-14);
    for (found, expected) in form.position_mm.iter().zip([150.0, 0.0, 0.0]) {
        near(*found, expected, 1e-12);
    }
}
