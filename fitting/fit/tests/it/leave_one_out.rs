//! The leave-one-out error equals the error of refits without each target.

use nalgebra::{DMatrix, DVector};
use volcomp_fit::curve::{BSpline, Curve};
use volcomp_fit::{
    Fit, FitError, fit_bspline, fit_fourier, fit_linear_table, fit_mls, fit_polynomial,
};

use crate::{noisy, targets};

/// RMS error of predicting the readings of each target from a fit to the readings of all other targets.
fn brute_force(x: &[f64], u: &[f64], fit: impl Fn(&[f64], &[f64]) -> Result<Fit, FitError>) -> f64 {
    let square = |(target, reading): (&f64, &f64)| {
        let pairs = || x.iter().copied().zip(u.iter().copied());
        let (others, readings): (Vec<f64>, Vec<f64>) = pairs().filter(|p| p.0 != *target).unzip();
        (reading - fit(&others, &readings).unwrap().curve.value(*target)).powi(2)
    };
    (x.iter().zip(u).map(square).sum::<f64>() / x.len() as f64).sqrt()
}

/// For three runs with offsets larger than the error of the curve, the leave-one-out error of each kind is at least the
/// residual, because it is the error at readings, not at the mean of each target.
#[test]
fn several_lines_do_not_make_it_less_than_the_residual() {
    let one = targets(21);
    let x = one.repeat(3);
    let u: Vec<f64> = (x.iter().enumerate())
        .map(|(i, x)| (x / 1000.0).sin() * 10.0 + 4.0 * (i / 21) as f64)
        .collect();
    let fits = [
        fit_polynomial(&x, &u, 8, [0.0, 8000.0]),
        fit_bspline(&x, &u),
        fit_mls(&x, &u, 4, 1.0 / 3.0, 3.0),
        fit_linear_table(&x, &u),
    ];
    for fit in fits {
        let fit = fit.unwrap();
        // The offsets of the runs alone leave 4 times the RMS of −1, 0 and 1.
        let least = 4.0 * (2.0_f64 / 3.0).sqrt();
        let kind = fit.curve.kind();
        assert!(fit.rms() >= least * (1.0 - 1e-9), "{kind}: {}", fit.rms());
        assert!(
            fit.leave_one_out_rms >= fit.rms() * (1.0 - 1e-9),
            "{kind}: {} {}",
            fit.leave_one_out_rms,
            fit.rms()
        );
    }
}

fn same(found: f64, expected: f64) {
    assert!((found - expected).abs() < 1e-8 * expected, "{found} {expected}");
}

#[test]
fn polynomial_with_runs() {
    // Two complete runs and an incomplete run, so that targets have unequal weights.
    let x = [targets(11), targets(11), targets(11)[..4].to_vec()].concat();
    let u = noisy(&x, 1.0, 3, |x| (x / 1000.0).sin() * 10.0);
    let fit = |x: &[f64], u: &[f64]| fit_polynomial(x, u, 5, [0.0, 8000.0]);
    same(fit(&x, &u).unwrap().leave_one_out_rms, brute_force(&x, &u, fit));
}

#[test]
fn fourier() {
    let x: Vec<f64> = (0..13).map(|i| f64::from(i) * 27.0).collect();
    let u = noisy(&x, 1.0, 4, |x| x.to_radians().cos() * 10.0);
    let fit = |x: &[f64], u: &[f64]| fit_fourier(x, u, 3, 360.0, [0.0, 360.0]);
    same(fit(&x, &u).unwrap().leave_one_out_rms, brute_force(&x, &u, fit));
}

/// The leave-one-out error of moving least squares equals that of independent solutions without each target; end
/// targets are included.
#[test]
fn moving_least_squares_with_its_half_width_kept() {
    let x = targets(21);
    let u = noisy(&x, 1.0, 5, |x| (x / 800.0).sin() * 10.0);
    let nodes: Vec<[f64; 2]> = x.iter().zip(&u).map(|(&x, &u)| [x, u]).collect();
    for (order, support) in [(1, 0.15), (2, 1.0), (3, 0.45), (4, 1.0 / 3.0), (6, 0.8)] {
        let expected = crate::brute_force::left_out(&nodes, order, support * 8000.0);
        let whole = fit_mls(&x, &u, order, support, 3.0).unwrap();
        let Curve::MovingLeastSquares(curve) = &whole.curve else { panic!("{:?}", whole.curve) };
        for (i, expected) in expected.iter().enumerate() {
            let found = whole.residuals[i] / (1.0 - curve.influence(x[i], i));
            assert!(
                (found - expected).abs() < 1e-7 * (1.0 + expected.abs()),
                "order {order}, support {support}, target {i}: {found} {expected}"
            );
        }
        let squares: f64 = expected.iter().map(|e| e * e).sum();
        let rms = (squares / 21.0).sqrt();
        assert!((whole.leave_one_out_rms / rms - 1.0).abs() < 1e-7);
    }
}

