//! Verdicts on thermal terms over many random tests.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use volcomp_fit::{
    ThermalRecord, ThermalRun, ThermalSearch, ThermalVerdict, judge_thermal_rows,
    judge_thermal_runs,
};

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
