//! Fits reproduce curves of their own kind, and equal those of NumPy and SciPy.

use std::io::Write as _;
use std::process::{Command, Stdio};

use proptest::prelude::*;
use serde_json::{Value, json};
use volcomp_fit::curve::Curve;
use volcomp_fit::{
    Fit, fit_bspline, fit_chebyshev, fit_cubic_table, fit_fourier, fit_linear_table, fit_mls,
    fit_polynomial,
};

use crate::{at, noisy, targets};

const RANGE: [f64; 2] = [0.0, 8000.0];

#[test]
fn order_eight_over_eight_metres() {
    let x = targets(41);
    // In powers of x, the Chebyshev polynomial T8 is the worst conditioned.
    let f = |x: f64| 50.0 * (8.0 * (x / 4000.0 - 1.0).clamp(-1.0, 1.0).acos()).cos();
    let fit = fit_polynomial(&x, &at(&x, f), 8, RANGE).unwrap();
    let Curve::Polynomial(polynomial) = &fit.curve else { panic!("{:?}", fit.curve) };
    assert_eq!(polynomial.coefficients().len(), 9);
    for i in 0..=777 {
        let x = 8000.0 * f64::from(i) / 777.0;
        assert!((fit.curve.value(x) - f(x)).abs() < 50.0 * 1e-6);
    }
}

#[test]
fn polynomial_and_chebyshev_are_the_same_function() {
    let x = targets(21);
    let u = noisy(&x, 2.0, 1, |x| (x / 700.0).sin() * 20.0);
    let a = fit_polynomial(&x, &u, 6, RANGE).unwrap();
    let b = fit_chebyshev(&x, &u, 6, RANGE).unwrap();
    for x in targets(100) {
        assert!((a.curve.value(x) - b.curve.value(x)).abs() < 1e-8);
    }
    // At the least-squares solution, residuals are orthogonal to the powers.
    for k in 0..=6 {
        let dot: f64 = x.iter().zip(&a.residuals).map(|(x, e)| (x / 8000.0).powi(k) * e).sum();
        assert!(dot.abs() < 1e-7, "power {k}: {dot}");
    }
    assert!((a.rms() - b.rms()).abs() < 1e-9);
    assert!(a.min() < 0.0 && a.max() > 0.0 && a.max_abs() >= a.max());
}

#[test]
fn fourier_series_of_a_rotary_axis() {
    let x: Vec<f64> = (0..24).map(|i| f64::from(i) * 15.0 - 180.0).collect();
    let f = |q: f64| {
        let q = q.to_radians();
        0.5 + 3.0 * q.cos() - 1.2 * q.sin() + 0.7 * (2.0 * q).sin()
    };
    let fit = fit_fourier(&x, &at(&x, f), 3, 360.0, [-360.0, 360.0]).unwrap();
    let Curve::Fourier(series) = &fit.curve else { panic!("{:?}", fit.curve) };
    let expected = [0.5, 3.0, -1.2, 0.0, 0.7, 0.0, 0.0];
    for (found, expected) in series.coefficients().iter().zip(expected) {
        assert!((found - expected).abs() < 1e-12, "{:?}", series.coefficients());
    }
    assert!(fit.max_abs() < 1e-12 && fit.leave_one_out_rms < 1e-12);
}

#[test]
fn tables_hold_the_mean_of_each_target() {
    let (x, u) = ([0.0, 100.0, 200.0, 200.0, 100.0, 0.0], [0.0, 1.0, 5.0, 3.0, 3.0, 1.0]);
    for fit in [fit_linear_table(&x, &u).unwrap(), fit_cubic_table(&x, &u).unwrap()] {
        assert_eq!([0.0, 100.0, 200.0].map(|x| fit.curve.value(x)), [0.5, 2.0, 4.0]);
        assert_eq!(fit.residuals, [-0.5, -1.0, 1.0, -1.0, 1.0, 0.5]);
        // The inner target is predicted as 2.25, half-way between 0.5 and 4; its readings are 1 and 3.
        let expected = f64::midpoint(1.25_f64.powi(2), 0.75_f64.powi(2)).sqrt();
        assert!((fit.leave_one_out_rms - expected).abs() < 1e-12);
    }
}

