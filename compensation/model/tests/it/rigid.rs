//! The best-fit rigid motion, compared with known rigid motions and a dense singular value decomposition.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use volcomp_kinematics::nalgebra::{DMatrix, DVector, Vector3};
use volcomp_model::{Lengths, RigidMotion, RigidSums};

type Point = (Vector3<f64>, Vector3<f64>);

fn best(points: &[Point]) -> RigidMotion {
    sums(points).motion()
}

fn sums(points: &[Point]) -> RigidSums {
    let mut sums = RigidSums::default();
    for (place, error) in points {
        sums.take(place, error);
    }
    sums
}

/// RMS and maximum of the residual, µm.
fn left_um(points: &[Point]) -> [f64; 2] {
    let motion = best(points);
    let mut lengths = Lengths::default();
    for (place, error) in points {
        lengths.take(&motion.left_mm(place, error));
    }
    [1e3 * lengths.rms(), 1e3 * lengths.max()]
}

/// Points on a regular grid over a box of this size with a corner at `from`, mm.
fn box_of(size: [f64; 3], from: [f64; 3]) -> Vec<Vector3<f64>> {
    let mut places = Vec::new();
    for index in 0..7 * 5 * 4 {
        let share = [
            f64::from(index % 7) / 6.0,
            f64::from(index / 7 % 5) / 4.0,
            f64::from(index / 35) / 3.0,
        ];
        places.push(Vector3::from_fn(|k, _| from[k] + size[k] * share[k]));
    }
    places
}

const BOXES: [([f64; 3], [f64; 3]); 6] = [
    ([20_000.0, 6_000.0, 3_000.0], [0.0; 3]),
    ([40_000.0, 8_000.0, 4_000.0], [-500.0, 0.0, 1_000.0]),
    ([600.0, 500.0, 400.0], [0.0, 0.0, -400.0]),
    ([100.0; 3], [1_000.0, 1_000.0, 500.0]),
    ([100.0; 3], [100_000.0, -100_000.0, 100_000.0]),
    ([40_000.0, 1.0, 0.1], [0.0; 3]),
];

#[test]
fn a_rigid_motion_leaves_nothing() {
    let motions = [
        ([0.0229, 0.0, 0.0], [0.0; 3]),
        ([0.4, -0.3, 0.2], [50e-6, -80e-6, 30e-6]),
        ([0.0; 3], [0.0, 0.0, 120e-6]),
    ];
    for (size, from) in BOXES {
        for (shift, turn) in motions {
            let (shift, turn) = (Vector3::from(shift), Vector3::from(turn));
            let points: Vec<Point> = box_of(size, from)
                .into_iter()
                .map(|place| (place, shift + turn.cross(&place)))
                .collect();
            let [rms, max] = left_um(&points);
            assert!(rms <= max && max < 1e-6, "{size:?} {from:?}: {rms} {max}");
            let found = best(&points);
            // For points within 0.1 mm of a line of 40 m, the rotation about the line has an effect of a few pm only.
            if size[2] > 1.0 {
                assert!((found.rotation_rad - turn).norm() < 1e-12, "{found:?}");
            }
            let orientation = found.left_rad(&turn);
            assert!(size[2] < 1.0 || orientation.norm() < 1e-12);
            let rms_um = 1e3 * sums(&points).rms_left_mm();
            assert!(rms_um < 1e-4, "{size:?} {from:?}: {rms_um}");
        }
    }
}

/// With random errors the residual equals that of a dense solution within 1e-6 µm.
#[test]
fn what_is_left_is_what_a_dense_decomposition_leaves() {
    let mut random = ChaCha8Rng::seed_from_u64(5);
    for (size, from) in BOXES {
        let points: Vec<Point> = box_of(size, from)
            .into_iter()
            .map(|place| {
                let error = Vector3::from_fn(|_, _| random.random_range(-0.05..0.05));
                (place, error)
            })
            .collect();
        let dense = dense_left_um(&points);
        let [rms, max] = left_um(&points);
        let [dense_rms, dense_max] = dense;
        assert!((rms - dense_rms).abs() < 1e-6, "{size:?}: {rms} {dense:?}");
        assert!((max - dense_max).abs() < 1e-6, "{size:?}: {max} {dense:?}");
        assert!((1e3 * sums(&points).rms_left_mm() - rms).abs() < 1e-6);
    }
}

