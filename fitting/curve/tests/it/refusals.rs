//! Invalid numbers are rejected. Arbitrary numbers give an error, or a curve that can be evaluated at any coordinate.

use proptest::collection::vec;
use proptest::prelude::*;
use volcomp_curve::{
    BSpline, Chebyshev, Curve, CurveError, ErrorCurve, Field, Fourier, Grid, MovingLeastSquares,
    Polynomial, Table, first_order_lag, first_order_lag_of_ramp,
};
use volcomp_vocabulary::Direction;

fn refused<T: std::fmt::Debug>(built: Result<T, CurveError>, message: &str) {
    assert_eq!(built.unwrap_err().to_string(), message);
}

const UNIT: [f64; 2] = [0.0, 1.0];
const NAN: f64 = f64::NAN;
const INF: f64 = f64::INFINITY;

#[test]
fn series() {
    refused(Curve::constant(NAN), "constant 0 is NaN: expected a finite number");
    refused(Polynomial::new(vec![], UNIT), "found 0 coefficients: expected at least 1");
    refused(
        Polynomial::new(vec![1.0, NAN], UNIT),
        "coefficient 1 is NaN: expected a finite number",
    );
    refused(Chebyshev::new(vec![INF], UNIT), "coefficient 0 is inf: expected a finite number");
    for domain in [[1.0, 1.0], [2.0, 1.0], [-f64::MAX, f64::MAX]] {
        let error = Polynomial::new(vec![1.0], domain).unwrap_err();
        assert!(matches!(error, CurveError::Domain { .. }), "{error}");
        assert!(Chebyshev::new(vec![1.0], domain).is_err());
        assert!(Fourier::new(vec![1.0], 1.0, domain).is_err());
    }
    refused(
        Polynomial::new(vec![1.0], [2.0, 1.0]),
        "domain [2, 1]: expected a lower end below the upper end, a finite distance apart",
    );
    refused(
        Polynomial::new(vec![1.0], [0.0, INF]),
        "domain end 1 is inf: expected a finite number",
    );
    refused(
        Fourier::new(vec![1.0, 2.0], 360.0, UNIT),
        "found 2 Fourier coefficients: expected an odd number, a0 and then pairs of cosine and sine",
    );
    for period in [0.0, -1.0, NAN, INF] {
        assert!(Fourier::new(vec![1.0], period, UNIT).is_err());
    }
    assert!(ErrorCurve::with_reversal(Curve::Constant(0.0).into(), INF).is_err());
}

#[test]
fn tables() {
    refused(Table::linear(vec![[0.0, 1.0]]), "found 1 nodes: expected at least 2");
    refused(
        Table::cubic(vec![[0.0, 1.0], [400.0, 2.0], [400.0, 3.0]]),
        "node abscissa 2 is 400, after 400: expected strictly increasing values",
    );
    refused(
        Table::linear(vec![[0.0, 1.0], [1.0, NAN]]),
        "node value 1 is NaN: expected a finite number",
    );
    refused(
        Table::linear(vec![[NAN, 1.0], [1.0, 2.0]]),
        "node abscissa 0 is NaN: expected a finite number",
    );
}

#[test]
fn bsplines() {
    let knots = |n: u32| (0..n).map(f64::from).collect::<Vec<_>>();
    refused(BSpline::new(knots(8), vec![0.0; 7], 0), "degree is 0: expected 1 to 5");
    refused(BSpline::new(knots(18), vec![0.0; 9], 6), "degree is 6: expected 1 to 5");
    refused(BSpline::new(knots(6), vec![0.0; 3], 3), "found 3 coefficients: expected at least 4");
    refused(
        BSpline::new(knots(8), vec![0.0; 5], 3),
        "found 8 knots for 5 coefficients of degree 3: expected coefficients + degree + 1 = 9",
    );
    refused(
        BSpline::new(vec![0.0, 1.0, 3.0, 2.0, 4.0, 5.0], vec![0.0; 4], 1),
        "knot 3 is 2, after 3: expected non-decreasing knots",
    );
    refused(
        BSpline::new(vec![0.0, 0.0, 2.0, 2.0, 4.0, 4.0], vec![0.0; 4], 1),
        "knot 2 stands 2 times inside the domain, from index 2: expected at most 1 times for degree 1",
    );
}

