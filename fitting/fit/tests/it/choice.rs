//! Tests of the automatic choice of a kind of curve.

use volcomp_fit::curve::{Curve, MovingLeastSquares};
use volcomp_fit::{
    Fit, FitError, FitOptions, Method, MlsTrial, Noise, Reason, choose, fit_auto, fit_mls,
    fit_mls_auto, fit_polynomial, scan_mls,
};

use crate::judged::{Row, rows};
use crate::{at, brute_force, noisy, targets};

fn none() -> FitOptions {
    FitOptions::default()
}

/// On 200 generated lines, the leave-one-out error of the choice is at most twice that of the best single kind, both as
/// reported and when refitted without each target. The distance of the chosen curve from the truth is on average less
/// than 1.15 times that of the best kind.
#[test]
fn never_worse_than_twice_the_best_single_kind() {
    let mut from_truth = Vec::new();
    for (index, row) in rows(200, 31).enumerate() {
        let score = |row: &Row| row.choice.chosen().unwrap().leave_one_out_rms;
        let best = row.choice.best_of_kinds();
        let best = best.iter().map(|s| s.leave_one_out_rms).fold(f64::INFINITY, f64::min);
        assert!(score(&row) <= 2.0 * best, "{index}: {} {best}", score(&row));
        // A refitted spline chooses its smoothing again; all other kinds keep their settings.
        if row.choice.method != Method::BSpline && row.line.targets.len() <= 31 {
            let refitted = row.automatic.leave_one_out;
            assert!((score(&row) / refitted - 1.0).abs() < 1e-6, "{index}: {refitted}");
            let others = row.kinds.iter().filter(|k| k.method != Method::BSpline);
            let best = others.map(|k| k.leave_one_out).fold(f64::INFINITY, f64::min);
            assert!(refitted <= 2.0 * best, "{index}: {refitted} {best}");
        }
        from_truth.push(row.ratios()[1].ln());
    }
    from_truth.sort_by(f64::total_cmp);
    let mean = (from_truth.iter().sum::<f64>() / 200.0).exp();
    // The comparison is with the kind that is nearest to the truth.
    assert!(mean < 1.15, "{mean}");
    assert!(from_truth[180].exp() < 1.5, "{}", from_truth[180].exp());
}

/// For readings that consist only of noise, the choice is the constant, their mean, on at least 40 of 60 lines.
#[test]
fn noise_gives_nearly_a_constant() {
    let mut constants = 0;
    let mut squares = 0.0;
    for seed in 0..60_usize {
        let count = [7, 11, 21, 41, 101][seed % 5];
        let runs = 1 + seed % 5;
        let x = vec![targets(count); runs].concat();
        let u = noisy(&x, 1.0, seed as u64, |_| 5.0);
        let found = fit_auto(&x, &u, &none()).unwrap();
        constants += u32::from(found.choice.chosen().unwrap().coefficients < 1.5);
        let fine = targets(201);
        let off: f64 = fine.iter().map(|&x| (found.fit.curve.value(x) - 5.0).powi(2)).sum();
        // Errors are in units of the standard deviation of a mean reading.
        squares += off / 201.0 * runs as f64;
    }
    assert!(constants >= 40, "{constants} of 60");
    let rms = (squares / 60.0).sqrt();
    assert!(rms < 0.5, "{rms}");
}

/// Between targets, evenly spaced or with a wide gap, no chosen curve is outside the range of the readings by more than
/// a quarter of its height.
#[test]
fn no_chosen_curve_leaves_the_band() {
    for seed in 0..40_u32 {
        let count = 5 + seed % 17;
        let mut x = targets(count);
        if seed % 2 == 1 && count > 8 {
            // Four neighbouring targets near the end are missing.
            x.drain(count as usize - 6..count as usize - 2);
        }
        let bend = 200.0 + 80.0 * f64::from(seed % 7);
        let u = noisy(&x, 0.3, u64::from(seed), |x| 8.0 * (x / bend).sin() + 0.002 * x);
        let curve = fit_auto(&x, &u, &none()).unwrap().fit.curve;
        let low = u.iter().copied().fold(f64::INFINITY, f64::min);
        let high = u.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        let more = 0.25 * (high - low);
        // The limit is slightly larger than at the positions that the rule samples.
        for x in targets(1601) {
            let value = curve.value(x);
            assert!(
                (low - 1.2 * more..=high + 1.2 * more).contains(&value),
                "{seed}: {value} at {x} of {low} to {high}, {}",
                curve.kind()
            );
        }
    }
}

