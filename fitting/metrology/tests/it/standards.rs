//! Tests of standards other than ISO 230-2, of its editions and their requirements on a test, of the measurement
//! uncertainty, and of tolerances.

use rand::SeedableRng;
use rand_distr::{Distribution, Normal};
use volcomp_metrology::{
    Direction::{self, Negative, Positive},
    Edition, UncertaintyInputs, Vdi3441, Verdict, asme_b5_54, axis_kind, decide, evaluate,
    parse_csv, parse_tolerances, positioning_uncertainty, required_test, shortfalls, vdi_3441,
};
use volcomp_vocabulary::AxisKind;

use crate::samples::{measurement, near, small};

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

/// For the published readings, an independent implementation of VDI/DGQ 3441 gives the same values.
#[test]
fn vdi_3441_of_the_published_readings() {
    let text = include_str!("../data/iso230-2-axis.csv");
    let m = parse_csv(text.as_bytes(), "axis.csv").unwrap();
    let mut rows: Vec<(f64, String, f64)> = Vec::new();
    for line in text.lines().skip(1) {
        let cells: Vec<&str> = line.split(',').collect();
        let number = |k: usize| cells[k].trim().parse::<f64>().unwrap();
        rows.push((number(0), cells[2].trim().to_owned(), number(3)));
    }
    let mut targets: Vec<f64> = rows.iter().map(|r| r.0).collect();
    targets.sort_by(f64::total_cmp);
    targets.dedup();
    let (mut upper, mut lower, mut means) = (f64::MIN, f64::MAX, Vec::new());
    for target in targets {
        let of = |sign: &str| {
            let here = rows.iter().filter(|r| r.0 == target && r.1 == sign);
            let x: Vec<f64> = here.map(|r| r.2).collect();
            let n = x.len() as f64;
            let mean = x.iter().sum::<f64>() / n;
            let squares: f64 = x.iter().map(|v| v * v).sum::<f64>() - n * mean * mean;
            (mean, (squares / (n - 1.0)).sqrt())
        };
        let ((up, s_up), (down, s_down)) = (of("+"), of("-"));
        let mean = 0.5 * (up + down);
        let half = 0.5 * (up - down).abs() + 1.5 * (s_up + s_down);
        upper = upper.max(mean + half);
        lower = lower.min(mean - half);
        means.push(mean);
    }
    let vdi = vdi_3441(&evaluate(&m).unwrap()).unwrap();
    near(vdi.p, upper - lower, 1e-9);
    let largest = means.iter().copied().fold(f64::MIN, f64::max);
    let smallest = means.iter().copied().fold(f64::MAX, f64::min);
    // The published M of ISO 230-2, in µm, is the same range.
    near(vdi.pa, largest - smallest, 1e-9);
    near(vdi.pa, 48.09, 0.011);
    // The published B of ISO 230-2, in µm.
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
