//! Tests of thermal terms from logs with various intervals, on a machine that is simulated every five seconds. The
//! tests check the coefficients, and the residual when the terms are evaluated in every cycle.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use volcomp_fit::{
    ThermalEffect, ThermalNumber, ThermalRecord, ThermalRun, ThermalSearch, ThermalTerms,
    left_out_runs, search_thermal,
};

const STEP_S: f64 = 5.0;
const HOURS: usize = 8;
/// Number of simulation steps per hour.
const HOUR: usize = 720;

/// Eight hours in steps of five seconds: temperatures of spindle, bed and room, and a displacement (µm) of 3.2 µm/K of
/// the spindle with a lag of 600 s minus 2 µm/K of the bed.
struct World {
    degc: [Vec<f64>; 3],
    moved: Vec<f64>,
}

fn normal(random: &mut ChaCha8Rng) -> f64 {
    (0..12).map(|_| random.random::<f64>()).sum::<f64>() - 6.0
}

fn world(seed: u64) -> World {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    // A heat input that changes every hour, and acts through a mass with a time constant.
    let mut process = |size: f64, lag_s: f64| {
        let mut heat = 0.0;
        let mut value = 0.0;
        (0..HOURS * HOUR)
            .map(|step| {
                if step % HOUR == 0 {
                    heat = size * normal(&mut random);
                }
                if step > 0 {
                    value = heat + (value - heat) * (-STEP_S / lag_s).exp();
                }
                value
            })
            .collect::<Vec<f64>>()
    };
    let (slow, fast) = (process(8.0, 900.0), process(3.0, 200.0));
    let spindle: Vec<f64> = slow.iter().zip(fast).map(|(a, b)| 25.0 + a + b).collect();
    let bed: Vec<f64> = process(8.0, 3000.0).iter().map(|t| 21.0 + t).collect();
    let room: Vec<f64> = process(3.0, 2000.0).iter().map(|t| 20.0 + t).collect();
    let lagged = stepped(&spindle, 600.0);
    let moved = lagged
        .iter()
        .zip(&bed)
        .map(|(spindle, bed)| 3.2 * (spindle - 20.0) - 2.0 * (bed - 20.0))
        .collect();
    World { degc: [spindle, bed, room], moved }
}

/// A lag as evaluated on a machine: during each short step its input is constant.
fn stepped(degc: &[f64], lag_s: f64) -> Vec<f64> {
    let mut value = degc[0];
    let follows = if lag_s > 0.0 { 1.0 - (-STEP_S / lag_s).exp() } else { 1.0 };
    degc.iter()
        .map(|t| {
            value += follows * (t - value);
            value
        })
        .collect()
}

#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a count of steps")]
fn steps(seconds: f64) -> usize {
    (seconds / STEP_S) as usize
}

/// The log of a machine with 0.1 µm of noise: rows at intervals of `every_s`, or at random intervals of 0.2 to 1.8
/// times `every_s`.
fn logged(world: &World, every_s: f64, is_regular: bool, seed: u64) -> ThermalRun {
    let mut random = ChaCha8Rng::seed_from_u64(seed + 1_000_000);
    let all = world.moved.len();
    // In the first row the machine has a uniform temperature, from which each lag starts.
    let mut rows = vec![0];
    loop {
        let share = if is_regular { 1.0 } else { random.random_range(0.2..1.8) };
        let next = rows[rows.len() - 1] + steps(every_s * share).max(1);
        if next >= all {
            break;
        }
        rows.push(next);
    }
    let of = |values: &[f64]| rows.iter().map(|&row| values[row]).collect::<Vec<f64>>();
    let zero = world.moved[rows[0]];
    ThermalRecord {
        time_s: rows.iter().map(|&row| row as f64 * STEP_S).collect(),
        degc: world.degc.iter().map(|degc| of(degc)).collect(),
        displacement: (of(&world.moved).iter())
            .map(|moved| moved - zero + 0.1 * normal(&mut random))
            .collect(),
    }
    .into()
}

/// RMS of the residual about its mean, µm, when the terms are evaluated every five seconds on machines that were not
/// logged.
fn at_run_time(terms: &ThermalTerms) -> f64 {
    let mut squares = Vec::new();
    for seed in 500..503 {
        let world = world(seed);
        let mut left = world.moved.clone();
        for number in &terms.numbers {
            let ThermalEffect::Drift { lag_s } = number.effect else {
                panic!("no position was moved");
            };
            for (left, t) in left.iter_mut().zip(stepped(&world.degc[number.sensor], lag_s)) {
                *left -= number.value * t;
            }
        }
        let mean = left.iter().sum::<f64>() / left.len() as f64;
        squares.extend(left.iter().map(|l| (l - mean).powi(2)));
    }
    (squares.iter().sum::<f64>() / squares.len() as f64).sqrt()
}

fn rms(values: &[f64]) -> f64 {
    (values.iter().map(|x| x * x).sum::<f64>() / values.len() as f64).sqrt()
}

