//! Scatter of results due to noise, compared with the Cramér–Rao bound (the inverse of the Fisher information). No
//! unbiased evaluation of the same readings has less scatter, unless it makes assumptions on the shape of a guideway or
//! on the tilts between targets.

use nalgebra::{DMatrix, DVector};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use volcomp_metrology::{
    Measurement, ParallelLine, Reading, ReferenceLine, TiltReading, angular_method_um,
    separate_parallel_lines, squareness,
};
use volcomp_vocabulary::{Direction, ErrorName, Urad};

const DRAWS: usize = 1500;
/// Accepted ratio of the scatter to the bound. With this number of samples, a standard deviation is known within 2 %.
const AS_GOOD: std::ops::RangeInclusive<f64> = 0.9..=1.1;

/// Smallest possible standard deviations of linear functions of the parameters (rows of `wanted`). The readings are
/// linear in the parameters (rows of `design`) and have this noise.
fn bound(design: &DMatrix<f64>, wanted: &DMatrix<f64>, noise: f64) -> DVector<f64> {
    let information = design.transpose() * design / (noise * noise);
    let covariance = wanted * information.try_inverse().unwrap() * wanted.transpose();
    covariance.diagonal().map(f64::sqrt)
}

/// Readings of several runs: the true values with noise.
fn read(truth: &[(f64, f64)], runs: u32, noise: f64, rng: &mut ChaCha8Rng) -> Measurement {
    let mut readings = Vec::new();
    for run in 1..=runs {
        for (target, value) in truth {
            let drawn: f64 = StandardNormal.sample(rng);
            readings.push(Reading {
                target: *target,
                run,
                direction: Direction::Positive,
                deviation: value + noise * drawn,
            });
        }
    }
    Measurement { readings, ..Measurement::default() }
}

/// Scatter of the errors over many samples, divided by the bound.
fn ratio(bound: &DVector<f64>, seed: u64, error: impl Fn(&mut ChaCha8Rng) -> Vec<f64>) -> f64 {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let squares: f64 = (0..DRAWS).flat_map(|_| error(&mut rng)).map(|e| e * e).sum();
    (squares / DRAWS as f64 / bound.norm_squared()).sqrt()
}

fn named(name: &str) -> ErrorName {
    name.parse().unwrap()
}

/// Straightness deviation of a guideway of 8 m at `q` mm, µm.
fn guideway(q: f64) -> f64 {
    let t = q / 8000.0 * std::f64::consts::TAU;
    20.0 * t.sin() + 6.0 * (3.0 * t).cos()
}

#[test]
fn straightness_by_the_angular_method_scatters_as_little_as_it_can() {
    for (bridge_mm, steps, noise_urad, runs) in
        [(200.0, 40_usize, 5.0, 1), (500.0, 16, 2.0, 3), (1000.0, 8, 1.0, 10)]
    {
        let targets: Vec<f64> = (0..=steps).map(|k| bridge_mm * k as f64).collect();
        let tilt = |q: &f64| (guideway(*q) - guideway(q - bridge_mm)) / bridge_mm * 1e3;
        let truth: Vec<(f64, f64)> = targets.iter().map(|q| (*q, tilt(q))).collect();
        // Each tilt is a parameter that is read once in each run. The profile is the running sum of the tilts without
        // its best-fit line.
        let design = DMatrix::identity(steps, steps);
        let sums =
            DMatrix::from_fn(
                steps + 1,
                steps,
                |to, step| {
                    if step < to { 1e-3 * bridge_mm } else { 0.0 }
                },
            );
        let line =
            DMatrix::from_fn(steps + 1, 2, |k, power| if power == 0 { 1.0 } else { targets[k] });
        let normal = line.transpose() * &line;
        let wanted = &sums - &line * normal.try_inverse().unwrap() * line.transpose() * &sums;
        let least = bound(&design, &wanted, noise_urad / f64::from(runs).sqrt());
        // For many steps, the variance of the profile tends to steps/15, in units of the variance of a step.
        let step_um = 1e-3 * bridge_mm * noise_urad / f64::from(runs).sqrt();
        let closed = step_um * (steps as f64 / 15.0).sqrt();
        let rms = least.norm() / ((steps + 1) as f64).sqrt();
        assert!((rms / closed - 1.0).abs() < 0.05, "{rms} {closed}");
        let about_line = |profile: &[(f64, f64)]| {
            let line = ReferenceLine::least_squares(profile).unwrap();
            line.removed_from(profile)
        };
        let true_profile: Vec<(f64, f64)> = targets.iter().map(|q| (*q, guideway(*q))).collect();
        let true_profile = about_line(&true_profile);
        let error = |rng: &mut ChaCha8Rng| {
            let tilts = read(&truth, runs, noise_urad, rng).mean_curve_in(Direction::Positive);
            let profile =
                angular_method_um(named("EZX"), TiltReading::Slope, &tilts, bridge_mm).unwrap();
            let found = about_line(&profile).into_iter().zip(&true_profile);
            found.map(|(found, truth)| found.1 - truth.1).collect()
        };
        let ratio = ratio(&least, 1, error);
        assert!(AS_GOOD.contains(&ratio), "{bridge_mm} {runs}: {ratio}");
    }
}

