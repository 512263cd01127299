//! Tests of features that were measured point by point.
//!
//! The features are compared with closed forms, brute-force searches, published values, and SciPy in
//! `tests/reference/form.py`.

use std::f64::consts::TAU;
use std::fmt::Write as _;
use std::io::Write as _;
use std::process::{Command, Stdio};

use proptest::prelude::*;
use rand::SeedableRng as _;
use rand_chacha::ChaCha8Rng;
use volcomp_metrology::form::{
    Axis, CoordinatePlane, DatumAxis, Feature, Form, FormError, evaluate_form, parse_points,
};
use volcomp_test_support::cases;

use crate::samples::near;

pub(crate) type Point = [f64; 3];

const CIRCLE: Feature = Feature::Circle { plane: None };
const CIRCLE_XY: Feature = Feature::Circle { plane: Some(CoordinatePlane::Xy) };
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

/// Results of the Python script; `None` without Python.
fn scipy(feature: &str, points: &[Point]) -> Option<Vec<f64>> {
    let python = volcomp_test_support::peers::python()?;
    let script = volcomp_test_support::root().join("fitting/metrology/tests/reference/form.py");
    let mut child = Command::new(python)
        .arg(script)
        .arg(feature)
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .spawn()
        .unwrap();
    let mut rows = String::new();
    for [x, y, z] in points {
        writeln!(rows, "{x} {y} {z}").unwrap();
    }
    child.stdin.take().unwrap().write_all(rows.as_bytes()).unwrap();
    let output = child.wait_with_output().unwrap();
    assert!(output.status.success());
    let text = String::from_utf8(output.stdout).unwrap();
    Some(text.split_whitespace().map(|x| x.parse().unwrap()).collect())
}

fn noise(rng: &mut ChaCha8Rng, size: f64) -> f64 {
    rng.random_range(-size..size)
}

#[test]
fn circles() {
    let mut rng = ChaCha8Rng::seed_from_u64(21);
    let points: Vec<Point> = (0..60)
        .map(|k| {
            let (r, t) = (25.0 + noise(&mut rng, 0.02), TAU * f64::from(k) / 60.0);
            [3.0 + r * t.cos(), r * t.sin() - 8.0, 0.0]
        })
        .collect();
    let Some(answer) = scipy("circle", &points) else {
        return;
    };
    let plane = Some(CoordinatePlane::Xy);
    let form = evaluate_form(&points, Feature::Circle { plane }).unwrap();
    near(form.position_mm[0], answer[0], 1e-8);
    near(form.position_mm[1], answer[1], 1e-8);
    near(form.radius_mm.unwrap(), answer[2], 1e-8);
    near(form.deviation_mm, answer[3], 1e-8);
    let zone = form.minimum_zone.unwrap();
    near(zone.deviation_mm, answer[4], 1e-9);
    near(zone.position_mm[0], answer[5], 1e-8);
    near(zone.position_mm[1], answer[6], 1e-8);
}

#[test]
fn planes() {
    let mut rng = ChaCha8Rng::seed_from_u64(22);
    let motion = Motion::new([0.3, -0.5, 0.7, 0.2], [100.0, 200.0, -50.0]);
    let points: Vec<Point> = (0..80)
        .map(|_| {
            motion.moved([noise(&mut rng, 300.0), noise(&mut rng, 200.0), noise(&mut rng, 0.01)])
        })
        .collect();
    let Some(answer) = scipy("plane", &points) else {
        return;
    };
    let form = evaluate_form(&points, Feature::Plane).unwrap();
    near(form.deviation_mm, answer[0], 1e-10);
    near(form.minimum_zone.unwrap().deviation_mm, answer[1], 1e-9);
}

#[test]
fn cylinders_and_cones() {
    let mut rng = ChaCha8Rng::seed_from_u64(23);
    let motion = Motion::new([0.8, 0.1, -0.4, 0.3], [10.0, -20.0, 30.0]);
    for (name, feature, slope) in
        [("cylinder", Feature::Cylinder, 0.0), ("cone", Feature::Cone, 0.3)]
    {
        let points: Vec<Point> = (0..80)
            .map(|_| {
                let (s, t) = (rng.random_range(0.0..50.0), rng.random_range(0.0..TAU));
                let r = 15.0 + slope * s + noise(&mut rng, 0.02);
                motion.moved([r * t.cos(), r * t.sin(), s])
            })
            .collect();
        let Some(answer) = scipy(name, &points) else {
            return;
        };
        let form = evaluate_form(&points, feature).unwrap();
        near(form.radius_mm.or(form.half_angle_rad).unwrap(), answer[0], 1e-8);
        near(form.deviation_mm, answer[1], 1e-7);
        let vector = if slope > 0.0 { form.position_mm } else { form.direction };
        let sign = if slope > 0.0 || answer[2] * vector[0] > 0.0 { 1.0 } else { -1.0 };
        for (found, expected) in vector.iter().zip(&answer[2..]) {
            near(*found, sign * expected, 1e-6);
        }
    }
}

