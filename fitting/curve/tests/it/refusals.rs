use volcomp_curve::{
    BSpline, Chebyshev, Curve, CurveError, ErrorCurve, Fourier, Grid, MovingLeastSquares,
    Polynomial, Table,
};

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