#[test]
fn moving_least_squares() {
    let nodes: Vec<[f64; 2]> = (0..11).map(|i| [f64::from(i), 0.0]).collect();
    let mls = |order, support, shape| MovingLeastSquares::new(nodes.clone(), order, support, shape);
    refused(
        mls(4, 0.3, 3.0),
        "support 0.3 gives fewer than 5 of 11 nodes a positive weight at 0: expected more than 0.4 for order 4, or a lower order",
    );
    // The curve can be built with the support that the message requires.
    assert!(mls(4, 0.4, 3.0).is_err());
    let curve = mls(4, 0.400001, 3.0).unwrap();
    for i in 0..=1000 {
        assert!(curve.value(f64::from(i) / 100.0).abs() < 1e-9);
    }
    refused(mls(9, 1.0, 3.0), "order is 9: expected 0 to 8");
    refused(mls(2, 0.0, 3.0), "support is 0: expected a positive finite number");
    refused(mls(2, 0.5, -1.0), "shape is -1: expected 1e-6 to 20");
    assert!(mls(2, NAN, 3.0).is_err() && mls(2, 0.5, NAN).is_err() && mls(2, INF, 3.0).is_err());
    let few = nodes[..3].to_vec();
    refused(MovingLeastSquares::new(few, 3, 1.0, 3.0), "found 3 nodes: expected at least 4");
    // A gap in the middle has the same effect as a missing end.
    let mut gap = nodes.clone();
    gap.drain(3..8);
    assert!(MovingLeastSquares::new(gap, 1, 0.29, 3.0).is_err());
}

#[test]
fn grids() {
    let nodes = || [vec![0.0, 1.0], vec![0.0, 1.0, 2.0]];
    let values = || vec![vec![0.0; 3]; 2];
    refused(
        Grid::new([1, 1], nodes(), values()),
        "both grid axes are coordinate 1: expected two different axes",
    );
    refused(
        Grid::new([0, 1], nodes(), vec![vec![0.0; 3]; 3]),
        "found 3 rows of values: expected 2, one for each node of the first axis",
    );
    refused(
        Grid::new([0, 1], nodes(), vec![vec![0.0; 3], vec![0.0; 2]]),
        "found 2 values in row 1: expected 3, one for each node of the second axis",
    );
    refused(
        Grid::new([0, 1], [vec![0.0], vec![0.0, 1.0]], vec![vec![0.0; 2]]),
        "found 1 nodes along an axis: expected at least 2",
    );
    refused(
        Grid::new([0, 1], [vec![0.0, 0.0], vec![0.0, 1.0, 2.0]], values()),
        "node of the first axis 1 is 0, after 0: expected strictly increasing values",
    );
    let mut bad = values();
    bad[1][2] = NAN;
    refused(
        Grid::new([0, 1], nodes(), bad),
        "grid value in column 2 is NaN: expected a finite number",
    );
}

fn number() -> impl Strategy<Value = f64> {
    prop_oneof![
        any::<f64>(),
        -10.0..10.0_f64,
        (0..4_u8).prop_map(f64::from),
        Just(f64::NAN),
        Just(f64::INFINITY),
        Just(f64::MAX),
        Just(f64::MIN_POSITIVE),
    ]
}

fn count() -> impl Strategy<Value = usize> {
    prop_oneof![0..10_usize, any::<usize>()]
}

/// Increasing nodes that constructors accept, with extreme values and gaps.
fn nodes() -> impl Strategy<Value = Vec<[f64; 2]>> {
    let rising = vec((prop_oneof![1e-300..1e-9, 0.1..10.0, 1e9..1e306_f64], number()), 0..12);
    let rising = rising.prop_map(|gaps| {
        let mut x = -5.0;
        gaps.into_iter()
            .map(|(gap, value)| {
                x += gap;
                [x, value]
            })
            .collect()
    });
    prop_oneof![rising, vec((number(), number()).prop_map(|(x, u)| [x, u]), 0..6)]
}