#[test]
fn nothing_left_over_predicts_nothing() {
    let fit = fit_polynomial(&[0.0, 1.0, 2.0], &[1.0, 5.0, 2.0], 2, [0.0, 2.0]).unwrap();
    assert!(fit.max_abs() < 1e-12);
    assert_eq!(fit.leave_one_out_rms, f64::INFINITY);
}

#[test]
fn a_table_predicts_its_inner_targets() {
    let x: Vec<f64> = (0..9).map(|i| 100.0 * f64::from(i)).collect();
    let u: Vec<f64> = x.iter().map(|x| (x / 150.0).sin() * 5.0).collect();
    let mut squares = 0.0;
    for left in 1..8 {
        let others = |values: &[f64]| [&values[..left], &values[left + 1..]].concat();
        let refit = fit_linear_table(&others(&x), &others(&u)).unwrap();
        squares += (u[left] - refit.curve.value(x[left])).powi(2);
    }
    let found = fit_linear_table(&x, &u).unwrap().leave_one_out_rms;
    same(found, (squares / 7.0).sqrt());
}

/// The leave-one-out error of a spline equals that of the penalised equations solved without each row. The smoothing
/// parameter is that of the fit to all readings.
#[test]
fn a_spline_with_its_smoothing_kept() {
    let x: Vec<f64> = (0..15).map(|i| 100.0 * f64::from(i)).collect();
    let u = noisy(&x, 1.0, 9, |x| (x / 400.0).sin() * 8.0);
    let fit = fit_bspline(&x, &u).unwrap();
    let Curve::BSpline(spline) = &fit.curve else {
        panic!("a spline");
    };
    let size = spline.coefficients().len();
    let basis = DMatrix::from_fn(x.len(), size, |i, k| {
        let mut unit = vec![0.0; size];
        unit[k] = 1.0;
        BSpline::new(spline.knots().to_vec(), unit, 3).unwrap().value(x[i])
    });
    let penalty = DMatrix::from_fn(size - 2, size, |i, k| match k.wrapping_sub(i) {
        0 | 2 => 1.0,
        1 => -2.0,
        _ => 0.0,
    });
    let readings = DVector::from_column_slice(&u);
    let solve = |lambda: f64, basis: &DMatrix<f64>, readings: &DVector<f64>| {
        let normal = basis.transpose() * basis + penalty.transpose() * &penalty * lambda;
        normal.lu().solve(&(basis.transpose() * readings)).unwrap()
    };
    let whole = |lambda: f64| {
        let left = &readings - &basis * solve(lambda, &basis, &readings);
        (left.norm_squared() / 15.0).sqrt()
    };
    let (mut low, mut high) = (-9.0_f64, 9.0_f64);
    for _ in 0..200 {
        let middle = 0.5 * (low + high);
        if whole(10_f64.powf(middle)) < fit.rms() {
            low = middle;
        } else {
            high = middle;
        }
    }
    let lambda = 10_f64.powf(low);
    assert!((whole(lambda) - fit.rms()).abs() < 1e-9, "the same fit");
    assert!(fit.rms() > 0.1, "it smooths: {}", fit.rms());
    let squares: f64 = (0..15)
        .map(|left| {
            let others = basis.clone().remove_row(left);
            let coefficients = solve(lambda, &others, &readings.clone().remove_row(left));
            (u[left] - (basis.row(left) * coefficients)[0]).powi(2)
        })
        .sum();
    let expected = (squares / 15.0).sqrt();
    assert!((fit.leave_one_out_rms / expected - 1.0).abs() < 1e-6, "{expected}");
}
