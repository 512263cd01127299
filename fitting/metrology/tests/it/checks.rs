//! Plausibility checks: outlying runs and readings, and anomalies of a straightness measurement.

use std::fmt::Write as _;

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, Normal};
use volcomp_metrology::{Measurement, Quantity, Reading, anomalies, outlier_hints, parse_csv};
use volcomp_vocabulary::Direction;

const SIGMA_UM: f64 = 1.3;

/// Readings of a smooth curve with a reversal value, with Gaussian noise on each reading.
fn gaussian(rng: &mut ChaCha8Rng, runs: u32, targets: u32) -> Measurement {
    let noise = Normal::new(0.0, SIGMA_UM).unwrap();
    let mut readings = Vec::new();
    for run in 1..=runs {
        for direction in Direction::BOTH {
            for k in 0..targets {
                let target = f64::from(k) * 400.0;
                let reversal = if direction == Direction::Positive { 2.0 } else { -2.0 };
                let deviation = 30.0 * (target / 900.0).sin() + reversal + noise.sample(rng);
                readings.push(Reading { target, run, direction, deviation });
            }
        }
    }
    Measurement { readings, ..Measurement::default() }
}

fn share_with_hints(runs: u32, targets: u32) -> f64 {
    const TRIALS: u32 = 2000;
    let mut rng = ChaCha8Rng::seed_from_u64(230);
    let with_hints =
        (0..TRIALS).filter(|_| !outlier_hints(&gaussian(&mut rng, runs, targets)).is_empty());
    with_hints.count() as f64 / f64::from(TRIALS)
}

#[test]
fn clean_gaussian_readings_give_no_hint() {
    for (runs, targets) in [(5, 21), (5, 5), (3, 21), (3, 11), (10, 41)] {
        let share = share_with_hints(runs, targets);
        println!("{runs} x 2 runs, {targets} targets: {:.2} % with a hint", 100.0 * share);
        assert!(share <= 0.01, "{runs} x 2 runs, {targets} targets: {share}");
    }
}

#[test]
fn only_an_outlying_run_is_reported() {
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    for runs in [3, 5, 8] {
        let mut m = gaussian(&mut rng, runs, 21);
        let bad = |r: &&mut Reading| r.run == 2 && r.direction == Direction::Negative;
        m.readings.iter_mut().filter(bad).for_each(|r| r.deviation += 8.0 * SIGMA_UM);
        let hints = outlier_hints(&m);
        let named: Vec<_> = hints.iter().map(|h| (h.run, h.direction, h.target)).collect();
        assert_eq!(named, [(2, Direction::Negative, None)], "{runs} runs");
        assert!((hints[0].size - 8.0 * SIGMA_UM).abs() < 2.0 * SIGMA_UM);
    }
}

#[test]
fn a_single_outlier_is_reported_with_its_target_and_sign() {
    let mut rng = ChaCha8Rng::seed_from_u64(2);
    let mut m = gaussian(&mut rng, 5, 21);
    let wild = m.readings.iter_mut().find(|r| r.run == 4 && r.target == 2000.0).unwrap();
    wild.deviation -= 11.0 * SIGMA_UM;
    let before = m.clone();
    let hints = outlier_hints(&m);
    assert_eq!(m, before);
    assert_eq!(hints.len(), 1);
    assert_eq!((hints[0].run, hints[0].target), (4, Some(2000.0)));
    assert!(hints[0].size < -7.0 * SIGMA_UM);
}

#[test]
fn two_runs_and_rounded_readings_give_no_hint() {
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    let mut two_runs = gaussian(&mut rng, 2, 5);
    two_runs.readings[0].deviation += 100.0;
    assert_eq!(outlier_hints(&two_runs), []);
    // The noise is far below the step: readings are equal or differ by one step.
    let mut rounded = gaussian(&mut rng, 5, 21);
    for reading in &mut rounded.readings {
        let noise = (reading.deviation * 1e6).fract() / 1e3;
        reading.deviation = (0.49 + noise * 15.0 + reading.target / 100.0).round();
    }
    let values = |target| rounded.deviations_at(target, Direction::Positive);
    assert!(values(400.0).iter().any(|x| *x != values(400.0)[0]), "some readings differ");
    assert_eq!(outlier_hints(&rounded), []);
}

/// A parabola with the deviation `middle_um` in its middle, on a slope of 5 mm as from misaligned optics.
fn straightness(middle_um: f64) -> Measurement {
    let mut text = String::from("target,deviation_um\n");
    for step in 0..=10 {
        let share = f64::from(step) / 10.0;
        let value = 5000.0 * share + 4.0 * middle_um * share * (1.0 - share);
        // Writing to a String cannot fail.
        let _ = writeln!(text, "{},{value}", 100 * step);
    }
    let mut measurement = parse_csv(text.as_bytes(), "exy.csv").expect("readings");
    measurement.quantity = Some(Quantity::Straightness);
    measurement
}

#[test]
fn a_straightness_is_checked_after_removing_its_line() {
    let said = |middle_um: f64| anomalies(&straightness(middle_um)).join("\n");
    assert_eq!(said(6.0), "");
    // Deviations in mm that are read as µm: the middle is only 6 nm off the line.
    assert!(said(0.006).contains("every deviation is below 0.1 µm"), "{}", said(0.006));
    // The middle and the ends of a parabola deviate by up to two thirds of its height from its line.
    let message = said(6000.0);
    assert!(
        message.contains("are large for a machine tool") && !message.contains("5000"),
        "{message}"
    );
    // As positioning deviations, the same readings extend over 5 mm.
    let positioning = Measurement { quantity: Some(Quantity::Positioning), ..straightness(6.0) };
    assert!(anomalies(&positioning).join("\n").contains("up to 5000 µm"));
}