/// For any logging interval, the residual in operation is at most 1.2 times the stated error, and the time constant is
/// found.
#[test]
fn the_claimed_error_is_met_at_run_time_for_any_logger() {
    for (every_s, is_regular) in [
        (30.0, true),
        (60.0, true),
        (60.0, false),
        (120.0, true),
        (120.0, false),
        (300.0, true),
        (300.0, false),
    ] {
        for from in [0, 20, 40] {
            let runs: Vec<ThermalRun> = (from..from + 4)
                .map(|seed| logged(&world(seed), every_s, is_regular, seed))
                .collect();
            let search = ThermalSearch::default();
            let terms = search_thermal(&runs, &search).unwrap();
            let left = rms(&left_out_runs(&runs, &search).unwrap());
            let between: Vec<f64> = runs.iter().map(|run| terms.rms_between_rows(run)).collect();
            let between = rms(&between);
            let run_time = at_run_time(&terms);
            let claimed = left.hypot(between);
            let is_spindle = |number: &&ThermalNumber| {
                number.effect == ThermalEffect::Drift { lag_s: 600.0 } && number.sensor == 0
            };
            let shown: Vec<String> = (terms.numbers.iter())
                .map(|n| {
                    format!("{} {:?} {:.3} ± {:.3}", n.sensor, n.effect, n.value, n.uncertainty)
                })
                .collect();
            println!(
                "{every_s} s regular {is_regular}: left out {left:.3}, between rows {between:.3}, claimed {claimed:.3}, at run time {run_time:.3}: {shown:?}"
            );
            assert!(run_time < 1.2 * claimed, "{every_s} s: {run_time} of {claimed}");
            // If each row were constant over the interval before it, rows at intervals of 300 s would leave 1.5 µm in
            // operation.
            assert!(run_time < if every_s < 200.0 { 0.12 } else { 0.3 }, "{run_time}");
            let found = terms.numbers.iter().find(is_spindle).expect("the lag");
            let off = (found.value - 3.2).abs();
            assert!(off < 3.0 * found.uncertainty + 0.01, "{every_s} s: {found:?}");
        }
    }
}

/// A logger stops for an hour while the spindle runs. The temperature in the gap is unknown, and rows that depend on it
/// are excluded.
#[test]
fn a_gap_in_time_is_not_bridged() {
    let mut runs: Vec<ThermalRun> = (0..4).map(|s| logged(&world(s), 60.0, true, s)).collect();
    let search = ThermalSearch::default();
    let whole = search_thermal(&runs, &search).unwrap();
    let record = &mut runs[1].record;
    let (from, to) = (3 * 60, 4 * 60);
    record.time_s.drain(from..to);
    record.displacement.drain(from..to);
    for degc in &mut record.degc {
        degc.drain(from..to);
    }
    let gaps = record.gaps(&search.lags_s);
    assert_eq!(gaps.len(), 1);
    assert_eq!((gaps[0].from_s, gaps[0].to_s), (10_740.0, 14_400.0));
    // By hand: at the end of the gap, the slowest lag has followed 1 − exp(−3660/5400) of a step within the gap. The
    // effect of this step decays to a twentieth in 5400·ln(9.845) s.
    let known = gaps[0].left_out.clone();
    assert_eq!(known.start, from);
    let behind_s = 60.0 * known.len() as f64;
    assert!(
        (behind_s - 5400.0 * (20.0 * (1.0 - (-3660.0_f64 / 5400.0).exp())).ln()).abs() < 61.0,
        "{behind_s}"
    );
    // Without lags, no row depends on a gap; an irregular log has no gap; excluded rows have no effect.
    assert!(record.gaps(&[0.0]).iter().all(|gap| gap.left_out.is_empty()));
    assert!(logged(&world(7), 120.0, false, 7).record.gaps(&search.lags_s).is_empty());
    let mut changed = runs.clone();
    for row in known {
        changed[1].record.displacement[row] += 50.0;
    }
    let terms = search_thermal(&runs, &search).unwrap();
    assert_eq!(terms.numbers, search_thermal(&changed, &search).unwrap().numbers);
    let left = left_out_runs(&runs, &search).unwrap();
    let (with, without) = (at_run_time(&terms), at_run_time(&whole));
    println!("left out {left:.3?}, at run time {with:.3}, without the gap {without:.3}");
    assert!(left[1] < 0.3 && with < 0.05, "{left:?} {with}");
    for number in &terms.numbers {
        let ThermalEffect::Drift { lag_s } = number.effect else {
            panic!("no position was moved");
        };
        let truth = match (number.sensor, lag_s) {
            (0, 600.0) => 3.2,
            (1, 0.0) => -2.0,
            other => panic!("{other:?}"),
        };
        assert!((number.value - truth).abs() < 0.02, "{number:?}");
    }
    // If all of a run except its start depends on a gap, the message states the number of usable rows.
    runs[1].record.time_s.iter_mut().skip(20).for_each(|t| *t += 4.0 * 3600.0);
    let slow = ThermalSearch { lags_s: vec![0.0, 20_000.0], ..search };
    let refused = search_thermal(&runs, &slow).unwrap_err().to_string();
    assert!(refused.contains("found 20 rows that are not behind a gap in the log"), "{refused}");
}
