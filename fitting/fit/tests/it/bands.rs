//! Tests of 95 % bands against known truth.

use volcomp_fit::{
    Band, BandOptions, BandSource, FitOptions, Method, band, choose, fit_polynomial,
};

use crate::covered::{Covered, covered};
use crate::generated::{FAMILIES, Side, generated, undersampled};
use crate::{noisy, targets};

fn of_side(side: &Side, targets: &[f64], method: Method, at: &[f64]) -> Band {
    let runs: Vec<(&[f64], &[f64])> = side.runs.iter().map(|u| (targets, &u[..])).collect();
    band(method, &runs, at, &BandOptions::default()).expect("a band")
}

/// The bands of automatically chosen curves contain the truth at 90 to 99 % of the positions.
#[test]
fn bands_cover_the_truth_of_generated_lines() {
    let mut all = [0_u32; 2];
    for (number, family) in (0_u32..).zip(FAMILIES) {
        let mut pooled = [0_u32; 2];
        for index in (0..60).map(|k| 5 * k + number) {
            let line = generated(23, index);
            let sets: Vec<(Vec<f64>, Vec<f64>)> =
                line.sides.iter().map(|s| s.readings(&line.targets)).collect();
            let parts: Vec<(&[f64], &[f64])> = sets.iter().map(|(x, u)| (&x[..], &u[..])).collect();
            let method = choose(&parts, &FitOptions::default()).unwrap().method;
            let ends = [line.targets[0], line.targets[line.targets.len() - 1]];
            let at: Vec<f64> =
                (0..=60).map(|k| ends[0] + (ends[1] - ends[0]) * f64::from(k) / 60.0).collect();
            for (side, (x, u)) in line.sides.iter().zip(&sets) {
                let found = of_side(side, &line.targets, method, &at);
                let curve = method.fit(x, u).unwrap().curve;
                for (&x, half) in at.iter().zip(&found.half_width) {
                    pooled[0] += u32::from((curve.value(x) - (side.truth)(x)).abs() <= *half);
                    pooled[1] += 1;
                }
            }
        }
        let share = |held: [u32; 2]| f64::from(held[0]) / f64::from(held[1]);
        all = [all[0] + pooled[0], all[1] + pooled[1]];
        assert!((0.90..=0.99).contains(&share(pooled)), "{family}: {}", share(pooled));
    }
    let share = f64::from(all[0]) / f64::from(all[1]);
    assert!((0.90..=0.99).contains(&share), "{share}");
}

/// On a hundred lines, plotted bands contain the truth at 92 to 98 % of the positions at and between targets. On a
/// fifth of the lines the targets are too sparse for the pitch of the ball screw; bands from the targets alone contain
/// the truth there at less than 40 % of the positions.
#[test]
fn bands_cover_the_truth_between_targets() {
    let mut all = [Covered::default(); 2];
    for index in 0..100 {
        let is_sparse = index % 5 == 4;
        let line =
            if is_sparse { undersampled(29, index) } else { generated(29, index + index / 5) };
        all[usize::from(is_sparse)].add(covered(&line, 100));
    }
    let [others, mut sparse] = all;
    let mut together = others;
    together.add(sparse);
    assert!((0.92..=0.98).contains(&together.share()), "{together:?}");
    assert!((0.92..=0.98).contains(&others.share()), "{others:?}");
    assert!(sparse.share_of_targets() < 0.4, "{sparse:?}");
    // Most undersampled lines give a warning; a few look like a long wave.
    assert!(10 * sparse.warned >= 8 * sparse.curves, "{sparse:?}");
    // Twenty undersampled lines are too few to determine the coverage; about eighty more are used.
    for index in (104..500).step_by(5) {
        sparse.add(covered(&undersampled(29, index), 100));
    }
    assert!((0.93..=0.97).contains(&sparse.share()), "{sparse:?}");
}

/// The band of a line through many runs equals that of textbooks: ±1.96 σ √(h/m) for m runs, with the leverage h.
#[test]
fn the_band_of_many_runs_matches_the_textbook() {
    let x = targets(11);
    let runs: Vec<Vec<f64>> = (0..200).map(|seed| noisy(&x, 1.0, seed, |x| x / 800.0)).collect();
    let parts: Vec<(&[f64], &[f64])> = runs.iter().map(|u| (&x[..], &u[..])).collect();
    let at = [0.0, 4000.0, 8000.0];
    let line = Method::Polynomial { order: 1 };
    let found = band(line, &parts, &at, &BandOptions::default()).unwrap();
    assert_eq!(found.source, BandSource::Runs);
    // h = 1/n + (x − x̄)²/Σ(x − x̄)². For eleven evenly spaced targets, h is 1/11 in the middle and 1/11 + 25/110 at
    // the ends.
    for (half, h) in found.half_width.iter().zip([7.0 / 22.0, 1.0 / 11.0, 7.0 / 22.0]) {
        let expected = 1.96 * (h / 200.0_f64).sqrt();
        assert!((half / expected - 1.0).abs() < 0.2, "{half} {expected}");
    }
}

/// The band of one run is ±t s √h, with the residual standard deviation s and the leverage h, plus a component for the
/// shape. Resampling causes differences of up to 6 %.
#[test]
fn the_band_of_one_run_matches_the_textbook() {
    let x = targets(21);
    let u = noisy(&x, 1.0, 5, |x| x / 800.0);
    let at = [0.0, 4000.0];
    let line = Method::Polynomial { order: 1 };
    let options = BandOptions { resamples: 4000, seed: 3 };
    let found = band(line, &[(&x, &u)], &at, &options).unwrap();
    assert_eq!(found.source, BandSource::Residuals);
    let fit = fit_polynomial(&x, &u, 1, [0.0, 8000.0]).unwrap();
    let s = (fit.residuals.iter().map(|r| r * r).sum::<f64>() / 19.0).sqrt();
    for (half, h) in found.half_width.iter().zip([1.0 / 21.0 + 100.0 / 770.0, 1.0 / 21.0]) {
        // A quarter of the residual variance is attributed to the shape.
        let expected = s * (2.093_f64.powi(2) * h + 4.0 * 0.25).sqrt();
        assert!((half / expected - 1.0).abs() < 0.06, "{half} {expected}");
    }
    assert_eq!(found, band(line, &[(&x, &u)], &at, &options).unwrap());
}

#[test]
fn sets_without_resamples_are_refused_or_unknown() {
    let x = targets(2);
    let line = Method::Polynomial { order: 1 };
    let none = BandOptions { resamples: 1, seed: 1 };
    assert!(band(line, &[(&x, &x)], &x, &none).is_err());
    assert!(band(line, &[], &x, &BandOptions::default()).is_err());
    let unknown = band(line, &[(&x, &x)], &x, &BandOptions::default()).unwrap();
    assert_eq!(unknown.half_width, [f64::INFINITY; 2]);
}
