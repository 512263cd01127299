//! Thermal fits of records with known truth, and verdicts on thermal terms over many random tests.
//!
//! The runs in `examples/thermal` are every fourth minute and five sensors of the simulated machine.

use std::fmt::Write as _;
use std::fs;
use std::path::Path;

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use volcomp_fit::{
    FitError, ThermalOptions, ThermalRecord, ThermalRun, ThermalSearch, ThermalVerdict,
    fit_thermal, judge_thermal_rows, judge_thermal_runs,
};

use crate::heat_network::run;

/// A record of three sensors that drift randomly. The displacement is 2 µm/K of the first sensor with a lag of 900 s,
/// minus 3 µm/K of the second without a lag, plus 1 µm at the start, plus noise. The third sensor has no effect.
fn record(rows: u32, noise_um: f64, seed: u64) -> ThermalRecord {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let time_s: Vec<f64> = (0..rows).map(|i| 20.0 * f64::from(i)).collect();
    let mut degc: Vec<Vec<f64>> = Vec::new();
    for sensor in 0..3 {
        let (mut value, mut heat) = (20.0 + f64::from(sensor), 0.0);
        degc.push(
            time_s
                .iter()
                .map(|_| {
                    if random.random_range(0..40) == 0 {
                        heat = random.random_range(-0.05..0.05);
                    }
                    value += heat - 0.001 * (value - 22.0);
                    value
                })
                .collect(),
        );
    }
    let mut lag = degc[0][0];
    let kept = (-20.0_f64 / 900.0).exp();
    let displacement = (0..time_s.len())
        .map(|row| {
            if row > 0 {
                lag = degc[0][row] + (lag - degc[0][row]) * kept;
            }
            let truth = 1.0 + 2.0 * (lag - degc[0][0]) - 3.0 * (degc[1][row] - degc[1][0]);
            truth + noise_um * random.random_range(-1.0..1.0)
        })
        .collect();
    ThermalRecord { time_s, degc, displacement }
}

#[test]
fn a_lag_and_its_weights_are_found() {
    let record = record(3000, 0.1, 4);
    let options = ThermalOptions { mean_of: 1, ..ThermalOptions::default() };
    let fit = fit_thermal(&record, 0..2100, &options).unwrap();
    let lags: Vec<f64> = fit.terms.iter().map(|term| term.lag_s).collect();
    assert_eq!(lags, [0.0, 900.0]);
    assert!((fit.terms[1].per_k[0] - 2.0).abs() < 0.05, "{:?}", fit.terms);
    assert!((fit.terms[0].per_k[1] + 3.0).abs() < 0.05, "{:?}", fit.terms);
    assert!((fit.constant - 1.0).abs() < 0.1, "{}", fit.constant);
    let (rms, worst) = fit.residual(&record, 2100..3000);
    assert!(rms < 0.08, "{rms}");
    let worst = worst.unwrap();
    assert!(worst.rms >= rms && worst.from_s >= record.time_s[2100]);
    // The constant as in a machine file, for which all sensors are at 20 °C.
    let at_20 = 1.0 + 2.0 * (20.0 - record.degc[0][0]) - 3.0 * (20.0 - record.degc[1][0]);
    assert!((fit.constant_at(20.0) - at_20).abs() < 0.2);
}

#[test]
fn plain_ridge_is_beaten_where_there_is_a_lag() {
    for seed in 0..5 {
        let record = record(3000, 0.1, seed);
        let rms = |options: &ThermalOptions| {
            fit_thermal(&record, 0..2100, options).unwrap().residual(&record, 2100..3000).0
        };
        let (plain, lagged) = (rms(&ThermalOptions::plain()), rms(&ThermalOptions::default()));
        assert!(lagged < 0.5 * plain, "{lagged} {plain}");
    }
}

#[test]
fn a_sensor_without_part_is_left_out() {
    let record = record(3000, 0.1, 4);
    let options = ThermalOptions { select_sensors: true, ..ThermalOptions::default() };
    let fit = fit_thermal(&record, 0..2100, &options).unwrap();
    assert_eq!(fit.sensors(), [0, 1]);
}

#[test]
fn rows_outside_the_fitted_range_have_no_effect() {
    let mut record = record(3000, 0.1, 4);
    let before = fit_thermal(&record, 0..2100, &ThermalOptions::default()).unwrap();
    for row in 2100..3000 {
        record.displacement[row] += 100.0;
        record.degc[0][row] -= 5.0;
    }
    assert_eq!(fit_thermal(&record, 0..2100, &ThermalOptions::default()).unwrap(), before);
}

#[test]
fn wrong_records_are_refused() {
    let good = record(400, 0.1, 4);
    let refused = |change: &dyn Fn(&mut ThermalRecord, &mut ThermalOptions)| {
        let (mut record, mut options) = (good.clone(), ThermalOptions::default());
        change(&mut record, &mut options);
        let rows = record.len();
        fit_thermal(&record, 0..rows, &options).expect_err("refused")
    };
    assert!(matches!(
        refused(&|r, _| r.degc[1][7] = f64::NAN),
        FitError::NotFinite { index: 7, .. }
    ));
    assert!(matches!(refused(&|r, _| r.time_s[5] = r.time_s[4]), FitError::Parameter { .. }));
    assert!(matches!(refused(&|r, _| r.displacement.truncate(5)), FitError::Lengths { .. }));
    assert!(matches!(
        refused(&|r, _| r.degc = vec![vec![20.0; 400]]),
        FitError::Undetermined { .. }
    ));
    assert!(matches!(refused(&|r, _| r.degc.clear()), FitError::Undetermined { .. }));
    assert!(matches!(refused(&|_, o| o.lags_s = vec![-1.0]), FitError::Parameter { .. }));
    assert!(matches!(refused(&|_, o| o.penalties.clear()), FitError::Parameter { .. }));
    assert!(matches!(
        fit_thermal(&good, 0..100, &ThermalOptions::default()),
        Err(FitError::TooFew { what: "rows", found: 100, .. })
    ));
}

