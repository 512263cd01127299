use volcomp_fit::curve::{Curve, MovingLeastSquares};
use volcomp_fit::{Fit, FitError, fit_auto, fit_mls, fit_mls_auto};

use crate::{at, noisy, targets};

fn mls(fit: &Fit) -> &MovingLeastSquares {
    let Curve::MovingLeastSquares(curve) = &fit.curve else {
        panic!("{:?}", fit.curve)
    };
    curve
}

/// The smallest Σw / max w on a fine uniform grid, from the formula as it is written.
fn least_weight(x: &[f64], support: f64) -> f64 {
    let h = support * 8000.0;
    let edge = (-9.0_f64).exp();
    let ratio = |at: f64| {
        let weight = |xj: &f64| {
            let d = (at - xj).abs();
            if d < h {
                ((-(3.0 * d / h).powi(2)).exp() - edge) / (1.0 - edge)
            } else {
                0.0
            }
        };
        let weights: Vec<f64> = x.iter().map(weight).collect();
        weights.iter().sum::<f64>() / weights.iter().copied().fold(0.0, f64::max)
    };
    (0..=16000)
        .map(|i| ratio(f64::from(i) * 0.5))
        .fold(f64::INFINITY, f64::min)
}

#[test]
fn takes_the_best_of_all_candidates() {
    let x = targets(31);
    let u = noisy(&x, 0.5, 21, |x| {
        10.0 * (x / 700.0).sin() + 4.0 * (x / 300.0).cos()
    });
    for required in [None, Some(1.0), Some(0.01)] {
        let mut all = Vec::new();
        for order in 1..=6_usize {
            for twentieths in (3..=20_u32).rev() {
                let support = f64::from(twentieths) * 0.05;
                if least_weight(&x, support) >= (order + 2) as f64 {
                    let fit = fit_mls(&x, &u, order, support, 3.0).unwrap();
                    all.push((order, support, fit));
                }
            }
        }
        assert!(all.len() > 20 && all.len() < 108, "{}", all.len());
        let meeting = |fit: &Fit| required.is_none_or(|r| fit.max_abs() <= r);
        let any = all.iter().any(|(_, _, fit)| meeting(fit));
        let (order, support, expected) = all
            .iter()
            .filter(|(_, _, fit)| !any || meeting(fit))
            .min_by(|a, b| a.2.leave_one_out_rms.total_cmp(&b.2.leave_one_out_rms))
            .unwrap();
        let found = fit_mls_auto(&x, &u, 3.0, required).unwrap();
        assert_eq!(mls(&found).order(), *order, "{required:?}");
        assert!((mls(&found).support() - support).abs() < 1e-12);
        assert!((found.leave_one_out_rms - expected.leave_one_out_rms).abs() < 1e-9);
        assert_eq!(found.meets_required, required.map(|_| any));
    }
}

#[test]
fn says_when_the_required_residual_is_not_met() {
    let x = targets(21);
    let u = noisy(&x, 2.0, 22, |_| 0.0);
    let fit = fit_mls_auto(&x, &u, 3.0, Some(1e-6)).unwrap();
    assert_eq!(fit.meets_required, Some(false));
    assert_eq!(fit.curve, fit_mls_auto(&x, &u, 3.0, None).unwrap().curve);
}

#[test]
fn ties_go_to_the_lower_order_and_the_wider_support() {
    let x = targets(21);
    let u = at(&x, |x| 3.0 - 0.004 * x);
    let fit = fit_mls_auto(&x, &u, 3.0, Some(1.0)).unwrap();
    assert_eq!((mls(&fit).order(), mls(&fit).support()), (1, 1.0));
}

#[test]
fn runs_are_averaged_before_they_are_judged() {
    let once = targets(21);
    let f = |x: f64| 10.0 * (x / 1500.0).sin();
    let x = [once.clone(), once.clone()].concat();
    let u = [at(&once, |x| f(x) + 5.0), at(&once, |x| f(x) - 5.0)].concat();
    let fit = fit_mls_auto(&x, &u, 3.0, Some(0.5)).unwrap();
    assert_eq!(fit.meets_required, Some(true));
    assert_eq!(fit.residuals.len(), 42);
    assert!(fit.max_abs() > 4.5);
}

#[test]
fn few_targets_get_simpler_curves() {
    let constant = fit_auto(&[5.0, 5.0], &[1.0, 2.0], None).unwrap();
    assert_eq!(constant.curve, Curve::Constant(1.5));
    let line = fit_auto(&[0.0, 10.0], &[1.0, 2.0], Some(0.1)).unwrap();
    assert!((line.curve.value(5.0) - 1.5).abs() < 1e-12);
    assert_eq!(line.meets_required, Some(true));
    let x = [0.0, 1.0, 2.0, 3.0, 4.0, 5.0];
    let parabola = fit_auto(&x, &at(&x, |x| x * x), None).unwrap();
    let Curve::Polynomial(polynomial) = &parabola.curve else {
        panic!("{:?}", parabola.curve)
    };
    assert_eq!(polynomial.coefficients().len(), 3);
    let constant = fit_auto(&x, &[2.0; 6], None).unwrap();
    assert!(matches!(&constant.curve, Curve::Polynomial(p) if p.coefficients().len() == 1));
    // 7 targets leave moving least squares of shape 3 no candidate.
    let x = targets(7);
    assert!(matches!(
        fit_mls_auto(&x, &x, 3.0, None),
        Err(FitError::NoCandidate { targets: 7, .. })
    ));
    assert!(matches!(
        fit_auto(&x, &x, None).unwrap().curve,
        Curve::Polynomial(_)
    ));
    // A straight line needs no more than a polynomial, however many targets there are.
    let x = targets(21);
    assert!(matches!(
        fit_auto(&x, &x, None).unwrap().curve,
        Curve::Polynomial(_)
    ));
}