#[test]
fn squareness_from_two_lines_scatters_as_little_as_it_can() {
    for (length_mm, targets, runs) in
        [(500.0, 11, 1), (500.0, 51, 2), (1000.0, 21, 2), (4000.0, 41, 1)]
    {
        let places: Vec<f64> =
            (0..targets).map(|k| length_mm * f64::from(k) / f64::from(targets - 1)).collect();
        // Parameters: intercept and slope of each line. The result is the sum of the slopes, µrad.
        let count = places.len();
        let design = DMatrix::from_fn(2 * count, 4, |row, column| {
            let own = column / 2 == row / count;
            match (own, column % 2) {
                (false, _) => 0.0,
                (true, 0) => 1.0,
                (true, _) => places[row % count],
            }
        });
        let wanted = DMatrix::from_row_slice(1, 4, &[0.0, -1e3, 0.0, -1e3]);
        let least = bound(&design, &wanted, 1.0 / f64::from(runs).sqrt());
        let n = count as f64;
        let closed =
            (24.0 * (n - 1.0) / (n * (n + 1.0)) / f64::from(runs)).sqrt() / length_mm * 1e3;
        assert!((least[0] / closed - 1.0).abs() < 1e-9, "{} {closed}", least[0]);
        let error = |rng: &mut ChaCha8Rng| {
            let mut slope = |slope_urad: f64| {
                let truth: Vec<_> = places.iter().map(|q| (*q, 1e-3 * slope_urad * q)).collect();
                let profile = read(&truth, runs, 1.0, rng).mean_curve();
                ReferenceLine::least_squares(&profile).unwrap().slope()
            };
            let slopes = [(named("EXY"), slope(12.0)), (named("EYX"), slope(-7.0))];
            let found = squareness(named("EC0Y"), Urad(0.0), slopes).unwrap();
            vec![found.0 + 5.0]
        };
        let ratio = ratio(&least, 2, error);
        assert!(AS_GOOD.contains(&ratio), "{length_mm} {targets}: {ratio}");
    }
}

#[test]
fn angles_from_parallel_lines_scatter_as_little_as_they_can() {
    let three = [[0.0, 0.0], [1000.0, 0.0], [0.0, 1000.0]];
    let four = [[0.0, 0.0], [1000.0, 0.0], [0.0, 700.0], [-400.0, 300.0]];
    for (offsets, runs) in [(&three[..], 10), (&four[..], 2)] {
        // Parameters: the linear error and both angles; µrad times m give µm.
        let design = DMatrix::from_fn(offsets.len(), 3, |line, parameter| match parameter {
            0 => 1.0,
            1 => 1e-3 * offsets[line][1],
            _ => -1e-3 * offsets[line][0],
        });
        let wanted = DMatrix::from_row_slice(2, 3, &[0.0, 1.0, 0.0, 0.0, 0.0, 1.0]);
        let least = bound(&design, &wanted, 1.0 / f64::from(runs).sqrt());
        let truth = DVector::from_row_slice(&[3.0, 15.0, -8.0]);
        let read_on = &design * &truth;
        let error = |rng: &mut ChaCha8Rng| {
            let lines: Vec<ParallelLine> = (offsets.iter().zip(read_on.iter()))
                .map(|(offset, value)| ParallelLine {
                    offset_mm: *offset,
                    deviations_um: (read(&[(0.0, *value)], runs, 1.0, rng).mean_curve().iter())
                        .map(|point| point.1)
                        .collect(),
                })
                .collect();
            let found = separate_parallel_lines(&lines).unwrap()[0].angles_urad;
            vec![found[0] - truth[1], found[1] - truth[2]]
        };
        let ratio = ratio(&least, 3, error);
        assert!(AS_GOOD.contains(&ratio), "{} lines: {ratio}", offsets.len());
        if offsets.len() == 3 {
            // Closed form: √2 times the noise divided by the lever, µrad.
            let closed = (2.0 / f64::from(runs)).sqrt();
            assert!((least[0] / closed - 1.0).abs() < 1e-9, "{}", least[0]);
        }
    }
}
