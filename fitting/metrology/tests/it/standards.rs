//! Tests of positioning tests and diagonals by their standards, of the measurement uncertainty, and of tolerances.
//!
//! They include the editions of a standard and its requirements on a test.

use proptest::prelude::*;
use rand::SeedableRng;
use rand_distr::{Distribution, Normal};
use volcomp_metrology::Direction::{self, Negative, Positive};
use volcomp_metrology::{
    Diagonal, Edition, Iso230Part2, Measurement, MetrologyError, Reading, UncertaintyInputs,
    Vdi3441, Verdict, asme_b5_54, axis_kind, decide, evaluate, evaluate_diagonals, parse_csv,
    parse_tolerances, positioning_uncertainty, required_test, shortfalls, vdi_3441,
};
use volcomp_vocabulary::AxisKind;

use crate::samples::{measurement, near, small};

fn published() -> Measurement {
    let text = include_bytes!("../data/iso230-2-axis.csv");
    parse_csv(text, "iso230-2-axis.csv").unwrap()
}

#[track_caller]
fn value_near(found: Option<f64>, expected: f64, tolerance: f64) {
    let found = found.expect("a value");
    assert!((found - expected).abs() <= tolerance, "{found} against {expected}");
}

#[test]
fn published_report_is_reproduced() {
    let result = evaluate(&published()).unwrap();
    // Published in mm with five decimals: half a digit is 0.005 µm. The readings are rounded to 0.01 µm.
    let tolerance = 0.0101;
    value_near(result.b, 43.46, tolerance);
    value_near(result.e_forward, 74.77, tolerance);
    value_near(result.e_backward, 46.12, tolerance);
    value_near(result.m, 48.09, tolerance);
    value_near(result.a_forward, 89.27, tolerance);
    value_near(result.a_backward, 204.75, tolerance);
    value_near(result.a, 204.75, tolerance);
    value_near(result.r_backward, 204.75, tolerance);
    // Published with one digit fewer.
    value_near(result.r_forward, 18.3, 0.05);
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
    value_near(first.forward.unwrap().s, s, 1e-12);
    assert_eq!(first.backward.unwrap().s, Some(0.0));
    assert_eq!(first.mean, Some(0.0));
    value_near(first.repeatability, 2.0 * s + 4.0, 1e-12); // 6.83, above R↑ = 5.66
    value_near(result.targets[1].repeatability, 8.0 * root2, 1e-12); // R↓ = 4·2√2 rules over 4√2 + 1
    value_near(result.r, 8.0 * root2, 1e-12);
    value_near(result.r_forward, 4.0 * s, 1e-12);
    value_near(result.r_backward, 8.0 * root2, 1e-12);
    assert_eq!((result.e, result.e_forward, result.e_backward), (Some(8.0), Some(3.0), Some(8.0)));
    assert_eq!((result.m, result.b, result.mean_b), (Some(5.5), Some(4.0), Some(1.5)));
    value_near(result.a, (6.0 + 4.0 * root2) - (-2.0), 1e-12);
    value_near(result.a_forward, 5.0 - (2.0 - 2.0 * s), 1e-12);
    value_near(result.a_backward, (6.0 + 4.0 * root2) - (-2.0), 1e-12);
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
        value_near(found, expected, tolerance);
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
    /// For any order of the readings and any numbers of the runs.
    #[test]
    fn agrees_with_a_second_implementation(
        (m, shuffled) in bidirectional().prop_flat_map(|m| {
            let readings = Just(m.readings.clone()).prop_shuffle();
            (Just(m), readings)
        })
    ) {
        let runs = shuffled.iter().map(|r| r.run).max().unwrap();
        let renumbered = |r: Reading| Reading { run: runs + 1 - r.run, ..r };
        let readings = shuffled.into_iter().map(renumbered).collect();
        let other = Measurement { readings, ..Measurement::default() };
        for m in [m, other] {
            same(summary(&evaluate(&m).unwrap()), second_implementation(&m), 1e-6);
        }
    }
}

