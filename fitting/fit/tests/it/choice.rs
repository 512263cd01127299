//! Tests of the automatic choice of a kind of curve.

use volcomp_fit::curve::Curve;
use volcomp_fit::{FitOptions, Method, Noise, Reason, choose, fit_auto};

use crate::judged::{Row, rows};
use crate::{at, noisy, targets};

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