const ALL: [Feature; 5] = [
    Feature::Circle { plane: None },
    Feature::Line { plane: None },
    Feature::Plane,
    Feature::Cylinder,
    Feature::Cone,
];

fn refused(points: &[[f64; 3]], feature: Feature) -> String {
    evaluate_form(points, feature).unwrap_err().to_string()
}

#[test]
fn too_few_different_points() {
    for (feature, name, fewest) in [
        (ALL[0], "circle", 4),
        (ALL[1], "line", 3),
        (ALL[2], "plane", 4),
        (ALL[3], "cylinder", 6),
        (ALL[4], "cone", 7),
    ] {
        let one_less: Vec<[f64; 3]> =
            (1..fewest).map(|k| [f64::from(k), f64::from(k * k), 1.0]).collect();
        let mut twice = one_less.clone();
        twice.extend(&one_less);
        for points in [&one_less, &twice] {
            let expected = format!(
                "{name}: found {} different points, expected at least {fewest}: with fewer every form deviation is zero",
                fewest - 1
            );
            assert_eq!(refused(points, feature), expected);
        }
        assert!(refused(&[], feature).contains("found 0 different points"));
        assert!(refused(&[[3.0; 3]; 20], feature).contains("found 1 different points"));
    }
}

#[test]
fn invalid_numbers_are_refused() {
    for feature in ALL {
        for wrong in [f64::NAN, f64::INFINITY, -1e300, 1.1e9] {
            let mut points: Vec<[f64; 3]> =
                (0..20).map(|k| [f64::from(k), f64::from(k * k), 1.0]).collect();
            points[4][2] = wrong;
            let error = evaluate_form(&points, feature).unwrap_err();
            assert!(matches!(error, FormError::Coordinate { number: 5, .. }), "{error}");
        }
    }
}

#[test]
fn points_that_do_not_determine_the_feature() {
    let number = |k: i32| f64::from(k);
    let line: Vec<[f64; 3]> =
        (0..20).map(|k| [1e4 + number(k), 2.0 * number(k), 3.0 * number(k)]).collect();
    for feature in [ALL[0], ALL[2], ALL[3], ALL[4]] {
        assert!(refused(&line, feature).contains("points on one straight line"));
    }
    let circle: Vec<[f64; 3]> =
        (0..20).map(|k| [number(k).cos(), 1e4 + number(k).sin(), 7.0]).collect();
    for feature in [ALL[3], ALL[4]] {
        assert!(refused(&circle, feature).contains("points in one plane"));
    }
    let expected = "line: found points as broad as they are long, expected points near a line";
    assert_eq!(refused(&circle, ALL[1]), expected);
    let cube: Vec<[f64; 3]> =
        (0..8).map(|k| [number(k & 1), number(k >> 1 & 1), number(k >> 2)]).collect();
    assert!(refused(&cube, ALL[2]).contains("as high as they are broad"));
    assert!(refused(&cube, ALL[0]).contains("do not lie near a plane"));
    // In the plane of y and z, points along x coincide.
    let along_x = Feature::Line { plane: Some(CoordinatePlane::Yz) };
    let axis: Vec<[f64; 3]> = (0..9).map(|k| [number(k), 0.0, 0.0]).collect();
    assert!(refused(&axis, along_x).contains("found 1 different points"));
    let in_plane = Feature::Circle { plane: Some(CoordinatePlane::Zx) };
    assert!(
        refused(&circle, in_plane)
            .contains("points on one straight line in the plane of the circle")
    );
}

#[test]
fn a_cylinder_is_no_cone() {
    let mut points = Vec::new();
    for k in 0..60 {
        let t = f64::from(k);
        points.push([10.0 * t.cos(), 10.0 * t.sin(), f64::from(k % 7) * 5.0]);
    }
    let expected =
        "cone: found sides that are parallel, expected a cone: for this shape ask for a cylinder";
    assert_eq!(refused(&points, Feature::Cone), expected);
}

