use proptest::prelude::*;
use volcomp_metrology::{
    Direction::{self, Negative, Positive},
    Iso230Part2, Measurement, MetrologyError, Reading, evaluate, parse_csv,
};

use crate::samples::{measurement, small};

fn published() -> Measurement {
    let text = include_bytes!("../data/iso230-2-axis.csv");
    parse_csv(text, "iso230-2-axis.csv").unwrap()
}

#[track_caller]
fn near(found: Option<f64>, expected: f64, tolerance: f64) {
    let found = found.expect("a value");
    assert!((found - expected).abs() <= tolerance, "{found} against {expected}");
}

#[test]
fn published_report_is_reproduced() {
    let result = evaluate(&published()).unwrap();
    // Published in mm with five decimals: half a digit is 0.005 µm. The readings are rounded to 0.01 µm.
    let tolerance = 0.0101;
    near(result.b, 43.46, tolerance);
    near(result.e_forward, 74.77, tolerance);
    near(result.e_backward, 46.12, tolerance);
    near(result.m, 48.09, tolerance);
    near(result.a_forward, 89.27, tolerance);
    near(result.a_backward, 204.75, tolerance);
    near(result.a, 204.75, tolerance);
    near(result.r_backward, 204.75, tolerance);
    // Published with one digit fewer.
    near(result.r_forward, 18.3, 0.05);
}

#[test]
fn only_the_outlying_backward_run_is_reported() {
    let hints = evaluate(&published()).unwrap().outlier_hints;
    let named: Vec<_> = hints.iter().map(|h| (h.run, h.direction, h.target)).collect();
    assert_eq!(named, [(1, Negative, None)]);
    insta::assert_snapshot!(hints[0].text, @"backward run 1 differs from the other runs by 55.23 (root mean square; usual scatter 2.26)");
}

/// Each value equals the value computed by hand.
#[test]
fn small_case_by_hand() {
    let result = evaluate(&small()).unwrap();
    let (s, root2) = (2.0_f64.sqrt(), 2.0_f64.sqrt());
    let first = result.targets[0];
    assert_eq!((first.forward.unwrap().n, first.backward.unwrap().n), (2, 2));
    assert_eq!((first.forward.unwrap().mean, first.reversal), (2.0, Some(4.0)));
    near(first.forward.unwrap().s, s, 1e-12);
    assert_eq!(first.backward.unwrap().s, Some(0.0));
    assert_eq!(first.mean, Some(0.0));
    near(first.repeatability, 2.0 * s + 4.0, 1e-12); // 6.83, above R↑ = 5.66
    near(result.targets[1].repeatability, 8.0 * root2, 1e-12); // R↓ = 4·2√2 rules over 4√2 + 1
    near(result.r, 8.0 * root2, 1e-12);
    near(result.r_forward, 4.0 * s, 1e-12);
    near(result.r_backward, 8.0 * root2, 1e-12);
    assert_eq!((result.e, result.e_forward, result.e_backward), (Some(8.0), Some(3.0), Some(8.0)));
    assert_eq!((result.m, result.b, result.mean_b), (Some(5.5), Some(4.0), Some(1.5)));
    near(result.a, (6.0 + 4.0 * root2) - (-2.0), 1e-12);
    near(result.a_forward, 5.0 - (2.0 - 2.0 * s), 1e-12);
    near(result.a_backward, (6.0 + 4.0 * root2) - (-2.0), 1e-12);
}

#[test]
fn one_run_has_no_repeatability_and_no_accuracy() {
    let m = measurement(&[
        (0.0, 1, Positive, 1.0),
        (10.0, 1, Positive, 5.0),
        (0.0, 1, Negative, -2.0),
        (10.0, 1, Negative, 4.0),
    ]);
    let r = evaluate(&m).unwrap();
    assert_eq!([r.r, r.r_forward, r.r_backward, r.a, r.a_forward, r.a_backward], [None; 6]);
    assert_eq!((r.e, r.e_forward, r.e_backward), (Some(7.0), Some(4.0), Some(6.0)));
    assert_eq!((r.m, r.b, r.mean_b), (Some(5.0), Some(3.0), Some(2.0)));
}