/// At target 0: means 2 and −2, x̄ = 0, U = 4, s = √2 and 0, Ps = 3√2. At target 10: means 5 and 6, x̄ = 5.5, U = 1, s
/// = 0 and 2√2, Ps = 6√2.
#[test]
fn vdi_3441_by_hand() {
    let root2 = 2.0_f64.sqrt();
    let vdi = vdi_3441(&evaluate(&small()).unwrap()).unwrap();
    near(vdi.pa, 5.5, 1e-12);
    near(vdi.u_max, 4.0, 1e-12);
    near(vdi.u_mean, 2.5, 1e-12);
    near(vdi.ps_max, 6.0 * root2, 1e-12);
    near(vdi.ps_mean, 4.5 * root2, 1e-12);
    // P is the range from 0 − (4 + 3√2)/2 = −4.12 to 5.5 + (1 + 6√2)/2 = 10.24.
    near(vdi.p, 5.5 + 0.5 + 3.0 * root2 + 2.0 + 1.5 * root2, 1e-12);
    let symbols: Vec<&str> = Vdi3441::quantities(Some(&vdi)).iter().map(|q| q.symbol).collect();
    assert_eq!(symbols, ["P", "Pa", "U_max", "U_mean", "Ps_max", "Ps_mean"]);
    assert_eq!(Vdi3441::quantities(Some(&vdi))[0].value, Some(vdi.p));
    let none = Vdi3441::quantities(None);
    assert!(none.len() == 6 && none.iter().all(|q| q.value.is_none()));
}

#[test]
fn vdi_3441_needs_both_directions_and_several_runs() {
    let one_way = measurement(&[(0.0, 1, Positive, 1.0), (0.0, 2, Positive, 2.0)]);
    assert_eq!(vdi_3441(&evaluate(&one_way).unwrap()), None);
    let one_run = measurement(&[(0.0, 1, Positive, 1.0), (0.0, 1, Negative, 2.0)]);
    assert_eq!(vdi_3441(&evaluate(&one_run).unwrap()), None);
}

#[test]
fn vdi_3441_of_the_published_readings() {
    let vdi = vdi_3441(&evaluate(&published()).unwrap()).unwrap();
    // The published M and B of ISO 230-2, in µm, are the same ranges.
    near(vdi.pa, 48.09, 0.011);
    near(vdi.u_max, 43.46, 0.011);
}

#[test]
fn editions_name_the_same_values_differently() {
    let result = evaluate(&small()).unwrap();
    let [old, new] = [Edition::Iso1997, Edition::Iso2014].map(|e| e.quantities(&result));
    assert_eq!(old.len(), 12);
    for (old, new) in old.iter().zip(&new) {
        assert_eq!((old.symbol, old.value), (new.symbol, new.value));
        assert_ne!(old.name, new.name);
    }
    let value = |symbol: &str| old.iter().find(|q| q.symbol == symbol).unwrap().value;
    assert_eq!((value("B"), value("mean_B")), (Some(4.0), Some(1.5)));
    assert_eq!((value("E"), value("M")), (Some(8.0), Some(5.5)));
    assert_eq!(Edition::of_year(2006), Some(Edition::Iso2006));
    assert_eq!(Edition::of_year(1988), None);
    let asme = asme_b5_54(&result);
    assert_eq!(asme[0].value, result.a);
}

/// The required numbers of targets and runs change at these travels (mm or deg) of each kind of axis.
#[test]
fn required_targets_and_runs() {
    use AxisKind::{Linear, Rotary};
    for (kind, travel, targets, runs) in [
        (Linear, 300.0, 5, 5),
        (Linear, 1000.0, 5, 5),
        (Linear, 1500.0, 8, 5),
        (Linear, 2000.0, 10, 5),
        (Linear, 2100.0, 10, 1),
        (Linear, 8000.0, 33, 1),
        (Rotary, 90.0, 3, 5),
        (Rotary, 180.0, 5, 5),
        (Rotary, 360.0, 8, 5),
        (Rotary, 720.0, 16, 1),
    ] {
        let asked = required_test(kind, travel);
        assert_eq!((asked.targets, asked.runs), (targets, runs), "{travel}");
    }
}

