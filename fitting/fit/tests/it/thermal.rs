//! Thermal fits of records with known truth.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use volcomp_fit::{FitError, ThermalOptions, ThermalRecord, fit_thermal};

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