#[test]
fn one_direction_gives_no_bidirectional_values() {
    let backward = |target, run, deviation| (target, run, Negative, deviation);
    let m = measurement(&[
        backward(0.0, 1, 1.0),
        backward(0.0, 2, 1.0),
        backward(10.0, 1, 5.0),
        backward(10.0, 2, 5.0),
    ]);
    let r = evaluate(&m).unwrap();
    assert_eq!((r.a_backward, r.r_backward, r.e_backward), (Some(4.0), Some(0.0), Some(4.0)));
    let open = [r.a, r.r, r.e, r.a_forward, r.r_forward, r.e_forward, r.m, r.b, r.mean_b];
    assert_eq!(open, [None; 9]);
    assert_eq!((r.targets[0].forward, r.targets[0].mean), (None, None));
}

#[test]
fn a_target_without_one_direction_is_refused() {
    let m =
        measurement(&[(0.0, 1, Positive, 1.0), (10.0, 1, Positive, 5.0), (10.0, 1, Negative, 4.0)]);
    let error = evaluate(&m).unwrap_err();
    assert!(matches!(
        error,
        MetrologyError::TargetLacking { target: 0.0, direction: Negative, .. }
    ));
    insta::assert_snapshot!(error, @"m: target 0: found no reading in direction -, expected every target in each direction that was run");
}

#[test]
fn non_finite_readings_are_refused() {
    insta::assert_snapshot!(evaluate(&measurement(&[])).unwrap_err(), @"m: readings: found none, expected at least one reading");
    for bad in [f64::NAN, f64::INFINITY, 1e300] {
        assert!(evaluate(&measurement(&[(0.0, 1, Positive, bad)])).is_err());
        assert!(evaluate(&measurement(&[(bad, 1, Positive, 0.0)])).is_err());
    }
    insta::assert_snapshot!(evaluate(&measurement(&[(3.0, 1, Positive, f64::NAN)])).unwrap_err(), @"m: readings: found deviation NaN at target 3, expected finite numbers, at most 1e12");
}

/// Independent implementation of the formulas of ISO 230-2, directly from the readings.
fn second_implementation(m: &Measurement) -> [f64; 12] {
    let targets = m.targets();
    let stats = |target: f64, direction| {
        let x: Vec<f64> = (m.readings.iter())
            .filter(|r| r.target == target && r.direction == direction)
            .map(|r| r.deviation)
            .collect();
        let n = x.len() as f64;
        let sum: f64 = x.iter().sum();
        let squares: f64 = x.iter().map(|v| v * v).sum();
        (sum / n, ((squares - sum * sum / n).max(0.0) / (n - 1.0)).sqrt())
    };
    let up: Vec<_> = targets.iter().map(|t| stats(*t, Positive)).collect();
    let down: Vec<_> = targets.iter().map(|t| stats(*t, Negative)).collect();
    let max = |v: &[f64]| v.iter().fold(f64::NEG_INFINITY, |a, b| a.max(*b));
    let spread = |v: &[f64]| max(v) + max(&v.iter().map(|x| -x).collect::<Vec<_>>());
    let accuracy = |x: &[(f64, f64)]| {
        let upper: Vec<f64> = x.iter().map(|(m, s)| m + 2.0 * s).collect();
        let lower: Vec<f64> = x.iter().map(|(m, s)| -(m - 2.0 * s)).collect();
        max(&upper) + max(&lower)
    };
    let means = |x: &[(f64, f64)]| x.iter().map(|(m, _)| *m).collect::<Vec<_>>();
    let four_s = |x: &[(f64, f64)]| max(&x.iter().map(|(_, s)| 4.0 * s).collect::<Vec<_>>());
    let both = [up.clone(), down.clone()].concat();
    let pairs: Vec<_> = up.iter().zip(&down).collect();
    let reversal: Vec<f64> = pairs.iter().map(|(u, d)| u.0 - d.0).collect();
    let across: Vec<f64> =
        pairs.iter().map(|(u, d)| 2.0 * u.1 + 2.0 * d.1 + (u.0 - d.0).abs()).collect();
    [
        accuracy(&both),
        accuracy(&up),
        accuracy(&down),
        max(&across).max(four_s(&both)),
        four_s(&up),
        four_s(&down),
        spread(&means(&both)),
        spread(&means(&up)),
        spread(&means(&down)),
        spread(&pairs.iter().map(|(u, d)| 0.5 * (u.0 + d.0)).collect::<Vec<_>>()),
        max(&reversal.iter().map(|b| b.abs()).collect::<Vec<_>>()),
        reversal.iter().sum::<f64>() / reversal.len() as f64,
    ]
}

