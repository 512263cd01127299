//! Invalid readings are rejected, and arbitrary readings give a fit or an error, never a panic.

use proptest::collection::vec;
use proptest::prelude::*;
use volcomp_fit::{
    Fit, FitError, FitOptions, Noise, ThermalFit, ThermalOptions, ThermalRecord, ThermalTerm,
    fit_auto, fit_bspline, fit_chebyshev, fit_cubic_table, fit_fourier, fit_linear_table, fit_mls,
    fit_mls_auto, fit_polynomial, fit_thermal,
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

fn number() -> impl Strategy<Value = f64> {
    prop_oneof![
        4 => (0..9_u8).prop_map(f64::from),
        2 => -1e3..1e3_f64,
        1 => any::<f64>(),
        1 => prop::sample::select(&[f64::NAN, f64::INFINITY, f64::MAX, f64::MIN, f64::MIN_POSITIVE, 1e200][..]),
    ]
}

/// A finite reading, including the largest and the smallest number.
fn reading() -> impl Strategy<Value = f64> {
    number().prop_filter("finite", |x| x.is_finite())
}

fn count() -> impl Strategy<Value = usize> {
    prop_oneof![4 => 0..9_usize, 1 => any::<usize>()]
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(200))]

    #[test]
    fn any_readings_are_fitted_or_refused(
        pairs in prop_oneof![
            vec((reading(), reading()), 0..14),
            vec((number(), number()), 0..6),
        ],
        missing in prop::bool::weighted(0.1),
        order in count(), domain in [number(), number()], period in number(), support in number(),
        shape in number(), required in prop::option::of(number()),
    ) {
        let (x, mut u): (Vec<f64>, Vec<f64>) = pairs.into_iter().unzip();
        if missing {
            u.pop();
        }
        let finite = |a: f64, x: &f64| a.min(*x);
        let wide = [x.iter().fold(0.0, finite), x.iter().fold(9.0, |a: f64, x| a.max(*x))];
        let noise = missing.then_some(Noise { deviation: support, freedom: shape });
        let options = FitOptions { required_residual: required, noise, period: (order % 2 == 0).then_some(period) };
        let fits: [Result<Fit, FitError>; 10] = [
            fit_auto(&x, &u, &options).map(|chosen| chosen.fit),
            fit_bspline(&x, &u),
            fit_chebyshev(&x, &u, order, domain),
            fit_chebyshev(&x, &u, order, wide),
            fit_polynomial(&x, &u, order, wide),
            fit_cubic_table(&x, &u),
            fit_linear_table(&x, &u),
            fit_fourier(&x, &u, order, period, wide),
            fit_mls(&x, &u, order, support, shape),
            fit_mls_auto(&x, &u, shape, required),
        ];
        for fit in fits.into_iter().flatten() {
            prop_assert_eq!(fit.residuals.len(), x.len());
            let _ = (fit.min(), fit.max(), fit.max_abs(), fit.rms());
            let _ = fit.curve.value(shape);
        }
    }

    #[test]
    fn any_thermal_record_is_fitted_or_refused(
        sensors in 0..3_usize, rows in prop_oneof![0..3_usize, 200..230_usize], extra in 0..3_usize,
        step in number(), values in vec(reading(), 1..9), mean_of in count(),
        select_sensors in any::<bool>(), start in count(), end in prop_oneof![count(), Just(200)],
        lags_s in vec(prop_oneof![4 => Just(60.0), 1 => number()], 0..3),
        penalties in vec(prop_oneof![4 => Just(0.01), 1 => number()], 0..2),
        penalty in number(),
    ) {
        let value = |place: usize| values[place % values.len()];
        let record = ThermalRecord {
            time_s: (0..rows).map(|row| step * row as f64).collect(),
            degc: (0..sensors)
                .map(|sensor| (0..rows + extra / 2).map(|row| value(3 * row + sensor)).collect())
                .collect(),
            displacement: (0..rows + extra % 2).map(value).collect(),
        };
        let options = ThermalOptions { lags_s, penalties, select_sensors, mean_of };
        let mut fits = vec![
            fit_thermal(&record, start..end, &options),
            fit_thermal(&record, 0..end, &ThermalOptions::plain()),
        ];
        // The number of sensors of this term differs from that of the record.
        let term = ThermalTerm { lag_s: penalty, per_k: values.clone() };
        fits.push(Ok(ThermalFit {
            terms: vec![term],
            constant: step,
            start_degc: values.clone(),
            forward_rms: 0.0,
            choices: Vec::new(),
        }));
        for fit in fits.into_iter().flatten() {
            prop_assert_eq!(fit.predict(&record).len(), record.len());
            let _ = (fit.residual(&record, start..end), fit.sensors(), fit.constant_at(step));
        }
    }
}

/// Without rows there is no residual; the same applies to a range that ends before its start.
#[test]
fn no_rows_have_no_residual() {
    let record = ThermalRecord {
        time_s: vec![0.0, 1.0],
        degc: vec![vec![20.0, 21.0]],
        displacement: vec![0.0, 1.0],
    };
    let fit = ThermalFit {
        terms: Vec::new(),
        constant: 0.0,
        start_degc: vec![20.0],
        forward_rms: 0.0,
        choices: Vec::new(),
    };
    let backwards = std::ops::Range { start: 1, end: 0 };
    for rows in [0..0, 1..1, backwards, 5..7] {
        let (rms, worst) = fit.residual(&record, rows.clone());
        assert!(rms.is_nan() && worst.is_none(), "{rows:?}");
    }
}