/// RMS and maximum residual, µm, by least squares with a dense matrix of six normalised columns; points relative to the middle of their
/// range.
fn dense_left_um(points: &[Point]) -> [f64; 2] {
    let rows = 3 * points.len();
    let low = points.iter().fold(points[0].0, |a, p| a.inf(&p.0));
    let high = points.iter().fold(points[0].0, |a, p| a.sup(&p.0));
    let middle = (low + high) / 2.0;
    let matrix = DMatrix::from_fn(rows, 6, |row, column| {
        let (place, axis) = (points[row / 3].0 - middle, row % 3);
        let mut unit = Vector3::zeros();
        unit[column % 3] = 1.0;
        if column < 3 { unit[axis] } else { unit.cross(&place)[axis] }
    });
    let lengths: Vec<f64> = matrix.column_iter().map(|c| c.norm().max(1e-300)).collect();
    let scaled = DMatrix::from_fn(rows, 6, |row, column| matrix[(row, column)] / lengths[column]);
    let errors = DVector::from_fn(rows, |row, _| points[row / 3].1[row % 3]);
    let svd = scaled.clone().svd(true, true);
    let found = svd.solve(&errors, 1e-12).unwrap();
    let left = errors - scaled * found;
    let mut all = Lengths::default();
    for of in left.as_slice().chunks(3) {
        all.take(&Vector3::new(of[0], of[1], of[2]));
    }
    [1e3 * all.rms(), 1e3 * all.max()]
}

/// A rotation is zero only if the points do not determine it: about a line through all points, or any rotation about a single point.
#[test]
fn points_in_a_plane_on_a_line_or_at_one_place() {
    let turn = Vector3::new(20e-6, -30e-6, 40e-6);
    let shift = Vector3::new(0.01, 0.02, -0.03);
    let along = Vector3::new(3.0, -2.0, 6.0) / 7.0;
    let off_zero = Vector3::new(1e5, 2e4, -3e4);
    let across = Vector3::new(2.0, 6.0, 1.0).normalize();
    let point = |place: Vector3<f64>| (place, shift + turn.cross(&place));
    let line: Vec<Point> = (0..30).map(|k| point(off_zero + along * f64::from(k) * 11.3)).collect();
    let plane: Vec<Point> = (0..30)
        .map(|k| point(off_zero + along * f64::from(k) * 11.3 + across * f64::from(k % 4) * 70.0))
        .collect();
    let single = vec![point(off_zero); 5];
    for (points, seen) in
        [(&line, turn - along * along.dot(&turn)), (&plane, turn), (&single, Vector3::zeros())]
    {
        let found = best(points);
        assert!((found.rotation_rad - seen).norm() < 1e-11, "{found:?}");
        let [_, max] = left_um(points);
        assert!(max < 1e-6, "{max}");
    }
    let mut none = RigidSums::default();
    none.merge(&RigidSums::default());
    assert_eq!(none.motion().rotation_rad, Vector3::zeros());
    assert_eq!(none.rms_left_mm(), 0.0);
}

/// Merged partial sums equal the sums over all points.
#[test]
fn parts_are_put_together() {
    let mut random = ChaCha8Rng::seed_from_u64(9);
    let places = box_of([20_000.0, 6_000.0, 3_000.0], [0.0; 3]);
    let points: Vec<Point> = places
        .into_iter()
        .map(|p| (p, Vector3::from_fn(|_, _| random.random_range(-0.1..0.1))))
        .collect();
    let whole = best(&points);
    let mut parts = RigidSums::default();
    for part in points.chunks(17) {
        parts.merge(&sums(part));
    }
    let of_parts = parts.motion();
    assert!((whole.shift_mm - of_parts.shift_mm).norm() < 1e-15);
    assert!((whole.rotation_rad - of_parts.rotation_rad).norm() < 1e-18);
}

/// Numbers that are NaN, infinite or overflow do not panic.
#[test]
fn what_is_no_number_stays_none() {
    for bad in [f64::NAN, f64::INFINITY, 1e300] {
        let mut sums = RigidSums::default();
        for k in 0..4 {
            let place = Vector3::new(f64::from(k), bad, 1.0);
            sums.take(&place, &Vector3::repeat(bad));
        }
        let _ = (sums.motion(), sums.rms_left_mm());
    }
}
