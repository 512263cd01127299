//! Tests of straightness and squareness from files, and of errors on parallel lines.

use std::{fmt::Write as _, iter};

use rand::SeedableRng;
use rand_distr::{Distribution, Normal};
use volcomp_metrology::{
    Direction, Measurement, ParallelLine, Reading, ReferenceKind, ReferenceLine, SlopeUncertainty,
    SquarenessInputs, parse_csv, separate_parallel_lines, squareness_of_lengths,
    squareness_uncertainty, straightness_of, straightness_of_profile,
};

use crate::samples::near;

/// A triangle of 6 µm on a slope of 10 µrad. All three lines give 6 µm: the end-point line, the minimum zone, and the
/// least-squares line, which is level at 2 through (−1, 0), (0, 6) and (1, 0). With a fourth point, the three results
/// differ.
#[test]
fn the_three_reference_lines_by_hand() {
    let sloped = |q: f64, x: f64| (q, x + 0.01 * q);
    let profile = [sloped(0.0, 0.0), sloped(500.0, 6.0), sloped(1000.0, 0.0)];
    let found = straightness_of_profile(&profile).unwrap();
    for kind in [ReferenceKind::LeastSquares, ReferenceKind::EndPoints, ReferenceKind::MinimumZone]
    {
        let about = found.of(kind);
        assert_eq!(about.kind, kind);
        near(about.error_um, 6.0, 1e-9);
        near(about.line.slope().0, 10.0, 1e-9);
    }
    // Points (0, 0), (1, 3), (2, 0), (3, 3). The end-point line rises by 1 per unit: residuals 0, 2, −2, 0, range 4.
    // The least-squares line has slope 0.6: residuals −0.6, 1.8, −1.8, 0.6, range 3.6. The narrowest strip has slope 0:
    // range 3.
    let zigzag = [(0.0, 0.0), (1.0, 3.0), (2.0, 0.0), (3.0, 3.0)];
    let found = straightness_of_profile(&zigzag).unwrap();
    near(found.of(ReferenceKind::EndPoints).error_um, 4.0, 1e-12);
    near(found.of(ReferenceKind::LeastSquares).error_um, 3.6, 1e-12);
    near(found.of(ReferenceKind::MinimumZone).error_um, 3.0, 1e-12);
    // Residuals −0.6, 1.8, −1.8, 0.6: sum of squares 7.2, s² = 3.6, Σ(q − q̄)² = 5. 1 µm/mm is 1000 µrad.
    let u = found.slope_uncertainty.unwrap().standard_urad;
    near(u, (3.6_f64 / 5.0).sqrt() * 1e3, 1e-9);
}

#[test]
fn runs_of_both_directions_make_one_profile_and_their_difference() {
    let text = "target,run,direction,deviation_um\n0,1,+,0\n10,1,+,4\n20,1,+,0\n20,1,-,2\n10,1,-,2\n0,1,-,2\n";
    let found = straightness_of(&parse_csv(text.as_bytes(), "s.csv").unwrap()).unwrap();
    assert_eq!(found.profile, [(0.0, 1.0), (10.0, 3.0), (20.0, 1.0)]);
    assert_eq!(found.reversal_um, Some(2.0));
    let single = parse_csv(b"target,deviation_um\n0,1\n", "s.csv").unwrap();
    assert!(straightness_of(&single).is_err());
}

/// Runs with different slopes, as after realignment of the beam, increase the uncertainty of the slope by their
/// scatter: the standard deviation of (−60, 10, 50) µrad is 55.7 µrad.
#[test]
fn different_slopes_of_runs_widen_the_uncertainty() {
    let stated = |slopes: [f64; 3]| {
        let mut text = "target,run,direction,deviation_um\n".to_owned();
        for (run, slope) in (1..).zip(slopes) {
            for k in 0..11 {
                let at = 50.0 * f64::from(k);
                let noise = 0.05 * f64::from((7 * k + 3 * run) % 5 - 2);
                let _ = writeln!(text, "{at},{run},+,{:?}", 1e-3 * slope * at + noise);
            }
        }
        let found = straightness_of(&parse_csv(text.as_bytes(), "s.csv").unwrap()).unwrap();
        found.slope_uncertainty.unwrap().standard_urad
    };
    near(stated([-60.0, 10.0, 50.0]), 55.678 / 3.0_f64.sqrt(), 0.2);
    assert!(stated([0.0, 0.0, 0.0]) < 0.2);
}

