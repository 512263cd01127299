use volcomp_fit::curve::{Curve, MovingLeastSquares};
use volcomp_fit::{Fit, FitError, FitOptions, MlsTrial, fit_mls_auto, scan_mls};

use crate::{at, brute_force, noisy, targets};

fn fit_auto(x: &[f64], u: &[f64], required_residual: Option<f64>) -> Result<Fit, FitError> {
    let options = FitOptions { required_residual, ..FitOptions::default() };
    Ok(volcomp_fit::fit_auto(x, u, &options)?.fit)
}

fn mls(fit: &Fit) -> &MovingLeastSquares {
    let Curve::MovingLeastSquares(curve) = &fit.curve else { panic!("{:?}", fit.curve) };
    curve
}

/// Readings (µm) with a trend, waves and noise at these targets (mm).
fn wavy(x: &[f64], seed: u64) -> Vec<f64> {
    noisy(x, 0.5, seed, |x| 10.0 * (x / 700.0).sin() + 4.0 * (x / 300.0).cos())
}

/// Two sets of targets. The first is evenly spaced, with no target at the edge of a tried support, where rounding would
/// decide whether the target counts. The second is dense at the ends and sparse in the middle.
fn spacings() -> [Vec<f64>; 2] {
    let uneven = |i: u32| 4000.0 * (1.0 - (f64::from(i) * std::f64::consts::PI / 22.0).cos());
    [targets(32), (0..=22).map(uneven).collect()]
}

#[test]
fn the_scan_is_that_of_brute_force() {
    for x in spacings() {
        let u = wavy(&x, 21);
        let nodes: Vec<[f64; 2]> = x.iter().zip(&u).map(|(&x, &u)| [x, u]).collect();
        let mut expected = brute_force::scan(&nodes);
        let mut found = scan_mls(&x, &u, 3.0).unwrap();
        assert!(expected.len() > 20 && expected.len() < 109, "{}", expected.len());
        expected.sort_by(|a, b| a.0.cmp(&b.0).then(a.1.total_cmp(&b.1)));
        found.sort_by(|a, b| a.order.cmp(&b.order).then(a.support.total_cmp(&b.support)));
        let settings = |found: &[(usize, f64)]| format!("{found:.3?}");
        let of_brute_force: Vec<(usize, f64)> = expected.iter().map(|t| (t.0, t.1)).collect();
        let of_scan: Vec<(usize, f64)> = found.iter().map(|t| (t.order, t.support)).collect();
        assert_eq!(settings(&of_scan), settings(&of_brute_force));
        for (found, (order, support, largest, leave_one_out)) in found.iter().zip(expected) {
            assert_eq!(found.order, order);
            assert!((found.support - support).abs() < 1e-12);
            assert!((found.max_residual - largest).abs() < 1e-6, "{found:?} {largest}");
            // Rounding errors grow with the condition number of the equations.
            assert!(
                (found.leave_one_out_rms / leave_one_out - 1.0).abs() < 1e-4,
                "{found:?} {leave_one_out}"
            );
        }
    }
}

#[test]
fn takes_the_best_of_all_candidates() {
    for (seed, x) in (21..).zip(spacings()) {
        let u = wavy(&x, seed);
        let nodes: Vec<[f64; 2]> = x.iter().zip(&u).map(|(&x, &u)| [x, u]).collect();
        let all = brute_force::scan(&nodes);
        // Few settings meet the requirement 0.5, and none meets the requirement 1e-6.
        for required in [None, Some(1.0), Some(0.5), Some(1e-6)] {
            let ((order, support, ..), any) = brute_force::choice(&all, required);
            let found = fit_mls_auto(&x, &u, 3.0, required).unwrap();
            assert_eq!(mls(&found).order(), order, "{required:?}");
            assert!((mls(&found).support() - support).abs() < 1e-12);
            assert_eq!(found.meets_required, required.map(|_| any));
        }
    }
}

/// The published setting, order 4 and support 1/3, is a candidate for the 21 targets over 8000 mm of the publication.
#[test]
fn the_published_pair_is_carried_by_its_own_targets() {
    let x = targets(21);
    let nodes: Vec<[f64; 2]> = x.iter().map(|&x| [x, 0.0]).collect();
    assert!(brute_force::carried(&nodes, 4, 8000.0 / 3.0));
    // A window of a sixth of the range on each side follows this wave; a wider window does not.
    let u = at(&x, |x| 8.0 * (x / 420.0).sin());
    let trials = scan_mls(&x, &u, 3.0).unwrap();
    let is_published = |t: &&MlsTrial| t.order == 4 && (t.support - 1.0 / 3.0).abs() < 1e-12;
    let published = trials.iter().find(is_published).unwrap();
    let found = fit_mls_auto(&x, &u, 3.0, None).unwrap();
    assert!(found.leave_one_out_rms <= published.leave_one_out_rms * (1.0 + 1e-9));
}

#[test]
fn says_when_the_required_residual_is_not_met() {
    let x = targets(21);
    let u = noisy(&x, 2.0, 22, |_| 0.0);
    let fit = fit_mls_auto(&x, &u, 3.0, Some(1e-6)).unwrap();
    assert_eq!(fit.meets_required, Some(false));
    assert_eq!(fit.curve, fit_mls_auto(&x, &u, 3.0, None).unwrap().curve);
}

