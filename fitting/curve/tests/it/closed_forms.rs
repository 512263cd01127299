//! Curves compared with closed forms, with SciPy, and with a second implementation of moving least squares.

use std::collections::BTreeMap;

use nalgebra::{DMatrix, DVector};
use proptest::prelude::*;
use volcomp_curve::{BSpline, Chebyshev, Curve, Fourier, MovingLeastSquares, Polynomial, Table};

fn close(found: f64, expected: f64) {
    assert!((found - expected).abs() <= 1e-12 * (1.0 + expected.abs()), "{found} != {expected}");
}

#[test]
fn polynomial_of_the_machine_file() {
    let exx = Polynomial::new(vec![0.0, 0.0073, -2.1e-7], [0.0, 8000.0]).unwrap();
    close(exx.value(4000.0), 0.0073 * 4000.0 - 2.1e-7 * 16e6);
    close(exx.derivative(4000.0), 0.0073 - 4.2e-7 * 4000.0);
    close(exx.value(9000.0), exx.value(8000.0));
    assert_eq!(exx.derivative(8000.1), 0.0);
    assert!(exx.derivative(8000.0) != 0.0);
}

#[test]
fn chebyshev_is_the_cosine_of_multiple_angles() {
    let coefficients = vec![0.4, -1.2, 3.0, 0.7, -2.2];
    let eyx = Chebyshev::new(coefficients.clone(), [100.0, 8000.0]).unwrap();
    for i in 1..20 {
        let angle = f64::from(i) * 0.15;
        let x = 4050.0 + 3950.0 * angle.cos();
        let terms = coefficients.iter().zip(0_u32..).map(|(c, k)| (c, f64::from(k)));
        let value: f64 = terms.clone().map(|(c, k)| c * (k * angle).cos()).sum();
        let slope: f64 = terms.map(|(c, k)| c * k * (k * angle).sin() / angle.sin()).sum();
        close(eyx.value(x), value);
        close(eyx.derivative(x), slope / 3950.0);
    }
    // The coefficient c0 is not halved; at the upper end all terms are 1.
    close(eyx.value(8000.0), 0.4 - 1.2 + 3.0 + 0.7 - 2.2);
}

#[test]
fn fourier_of_the_machine_file() {
    let eac = Fourier::new(vec![0.5, 3.0, -1.2, 0.3, 0.2], 360.0, [-360.0, 360.0]).unwrap();
    for degrees in [-350.0, -90.0, 0.0, 33.0, 270.0_f64] {
        let q = degrees.to_radians();
        let value =
            0.5 + 3.0 * q.cos() - 1.2 * q.sin() + 0.3 * (2.0 * q).cos() + 0.2 * (2.0 * q).sin();
        let slope = -3.0 * q.sin() - 1.2 * q.cos() - 0.6 * (2.0 * q).sin() + 0.4 * (2.0 * q).cos();
        close(eac.value(degrees), value);
        close(eac.derivative(degrees), slope.to_radians());
    }
}

#[test]
fn linear_table_of_the_machine_file() {
    let ezx = Table::linear(vec![[0.0, 0.0], [400.0, 1.5], [500.0, 1.0]]).unwrap();
    close(ezx.value(100.0), 0.375);
    close(ezx.derivative(0.0), 1.5 / 400.0);
    close(ezx.derivative(400.0), -0.005);
    close(ezx.derivative(500.0), -0.005);
    close(ezx.value(-3.0), 0.0);
}

#[test]
fn cubic_bspline_with_bezier_knots_is_the_bernstein_polynomial() {
    let knots = vec![0.0, 0.0, 0.0, 0.0, 2.0, 2.0, 2.0, 2.0];
    let spline = BSpline::new(knots, vec![1.0, -2.0, 4.0, 0.5], 3).unwrap();
    for i in 0..=8 {
        let s = f64::from(i) / 8.0;
        let r = 1.0 - s;
        let value = r * r * r - 6.0 * s * r * r + 12.0 * s * s * r + 0.5 * s * s * s;
        close(spline.value(2.0 * s), value);
    }
}

#[test]
fn constant_is_unbounded() {
    let constant = Curve::constant(12.0).unwrap();
    assert_eq!(constant.value(1e300), 12.0);
    assert_eq!(constant.derivative(1.0), 0.0);
    assert!(constant.contains(f64::INFINITY) && !constant.contains(f64::NAN));
    assert_eq!(constant.domain(), None);
    assert!(constant.breakpoints().is_empty());
}

#[test]
fn breakpoints_are_sorted_and_inside() {
    let table = Table::cubic(vec![[0.0, 1.0], [2.0, 3.0], [5.0, 0.0]]).unwrap();
    assert_eq!(Curve::Table(table).breakpoints(), [0.0, 2.0, 5.0]);
    let knots = vec![-1.0, 0.0, 1.0, 1.0, 3.0, 4.0];
    let spline = BSpline::new(knots, vec![0.0; 3], 2).unwrap_err();
    assert!(spline.to_string().contains("domain [1, 1]"), "{spline}");
    let spline = BSpline::new(vec![-1.0, 0.0, 1.0, 2.0, 3.0, 4.0, 5.0], vec![0.0; 4], 2).unwrap();
    assert_eq!(Curve::BSpline(spline).breakpoints(), [1.0, 2.0, 3.0]);
}

