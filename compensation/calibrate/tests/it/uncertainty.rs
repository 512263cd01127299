//! Monte Carlo samples of a calibration, compared with the independently computed covariance of the readings.

use std::fmt::Write;

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use volcomp_calibrate::{CalibrationFile, Ensemble, calibrate};
use volcomp_vocabulary::AxisName;

use volcomp_model::{Machine, Tolerance};

use crate::lab::Lab;

const TRIALS: u64 = 2000;
const MACHINE: &str =
    "structure = \"w b X Y t\"\n[axes]\nX.travel = [0, 1000]\nY.travel = [0, 500]\n";
const TARGETS: usize = 6;
const RUNS: usize = 5;

/// Readings of runs that each have a shift and a slope in addition to noise, so that targets are correlated.
fn runs() -> Vec<[f64; TARGETS]> {
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    let mut run = |_| {
        let (shift, slope) = (rng.random_range(-2.0..2.0), rng.random_range(-1.0..1.0));
        std::array::from_fn(|i| shift + slope * i as f64 + rng.random_range(-0.5..0.5))
    };
    (0..RUNS).map(&mut run).collect()
}

fn written(more: &str) -> CalibrationFile {
    let mut csv = String::from("target,run,direction,deviation\n");
    for (run, values) in runs().iter().enumerate() {
        for (i, value) in values.iter().enumerate() {
            writeln!(csv, "{},{},+,{value}", 200 * i, run + 1).expect("a String");
        }
    }
    let lab = Lab::new(MACHINE);
    lab.write("x.csv", &csv);
    let text = format!(
        "{more}\n[[measurement]]\nerror = \"EXX\"\nfile = \"x.csv\"\ncurve = {{ table = {{}} }}\n"
    );
    lab.read(&text).expect("a valid calibration")
}

fn machine_of(file: &CalibrationFile) -> Machine {
    calibrate(file, |_, _| {}).expect("calibrated").machine
}

fn ensemble(file: &CalibrationFile) -> Ensemble {
    let compiled = |trial| {
        let machine = machine_of(&file.varied(7, trial));
        machine.compile(Tolerance::default()).expect("compiles")
    };
    Ensemble::new((0..TRIALS).map(compiled).collect()).expect("many machines")
}

fn uncertainty(ensemble: &Ensemble, machine: &Machine, x: f64, y: f64) -> [f64; 6] {
    let state = machine.state(&[(AxisName::X, x), (AxisName::Y, y)]);
    ensemble.standard_uncertainty(&state.expect("a state"))
}

/// The spread at a target is the spread of the difference of the means from the first target, because the curve is zero
/// at the first target.
#[test]
fn the_spread_is_that_of_the_means_of_the_runs() {
    let file = written("");
    let (ensemble, runs) = (ensemble(&file), runs());
    for i in 1..TARGETS {
        let differences: Vec<f64> = runs.iter().map(|run| run[i] - run[0]).collect();
        let mean = differences.iter().sum::<f64>() / RUNS as f64;
        let squares: f64 = differences.iter().map(|d| (d - mean).powi(2)).sum();
        let expected_mm = (squares / (RUNS * (RUNS - 1)) as f64).sqrt() * 1e-3;
        let found = uncertainty(&ensemble, &file.machine, 200.0 * i as f64, 0.0)[0];
        // Four standard deviations of a standard deviation that is estimated from this number of trials.
        let allowed = 4.0 / (2.0 * TRIALS as f64).sqrt();
        assert!((found / expected_mm - 1.0).abs() < allowed, "{found} {expected_mm}");
    }
    let at_reference = uncertainty(&ensemble, &file.machine, 0.0, 0.0);
    assert!(at_reference.iter().all(|u| *u < 1e-15));
}

#[test]
fn stated_uncertainties_are_carried() {
    let more = "[uncertainty]\nlaser_um_per_m = 20.0\nsquare_urad = 5.0\n[[squareness]]\nerror = \"EC0Y\"\nvalue_urad = 12.0";
    let mut file = written(more);
    // Without scatter only the stated uncertainties remain.
    for reading in &mut file.measurements[0].readings.readings {
        reading.deviation = 1.0;
    }
    let ensemble = ensemble(&file);
    let found = uncertainty(&ensemble, &file.machine, 1000.0, 500.0);
    // 20 µm/m over 1 m and 5 µrad over 0.5 m add in quadrature along X.
    let expected_mm = f64::hypot(20e-3, 2.5e-3);
    let allowed = 4.0 / (2.0 * TRIALS as f64).sqrt();
    assert!((found[0] / expected_mm - 1.0).abs() < allowed, "{found:?}");
    assert!(found[1] < 1e-12 && found[5] < 1e-12, "{found:?}");
}

#[test]
fn a_sample_does_not_depend_on_earlier_samples() {
    let file = written("[uncertainty]\nreading_um = 0.5");
    let deviations = |seed, trial| {
        let varied = file.varied(seed, trial);
        let readings = varied.measurements[0].readings.readings.clone();
        readings.iter().map(|r| r.deviation).collect::<Vec<_>>()
    };
    let fifth = deviations(1, 5);
    let _ = deviations(1, 4);
    assert_eq!(deviations(1, 5), fifth);
    assert_ne!(deviations(1, 6), fifth);
    assert_ne!(deviations(2, 5), fifth);
    assert_eq!(file.files_without_scatter().len(), 0);
}