#[test]
fn tables_of_points() {
    let read = parse_points("Z mm;x;Y [mm];name\n3,5;1;2;a\n\n6;4;5;b\n", "p.csv").unwrap();
    assert_eq!(read.points_mm, [[1.0, 2.0, 3.5], [4.0, 5.0, 6.0]]);
    assert_eq!(read.lines, [2, 4]);
    assert_eq!(read.notes, ["columns that are not read: name"]);
    for [text, message] in &cases(
        r"
 | p.csv: found nothing in the file, expected the header `x,y,z`
x,y,z\n | p.csv:1: header: found no row under the header
x,y\n1,2\n | p.csv:1: header: found `x,y`, expected columns x, y and z in mm: `z` is missing
x_mm,y_in,z\n1,2,3\n | p.csv:1: header: found column `y_in` in in, expected mm: y or y_mm
x,y,z,X mm\n1,2,3,4\n | p.csv:1: header: found columns `x` and `X mm`, expected one for x
x,y,z\n1,2,3\n1,nan,3\n | p.csv:3: y: found `nan`, expected a finite number
x,y,z\n1,2,4e9\n | p.csv:2: z: found `4e9`, expected at most 1000000000 mm
x,y,z\n1,2\n | p.csv:2:
",
    ) {
        let error = parse_points(text, "p.csv").unwrap_err().to_string();
        assert!(error.starts_with(message), "{error}");
    }
}

/// Arbitrary points give a finite result or an error. Many sets of points are coincident or on a line, plane or circle,
/// with huge, tiny or non-finite coordinates.
#[test]
fn arbitrary_points_give_a_finite_result_or_an_error() {
    let mut rng = ChaCha8Rng::seed_from_u64(31);
    let odd = [0.0, -0.0, 1e9, -1e9, 1e-300, 5e-324, f64::NAN, f64::INFINITY, 1e-9];
    let (mut answers, mut refusals) = (0, 0);
    for case in 0..400 {
        let grid = f64::from(rng.random_range(1..5));
        let points: Vec<[f64; 3]> = (0..rng.random_range(0..14))
            .map(|_| {
                std::array::from_fn(|_| match rng.random_range(0..60) {
                    k if k < case % 4 => odd[rng.random_range(0..odd.len())],
                    _ => f64::floor(rng.random_range(0.0..=grid)),
                })
            })
            .collect();
        let plane = Some(CoordinatePlane::Yz);
        let in_plane = [Feature::Circle { plane }, Feature::Line { plane }];
        for feature in ALL.into_iter().chain(in_plane) {
            let Ok(form) = evaluate_form(&points, feature) else {
                refusals += 1;
                continue;
            };
            answers += 1;
            let zone = form.minimum_zone.as_ref();
            let numbers = [form.deviation_mm, form.rms_mm];
            let numbers = numbers.into_iter().chain(form.position_mm);
            let numbers = numbers.chain(form.direction).chain(form.radius_mm);
            let mut numbers = numbers.chain(zone.map(|zone| zone.deviation_mm));
            assert!(numbers.all(f64::is_finite), "{points:?} {form:?}");
            if let Some(zone) = zone {
                let rounding = 1e-9 * form.deviation_mm.max(1.0);
                assert!(zone.deviation_mm <= form.deviation_mm + rounding, "{points:?} {form:?}");
            }
        }
    }
    assert!(answers > 100 && refusals > 100, "{answers} {refusals}");
}

/// Points on a cone of half angle `psi` (rad) with its apex at the origin, from s to s + length along z. For `psi` = 0
/// they are on a cylinder of this radius.
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
            let (s, t) =
                (from + length * rng.random_range(0.0..1.0), turn * rng.random_range(0.0..1.0));
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
            near(between(form.direction, motion.turned([0.0, 0.0, 1.0])), 0.0, 1e-9);
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
                // The direction is from the apex into the cone.
                near(distance(form.direction, motion.turned([0.0, 0.0, 1.0])), 0.0, 1e-9);
                // The apex of a slender cone is far from the points.
                near(distance(form.position_mm, motion.moved([0.0; 3])), 0.0, 1e-9 / psi.sin());
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
                // Multiples of 2⁻²⁰ mm are exact in f64 with and without the offset.
                *x = ((*x + 0.01 * rng.random_range(-1.0..1.0)) * 1048576.0).round() / 1048576.0;
            }
        }
        let here = evaluate_form(&points, feature).unwrap();
        let far: Vec<Point> = points.iter().map(|p| [p[0] + 1e5, p[1] - 1e5, p[2] + 1e5]).collect();
        let there = evaluate_form(&far, feature).unwrap();
        near(there.deviation_mm, here.deviation_mm, 1e-10);
        near(there.rms_mm, here.rms_mm, 1e-11);
        near(distance(there.direction, here.direction), 0.0, 1e-12);
    }
}

