//! Tests of cylinders, cones, coaxiality, large offsets and rigid motions.

use std::f64::consts::TAU;

use proptest::prelude::*;
use rand::SeedableRng as _;
use rand_chacha::ChaCha8Rng;
use volcomp_metrology::form::{Axis, DatumAxis, Feature, Form, FormError, evaluate_form};

use crate::form::{CIRCLE, CIRCLE_XY, Motion, Point, between, distance, round};
use crate::samples::near;

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