#[test]
fn few_equal_and_repeated_targets() {
    let chosen = |x: &[f64], u: &[f64]| fit_auto(x, u, &none()).unwrap();
    // Repeated readings at one position are one target.
    let one = chosen(&[3.0; 4], &[1.0, 2.0, 3.0, 6.0]);
    assert_eq!(one.fit.curve, Curve::Constant(3.0));
    assert_eq!(one.choice.reason, Reason::FewTargets);
    let two = chosen(&[0.0, 10.0], &[1.0, 3.0]);
    assert_eq!(two.choice.method, Method::Polynomial { order: 1 });
    // Three readings cannot distinguish a bend from scatter: the choice is a line.
    let three = chosen(&[0.0, 10.0, 20.0], &[0.0, 6.0, 10.0]);
    assert_eq!(three.choice.method, Method::Polynomial { order: 1 });
    // Two equal runs over the three targets can.
    let x = [0.0, 10.0, 20.0, 0.0, 10.0, 20.0];
    let bent = chosen(&x, &[0.0, 6.0, 10.0, 0.01, 5.99, 10.01]);
    assert!((bent.fit.curve.value(10.0) - 5.995).abs() < 1e-9);
    // Repeated readings at a target count as one target, in any order.
    let (x, u) = ([0.0, 1.0, 2.0, 3.0, 1.0, 4.0], [0.0, 1.2, 1.9, 3.1, 1.0, 4.0]);
    let mixed = chosen(&x, &u).fit.curve;
    let (sorted_x, sorted_u) = ([0.0, 1.0, 1.0, 2.0, 3.0, 4.0], [0.0, 1.0, 1.2, 1.9, 3.1, 4.0]);
    let sorted = chosen(&sorted_x, &sorted_u).fit.curve;
    assert!((mixed.value(2.5) - sorted.value(2.5)).abs() < 1e-12);
    assert!(choose(&[], &none()).is_err());
}

/// The curve follows a bend at one target only if the known scatter of the readings is small.
#[test]
fn a_known_scatter_decides_what_is_followed() {
    let x = targets(9);
    let u = at(&x, |x| 10.0 * (x / 1500.0).sin() + if x == 4000.0 { 2.0 } else { 0.0 });
    let with = |deviation| {
        let noise = Some(Noise { deviation, freedom: 30.0 });
        let options = FitOptions { noise, ..none() };
        let fit = fit_auto(&x, &u, &options).unwrap().fit;
        (fit.curve.value(4000.0) - u[4]).abs()
    };
    assert!(with(0.05) < 0.1, "{}", with(0.05));
    assert!(with(2.0) > 0.5, "{}", with(2.0));
}

/// A scale error of a rotary axis over part of a turn gets no Fourier series, because a few widely spaced targets do
/// not cover a full turn.
#[test]
fn targets_over_a_part_of_a_turn_get_no_fourier_series() {
    let round = FitOptions { period: Some(360.0), ..none() };
    for (count, end) in [(2, 80.0), (3, 110.0), (4, 130.0), (5, 140.0), (8, 150.0), (10, 157.5)] {
        let step = 2.0 * end / f64::from(count - 1);
        let x: Vec<f64> = (0..count).map(|i| f64::from(i).mul_add(step, -end)).collect();
        let u = noisy(&x, 0.1, 5, |x| 0.5 * x);
        let chosen = fit_auto(&x, &u, &round).unwrap();
        let worst = (x.iter().zip(&u))
            .map(|(x, u)| (u - chosen.fit.curve.value(*x)).abs())
            .fold(0.0, f64::max);
        assert!(worst < 0.6, "{count} to ±{end}: {worst} by {}", chosen.choice.method);
    }
}

/// Readings over a full turn get a curve with the same value at both ends.
#[test]
fn periodic_readings_get_periodic_curves() {
    let round = FitOptions { period: Some(360.0), ..none() };
    let x: Vec<f64> = (0..12).map(|i| 30.0 * f64::from(i)).collect();
    let u = noisy(&x, 0.05, 3, |x| 5.0 * x.to_radians().cos() + (2.0 * x).to_radians().sin());
    let chosen = fit_auto(&x, &u, &round).unwrap();
    assert_eq!(chosen.choice.method, Method::Fourier { order: 2, period: 360.0 });
    assert!(
        (chosen.fit.curve.value(200.0)
            - (5.0 * 200_f64.to_radians().cos() + 400_f64.to_radians().sin()))
        .abs()
            < 0.1
    );
    for score in &chosen.choice.scores {
        let closes = matches!(
            score.method,
            Method::Fourier { .. }
                | Method::Polynomial { order: 0 }
                | Method::Chebyshev { order: 0 }
        );
        assert!(closes, "{}", score.method);
    }
    // Over part of a turn, other kinds of curve are candidates as well.
    let part: Vec<f64> = (0..9).map(|i| 15.0 * f64::from(i)).collect();
    let line = at(&part, |x| 0.1 * x);
    let chosen = fit_auto(&part, &line, &round).unwrap();
    assert_eq!(chosen.choice.method, Method::Polynomial { order: 1 });
}

/// Both directions of a line get the same kind of curve; each direction is fitted separately.
#[test]
fn several_sets_get_one_method() {
    let x = targets(21);
    let forward = noisy(&x, 0.2, 1, |x| 8.0 * (x / 900.0).sin());
    let backward = noisy(&x, 0.2, 2, |x| 8.0 * (x / 900.0).sin() - 2.0);
    let both = choose(&[(&x, &forward), (&x, &backward)], &none()).unwrap();
    let score = both.chosen().unwrap();
    let own = |u: &[f64]| {
        let one = choose(&[(&x, u)], &none()).unwrap();
        let same = one.scores.iter().find(|s| s.method == both.method);
        same.unwrap().leave_one_out_rms.powi(2)
    };
    let together = f64::midpoint(own(&forward), own(&backward)).sqrt();
    assert!((score.leave_one_out_rms / together - 1.0).abs() < 1e-12);
}