#[test]
fn coaxiality_is_twice_the_largest_distance() {
    let datum = DatumAxis::new([10.0, 0.0, 0.0], [0.0, 0.0, 7.0]).unwrap();
    // The axis is 0.01 mm off the datum at z = 0 and 0.03 mm at z = 100 mm.
    let axis = Axis { ends_mm: [[10.01, 0.0, 0.0], [10.0, 0.03, 100.0]] };
    near(axis.coaxiality_mm(&datum), 0.06, 1e-14);
    // A cylinder of 80 mm that is inclined by 1 mrad about its middle, which is 0.005 mm off the datum.
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
    near(form.axis.unwrap().coaxiality_mm(&datum), 2.0 * farthest, 1e-9);
    // Twice the distance of the circle's centre from the datum, in the plane of the circle.
    let circle: Vec<Point> =
        round(12, |_| 5.0).iter().map(|p| [p[0] + 10.003, p[1] + 0.004, 9.0]).collect();
    let circle = evaluate_form(&circle, CIRCLE).unwrap();
    near(circle.axis.unwrap().coaxiality_mm(&datum), 0.010, 1e-10);
    assert!(evaluate_form(&points, CIRCLE_XY).is_ok());
    let none = DatumAxis::new([0.0; 3], [0.0; 3]).unwrap_err();
    assert!(matches!(none, FormError::Direction { .. }));
}

#[test]
fn two_circles_determine_the_cone_on_one_side_of_its_apex() {
    let ring = |r: f64, z: f64| round(16, move |_| r).into_iter().map(move |p| [p[0], p[1], z]);
    let points: Vec<Point> = ring(10.0, 10.0).chain(ring(20.0, 20.0)).collect();
    let form = evaluate_form(&points, Feature::Cone).unwrap();
    near(form.half_angle_rad.unwrap().to_degrees(), 45.0, 1e-9);
    near(distance(form.position_mm, [0.0; 3]), 0.0, 1e-9);
}

fn any_feature(rng: &mut ChaCha8Rng) -> Vec<(Feature, Vec<Point>)> {
    let mut roughen = |points: Vec<Point>| -> Vec<Point> {
        let noise = |x: f64, rng: &mut ChaCha8Rng| x + rng.random_range(-0.02..0.02);
        points.into_iter().map(|p| p.map(|x| noise(x, rng))).collect()
    };
    let plane = (0..30).map(|k| [f64::from(k % 6) * 20.0, f64::from(k / 6) * 30.0, 0.0]);
    let line = (0..20).map(|k| [f64::from(k) * 10.0, 0.0, 0.0]);
    let mut seeded = ChaCha8Rng::seed_from_u64(12);
    vec![
        (CIRCLE, roughen(round(25, |_| 40.0))),
        (Feature::Plane, roughen(plane.collect())),
        (Feature::Line { plane: None }, roughen(line.collect())),
        (Feature::Cylinder, roughen(conical(&mut seeded, 40, 0.0, 20.0, 70.0, TAU))),
        (Feature::Cone, roughen(conical(&mut seeded, 40, 0.5, 20.0, 70.0, TAU))),
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

/// Points of a slightly oval cone that alternate between a few heights are fitted within 1.1 µm. In such points, each
/// n-th point has the same height, and a selection of these would not determine the cone.
#[test]
fn heights_in_turn_make_a_cone() {
    let slope = 15.0_f64.to_radians();
    for around in [361_u32, 600, 720] {
        let points: Vec<Point> = (0..around)
            .flat_map(|k| {
                let turn = f64::from(k) * TAU / f64::from(around);
                [0.0, 15.0, 30.0].map(|h: f64| {
                    let r = 100.0 - h * slope.sin() + 5e-4 * (2.0 * turn + h).sin();
                    let z = 20.0 + h * slope.cos();
                    [30.0 + r * turn.cos(), 20.0 + r * turn.sin(), z]
                        .map(|x| (x * 1e9).round() * 1e-9)
                })
            })
            .collect();
        let form = evaluate_form(&points, Feature::Cone).expect("a cone");
        assert!(form.deviation_mm < 1.1e-3, "{around}: {form:?}");
        let half = form.half_angle_rad.expect("an angle");
        assert!((half - slope).abs() < 1e-5);
    }
}