#[test]
fn spline_follows_what_is_smooth_and_not_the_noise() {
    let x = targets(41);
    let f = |x: f64| 20.0 * (x / 1200.0).sin();
    let exact = fit_bspline(&x, &at(&x, f)).unwrap();
    assert!(exact.max_abs() < 0.05, "{}", exact.max_abs());
    let noise = noisy(&x, 1.0, 7, |_| 0.0);
    let smooth = fit_bspline(&x, &noise).unwrap();
    let curve = at(&x, |x| smooth.curve.value(x));
    let power = |u: &[f64]| u.iter().map(|u| u * u).sum::<f64>();
    assert!(power(&curve) < 0.35 * power(&noise), "{} {}", power(&curve), power(&noise));
    assert_eq!(exact.curve.domain(), Some(RANGE));
}

proptest! {
    #[test]
    fn lines_are_lines_in_every_kind(c0 in -50.0..50.0, c1 in -0.01..0.01, place in 0.0..8000.0) {
        let f = |x: f64| c0 + c1 * x;
        let x = targets(21);
        let u = at(&x, f);
        for fit in [
            fit_polynomial(&x, &u, 3, RANGE),
            fit_chebyshev(&x, &u, 5, RANGE),
            fit_mls(&x, &u, 2, 0.4, 3.0),
            fit_bspline(&x, &u),
            fit_linear_table(&x, &u),
            fit_cubic_table(&x, &u),
        ] {
            let fit = fit.unwrap();
            prop_assert!((fit.curve.value(place) - f(place)).abs() < 1e-7, "{:?}", fit.curve);
            prop_assert!(fit.leave_one_out_rms < 1e-6);
        }
    }
}

/// Results of the Python script for this input; `None` without Python.
fn peer(given: &Value) -> Option<Value> {
    let python = volcomp_test_support::peers::python()?;
    let script = volcomp_test_support::root().join("fitting/fit/tests/reference/fits.py");
    let mut child = Command::new(python)
        .arg(script)
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .spawn()
        .unwrap();
    let text = given.to_string();
    child.stdin.take().unwrap().write_all(text.as_bytes()).unwrap();
    let output = child.wait_with_output().unwrap();
    assert!(output.status.success());
    Some(serde_json::from_slice(&output.stdout).unwrap())
}

/// For three runs and an incomplete run, the values at 101 positions and the leave-one-out error equal those of NumPy
/// and SciPy. The logarithm of the spline's smoothing parameter is searched to 0.01 here and to 1e-6 in the script; all
/// other kinds agree up to rounding.
#[test]
fn every_kind_is_that_of_numpy_and_scipy() {
    for (seed, order, support) in [(1, 6, 0.6), (2, 4, 1.0 / 3.0), (3, 3, 0.3)] {
        let one = targets(21);
        let x = [one.clone(), one.clone(), one.clone(), one[..8].to_vec()].concat();
        let u = noisy(&x, 0.8, seed, |x| (x / 900.0).sin() * 12.0 + 0.002 * x);
        let at: Vec<f64> = (0..=100).map(|i| 80.0 * f64::from(i)).collect();
        let given =
            json!({ "x": x, "u": u, "at": at, "order": order, "support": support, "shape": 3.0 });
        let Some(answer) = peer(&given) else {
            return;
        };
        let domain = [0.0, 8000.0];
        let fits: [(&str, Fit, f64); 5] = [
            ("polynomial", fit_polynomial(&x, &u, order, domain).unwrap(), 1e-8),
            ("chebyshev", fit_chebyshev(&x, &u, order, domain).unwrap(), 1e-9),
            ("table", fit_cubic_table(&x, &u).unwrap(), 1e-9),
            ("mls", fit_mls(&x, &u, order, support, 3.0).unwrap(), 1e-7),
            ("bspline", fit_bspline(&x, &u).unwrap(), 0.01),
        ];
        for (kind, fit, within) in fits {
            let values = answer[kind][0].as_array().unwrap();
            for (x, value) in at.iter().zip(values) {
                let (found, expected) = (fit.curve.value(*x), value.as_f64().unwrap());
                assert!(
                    (found - expected).abs() < within,
                    "{kind}, seed {seed}, at {x}: {found} {expected}"
                );
            }
            let expected = answer[kind][1].as_f64().unwrap();
            assert!(
                (fit.leave_one_out_rms - expected).abs() < within,
                "{kind}, seed {seed}: {} {expected}",
                fit.leave_one_out_rms
            );
        }
    }
}