fn curve() -> impl Strategy<Value = Result<Curve, CurveError>> {
    let list = || vec(number(), 0..12);
    let domain = || prop_oneof![Just([-5.0, 5.0]), [number(), number()]];
    prop_oneof![
        number().prop_map(Curve::constant),
        (list(), domain()).prop_map(|(c, d)| Polynomial::new(c, d).map(Curve::from)),
        (list(), domain()).prop_map(|(c, d)| Chebyshev::new(c, d).map(Curve::from)),
        (list(), number(), domain()).prop_map(|(c, p, d)| Fourier::new(c, p, d).map(Curve::from)),
        nodes().prop_map(|n| Table::linear(n).map(Curve::from)),
        nodes().prop_map(|n| Table::cubic(n).map(Curve::from)),
        (list(), list(), count(), any::<bool>()).prop_map(
            |(mut knots, coefficients, degree, sorted)| {
                if sorted {
                    knots.sort_by(f64::total_cmp);
                    knots.resize(coefficients.len() + degree.min(9) + 1, 99.0);
                }
                BSpline::new(knots, coefficients, degree).map(Curve::from)
            }
        ),
        (nodes(), count(), number(), number()).prop_map(|(n, order, support, shape)| {
            MovingLeastSquares::new(n, order, support, shape).map(Curve::from)
        }),
    ]
}

fn ask(curve: &Curve, x: f64) {
    let _ = (curve.value(x), curve.derivative(x), curve.contains(x));
    let _ = (curve.domain(), curve.breakpoints(), curve.kind());
    if let Curve::MovingLeastSquares(mls) = curve {
        let _ = (mls.influence(x, 0), mls.influence(x, usize::MAX), mls.half_width());
    }
}

