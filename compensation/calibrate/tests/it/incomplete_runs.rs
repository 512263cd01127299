//! The second of two runs with separate zeros stops half-way: curve, band and Monte Carlo samples are the same as with
//! complete runs.

use std::fmt::Write as _;

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use volcomp_calibrate::{CalibrationFile, calibrate, mean_scatter};
use volcomp_fit::{BandOptions, BandSource, Method, band_of_means, student_widening};
use volcomp_metrology::{Measurement, Reading};
use volcomp_vocabulary::Direction;

use crate::lab::Lab;

const MACHINE: &str = "structure = \"w b X t\"\n[axes]\nX.travel = [0, 1000]\n";

fn truth(x: f64, sign: &str) -> f64 {
    let half = if sign == "+" { 0.8 } else { -0.8 };
    0.02 * x + 3.0 * (x / 130.0).sin() + half
}

/// A calibration file with two runs over targets every 50 mm in both directions. Run 2 reads 40 µm more; if `last` is
/// given, run 2 ends at this target (mm) of its forward pass.
fn file(curve: &str, last: Option<f64>) -> CalibrationFile {
    let mut csv = String::from("target,run,direction,deviation_um\n");
    for (run, offset) in [(1, 0.0), (2, 40.0)] {
        for sign in ["+", "-"] {
            for x in (0..=20).map(|step| 50.0 * f64::from(step)) {
                if last.is_none_or(|last| run == 1 || (sign == "+" && x <= last)) {
                    writeln!(csv, "{x},{run},{sign},{}", truth(x, sign) + offset)
                        .expect("a String");
                }
            }
        }
    }
    let lab = Lab::new(MACHINE);
    lab.write("x.csv", &csv);
    let text = format!("[[measurement]]\nerror = \"EXX\"\nfile = \"x.csv\"\ncurve = {curve}\n");
    lab.read(&text).expect("a valid calibration")
}

#[test]
fn a_run_that_stops_makes_no_step() {
    let found = calibrate(&file("{ table = {} }", Some(500.0)), |_, _| {}).expect("calibrated");
    let zero = f64::midpoint(truth(0.0, "+"), truth(0.0, "-"));
    for (curve, sign) in found.curves.iter().zip(["+", "-"]) {
        assert_eq!(curve.points.len(), 21);
        for [x, reading, value] in &curve.points {
            let expected = truth(*x, sign) - zero;
            assert!(
                (reading - expected).abs() < 1e-9 && (value - expected).abs() < 1e-9,
                "{sign} {x}"
            );
        }
    }
    let notes = found.warnings.join("\n");
    assert!(notes.contains("x.csv: run 2 + holds 11 of 21 targets"), "{notes}");
    assert!(notes.contains("the runs are aligned at common targets"), "{notes}");
}

#[test]
fn band_and_samples_contain_the_zeros_of_the_runs() {
    let [complete, stopped] =
        [None, Some(500.0)].map(|last| file("{ poly = { order = 3 } }", last));
    // With Student's t for one degree of freedom.
    let widened = 12.706_205 * 40.0 / 2.0_f64.sqrt();
    for (file, expected) in [(&complete, widened / 2.0_f64.sqrt()), (&stopped, widened)] {
        let found = calibrate(file, |_, _| {}).expect("calibrated");
        for curve in &found.curves {
            let band = curve.band().expect("a band");
            assert_eq!(band.source, BandSource::Runs);
            // The resampling of complete runs is random.
            let near = |half: &f64| (half / expected - 1.0).abs() < 0.1;
            assert!(band.half_width.iter().all(near), "{expected} {:?}", band.half_width);
        }
    }
    let shifts = |file: &CalibrationFile, trial: u64| -> Vec<f64> {
        let varied = file.varied(1, trial);
        let [from, to] = [file, &varied].map(|file| &file.measurements[0].readings);
        let readings = from.readings.iter().zip(&to.readings);
        readings.map(|(from, to)| to.deviation - from.deviation).collect()
    };
    for trial in 0..5 {
        let of_complete = shifts(&complete, trial)[0];
        for shift in shifts(&stopped, trial) {
            let expected = 2.0_f64.sqrt() * of_complete;
            assert!((shift - expected).abs() < 1e-9, "{shift} {expected}");
        }
    }
}

