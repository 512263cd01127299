//! Arbitrary readings give a fit or an error, never a panic.

use proptest::{collection::vec, prelude::*};
use volcomp_fit::{
    Fit, FitError, FitOptions, Noise, ThermalFit, ThermalOptions, ThermalRecord, ThermalTerm,
    fit_auto, fit_bspline, fit_chebyshev, fit_cubic_table, fit_fourier, fit_linear_table, fit_mls,
    fit_mls_auto, fit_polynomial, fit_thermal,
};

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