/// Four tests with this number of rows, one row per minute. The temperature of the spindle rises and falls by 10 K; the
/// displacement is `um_per_k` times this temperature, plus noise of 0.2 µm.
fn tests(rows: u32, seed: u64, um_per_k: f64) -> Vec<ThermalRun> {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let mut draw = move || random.random_range(-1.0..1.0_f64);
    let test = |_| {
        let (phase, speed, other) = (3.0 * draw(), 1.5 + 0.5 * draw(), 3.0 * draw());
        let mut record = ThermalRecord { degc: vec![Vec::new(); 2], ..ThermalRecord::default() };
        for row in 0..rows {
            let hours = f64::from(row) / 60.0;
            let mut noise = |size: f64| size * (0..12).map(|_| 0.5 * draw()).sum::<f64>();
            let spindle = 25.0 + 10.0 * (speed * hours + phase).sin();
            record.time_s.push(f64::from(60 * row));
            record.degc[0].push(spindle);
            record.degc[1].push(21.0 + 0.8 * (0.7 * hours + other).sin() + noise(0.02));
            record.displacement.push(um_per_k * spindle + noise(0.2));
        }
        ThermalRun::from(record)
    };
    (0..4).map(test).collect()
}

/// At 3 µm/K without a lag, the terms are accepted in all of 40 tests. If temperatures have no effect, terms are
/// accepted in at most 2 of 40 tests.
#[test]
fn useful_terms_are_accepted_and_useless_ones_rejected() {
    let search = ThermalSearch::default();
    let count = |um_per_k: f64| {
        let is_good = |seed: &u64| {
            let judged = judge_thermal_runs(&tests(180, *seed, um_per_k), &search).unwrap();
            judged.verdict() == ThermalVerdict::Good
        };
        (0..40).filter(is_good).count()
    };
    assert_eq!(count(3.0), 40);
    let by_chance = count(0.0);
    assert!(by_chance <= 2, "{by_chance} of 40");
}

/// A single test is assessed on its last rows, which terms from the first rows predict within 1 µm.
#[test]
fn a_single_test_is_judged_by_its_last_rows() {
    let run = tests(360, 1, 3.0).remove(0);
    let judged = judge_thermal_rows(&run, 240, &ThermalSearch::default()).unwrap();
    assert_eq!(judged.verdict(), ThermalVerdict::Good);
    assert!(judged.left_out.is_empty() && judged.few.parts.len() == 10);
    assert!(judged.few.rms < 1.0 && judged.none_rms > 5.0, "{judged:?}");
    assert!(judged.gain().0 > judged.gain().1);
}

/// Name of each file, and seed of its run.
const RUNS: [(&str, u64); 4] =
    [("monday.csv", 1), ("tuesday.csv", 2), ("wednesday.csv", 3), ("thursday.csv", 4)];
/// Name of each column, and index of its sensor on the simulated machine.
const SENSORS: [(&str, usize); 5] =
    [("bearing", 0), ("head", 1), ("column", 2), ("bed", 3), ("room", 5)];
const EVERY: usize = 4;

/// Rows of a run: time (s), temperatures (°C), displacement (µm).
fn rows(seed: u64) -> Vec<Vec<f64>> {
    let record = run(seed).record;
    (0..record.len())
        .step_by(EVERY)
        .map(|row| {
            let degc = SENSORS.map(|(_, sensor)| record.degc[sensor][row]);
            let ends = [record.displacement[row]];
            [&[record.time_s[row]], &degc[..], &ends].concat()
        })
        .collect()
}

fn file(seed: u64) -> String {
    let mut text = "time_s".to_owned();
    for (name, _) in SENSORS {
        // Writing to a String cannot fail.
        let _ = write!(text, ",{name}_degc");
    }
    text += ",dz_um\n";
    for row in rows(seed) {
        let cells: Vec<String> = row[1..].iter().map(|cell| format!("{cell:.2}")).collect();
        let _ = writeln!(text, "{},{}", row[0], cells.join(","));
    }
    text
}

/// The shipped files equal the simulated runs. If the environment variable `VOLCOMP_WRITE` is set, the files are first
/// written.
#[test]
fn shipped_runs_are_those_of_the_simulated_machine() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../examples/thermal");
    for (name, seed) in RUNS {
        let path = folder.join(name);
        if std::env::var_os("VOLCOMP_WRITE").is_some() {
            fs::write(&path, file(seed)).unwrap();
        }
        let text = fs::read_to_string(&path).unwrap();
        let shipped = text.lines().skip(1).map(|line| {
            let cells = line.split(',').map(|cell| cell.parse::<f64>().unwrap());
            cells.collect::<Vec<f64>>()
        });
        let (shipped, expected): (Vec<_>, _) = (shipped.collect(), rows(seed));
        assert_eq!(shipped.len(), expected.len(), "{name}");
        for (shipped, expected) in shipped.iter().zip(&expected) {
            assert_eq!(shipped.len(), expected.len(), "{name}: {shipped:?}");
            let close = |(a, b): (&f64, &f64)| (a - b).abs() < 0.0051;
            assert!(shipped.iter().zip(expected).all(close), "{name}: {shipped:?} {expected:?}");
        }
    }
}