/// Standard deviation of a reading, µm.
const NOISE: f64 = 0.5;
const LAST: usize = 20;

/// Whether a run (from 1) has a reading at a target (0 to [`LAST`]).
type Holds = fn(u32, usize) -> bool;

/// Layouts: name, number of runs, and which targets each run has.
const LAYOUTS: [(&str, u32, Holds); 5] = [
    ("one of three stops", 3, |run, at| run < 3 || at <= 12),
    ("one run holds the end", 3, |run, at| run == 1 || at <= 16),
    ("scattered gaps", 4, |run, at| (7 * at + 5 * run as usize) % 11 > 2),
    ("two of five are partial", 5, |run, at| match run {
        1 => at >= 9,
        2 => at <= 6,
        _ => true,
    }),
    ("one of two stops", 2, |run, at| run == 1 || at <= 11),
];

fn smooth(x: f64) -> f64 {
    0.02 * x - 6.0 * (x / 700.0).powi(2) + 2.0 * (x / 1000.0).powi(3)
}

/// Simulated runs, whose zeros scatter with the standard deviation `zeros`.
fn simulated((runs, holds): (u32, Holds), zeros: f64, seed: u64) -> Measurement {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut normal = || -> f64 { StandardNormal.sample(&mut rng) };
    let mut readings = Vec::new();
    for run in 1..=runs {
        let zero = zeros * normal();
        for at in (0..=LAST).filter(|at| holds(run, *at)) {
            let target = 50.0 * at as f64;
            readings.push(Reading {
                target,
                run,
                direction: Direction::Positive,
                deviation: smooth(target) + zero + NOISE * normal(),
            });
        }
    }
    Measurement { readings, ..Measurement::default() }
}

fn seeds(few: u64) -> u64 {
    let seeds = std::env::var("VOLCOMP_SHOPS").ok();
    seeds.map_or(few, |text| text.parse().expect("a number"))
}

/// Bands of curves through runs that lack targets contain the truth at 95 % of the targets, also at targets that few
/// runs have. With missing readings filled in, the bands contained the truth at 49 to 64 % of these targets.
#[test]
fn bands_of_incomplete_runs_hold_the_truth() {
    let options = BandOptions { resamples: 60, ..BandOptions::default() };
    for method in [Method::Polynomial { order: 3 }, Method::LinearTable] {
        let (mut all, mut of_few) = ([0_u32; 2], [0_u32; 2]);
        for (name, runs, holds) in LAYOUTS {
            let mut here = [0_u32; 2];
            for seed in 0..seeds(200) {
                let zeros = if seed % 2 == 0 { 0.0 } else { 1.0 };
                let measurement = simulated((runs, holds), zeros, seed);
                let (x, u): (Vec<f64>, Vec<f64>) = measurement.mean_curve().into_iter().unzip();
                let incomplete = measurement.incomplete_runs().expect("lacking targets");
                let direction = Some(Direction::Positive);
                let scatter = mean_scatter(&incomplete, direction, &options).expect("repeated");
                let curve = method.fit(&x, &u).expect("fitted").curve;
                let band = band_of_means(method, [&x, &u], &scatter, &x).expect("a band");
                for (at, half) in band.half_width.iter().enumerate() {
                    let is_inside = (curve.value(x[at]) - smooth(x[at])).abs() <= *half;
                    let is_of_few =
                        (1..=runs).filter(|run| holds(*run, at)).count() < runs as usize;
                    for count in
                        [&mut here, &mut all].into_iter().chain(is_of_few.then_some(&mut of_few))
                    {
                        count[0] += u32::from(is_inside);
                        count[1] += 1;
                    }
                }
            }
            println!("{method} {name}: {:.3}", share(here));
        }
        println!("{method}: {:.3}, where runs lack a target {:.3}", share(all), share(of_few));
        for share in [share(all), share(of_few)] {
            assert!((0.93..=0.97).contains(&share), "{method}: {share}");
        }
    }
}

