use volcomp_fit::{
    Fit, FitError, FitOptions, fit_auto, fit_bspline, fit_chebyshev, fit_cubic_table, fit_fourier,
    fit_linear_table, fit_mls, fit_mls_auto, fit_polynomial,
};

use crate::targets;

fn refused(fit: Result<Fit, FitError>, message: &str) {
    assert_eq!(fit.unwrap_err().to_string(), message);
}

type AnyFit = fn(&[f64], &[f64]) -> Result<Fit, FitError>;

const ALL: [AnyFit; 9] = [
    |x, u| fit_polynomial(x, u, 1, [0.0, 8000.0]),
    |x, u| fit_chebyshev(x, u, 1, [0.0, 8000.0]),
    |x, u| fit_fourier(x, u, 1, 8000.0, [0.0, 8000.0]),
    |x, u| fit_mls(x, u, 1, 0.5, 3.0),
    |x, u| fit_mls_auto(x, u, 3.0, None),
    fit_bspline,
    fit_linear_table,
    fit_cubic_table,
    |x, u| Ok(fit_auto(x, u, &FitOptions::default())?.fit),
];

#[test]
fn invalid_readings_are_refused() {
    let x = targets(21);
    for fit in ALL {
        assert!(fit(&x, &x).is_ok());
        refused(fit(&x, &x[1..]), "found 20 readings for 21 abscissae: expected one for each");
        assert!(matches!(fit(&[], &[]), Err(FitError::TooFewTargets { found: 0, .. })));
        for bad in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
            let mut u = x.clone();
            u[3] = bad;
            assert!(matches!(
                fit(&x, &u),
                Err(FitError::NotFinite { what: "reading", index: 3, .. })
            ));
            assert!(matches!(
                fit(&u, &x),
                Err(FitError::NotFinite { what: "abscissa", index: 3, .. })
            ));
        }
    }
}

#[test]
fn too_few_targets_for_the_order() {
    let (x, u) = ([0.0, 1.0, 1.0, 1.0], [0.0; 4]);
    refused(
        fit_polynomial(&x, &u, 2, [0.0, 1.0]),
        "found 2 different targets: a polynomial of this order needs at least 3",
    );
    assert!(fit_polynomial(&x, &u, usize::MAX, [0.0, 1.0]).is_err());
    assert!(fit_fourier(&x, &u, usize::MAX, 1.0, [0.0, 1.0]).is_err());
    assert!(fit_mls(&x, &u, usize::MAX, 1.0, 3.0).is_err());
    // The targets 0 and 360 have the same phase.
    refused(
        fit_fourier(&[0.0, 180.0, 360.0], &[0.0; 3], 1, 360.0, [0.0, 360.0]),
        "the targets do not determine 3 coefficients: expected a lower order, or targets spread over the domain",
    );
}

#[test]
fn domains() {
    let x = targets(21);
    refused(
        fit_chebyshev(&x, &x, 2, [0.0, 7900.0]),
        "target 20 is 8000: expected it in the domain [0, 7900]",
    );
    refused(
        fit_chebyshev(&x, &x, 2, [8000.0, 0.0]),
        "domain [8000, 0]: expected a lower end below the upper end, a finite distance apart",
    );
    let far: Vec<f64> = (0..21).map(|i| 5000.0 + f64::from(i)).collect();
    let u: Vec<f64> = far.iter().map(|x| x.sin()).collect();
    let error = fit_polynomial(&far, &u, 8, [5000.0, 5020.0]).unwrap_err();
    assert!(matches!(error, FitError::PowersLoseDigits { order: 8, .. }), "{error}");
    assert!(fit_chebyshev(&far, &u, 8, [5000.0, 5020.0]).is_ok());
}

#[test]
fn parameters() {
    let x = targets(21);
    for required in [0.0, -1.0, f64::NAN, f64::INFINITY] {
        assert!(matches!(
            fit_mls_auto(&x, &x, 3.0, Some(required)),
            Err(FitError::Parameter { what: "required residual", .. })
        ));
        for options in [
            FitOptions { required_residual: Some(required), ..FitOptions::default() },
            FitOptions { period: Some(required), ..FitOptions::default() },
        ] {
            assert!(fit_auto(&x[..3], &x[..3], &options).is_err());
        }
    }
    assert!(matches!(fit_mls_auto(&x, &x, f64::NAN, None), Err(FitError::Curve(_))));
    assert!(matches!(fit_mls(&x, &x, 4, 0.1, 3.0), Err(FitError::Curve(_))));
    // A percentage, and a support above the range; the widest support is the whole range.
    for support in [50.0, 1.01] {
        refused(
            fit_mls(&x, &x, 4, support, 3.0),
            &format!(
                "support is {support}: expected a share of the measured range, above 0 and at most 1"
            ),
        );
    }
    assert!(fit_mls(&x, &x, 4, 1.0, 3.0).is_ok());
    assert!(fit_mls(&x, &x, 4, 0.0, 3.0).is_err());
    // With as many targets as coefficients, an end target is at the edge of even the widest support, where its weight
    // is 0.
    assert!(fit_mls(&x[..6], &x[..6], 4, 1.0, 3.0).is_ok());
    refused(
        fit_mls(&x[..5], &x[..5], 4, 1.0, 3.0),
        "found 5 different targets: a curve of moving least squares of this order needs at least 6",
    );
}
