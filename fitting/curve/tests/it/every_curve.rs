//! Properties that hold for every kind of curve.

use proptest::prelude::*;
use volcomp_curve::{
    BSpline, Chebyshev, Curve, ErrorCurve, Field, Fourier, Grid, MovingLeastSquares, Polynomial,
    Table,
};
use volcomp_vocabulary::Direction;

fn nodes() -> impl Strategy<Value = Vec<[f64; 2]>> {
    (-500.0..500.0, prop::collection::vec((5.0..50.0, -20.0..20.0), 8..24)).prop_map(
        |(start, steps)| {
            let mut x: f64 = start;
            steps
                .into_iter()
                .map(|(gap, u): (f64, f64)| {
                    x += gap;
                    [x, u]
                })
                .collect()
        },
    )
}

fn coefficients() -> impl Strategy<Value = Vec<f64>> {
    prop::collection::vec(-10.0..10.0, 1..8)
}

fn domain() -> impl Strategy<Value = [f64; 2]> {
    (-500.0..500.0, 10.0..800.0).prop_map(|(lower, width)| [lower, lower + width])
}

fn curve() -> impl Strategy<Value = Curve> {
    let polynomial = (coefficients(), domain()).prop_map(|(mut c, d)| {
        c.iter_mut().enumerate().for_each(|(k, c)| *c /= 500_f64.powf(k as f64));
        Polynomial::new(c, d).unwrap().into()
    });
    let chebyshev =
        (coefficients(), domain()).prop_map(|(c, d)| Chebyshev::new(c, d).unwrap().into());
    let fourier = (coefficients(), domain(), 100.0..1000.0).prop_map(|(mut c, d, period)| {
        c.truncate((c.len() - 1) / 2 * 2 + 1);
        Fourier::new(c, period, d).unwrap().into()
    });
    let bspline = (nodes(), 1_usize..=5).prop_map(|(nodes, degree)| {
        let knots: Vec<f64> = nodes.iter().map(|n| n[0]).collect();
        // Short knot vectors permit only lower degrees.
        let degree = degree.min(knots.len() / 2 - 1);
        let c = nodes[..knots.len() - degree - 1].iter().map(|n| n[1]).collect();
        BSpline::new(knots, c, degree).unwrap().into()
    });
    let mls =
        (nodes(), 0_usize..4, 0.9..1.5, 0.5..4.0).prop_map(|(nodes, order, support, shape)| {
            MovingLeastSquares::new(nodes, order, support, shape).unwrap().into()
        });
    prop_oneof![
        (-50.0..50.0).prop_map(Curve::Constant),
        polynomial,
        chebyshev,
        fourier,
        nodes().prop_map(|n| Table::linear(n).unwrap().into()),
        nodes().prop_map(|n| Table::cubic(n).unwrap().into()),
        bspline,
        mls,
    ]
}

