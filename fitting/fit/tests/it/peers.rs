//! Compares the fits with those of NumPy and SciPy in `tests/reference/fits.py`.

use std::io::Write as _;
use std::process::{Command, Stdio};

use serde_json::{Value, json};
use volcomp_fit::{Fit, fit_bspline, fit_chebyshev, fit_cubic_table, fit_mls, fit_polynomial};

use crate::{noisy, targets};

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