#[test]
fn tests_smaller_than_required_are_noted() {
    let said = shortfalls(&small(), AxisKind::Linear, Edition::Iso2014);
    insta::assert_snapshot!(said.join("\n"), @r"
    2 targets over 10 mm: ISO 230-2:2014 asks for 5 at least on linear axes up to 2000 mm
    2 runs in a direction: ISO 230-2:2014 asks for 5 in each direction on linear axes up to 2000 mm
    ");
    // For a travel over 2 m, one run in each direction is required.
    let long: Vec<_> =
        (0..=32).flat_map(|k| Direction::BOTH.map(|d| (f64::from(k) * 250.0, 1, d, 1.0))).collect();
    let said = shortfalls(&measurement(&long), AxisKind::Linear, Edition::Iso2006);
    insta::assert_snapshot!(said.join("\n"), @"one run in a direction, as ISO 230-2:2006 asks for on linear axes over 2000 mm: A and R need at least two and are not stated");
    assert_eq!(
        shortfalls(&measurement(&[]), AxisKind::Linear, Edition::Iso2014),
        Vec::<String>::new()
    );
    let rotary = parse_csv(b"target deg,deviation_urad\n0,1\n90,2\n", "c.csv").unwrap();
    assert_eq!(axis_kind(&rotary), Some(AxisKind::Rotary));
    let silent = parse_csv(b"target,deviation\n0,1\n90,2\n", "c.csv").unwrap();
    assert_eq!(axis_kind(&silent), None);
}

const INPUTS: UncertaintyInputs = UncertaintyInputs {
    device_um_per_m: Some(0.5),
    device_um: None,
    misalignment_mm: Some(1.0),
    temperature_range_k: Some(0.5),
    expansion_um_per_m_k: Some(12.0),
    expansion_range_um_per_m_k: Some(2.0),
    from_20_degc_k: Some(-3.0),
    environment_um: Some(1.7),
};

/// Each contribution to the uncertainty over 1.75 m equals that computed with the rounded factors 0.3 and 0.6 of the
/// annex, which differ from 1/√12 and 1/√3 by less than 4 %.
#[test]
fn contributions_to_the_uncertainty_by_hand() {
    let u = positioning_uncertainty(&INPUTS, 1.75, 5).unwrap();
    let expected =
        [0.5 * 1.75, 0.3 / 1.75, 0.6 * 12.0 * 1.75 * 0.5, 0.6 * 3.0 * 1.75 * 2.0, 0.6 * 1.7];
    for (contribution, expected) in u.contributions.iter().zip(expected) {
        near(contribution.u_um.unwrap(), expected, 0.041 * expected);
    }
    near(u.contributions[0].u_um.unwrap(), 0.875, 1e-12);
    // A beam misaligned by 1 mm over 1.75 m measures 0.2857 µm too little, which gives U = 0.2857/√3.
    let short_um = (1750.0_f64.hypot(1.0) - 1750.0) * 1e3;
    near(u.contributions[1].u_um.unwrap(), short_um / 3.0_f64.sqrt(), 1e-6);
    assert_eq!(u.left_out, Vec::<String>::new());
}

/// The environment changes each reading independently. Its effect on E, M and B equals that in a Monte Carlo
/// simulation.
#[test]
fn the_environment_spreads_the_results_as_stated() {
    const TRIALS: usize = 20_000;
    let only = UncertaintyInputs {
        environment_um: Some(2.0 * 3.0_f64.sqrt()),
        ..UncertaintyInputs::default()
    };
    // For U_EVE = 2 µm, each reading has a standard uncertainty of 1 µm.
    let u = positioning_uncertainty(&only, 1.0, 5).unwrap();
    near(u.contributions[4].u_um.unwrap(), 2.0, 1e-12);
    let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(230);
    let noise = Normal::new(0.0, 1.0).unwrap();
    let mut draws: [Vec<f64>; 4] = Default::default();
    for _ in 0..TRIALS {
        let mut readings = Vec::new();
        // The values are far apart, so that the extremes are always at the same targets.
        for (target, up, down) in [(0.0, 50.0, 0.0), (500.0, 500.0, 480.0)] {
            for run in 1..=5 {
                readings.push((target, run, Positive, up + noise.sample(&mut rng)));
                readings.push((target, run, Negative, down + noise.sample(&mut rng)));
            }
        }
        let result = evaluate(&measurement(&readings)).unwrap();
        draws[0].push(result.e.unwrap());
        draws[1].push(result.m.unwrap());
        draws[2].push(result.b.unwrap());
        draws[3].push(result.targets[0].forward.unwrap().s.unwrap());
    }
    let twice_sd = |values: &[f64]| {
        let mean = values.iter().sum::<f64>() / TRIALS as f64;
        let squares: f64 = values.iter().map(|v| (v - mean).powi(2)).sum();
        2.0 * (squares / TRIALS as f64).sqrt()
    };
    near(twice_sd(&draws[0]), u.e_um, 0.02 * u.e_um);
    near(twice_sd(&draws[1]), u.m_um, 0.02 * u.m_um);
    near(twice_sd(&draws[2]), u.b_um, 0.02 * u.b_um);
    // The environment alone gives a perfectly repeatable machine R = 4 s = 2 U_EVE.
    let mean_square = draws[3].iter().map(|s| s * s).sum::<f64>() / TRIALS as f64;
    near(4.0 * mean_square.sqrt(), u.r_unidirectional_um, 0.02 * u.r_unidirectional_um);
}

#[test]
fn unstated_contributions_are_listed() {
    let none = positioning_uncertainty(&UncertaintyInputs::default(), 1.0, 5).unwrap();
    assert_eq!((none.a_um, none.of("A"), none.of("X")), (0.0, None, None));
    insta::assert_snapshot!(none.left_out.join("\n"), @r"
    U_DEVICE: uncertainty of the instrument not stated
    U_MISALIGNMENT: misalignment not stated
    U_M: expansion coefficient and range of the temperature not stated
    U_E: difference to 20 °C and range of the expansion coefficient not stated
    U_EVE: environment variation not stated
    ");
    // Without a drift test, the uncertainties of B and R are unknown.
    let no_drift = UncertaintyInputs { environment_um: None, ..INPUTS };
    let u = positioning_uncertainty(&no_drift, 1.0, 5).unwrap();
    assert_eq!((u.of("B"), u.of("R")), (None, None));
    assert!(u.of("E") > Some(1.0) && u.of("E") == u.of("A_forward"));
    for bad in [f64::NAN, -1.0, f64::INFINITY] {
        let inputs = UncertaintyInputs { device_um: Some(bad), ..INPUTS };
        assert!(positioning_uncertainty(&inputs, 1.0, 5).is_err());
        assert!(positioning_uncertainty(&INPUTS, bad, 5).is_err());
    }
    assert!(positioning_uncertainty(&INPUTS, 1.0, 0).is_err());
}

#[test]
fn decisions_with_and_without_uncertainty() {
    use Verdict::{Fail, NotEvaluated, Pass, Undecided};
    for (value, limit, u, expected) in [
        (Some(9.0), 10.0, None, Pass),
        (Some(10.0), 10.0, None, Pass),
        (Some(10.1), 10.0, None, Fail),
        (Some(9.0), 10.0, Some(1.0), Pass),
        (Some(9.1), 10.0, Some(1.0), Undecided),
        (Some(11.0), 10.0, Some(1.0), Undecided),
        (Some(11.1), 10.0, Some(1.0), Fail),
        (Some(-11.1), 10.0, Some(1.0), Fail),
        (None, 10.0, Some(1.0), NotEvaluated),
    ] {
        assert_eq!(decide(value, limit, u), expected, "{value:?} {u:?}");
    }
    assert_eq!(Verdict::of_all([Pass, Undecided, Fail, NotEvaluated]), Fail);
    assert_eq!(Verdict::of_all([Pass, Undecided]), Undecided);
    assert_eq!(Verdict::of_all([Pass, NotEvaluated, Undecided]), NotEvaluated);
}

#[test]
fn tolerances_are_read_and_refused() {
    let known = ["A", "E_forward", "mean_B"];
    let read = parse_tolerances("a=10, E_forward = 8.5,MEAN_B=0", &known).unwrap();
    let pairs: Vec<(&str, f64)> = read.iter().map(|t| (t.symbol.as_str(), t.limit)).collect();
    assert_eq!(pairs, [("A", 10.0), ("E_forward", 8.5), ("mean_B", 0.0)]);
    let messages: Vec<String> =
        ["", "A", "A=", "A=ten", "A=-1", "A=nan", "A=10 µm", "Q=1", "A=1,a=2"]
            .iter()
            .map(|text| parse_tolerances(text, &known).unwrap_err().to_string())
            .collect();
    insta::assert_snapshot!(messages.join("\n"));
}

const EDGES: [f64; 3] = [800.0, 600.0, 500.0];
const RUNS: u32 = 2;

/// Errors of a machine: squareness errors (µrad), scale error (µm/m) and reversal value of X (µm).
struct Known {
    ec0y: f64,
    ea0z: f64,
    eb0z: f64,
    scale: f64,
    backlash_x: f64,
}

impl Known {
    fn measure(&self, name: &str, targets: usize) -> (Diagonal, Measurement) {
        let diagonal = Diagonal::named(name).unwrap();
        let signs = diagonal.signs().map(f64::from);
        let lengths: [f64; 3] = std::array::from_fn(|k| EDGES[k] * signs[k].abs());
        let length = lengths.iter().map(|l| l * l).sum::<f64>().sqrt();
        let unit: [f64; 3] = std::array::from_fn(|k| signs[k] * lengths[k] / length);
        // The start of each diagonal is at the ends of travel from which the axes move away.
        let start: [f64; 3] = std::array::from_fn(|k| if signs[k] < 0.0 { EDGES[k] } else { 0.0 });
        let mut readings = Vec::new();
        for run in 1..=RUNS {
            for direction in Direction::BOTH {
                for k in 0..targets {
                    let target = length * k as f64 / (targets - 1) as f64;
                    let [x, y, z]: [f64; 3] = std::array::from_fn(|k| start[k] + unit[k] * target);
                    let way = match direction {
                        Direction::Positive => 1.0,
                        Direction::Negative => -1.0,
                    };
                    let moved = [
                        1e-3 * (-self.ec0y * y + self.eb0z * z + self.scale * x)
                            + 0.5 * self.backlash_x * way * signs[0],
                        1e-3 * (-self.ea0z * z + self.scale * y),
                        1e-3 * self.scale * z,
                    ];
                    let along: f64 = moved.iter().zip(unit).map(|(m, u)| m * u).sum();
                    readings.push(Reading { target, run, direction, deviation: along });
                }
            }
        }
        let name = format!("{name}.csv");
        (diagonal, Measurement { name, readings, ..Measurement::default() })
    }
}

const KNOWN: Known = Known { ec0y: 21.0, ea0z: -13.0, eb0z: 8.0, scale: 4.0, backlash_x: 3.0 };

fn refused(measured: &[(Diagonal, Measurement)], edges: Option<[f64; 3]>) -> String {
    let measured: Vec<(Diagonal, &Measurement)> = measured.iter().map(|(d, m)| (*d, m)).collect();
    evaluate_diagonals(&measured, edges).unwrap_err().to_string()
}

#[test]
fn body_diagonals_give_back_squareness_scale_and_reversal() {
    let measured = ["PPN", "PPP", "PNP", "NPP"].map(|name| KNOWN.measure(name, 11));
    let measured: Vec<(Diagonal, &Measurement)> = measured.iter().map(|(d, m)| (*d, m)).collect();
    let found = evaluate_diagonals(&measured, Some(EDGES)).unwrap();
    let names: Vec<&str> = found.diagonals.iter().map(|m| m.diagonal.name()).collect();
    assert_eq!(names, ["PPP", "NPP", "PNP", "PPN"]);
    let squareness: Vec<_> =
        found.squareness.iter().map(|s| (s.error.to_string(), s.urad)).collect();
    for ((error, urad), (name, expected)) in
        squareness.into_iter().zip([("EC0Y", 21.0), ("EA0Z", -13.0), ("EB0Z", 8.0)])
    {
        assert_eq!(error, name);
        near(urad, expected, 1e-9);
    }
    near(found.scale_um_per_m, 4.0, 1e-9);
    // The reversal value along the diagonal is that of X times the direction cosine of X.
    let length = EDGES.iter().map(|e| e * e).sum::<f64>().sqrt();
    near(found.b_d_um.unwrap(), 3.0 * 800.0 / length, 1e-9);
    assert!(found.lacking.is_empty() && found.spread_um > 10.0);
    // On straight lines, E of each diagonal is its growth plus the reversal value.
    for m in &found.diagonals {
        near(m.result.e.unwrap(), m.growth_um.abs() + found.b_d_um.unwrap(), 1e-9);
        near(m.result.e_forward.unwrap(), m.growth_um.abs(), 1e-9);
    }
    let largest = found.diagonals.iter().map(|m| m.result.e.unwrap());
    near(found.e_d_um.unwrap(), largest.fold(0.0, f64::max), 0.0);
}

#[test]
fn face_diagonals_give_back_the_squareness_of_their_plane() {
    for (names, error, expected) in [
        (["PP0", "NP0"], "EC0Y", 21.0),
        (["P0P", "N0P"], "EB0Z", 8.0),
        (["0PP", "0NP"], "EA0Z", -13.0),
    ] {
        let measured = names.map(|name| KNOWN.measure(name, 6));
        let measured: Vec<(Diagonal, &Measurement)> =
            measured.iter().map(|(d, m)| (*d, m)).collect();
        let found = evaluate_diagonals(&measured, Some(EDGES)).unwrap();
        assert_eq!(found.squareness.len(), 1);
        assert_eq!(found.squareness[0].error.to_string(), error);
        near(found.squareness[0].urad, expected, 1e-9);
    }
}

#[test]
fn missing_diagonals_are_listed() {
    let one = KNOWN.measure("PNP", 5);
    let found = evaluate_diagonals(&[(one.0, &one.1)], None).unwrap();
    let lacking: Vec<&str> = found.lacking.iter().map(|d| d.name()).collect();
    assert_eq!(lacking, ["PPP", "NPP", "PPN"]);
    assert_eq!((found.spread_um, found.squareness.len()), (0.0, 0));
}

#[test]
fn names_of_diagonals() {
    assert_eq!(Diagonal::named(" npp "), Diagonal::named("NPP"));
    assert_eq!(Diagonal::named("NNN"), None);
    assert_eq!(Diagonal::in_text("body diagonal PPN"), Diagonal::named("PPN"));
    assert_eq!(Diagonal::in_text("run-ppp.csv"), Diagonal::named("PPP"));
    assert_eq!(Diagonal::in_text("PPP and NPP"), None);
}

#[test]
fn contradictions_are_refused() {
    let m = |name: &str| KNOWN.measure(name, 5);
    let mut angles = m("PPP");
    angles.1.unit = Some(volcomp_metrology::DeviationUnit::Urad);
    let mut longer = m("NPP");
    longer.1.readings.iter_mut().for_each(|r| r.target *= 1.1);
    let messages = [
        refused(&[], None),
        refused(&[m("PPP"), m("PPP")], None),
        refused(&[m("PPP"), m("PP0")], None),
        refused(&[m("PPP"), longer], None),
        refused(&[angles], None),
        refused(&[m("PPP")], Some([800.0, 600.0, 700.0])),
        refused(&[m("PPP")], Some([800.0, 0.0, 500.0])),
        refused(&[m("PPP")], Some([f64::NAN, 600.0, 500.0])),
    ];
    insta::assert_snapshot!(messages.join("\n"));
}