/// The coordinate at the fraction `place` (0 to 1) of the domain.
fn inside(curve: &Curve, place: f64) -> f64 {
    let [lower, upper] = curve.domain().unwrap_or([0.0, 1.0]);
    (lower + place * (upper - lower)).clamp(lower, upper)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(1000))]

    #[test]
    fn derivative_is_the_limit_of_differences(curve in curve(), place in 0.0..1.0) {
        let x = inside(&curve, place);
        let step = 1e-4;
        let near = |b: &f64| (b - x).abs() < 10.0 * step;
        prop_assume!(!curve.breakpoints().iter().any(near));
        let difference = (curve.value(x + step) - curve.value(x - step)) / (2.0 * step);
        let slope = curve.derivative(x);
        prop_assert!((slope - difference).abs() < 1e-5 * (1.0 + slope.abs()), "{} {}", slope, difference);
    }

    #[test]
    fn is_continuous_across_breakpoints(curve in curve()) {
        for b in curve.breakpoints() {
            let (left, at, right) = (curve.value(b - 1e-7), curve.value(b), curve.value(b + 1e-7));
            prop_assert!((left - at).abs() < 1e-4, "{} {} left of {}", left, at, b);
            prop_assert!((right - at).abs() < 1e-4, "{} {} right of {}", at, right, b);
        }
    }

    #[test]
    fn holds_its_end_value_outside(curve in curve(), beyond in 2e-9..1e6) {
        if let Some([lower, upper]) = curve.domain() {
            for (end, outside) in [(lower, lower - beyond), (upper, upper + beyond)] {
                prop_assert!(curve.contains(end));
                prop_assert!(!curve.contains(outside));
                prop_assert_eq!(curve.value(outside), curve.value(end));
                prop_assert_eq!(curve.derivative(outside), 0.0);
            }
            prop_assert_eq!(curve.value(f64::INFINITY), curve.value(upper));
            prop_assert_eq!(curve.value(f64::NEG_INFINITY), curve.value(lower));
        }
    }

    #[test]
    fn nan_gives_nan(curve in curve()) {
        prop_assert!(curve.value(f64::NAN).is_nan());
        prop_assert!(curve.derivative(f64::NAN).is_nan());
        prop_assert!(!curve.contains(f64::NAN));
    }

    #[test]
    fn offset_adds_and_scaled_multiplies_by_a_constant(curve in curve(), place in 0.0..1.0, c in -100.0..100.0) {
        let x = inside(&curve, place);
        let raised = curve.clone().offset(c);
        prop_assert_eq!(std::mem::discriminant(&raised), std::mem::discriminant(&curve));
        prop_assert!((raised.value(x) - curve.value(x) - c).abs() < 1e-8);
        prop_assert!((raised.derivative(x) - curve.derivative(x)).abs() < 1e-7);
        let scaled = curve.clone().scaled(c);
        prop_assert!((scaled.value(x) - c * curve.value(x)).abs() < 1e-8);
    }

    #[test]
    fn tables_go_through_their_nodes_and_cubics_do_not_overshoot(nodes in nodes(), place in 0.0..1.0) {
        let cubic = Table::cubic(nodes.clone()).unwrap();
        let linear = Table::linear(nodes.clone()).unwrap();
        for &[x, u] in &nodes {
            prop_assert_eq!(cubic.value(x), u);
            prop_assert_eq!(linear.value(x), u);
        }
        for pair in nodes.windows(2) {
            let x = pair[0][0] + place * (pair[1][0] - pair[0][0]);
            let (low, high) = (pair[0][1].min(pair[1][1]), pair[0][1].max(pair[1][1]));
            prop_assert!((low - 1e-9..=high + 1e-9).contains(&cubic.value(x)));
        }
    }
}

/// A Fourier series whose period may be much shorter than its domain, like the pitch of a ball screw.
fn periodic() -> impl Strategy<Value = Curve> {
    let harmonics = prop::collection::vec(-10.0..10.0, 1..4);
    (harmonics, domain(), 0.05..100.0).prop_map(|(pairs, d, period): (Vec<f64>, _, _)| {
        let c = core::iter::once(1.0).chain(pairs.iter().flat_map(|a| [*a, 3.0 - a]));
        Fourier::new(c.collect(), period, d).unwrap().into()
    })
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(300))]

    /// The extremes at the sampling positions equal those at 40 000 positions within 4 % of the range of values.
    #[test]
    fn places_show_the_extremes(curve in prop_oneof![curve(), periodic()]) {
        let range = |values: &mut dyn Iterator<Item = f64>| {
            values.fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], x| [low.min(x), high.max(x)])
        };
        let places = curve.places();
        if let Curve::Constant(_) = curve {
            prop_assert!(places.is_empty());
            return Ok(());
        }
        prop_assert!(places.is_sorted() && places.iter().all(|x| curve.contains(*x)));
        prop_assert!(curve.breakpoints().iter().all(|x| places.contains(x)));
        prop_assert!(places.len() < 10_000, "{} places", places.len());
        let [low, high] = range(&mut places.iter().map(|x| curve.value(*x)));
        let dense = (0..=40_000).map(|k| curve.value(inside(&curve, f64::from(k) / 40_000.0)));
        let [least, most] = range(&mut dense.into_iter());
        let most_missed = 0.04 * (most - least) + 1e-9;
        prop_assert!(low <= least + most_missed && high >= most - most_missed,
            "{low} to {high} at {} places, {least} to {most} at all", places.len());
    }
}

/// A grid over Y (coordinate index 1) and Z (coordinate index 2).
fn sag() -> Grid {
    let values = vec![vec![0.0, 1.0, 2.0], vec![0.5, 1.5, 2.5]];
    Grid::new([1, 2], [vec![0.0, 500.0], vec![0.0, 650.0, 1050.0]], values).unwrap()
}