type Rows = BTreeMap<(&'static str, &'static str), Vec<Vec<f64>>>;

fn golden() -> Rows {
    let mut rows = Rows::new();
    for line in include_str!("../reference/scipy.csv").lines().filter(|l| !l.starts_with('#')) {
        let mut parts = line.split(',');
        let key = (parts.next().unwrap(), parts.next().unwrap());
        rows.entry(key).or_default().push(parts.map(|p| p.parse().unwrap()).collect());
    }
    rows
}

fn compare(curve: &Curve, expected: &[Vec<f64>], case: &str) {
    for row in expected {
        let [x, value, slope] = row[..] else { panic!("{case}: {row:?}") };
        for (found, expected) in [(curve.value(x), value), (curve.derivative(x), slope)] {
            let difference = (found - expected).abs();
            assert!(
                difference < 1e-11 * (1.0 + expected.abs()),
                "{case} at {x}: {found} {expected}"
            );
        }
    }
}

#[test]
fn monotone_cubic() {
    let rows = golden();
    let cases: Vec<_> = rows.iter().filter(|((kind, _), _)| *kind == "pchip").collect();
    assert_eq!(cases.len(), 5);
    for ((_, case), expected) in cases {
        let nodes = rows[&("node", *case)].iter().map(|n| [n[0], n[1]]).collect();
        compare(&Table::cubic(nodes).unwrap().into(), expected, case);
    }
}

#[test]
fn bspline_of_every_degree() {
    let rows = golden();
    let cases: Vec<_> = rows.iter().filter(|((kind, _), _)| *kind == "bspline").collect();
    assert_eq!(cases.len(), 10);
    for ((_, case), expected) in cases {
        let degree = case[case.len() - 1..].parse().unwrap();
        let column = |kind| rows[&(kind, *case)].iter().map(|r| r[0]).collect::<Vec<_>>();
        let spline = BSpline::new(column("knot"), column("coefficient"), degree).unwrap();
        compare(&spline.into(), expected, case);
    }
}

/// The formula as published: Chebyshev polynomials over the whole range, Gaussian weights with compact support, and
/// normal equations solved by singular value decomposition.
fn reference(nodes: &[[f64; 2]], order: usize, support: f64, shape: f64, x: f64) -> f64 {
    let (start, end) = (nodes[0][0], nodes[nodes.len() - 1][0]);
    let h = support * (end - start);
    let t = |x: f64| 2.0 * (x - start) / (end - start) - 1.0;
    let chebyshev = |k: usize, x: f64| (k as f64 * t(x).clamp(-1.0, 1.0).acos()).cos();
    let weight = |xj: f64| {
        let d = (x - xj).abs();
        let edge = (-shape * shape).exp();
        if d < h { ((-(shape * d / h).powi(2)).exp() - edge) / (1.0 - edge) } else { 0.0 }
    };
    let roots: Vec<f64> = nodes.iter().map(|n| weight(n[0]).max(0.0).sqrt()).collect();
    let matrix =
        DMatrix::from_fn(nodes.len(), order + 1, |j, k| roots[j] * chebyshev(k, nodes[j][0]));
    let right = DVector::from_fn(nodes.len(), |j, _| roots[j] * nodes[j][1]);
    let a = matrix.svd(true, true).solve(&right, 1e-14).unwrap();
    (0..=order).map(|k| a[k] * chebyshev(k, x)).sum()
}

fn wavy(count: u32) -> Vec<[f64; 2]> {
    (0..count)
        .map(|i| {
            let x = f64::from(i) * 400.0 + 37.0 * (f64::from(i) * 1.7).sin();
            [x, 30.0 * (x / 900.0).sin() + 5.0 * (x / 310.0).cos()]
        })
        .collect()
}

#[test]
fn is_the_weighted_least_squares_value() {
    for (order, support, shape) in [
        (0, 0.3, 3.0),
        (1, 0.2, 3.0),
        (4, 1.0 / 3.0, 3.0),
        (2, 1.5, 0.1),
        (6, 0.6, 2.0),
        (8, 1.0, 3.0),
    ] {
        let nodes = wavy(21);
        let curve = MovingLeastSquares::new(nodes.clone(), order, support, shape).unwrap();
        let [start, end] = curve.domain();
        for i in 0..=333 {
            let x = start + (end - start) * f64::from(i) / 333.0;
            let expected = reference(&nodes, order, support, shape, x);
            let found = curve.value(x);
            assert!((found - expected).abs() < 1e-7, "order {order} at {x}: {found} {expected}");
        }
    }
}