/// With more than 100 targets, the settings are tested at some of the targets, with supports of at most 400 targets.
/// The curve is as good as with few targets.
#[test]
fn many_targets_are_followed_like_few() {
    let wave = |x: f64| 10.0 * (x / 500.0).sin();
    for count in [101, 400, 1000, 3000] {
        let x = targets(count);
        let u = noisy(&x, 1.0, 27, wave);
        let fit = fit_mls_auto(&x, &u, 3.0, Some(20.0)).unwrap();
        assert_eq!(fit.meets_required, Some(true));
        assert!(mls(&fit).half_width() * f64::from(count) <= 400.0 * 8000.0 * 1.01);
        let misses = x.iter().map(|&x| (fit.curve.value(x) - wave(x)).powi(2));
        let rms = (misses.sum::<f64>() / f64::from(count)).sqrt();
        // This limit is the residual of a fit with ten to twenty coefficients for a scatter of 1 µm.
        assert!(rms < 0.6, "{count}: {rms}");
        // A single reading that no curve follows is reported, even if the settings are not tested at its target.
        let mut u = u;
        u[usize::try_from(count / 2).unwrap() + 1] += 200.0;
        let fit = fit_mls_auto(&x, &u, 3.0, Some(20.0)).unwrap();
        assert_eq!(fit.meets_required, Some(false), "{count}");
    }
    // Both directions of a line get the same setting, even if one direction has an additional target.
    let [x, more] = [targets(800), targets(801)];
    let sets = [(&x[..], at(&x, wave)), (&more[..], at(&more, wave))];
    let both = sets.each_ref().map(|(x, u)| (*x, &u[..]));
    assert!(volcomp_fit::choose_mls(&both, 3.0, None).is_ok());
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
    let Curve::Polynomial(polynomial) = &parabola.curve else { panic!("{:?}", parabola.curve) };
    assert_eq!(polynomial.coefficients().len(), 3);
    let constant = fit_auto(&x, &[2.0; 6], None).unwrap();
    assert!(matches!(&constant.curve, Curve::Polynomial(p) if p.coefficients().len() == 1));
    // Three targets give no candidate for moving least squares: with one target omitted, only a line through two would
    // remain.
    let x = targets(3);
    assert!(matches!(
        fit_mls_auto(&x, &x, 3.0, None),
        Err(FitError::NoCandidate { targets: 3, .. })
    ));
    assert!(matches!(scan_mls(&x, &x, 3.0), Err(FitError::NoCandidate { targets: 3, .. })));
    let x = targets(7);
    assert!(matches!(fit_auto(&x, &x, None).unwrap().curve, Curve::Polynomial(_)));
    // A straight line is fitted by a polynomial, with any number of targets.
    let x = targets(21);
    assert!(matches!(fit_auto(&x, &x, None).unwrap().curve, Curve::Polynomial(_)));
}

/// The setting for two directions is the one with the smallest error at omitted targets when both curves are refitted
/// without these targets.
#[test]
fn the_setting_of_both_directions_is_that_of_refits() {
    let mut noise = 7_u32;
    let mut random = || {
        noise = noise.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        f64::from(noise >> 8) / f64::from(1_u32 << 24) - 0.5
    };
    let x: Vec<f64> = (0..17).map(|k| 50.0 * f64::from(k)).collect();
    let mut readings = |phase: f64| -> Vec<f64> {
        let value = |x: &f64| 8.0 * (x / 130.0 + phase).sin() + 0.01 * x + random();
        x.iter().map(value).collect()
    };
    let sets = [readings(0.0), readings(0.4)];
    let without = |values: &[f64], left: usize| -> Vec<f64> {
        let others = values.iter().enumerate().filter(|(k, _)| *k != left);
        others.map(|(_, value)| *value).collect()
    };
    // The support is a fraction of the range. The range is the same if an inner target is omitted.
    let missed = |order: usize, support: f64| -> Option<f64> {
        let mut sum = 0.0;
        for u in &sets {
            for left in 1..x.len() - 1 {
                let (others, values) = (without(&x, left), without(u, left));
                let fit = volcomp_fit::fit_mls(&others, &values, order, support, 3.0).ok()?;
                sum += (u[left] - fit.curve.value(x[left])).powi(2);
            }
        }
        Some(sum)
    };
    let trials = volcomp_fit::scan_mls(&x, &sets[0], 3.0).expect("settings");
    let refitted = trials
        .iter()
        .filter_map(|trial| Some((missed(trial.order, trial.support)?, trial)))
        .min_by(|a, b| a.0.total_cmp(&b.0))
        .expect("a setting")
        .1;
    let both: Vec<(&[f64], &[f64])> = sets.iter().map(|u| (&x[..], &u[..])).collect();
    let (order, support) = volcomp_fit::choose_mls(&both, 3.0, None).expect("a setting");
    assert_eq!((order, support), (refitted.order, refitted.support));
    // Only one stiffer or one looser setting meets this required residual, and the choice finds it.
    let strict = volcomp_fit::choose_mls(&both, 3.0, Some(0.3)).expect("a setting");
    for u in &sets {
        let fit = volcomp_fit::fit_mls(&x, u, strict.0, strict.1, 3.0).expect("a fit");
        assert!(fit.max_abs() <= 0.3, "{strict:?}: {}", fit.max_abs());
    }
    assert!(volcomp_fit::choose_mls(&[], 3.0, None).is_err());
}