/// The stated standard uncertainty of a slope equals the scatter of the slopes in simulations.
#[test]
fn the_uncertainty_of_a_slope_matches_simulations() {
    let noise = Normal::new(0.0, 1.0).unwrap();
    let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(1);
    let (mut slopes, mut stated) = (Vec::new(), Vec::new());
    for _ in 0..4000 {
        let profile: Vec<(f64, f64)> =
            (0..21).map(|k| (f64::from(k) * 50.0, noise.sample(&mut rng))).collect();
        let found = straightness_of_profile(&profile).unwrap();
        slopes.push(found.of(ReferenceKind::LeastSquares).line.slope().0);
        stated.push(found.slope_uncertainty.unwrap().standard_urad.powi(2));
    }
    let mean_square = |v: &[f64]| v.iter().map(|x| x * x).sum::<f64>() / v.len() as f64;
    let scatter = mean_square(&slopes).sqrt();
    let stated = (stated.iter().sum::<f64>() / stated.len() as f64).sqrt();
    near(stated, scatter, 0.03 * scatter);
}

/// A straightness line of 500 mm: numbers of targets and runs, noise of a reading in µm, and scatter of the slope of
/// the reference between runs in µrad.
struct Line {
    targets: u32,
    runs: u32,
    noise_um: f64,
    realigned_urad: f64,
}

impl Line {
    /// Simulates readings in both directions with a reversal value, and with a profile if there are several runs.
    /// Returns the evaluated straightness, and the error of its slope in µrad.
    fn measured(
        &self,
        rng: &mut rand_chacha::ChaCha8Rng,
    ) -> (volcomp_metrology::Straightness, f64) {
        let normal = Normal::new(0.0, 1.0).unwrap();
        let targets = (0..self.targets).map(|k| 500.0 * f64::from(k) / f64::from(self.targets - 1));
        let height_um = if self.runs > 1 { 5.0 } else { 0.0 };
        let truth: Vec<(f64, f64)> =
            targets.map(|q| (q, 0.012 * q + height_um * (q / 90.0).sin())).collect();
        let mut readings = Vec::new();
        for run in 1..=self.runs {
            let slope = 1e-3 * self.realigned_urad * normal.sample(rng);
            let zero = 100.0 * normal.sample(rng);
            for direction in Direction::BOTH {
                let reversal = if direction == Direction::Positive { 1.5 } else { -1.5 };
                readings.extend(truth.iter().map(|(target, value)| Reading {
                    target: *target,
                    run,
                    direction,
                    deviation: value
                        + zero
                        + slope * target
                        + reversal
                        + self.noise_um * normal.sample(rng),
                }));
            }
        }
        let measurement = Measurement { readings, ..Measurement::default() };
        let found = straightness_of(&measurement).unwrap();
        let true_slope = ReferenceLine::least_squares(&truth).unwrap().slope().0;
        let error = found.of(ReferenceKind::LeastSquares).line.slope().0 - true_slope;
        (found, error)
    }
}

/// Fraction of simulated squareness errors whose deviation from the truth is within the stated U. The reference square
/// is calibrated to U = 3 µrad.
fn coverage(lines: [&Line; 2]) -> f64 {
    const TRIALS: u32 = 800;
    let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(7);
    let square = Normal::new(0.0, 1.5).unwrap();
    let inputs = SquarenessInputs { square_urad: Some(3.0), ..SquarenessInputs::default() };
    let inside = (0..TRIALS).filter(|_| {
        let [(first, a), (second, b)] = lines.map(|line| line.measured(&mut rng));
        let error = a + b + square.sample(&mut rng);
        let slopes = [first, second].map(|line| line.slope_uncertainty.unwrap());
        let found = squareness_uncertainty(&inputs, slopes, [500.0; 2]).unwrap();
        error.abs() <= found.whole_urad
    });
    inside.count() as f64 / f64::from(TRIALS)
}

/// The stated U contains the true squareness with a probability of 95.45 % (k = 2), or more if both lines have few
/// degrees of freedom. The reference is realigned only if there are several runs, because a single run does not show
/// this effect.
#[test]
fn the_uncertainty_of_a_squareness_covers_the_truth() {
    for runs in [1, 2, 5] {
        for targets in [3, 4, 11] {
            let realigned_urad = if runs > 1 { 20.0 } else { 0.0 };
            let line = |noise_um| Line { targets, runs, noise_um, realigned_urad };
            let noisy = line(2.0);
            // The scatter of this line is negligible.
            let still = Line { noise_um: 0.01, realigned_urad: 0.01, ..noisy };
            let [both, one] = [coverage([&noisy, &noisy]), coverage([&noisy, &still])];
            assert!((0.935..0.998).contains(&both), "{runs} {targets}: {both}");
            assert!((0.935..0.975).contains(&one), "{runs} {targets}: {one}");
        }
    }
}