fn fit_within(x: &[f64], u: &[f64], required_residual: Option<f64>) -> Result<Fit, FitError> {
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
    let constant = fit_within(&[5.0, 5.0], &[1.0, 2.0], None).unwrap();
    assert_eq!(constant.curve, Curve::Constant(1.5));
    let line = fit_within(&[0.0, 10.0], &[1.0, 2.0], Some(0.1)).unwrap();
    assert!((line.curve.value(5.0) - 1.5).abs() < 1e-12);
    assert_eq!(line.meets_required, Some(true));
    let x = [0.0, 1.0, 2.0, 3.0, 4.0, 5.0];
    let parabola = fit_within(&x, &at(&x, |x| x * x), None).unwrap();
    let Curve::Polynomial(polynomial) = &parabola.curve else { panic!("{:?}", parabola.curve) };
    assert_eq!(polynomial.coefficients().len(), 3);
    let constant = fit_within(&x, &[2.0; 6], None).unwrap();
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
    assert!(matches!(fit_within(&x, &x, None).unwrap().curve, Curve::Polynomial(_)));
    // A straight line is fitted by a polynomial, with any number of targets.
    let x = targets(21);
    assert!(matches!(fit_within(&x, &x, None).unwrap().curve, Curve::Polynomial(_)));
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

/// Positioning deviation in µm at `x` in mm: a trend, waves longer than two target distances, and a local bump.
fn deviation(x: f64) -> f64 {
    let wave = |length: f64| (std::f64::consts::TAU * x / length).sin();
    let bump = 9.0 * (-((x - 5200.0) / 700.0).powi(2)).exp();
    0.0073 * x + 3.0 * wave(3700.0) + 2.5 * wave(2300.0) + bump
}

fn worst_between(curve: &Curve) -> f64 {
    targets(401).iter().map(|&x| (curve.value(x) - deviation(x)).abs()).fold(0.0, f64::max)
}

#[test]
fn moving_least_squares_residual_is_a_third_of_a_polynomial() {
    let x = targets(21);
    let readings = noisy(&x, 0.2, 11, deviation);
    let polynomial = fit_polynomial(&x, &readings, 6, [0.0, 8000.0]).unwrap();
    let moving = fit_mls(&x, &readings, 4, 1.0 / 3.0, 3.0).unwrap();
    assert!(polynomial.max_abs() > 3.0, "{}", polynomial.max_abs());
    assert!(moving.max_abs() <= polynomial.max_abs() / 3.0, "{}", moving.max_abs());
    // Largest deviations from the truth, including positions between the targets.
    let (by_moving, by_polynomial) =
        (worst_between(&moving.curve), worst_between(&polynomial.curve));
    assert!(by_moving <= by_polynomial / 3.0, "{by_moving} {by_polynomial}");
}

#[test]
fn the_automatic_mode_follows_it_over_dense_and_over_the_published_targets() {
    let dense = targets(81);
    let readings = noisy(&dense, 0.2, 11, deviation);
    let polynomial = fit_polynomial(&dense, &readings, 6, [0.0, 8000.0]).unwrap();
    let automatic = fit_mls_auto(&dense, &readings, 3.0, Some(2.0)).unwrap();
    assert_eq!(automatic.meets_required, Some(true));
    assert!(automatic.max_abs() <= polynomial.max_abs() / 3.0, "{}", automatic.max_abs());
    assert!(worst_between(&automatic.curve) <= worst_between(&polynomial.curve) / 3.0);

    // At the 21 targets of the published axis, the published setting is a candidate.
    let sparse = targets(21);
    let readings = noisy(&sparse, 0.2, 11, deviation);
    let polynomial = fit_polynomial(&sparse, &readings, 6, [0.0, 8000.0]).unwrap();
    let published = fit_mls(&sparse, &readings, 4, 1.0 / 3.0, 3.0).unwrap();
    let automatic = fit_mls_auto(&sparse, &readings, 3.0, Some(2.0)).unwrap();
    assert_eq!(automatic.meets_required, Some(true));
    assert!(automatic.leave_one_out_rms <= published.leave_one_out_rms);
    assert!(automatic.max_abs() <= polynomial.max_abs() / 3.0);
    assert!(worst_between(&automatic.curve) <= worst_between(&polynomial.curve) / 3.0);
}

#[test]
fn the_automatic_choice_follows_it_between_the_targets() {
    let x = targets(21);
    let readings = noisy(&x, 0.2, 11, deviation);
    let polynomial = fit_polynomial(&x, &readings, 6, [0.0, 8000.0]).unwrap();
    let chosen = fit_auto(&x, &readings, &FitOptions::default()).unwrap().fit;
    let (by_chosen, by_polynomial) =
        (worst_between(&chosen.curve), worst_between(&polynomial.curve));
    assert!(by_chosen <= by_polynomial / 3.0, "{by_chosen} {by_polynomial}");
}