fn summary(r: &Iso230Part2) -> [Option<f64>; 12] {
    [
        r.a,
        r.a_forward,
        r.a_backward,
        r.r,
        r.r_forward,
        r.r_backward,
        r.e,
        r.e_forward,
        r.e_backward,
        r.m,
        r.b,
        r.mean_b,
    ]
}

#[track_caller]
fn same(found: [Option<f64>; 12], expected: [f64; 12], tolerance: f64) {
    for (found, expected) in found.into_iter().zip(expected) {
        near(found, expected, tolerance);
    }
}

prop_compose! {
    fn bidirectional()(
        targets in 1..8_usize,
        runs in 2..6_u32,
        deviations in prop::collection::vec(-100.0..100.0_f64, 2 * 7 * 5),
    ) -> Measurement {
        let mut deviation = deviations.into_iter();
        let mut readings = Vec::new();
        for run in 1..=runs {
            for direction in Direction::BOTH {
                for k in 0..targets {
                    let target = 12.5 * k as f64 - 30.0;
                    let deviation = deviation.next().unwrap();
                    readings.push(Reading { target, run, direction, deviation });
                }
            }
        }
        Measurement { readings, ..Measurement::default() }
    }
}

proptest! {
    #[test]
    fn agrees_with_a_second_implementation(m in bidirectional()) {
        same(summary(&evaluate(&m).unwrap()), second_implementation(&m), 1e-6);
    }

    #[test]
    fn a_constant_on_all_deviations_changes_nothing(m in bidirectional(), c in -1e3..1e3_f64) {
        let mut shifted = m.clone();
        shifted.readings.iter_mut().for_each(|r| r.deviation += c);
        let expected = summary(&evaluate(&m).unwrap()).map(Option::unwrap);
        same(summary(&evaluate(&shifted).unwrap()), expected, 1e-9);
    }

    #[test]
    fn the_result_depends_neither_on_the_order_of_readings_nor_on_run_numbers(
        (m, shuffled) in bidirectional().prop_flat_map(|m| {
            let readings = Just(m.readings.clone()).prop_shuffle();
            (Just(m), readings)
        })
    ) {
        let runs = shuffled.iter().map(|r| r.run).max().unwrap();
        let renumbered = |r: Reading| Reading { run: runs + 1 - r.run, ..r };
        let readings = shuffled.into_iter().map(renumbered).collect();
        let other = Measurement { readings, ..Measurement::default() };
        let expected = summary(&evaluate(&m).unwrap()).map(Option::unwrap);
        same(summary(&evaluate(&other).unwrap()), expected, 1e-9);
    }

    #[test]
    fn mirrored_deviations_mirror_only_the_mean_reversal(m in bidirectional()) {
        let mut mirrored = m.clone();
        mirrored.readings.iter_mut().for_each(|r| r.deviation = -r.deviation);
        let mut expected = summary(&evaluate(&m).unwrap()).map(Option::unwrap);
        expected[11] = -expected[11];
        same(summary(&evaluate(&mirrored).unwrap()), expected, 1e-9);
    }
}