proptest! {
    #[test]
    fn any_curve_evaluates_at_any_number(
        curve in curve(), x in number(), factor in number(), shift in number(), reversal in number(),
        own in count(), with_respect_to in count(), coordinates in vec(number(), 0..4),
    ) {
        let Ok(curve) = curve else { return Ok(()) };
        ask(&curve, x);
        for end in curve.domain().unwrap_or_default() {
            ask(&curve, end);
        }
        let changed = curve.clone().scaled(factor).offset(shift);
        ask(&changed, x);
        let field = Field::from(curve);
        let _ = field.contains(own, &coordinates);
        let pair = ErrorCurve::Pair { forward: field.clone(), backward: changed.into() };
        let mut all = vec![ErrorCurve::from(field.clone()), pair];
        all.extend(ErrorCurve::with_reversal(field, reversal));
        for curve in all {
            for branch in [None, Some(Direction::Positive), Some(Direction::Negative)] {
                let _ = curve.value(own, &coordinates, branch);
                let _ = curve.partial(with_respect_to, own, &coordinates, branch);
            }
            let _ = (curve.contains(own, &coordinates), curve.is_finite());
        }
    }

    #[test]
    fn any_grid_is_made_or_refused(
        axes in [count(), count()], a in vec(number(), 0..4), b in vec(number(), 0..4), sorted in any::<bool>(),
        values in vec(vec(number(), 0..4), 0..4), coordinates in vec(number(), 0..4),
    ) {
        let (mut a, mut b) = (a, b);
        if sorted {
            a.sort_by(f64::total_cmp);
            b.sort_by(f64::total_cmp);
        }
        let values = if sorted { vec![vec![1.0; b.len()]; a.len()] } else { values };
        if let Ok(grid) = Grid::new(axes, [a, b], values) {
            let _ = (grid.value(&coordinates), grid.contains(&coordinates), grid.domain());
            let _ = (grid.partial(axes[0], &coordinates), grid.partial(axes[1], &coordinates));
        }
    }

    /// The lagged value lies between its previous value and the input, and two half steps equal one step.
    #[test]
    fn a_lag_moves_towards_its_input(
        before in -50.0..50.0_f64, input in -50.0..50.0_f64, dt in 0.0..1e4_f64, lag in 0.0..1e4_f64,
    ) {
        let after = first_order_lag(before, input, dt, lag);
        prop_assert!((before.min(input) - 1e-9..=before.max(input) + 1e-9).contains(&after));
        let half = first_order_lag(before, input, dt / 2.0, lag);
        let twice = first_order_lag(half, input, dt / 2.0, lag);
        prop_assert!((twice - after).abs() < 1e-9);
    }

    /// The lagged value lies within the range of its previous value and the ends of the ramp, and two half ramps equal
    /// one ramp.
    #[test]
    fn a_lag_follows_a_ramp(
        before in -50.0..50.0_f64, from in -50.0..50.0_f64, to in -50.0..50.0_f64, dt in 0.0..1e4_f64, lag in 0.0..1e4_f64,
    ) {
        let after = first_order_lag_of_ramp(before, from, to, dt, lag);
        let all = [before, from, to];
        let (low, high) = (all.into_iter().fold(50.0, f64::min), all.into_iter().fold(-50.0, f64::max));
        prop_assert!((low - 1e-9..=high + 1e-9).contains(&after));
        let middle = 0.5 * (from + to);
        let half = first_order_lag_of_ramp(before, from, middle, dt / 2.0, lag);
        let twice = first_order_lag_of_ramp(half, middle, to, dt / 2.0, lag);
        prop_assert!((twice - after).abs() < 1e-9);
        let held = first_order_lag_of_ramp(before, to, to, dt, lag);
        prop_assert!((held - first_order_lag(before, to, dt, lag)).abs() < 1e-9);
    }

    #[test]
    fn a_lag_accepts_any_number(before in number(), input in number(), dt in number(), lag in number()) {
        let _ = first_order_lag(before, input, dt, lag);
        let _ = first_order_lag_of_ramp(before, input, before, dt, lag);
    }
}

/// After one time constant, the lagged value has reached 1 − 1/e of a step. Negative time steps count as 0.
#[test]
fn a_lag_in_closed_form() {
    let reached = first_order_lag(20.0, 30.0, 600.0, 600.0);
    assert!((reached - (30.0 - 10.0 * (-1.0_f64).exp())).abs() < 1e-12);
    assert_eq!(first_order_lag(20.0, 30.0, 1.0, 0.0), 30.0);
    for dt in [-5.0, f64::NAN, 0.0] {
        assert_eq!(first_order_lag(20.0, 30.0, dt, 600.0), 20.0);
    }
}

/// On a ramp much longer than the time constant, the lagged value trails by slope × time constant. Many short steps
/// equal one long step.
#[test]
fn a_lag_of_a_ramp_in_closed_form() {
    let behind = first_order_lag_of_ramp(20.0, 20.0, 50.0, 3e4, 600.0);
    assert!((behind - (50.0 - 1e-3 * 600.0)).abs() < 1e-12, "{behind}");
    let (mut stepped, parts) = (22.0, 30_000);
    for part in 0..parts {
        let middle = 20.0 + 10.0 * (f64::from(part) + 0.5) / f64::from(parts);
        stepped = first_order_lag(stepped, middle, 300.0 / f64::from(parts), 120.0);
    }
    let at_once = first_order_lag_of_ramp(22.0, 20.0, 30.0, 300.0, 120.0);
    assert!((stepped - at_once).abs() < 1e-7, "{stepped} {at_once}");
    assert_eq!(first_order_lag_of_ramp(20.0, 25.0, 30.0, 1.0, 0.0), 30.0);
    for dt in [-5.0, f64::NAN, 0.0] {
        assert_eq!(first_order_lag_of_ramp(20.0, 25.0, 30.0, dt, 600.0), 20.0);
    }
}
