//! Compares the evaluated features with those of SciPy in `tests/reference/form.py`.

use std::{
    f64::consts::TAU,
    fmt::Write as _,
    io::Write as _,
    process::{Command, Stdio},
};

use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;
use volcomp_metrology::form::{CoordinatePlane, Feature, evaluate_form};

use crate::form::{Motion, Point};
use crate::samples::near;

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