fn share([inside, of]: [u32; 2]) -> f64 {
    f64::from(inside) / f64::from(of)
}

/// Intervals from samples of the readings, widened for the number of runs as `--trials` does, contain the true
/// difference from the first target at 95 % of the targets.
#[test]
fn samples_of_incomplete_runs_hold_the_truth() {
    const TRIALS: u64 = 60;
    let base = file("{ table = {} }", None);
    let (mut all, mut of_few) = ([0_u32; 2], [0_u32; 2]);
    for (name, runs, holds) in LAYOUTS {
        let mut here = [0_u32; 2];
        for seed in 0..seeds(60) {
            let mut file = base.clone();
            file.measurements[0].readings = simulated((runs, holds), 2.0, seed);
            let curve = |file: &CalibrationFile| -> Vec<f64> {
                let means = file.measurements[0].readings.mean_curve();
                means.iter().map(|mean| mean.1 - means[0].1).collect()
            };
            let found = curve(&file);
            let change = |of: &CalibrationFile| -> Vec<f64> {
                curve(of).iter().zip(&found).map(|(a, b)| (a - b).powi(2)).collect()
            };
            let sum =
                |squares: &[Vec<f64>], at: usize| squares.iter().map(|of| of[at]).sum::<f64>();
            let samples: Vec<Vec<f64>> =
                (0..TRIALS).map(|trial| change(&file.varied(seed, trial))).collect();
            let scatter = file.scatters().next().expect("repeated runs");
            let by_run = scatter.runs.iter().map(|run| change(&file.shifted_by_run(0, *run)));
            let by_run: Vec<Vec<f64>> = by_run.collect();
            for (at, mean) in found.iter().enumerate().skip(1) {
                let variance = sum(&samples, at) / TRIALS as f64;
                let of_scatter = sum(&by_run, at);
                let whole = variance.max(of_scatter);
                let degrees = whole * whole / (of_scatter * of_scatter / scatter.degrees as f64);
                let half = 1.959_964 * student_widening(degrees) * variance.sqrt();
                let error = mean - (smooth(50.0 * at as f64) - smooth(0.0));
                let is_of_few = (1..=runs).filter(|run| holds(*run, at)).count() < runs as usize;
                for count in
                    [&mut here, &mut all].into_iter().chain(is_of_few.then_some(&mut of_few))
                {
                    count[0] += u32::from(error.abs() <= half);
                    count[1] += 1;
                }
            }
        }
        println!("samples, {name}: {:.3}", share(here));
    }
    println!("samples: {:.3}, where runs lack a target {:.3}", share(all), share(of_few));
    for share in [share(all), share(of_few)] {
        assert!((0.93..=0.975).contains(&share), "{share}");
    }
}

