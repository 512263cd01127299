//! Deserialised curves are checked like curves from constructors.

use volcomp_curve::{
    BSpline, Chebyshev, Curve, ErrorCurve, Field, Fourier, Grid, MovingLeastSquares, Polynomial,
    Table,
};

fn nodes() -> Vec<[f64; 2]> {
    vec![[0.0, 0.0], [1.0, 2.0], [2.0, 1.0], [4.0, 0.5]]
}

#[test]
fn every_curve_reads_back_the_same() {
    let curves = [
        Curve::Constant(1.5),
        Polynomial::new(vec![1.0, 0.25], [0.0, 8.0]).unwrap().into(),
        Chebyshev::new(vec![1.0, 0.25], [0.0, 8.0]).unwrap().into(),
        Fourier::new(vec![0.5, 1.0, 2.0], 360.0, [0.0, 360.0]).unwrap().into(),
        Table::linear(nodes()).unwrap().into(),
        Table::cubic(nodes()).unwrap().into(),
        BSpline::new(vec![0.0, 0.0, 1.0, 2.0, 2.0], vec![1.0, 2.0, 0.5], 1).unwrap().into(),
        MovingLeastSquares::new(nodes(), 1, 1.0, 3.0).unwrap().into(),
    ];
    for curve in curves {
        let text = serde_json::to_string(&curve).unwrap();
        assert!(text.contains(curve.kind()), "{text}");
        let read: Curve = serde_json::from_str(&text).expect(&text);
        assert_eq!(read, curve, "{text}");
    }
    let grid = Grid::new([1, 2], [vec![0.0, 1.0], vec![0.0, 2.0]], vec![vec![0.5; 2]; 2]).unwrap();
    let errors = [
        ErrorCurve::Single(Field::Grid(grid)),
        ErrorCurve::with_reversal(Curve::Constant(1.0).into(), 3.0).unwrap(),
        ErrorCurve::Pair {
            forward: Curve::Constant(1.0).into(),
            backward: Curve::Constant(2.0).into(),
        },
    ];
    for error in errors {
        let text = serde_json::to_string(&error).unwrap();
        assert_eq!(serde_json::from_str::<ErrorCurve>(&text).expect(&text), error);
    }
}

#[test]
fn invalid_curves_are_not_deserialised() {
    for (text, reason) in [
        (r#"{"poly":{"coefficients":[],"domain":[0.0,1.0]}}"#, "found 0 coefficients"),
        (r#"{"chebyshev":{"coefficients":[1.0],"domain":[1.0,0.0]}}"#, "domain [1, 0]"),
        (
            r#"{"fourier":{"coefficients":[1.0,2.0],"period":360.0,"domain":[0.0,1.0]}}"#,
            "odd number",
        ),
        (
            r#"{"table":{"nodes":[[0.0,1.0],[0.0,2.0]],"interpolation":"cubic"}}"#,
            "strictly increasing",
        ),
        (r#"{"bspline":{"knots":[0.0],"coefficients":[1.0,2.0],"degree":1}}"#, "found 1 knots"),
        (
            r#"{"mls":{"nodes":[[0.0,1.0],[1.0,2.0]],"order":9,"support":1.0,"shape":3.0}}"#,
            "order is 9",
        ),
        (r#"{"constant":null}"#, "expected f64"),
        (r#"{"wavy":{}}"#, "unknown variant"),
    ] {
        let error = serde_json::from_str::<Curve>(text).expect_err(text).to_string();
        assert!(error.contains(reason), "{text}: {error}");
    }
    let grid = r#"{"single":{"grid":{"axes":[1,1],"nodes":[[0.0,1.0],[0.0,1.0]],"values":[[0.0,0.0],[0.0,0.0]]}}}"#;
    assert!(serde_json::from_str::<ErrorCurve>(grid).is_err());
}
