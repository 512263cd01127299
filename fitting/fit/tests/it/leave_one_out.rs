//! The leave-one-out error against fits that really leave a reading out.

use volcomp_fit::curve::Curve;
use volcomp_fit::{Fit, FitError, fit_fourier, fit_mls, fit_polynomial};

use crate::{noisy, targets};

fn brute_force(x: &[f64], u: &[f64], fit: impl Fn(&[f64], &[f64]) -> Result<Fit, FitError>) -> f64 {
    let square = |i: usize| {
        let (mut others, mut readings) = (x.to_vec(), u.to_vec());
        others.remove(i);
        readings.remove(i);
        (u[i] - fit(&others, &readings).unwrap().curve.value(x[i])).powi(2)
    };
    ((0..x.len()).map(square).sum::<f64>() / x.len() as f64).sqrt()
}

fn same(found: f64, expected: f64) {
    assert!(
        (found - expected).abs() < 1e-8 * expected,
        "{found} {expected}"
    );
}

#[test]
fn polynomial_with_runs() {
    let x = [targets(11), targets(11)].concat();
    let u = noisy(&x, 1.0, 3, |x| (x / 1000.0).sin() * 10.0);
    let fit = |x: &[f64], u: &[f64]| fit_polynomial(x, u, 5, [0.0, 8000.0]);
    same(
        fit(&x, &u).unwrap().leave_one_out_rms,
        brute_force(&x, &u, fit),
    );
}

#[test]
fn fourier() {
    let x: Vec<f64> = (0..13).map(|i| f64::from(i) * 27.0).collect();
    let u = noisy(&x, 1.0, 4, |x| x.to_radians().cos() * 10.0);
    let fit = |x: &[f64], u: &[f64]| fit_fourier(x, u, 3, 360.0, [0.0, 360.0]);
    same(
        fit(&x, &u).unwrap().leave_one_out_rms,
        brute_force(&x, &u, fit),
    );
}

#[test]
fn moving_least_squares_with_its_half_width_kept() {
    let x = targets(21);
    let u = noisy(&x, 1.0, 5, |x| (x / 800.0).sin() * 10.0);
    let support = 0.45;
    let whole = fit_mls(&x, &u, 3, support, 3.0).unwrap();
    // Without an end target the range is shorter and the curve would be held: the local polynomial
    // at the target is what is meant, so only inner targets can be refitted as curves.
    let mut squares = Vec::new();
    for i in 1..20 {
        let (mut others, mut readings) = (x.clone(), u.clone());
        others.remove(i);
        readings.remove(i);
        let refit = fit_mls(&others, &readings, 3, support, 3.0).unwrap();
        squares.push((u[i] - refit.curve.value(x[i])).powi(2));
    }
    let Curve::MovingLeastSquares(curve) = &whole.curve else {
        panic!("{:?}", whole.curve)
    };
    let identity = (1..20).map(|i| whole.residuals[i] / (1.0 - curve.influence(x[i], i)));
    for (expected, found) in squares.iter().zip(identity) {
        same(found.powi(2), *expected);
    }
    let all: f64 = (0..21)
        .map(|i| (whole.residuals[i] / (1.0 - curve.influence(x[i], i))).powi(2))
        .sum();
    same(whole.leave_one_out_rms, (all / 21.0).sqrt());
}

#[test]
fn nothing_left_over_predicts_nothing() {
    let fit = fit_polynomial(&[0.0, 1.0, 2.0], &[1.0, 5.0, 2.0], 2, [0.0, 2.0]).unwrap();
    assert!(fit.max_abs() < 1e-12);
    assert_eq!(fit.leave_one_out_rms, f64::INFINITY);
}