/// The stated U also covers the slope of a profile that is summed from bridge tilts; the residuals about its line would
/// give only a fraction of this U.
#[test]
fn the_uncertainty_of_the_slope_of_a_bridge_covers_the_truth() {
    const TRIALS: u32 = 2000;
    let noise = Normal::new(0.0, 3.0).unwrap();
    let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(3);
    for steps in [2, 4, 20] {
        let mut inside = 0;
        for _ in 0..TRIALS {
            let tilts: Vec<f64> = (0..steps).map(|_| 8.0 + noise.sample(&mut rng)).collect();
            let mut profile = vec![(0.0, 0.0)];
            for tilt in &tilts {
                let (at, height) = *profile.last().unwrap();
                profile.push((at + 200.0, height + 0.2 * tilt));
            }
            let slope = ReferenceLine::least_squares(&profile).unwrap().slope().0;
            // The tilt at the first target is not used.
            let at = |(place, tilt): (usize, &f64)| (200.0 * (place + 1) as f64, *tilt);
            let readings = tilts.iter().enumerate().map(at);
            let readings: Vec<_> = iter::once((0.0, 1e3)).chain(readings).collect();
            let u = SlopeUncertainty::of_tilts(&readings).unwrap();
            inside += u32::from((slope - 8.0).abs() <= u.expanded_urad());
        }
        let share = f64::from(inside) / f64::from(TRIALS);
        assert!((0.935..0.975).contains(&share), "{steps}: {share}");
    }
}

/// For a point at (b, c) across X, the deviation is δ = E + ε_Y c − ε_Z b. The deviations of four lines are computed by
/// hand.
#[test]
fn parallel_lines_give_back_the_angles() {
    let truth = [(3.0, [10.0, -20.0]), (-1.0, [0.0, 7.5])];
    let line = |b: f64, c: f64| ParallelLine {
        offset_mm: [b, c],
        deviations_um: truth
            .iter()
            .map(|(e, [about_y, about_z])| e + 1e-3 * (about_y * c - about_z * b))
            .collect(),
    };
    let lines = [line(0.0, 0.0), line(800.0, 0.0), line(0.0, 600.0), line(-300.0, 450.0)];
    let found = separate_parallel_lines(&lines).unwrap();
    for (found, (linear, angles)) in found.iter().zip(truth) {
        near(found.linear_um, linear, 1e-9);
        near(found.angles_urad[0], angles[0], 1e-9);
        near(found.angles_urad[1], angles[1], 1e-9);
    }
    let in_one_plane = [line(0.0, 0.0), line(800.0, 0.0), line(400.0, 0.0)];
    let mut uneven = lines.clone();
    uneven[1].deviations_um.pop();
    let mut broken = lines.clone();
    broken[1].deviations_um[0] = f64::NAN;
    let messages = [
        separate_parallel_lines(&lines[..2]),
        separate_parallel_lines(&in_one_plane),
        separate_parallel_lines(&uneven),
        separate_parallel_lines(&broken),
    ]
    .map(|refused| refused.unwrap_err().to_string());
    insta::assert_snapshot!(messages.join("\n"), @r"
    parallel lines: lines: found 2, expected at least three
    parallel lines: lines: found all in one plane, expected three that are not in one plane
    parallel lines: targets: found 1 beside 2, expected the same on each line
    parallel lines: numbers: found one that is not finite, expected finite numbers
    ");
}

/// A parallelogram whose side AD is along the first axis; side AB is inclined by t relative to the second axis. If B is
/// inclined towards the first axis, the angle is smaller by t: the result is −t for EC0Y and EA0Z, +t for EB0Z.
#[test]
fn squareness_of_a_drawn_parallelogram() {
    let distance = |[ax, ay]: [f64; 2], [bx, by]: [f64; 2]| (bx - ax).hypot(by - ay);
    for t in [-3e-3_f64, 0.0, 1e-4, 8e-3] {
        for [ad, ab] in [[100.0, 100.0], [150.0, 80.0]] {
            let (a, d) = ([10.0, 20.0], [10.0 + ad, 20.0]);
            let b = [10.0 + ab * t.sin(), 20.0 + ab * t.cos()];
            let c = [b[0] + ad, b[1]];
            for side in [distance(a, d), distance(a, b)] {
                let lengths = [distance(a, c), distance(b, d), side];
                for (error, sign) in [("EC0Y", -1.0), ("EA0Z", -1.0), ("EB0Z", 1.0)] {
                    let found = squareness_of_lengths(error.parse().unwrap(), lengths).unwrap();
                    assert!((found.0 - sign * t * 1e6).abs() < 1e-6, "{error} {t}: {found:?}");
                }
            }
        }
    }
    for lengths in [[0.0; 3], [141.0, 141.0, 250.0], [f64::NAN, 141.0, 100.0], [199.0, 20.0, 100.0]]
    {
        assert!(squareness_of_lengths("EC0Y".parse().unwrap(), lengths).is_err(), "{lengths:?}");
    }
    assert!(squareness_of_lengths("EXX".parse().unwrap(), [141.4, 141.4, 100.0]).is_err());
}