/// Half widths of the bands of both directions, at the targets, for runs whose zeros scatter. The last run lacks its
/// last `lacking` backward readings. `number` returns the number of a run in the file for each direction.
fn half_widths(runs: u32, number: impl Fn(u32, &str) -> u32, lacking: usize) -> Vec<Vec<f64>> {
    let zeros = [3.0, -4.0, 1.0, 6.0, -6.0];
    let mut csv = String::from("target,run,direction,deviation_um\n");
    for run in 1..=runs {
        for sign in ["+", "-"] {
            for at in 0..=LAST {
                if run == runs && sign == "-" && at + lacking > LAST {
                    continue;
                }
                let x = 50.0 * at as f64;
                let noise = 0.05 * (f64::from(run * run) * 3.7 + at as f64 * 5.9).sin();
                let deviation = smooth(x) + zeros[run as usize - 1] + noise;
                writeln!(csv, "{x},{},{sign},{deviation}", number(run, sign)).expect("a String");
            }
        }
    }
    let lab = Lab::new(MACHINE);
    lab.write("x.csv", &csv);
    let text =
        "[[measurement]]\nerror = \"EXX\"\nfile = \"x.csv\"\ncurve = { poly = { order = 3 } }\n";
    let file = lab.read(text).expect("a valid calibration");
    let found = calibrate(&file, |_, _| {}).expect("calibrated");
    let band = |curve: &volcomp_calibrate::FittedCurve| curve.band().expect("a band").half_width;
    found.curves.iter().map(band).collect()
}

/// A missing backward reading does not affect the zeros of the runs: the bands of both directions are as wide as with
/// the reading, also if the two directions of a run have separate numbers.
#[test]
fn a_direction_that_lacks_a_target_leaves_the_zeros_of_the_runs_in_both_bands() {
    let both = |run: u32, _: &str| run;
    let separate = |run: u32, sign: &str| 2 * run - u32::from(sign == "+");
    for runs in [2, 3, 5] {
        for lacking in [1, 2] {
            for (name, number) in [
                ("one number", &both as &dyn Fn(u32, &str) -> u32),
                ("separate numbers", &separate),
            ] {
                let complete = half_widths(runs, number, 0);
                let found = half_widths(runs, number, lacking);
                for (complete, found) in complete.iter().flatten().zip(found.iter().flatten()) {
                    assert!(
                        (found / complete - 1.0).abs() < 0.1,
                        "{runs} runs, {name}, lacking {lacking}: {found} {complete}"
                    );
                }
            }
        }
    }
}

/// Two runs in both directions, and three runs forward only: the mean curve keeps the mean slope of the two
/// bidirectional runs, which has one degree of freedom. With the four degrees of freedom of all runs, ±U would contain
/// the truth with 78 % (2/π · arctan 2.776) instead of 95 %.
#[test]
fn the_slope_of_two_runs_has_one_degree_of_freedom_beside_runs_of_one_direction() {
    let mut csv = String::from("target,run,direction,deviation_um\n");
    let slopes = [0.01, -0.03, 0.02, 0.05, -0.04];
    for (run, slope) in (1..).zip(slopes) {
        for sign in ["+", "-"] {
            for x in (0..=10).map(|step| 100.0 * f64::from(step)) {
                if run <= 2 || sign == "+" {
                    writeln!(csv, "{x},{run},{sign},{}", smooth(x) + slope * x).expect("a String");
                }
            }
        }
    }
    let lab = Lab::new(MACHINE);
    lab.write("x.csv", &csv);
    let read = |error: &str| {
        let text = format!("[[measurement]]\nerror = \"{error}\"\nfile = \"x.csv\"\n");
        lab.read(&text).expect("a valid calibration")
    };
    let file = read("EYX");
    let scatter = file.scatters().next().expect("repeated runs");
    assert_eq!(scatter.degrees, 1);
    // Only the two bidirectional runs vary the slope: each by half of their difference, divided by √2 for the mean of
    // both.
    let slope = |file: &CalibrationFile| -> f64 {
        let curve = file.measurements[0].readings.mean_curve();
        (curve[10].1 - curve[0].1) / 1000.0
    };
    let changes = (scatter.runs.iter())
        .map(|run| (slope(&file.shifted_by_run(0, *run)) - slope(&file)).powi(2));
    let expected = 0.04 / 2.0;
    assert!((changes.sum::<f64>().sqrt() - expected).abs() < 1e-9);
    // The degrees of freedom of a positioning error are those of all runs.
    assert_eq!(read("EXX").scatters().next().expect("repeated runs").degrees, 4);
}