#[test]
fn of_the_machine_file() {
    let nodes = vec![[0.0, 0.0], [1000.0, 2.2], [2000.0, 1.0], [3000.0, -0.5], [4000.0, 0.3]];
    let eyy = MovingLeastSquares::new(nodes.clone(), 2, 0.8, 3.0).unwrap();
    for x in [0.0, 500.0, 1234.5, 2000.0, 3999.0, 4000.0] {
        assert!((eyy.value(x) - reference(&nodes, 2, 0.8, 3.0, x)).abs() < 1e-10);
    }
}

#[test]
fn as_many_positive_weights_as_coefficients_interpolate() {
    let nodes = vec![[0.0, 1.0], [1.0, 4.0], [2.0, -2.0]];
    let curve = MovingLeastSquares::new(nodes.clone(), 2, 1.0 + 1e-6, 3.0).unwrap();
    for [x, u] in nodes {
        assert!((curve.value(x) - u).abs() < 1e-9);
    }
}

/// A fit of order 6 contains the fits of all lower orders, each with a bound of its condition number.
#[test]
fn lower_orders_are_nested() {
    let nodes = wavy(21);
    let curve = |order| MovingLeastSquares::new(nodes.clone(), order, 0.5, 3.0).unwrap();
    let between = nodes.windows(2).map(|n| 0.3 * n[0][0] + 0.7 * n[1][0]);
    let places = nodes.iter().map(|n| n[0]).enumerate();
    for (place, x) in places.chain(between.map(|x| (usize::MAX, x))) {
        let found = curve(6).nested(x);
        for order in 0..=6 {
            let (value, influence) = curve(order).value_and_influence(x, place);
            assert!((found.values[order] - value).abs() < 1e-9, "{order} {x}");
            assert!((found.influences[order] - influence).abs() < 1e-9);
            let rows = curve(order).design(x);
            let matrix = DMatrix::from_fn(rows.len(), order + 1, |row, column| rows[row][column]);
            let values = matrix.singular_values();
            let condition = values.min() / values.max();
            let bound = found.conditions[order] * (1.0 - 1e-6);
            assert!(bound <= condition, "{order} {x}: {bound} {condition}");
            assert!(bound * (order + 1) as f64 >= 0.9 * condition);
        }
    }
}

#[test]
fn influences_make_the_value() {
    let nodes = wavy(21);
    let curve = MovingLeastSquares::new(nodes.clone(), 4, 1.0 / 3.0, 3.0).unwrap();
    for x in [0.0, 1234.0, nodes[20][0]] {
        let sum: f64 = nodes.iter().enumerate().map(|(j, n)| curve.influence(x, j) * n[1]).sum();
        assert!((sum - curve.value(x)).abs() < 1e-9);
    }
    for x in [-50.0, 0.0, 1234.0, nodes[20][0], 1e9] {
        for node in [0, 3, 20, 21] {
            let both = curve.value_and_influence(x, node);
            assert_eq!(both, (curve.value(x), curve.influence(x, node)));
        }
    }
    assert!(curve.value_and_influence(f64::NAN, 3).0.is_nan());
    assert_eq!(curve.influence(100.0, 21), 0.0);
    assert_eq!(curve.influence(0.0, 20), 0.0);
}

#[test]
fn breakpoints_hold_nodes_and_ends_of_supports() {
    let nodes = vec![[0.0, 0.0], [1.0, 2.0], [2.0, 1.0], [3.0, 0.0], [4.0, 0.0]];
    let curve = Curve::from(MovingLeastSquares::new(nodes, 1, 0.625, 3.0).unwrap());
    assert_eq!(curve.breakpoints(), [0.0, 0.5, 1.0, 1.5, 2.0, 2.5, 3.0, 3.5, 4.0]);
}

proptest! {
    #[test]
    fn reproduces_polynomials_up_to_its_order(
        order in 0_usize..=6,
        coefficients in prop::collection::vec(-10.0..10.0, 7),
        gaps in prop::collection::vec(0.6..1.4, 20),
        place in 0.0..1.0,
    ) {
        let p = |s: f64| coefficients[..=order].iter().rev().fold(0.0, |v, c| v * s + c);
        let slope = |s: f64| {
            (1..=order).rev().fold(0.0, |v, k| v * s + k as f64 * coefficients[k])
        };
        let mut x = 1000.0;
        let nodes: Vec<[f64; 2]> = gaps.iter().map(|g| {
            x += 100.0 * g;
            [x, p((x - 2000.0) / 1000.0)]
        }).collect();
        let curve = MovingLeastSquares::new(nodes, order, 0.6, 3.0).unwrap();
        let [start, end] = curve.domain();
        let x = start + place * (end - start);
        let s = (x - 2000.0) / 1000.0;
        prop_assert!((curve.value(x) - p(s)).abs() < 1e-8);
        prop_assert!((curve.derivative(x) - slope(s) / 1000.0).abs() < 1e-8);
    }
}