fn line(c0: f64, c1: f64) -> Field {
    Field::Curve(Polynomial::new(vec![c0, c1], [0.0, 10.0]).unwrap().into())
}

#[test]
fn grid_of_the_machine_file() {
    let grid = sag();
    assert_eq!(grid.value(&[9.0, 500.0, 1050.0]), 2.5);
    assert_eq!(grid.value(&[9.0, 0.0, 650.0]), 1.0);
    assert!((grid.value(&[9.0, 250.0, 325.0]) - 0.75).abs() < 1e-15);
    assert!((grid.value(&[9.0, 600.0, 850.0]) - 2.0).abs() < 1e-15);
    assert!((grid.partial(1, &[9.0, 250.0, 325.0]) - 0.001).abs() < 1e-15);
    assert!((grid.partial(2, &[9.0, 250.0, 850.0]) - 1.0 / 400.0).abs() < 1e-15);
    assert_eq!(grid.partial(0, &[9.0, 250.0, 850.0]), 0.0);
    assert_eq!(grid.partial(1, &[9.0, 500.1, 850.0]), 0.0);
    assert!(grid.partial(2, &[9.0, 500.1, 850.0]) > 0.0);
    assert!(grid.contains(&[9.0, 500.0, 0.0]) && !grid.contains(&[9.0, 500.0, -0.1]));
    assert!(grid.value(&[0.0, f64::NAN, 0.0]).is_nan());
    assert!(grid.partial(2, &[0.0, f64::NAN, 0.0]).is_nan());
}

#[test]
fn missing_coordinates_count_as_zero() {
    assert_eq!(sag().value(&[]), 0.0);
    assert_eq!(line(3.0, 1.0).value(7, &[1.0]), 3.0);
}

#[test]
fn branches() {
    let pair = ErrorCurve::Pair { forward: line(1.0, 2.0), backward: line(3.5, 1.0) };
    assert_eq!(pair.value(0, &[1.0], Some(Direction::Positive)), 3.0);
    assert_eq!(pair.value(0, &[1.0], Some(Direction::Negative)), 4.5);
    assert_eq!(pair.value(0, &[1.0], None), 3.75);
    assert_eq!(pair.derivative(0, &[1.0], None), 1.5);
    assert_eq!(pair.partial(1, 0, &[1.0, 2.0], Some(Direction::Positive)), 0.0);

    let reversal = ErrorCurve::with_reversal(line(1.0, 2.0), 3.5).unwrap();
    assert_eq!(reversal.value(0, &[1.0], Some(Direction::Positive)), 4.75);
    assert_eq!(reversal.value(0, &[1.0], Some(Direction::Negative)), 1.25);
    assert_eq!(reversal.value(0, &[1.0], None), 3.0);
    assert_eq!(reversal.derivative(0, &[1.0], Some(Direction::Negative)), 2.0);

    let single = ErrorCurve::from(Curve::Constant(4.0));
    assert_eq!(single.value(0, &[], Some(Direction::Negative)), 4.0);
}

#[test]
fn contains_checks_all_parts() {
    let short = Polynomial::new(vec![0.0], [0.0, 1.0]).unwrap();
    let pair = ErrorCurve::Pair { forward: line(0.0, 0.0), backward: Curve::from(short).into() };
    assert!(pair.contains(0, &[1.0]));
    assert!(!pair.contains(0, &[2.0]));
    assert_eq!(pair.fields().count(), 2);
}

proptest! {
    #[test]
    fn grid_partials_are_limits_of_differences(y in 1.0..499.0_f64, z in 1.0..1049.0_f64) {
        prop_assume!((z - 650.0).abs() > 1.0);
        let values = vec![vec![0.0, 1.0, -2.0], vec![0.5, 7.5, 2.5]];
        let grid =
            Grid::new([1, 2], [vec![0.0, 500.0], vec![0.0, 650.0, 1050.0]], values).unwrap();
        let by_y = (grid.value(&[0.0, y + 0.5, z]) - grid.value(&[0.0, y - 0.5, z])) / 1.0;
        let by_z = (grid.value(&[0.0, y, z + 0.5]) - grid.value(&[0.0, y, z - 0.5])) / 1.0;
        prop_assert!((grid.partial(1, &[0.0, y, z]) - by_y).abs() < 1e-12);
        prop_assert!((grid.partial(2, &[0.0, y, z]) - by_z).abs() < 1e-12);
    }
}
