//! Rejected points and tables, with their messages.

use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;
use volcomp_metrology::form::{CoordinatePlane, Feature, FormError, evaluate_form, parse_points};
use volcomp_test_support::cases;

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
