//! The second of two runs with separate zeros stops half-way: curve, band and Monte Carlo samples are those of complete runs.

use std::fmt::Write as _;

use volcomp_calibrate::{CalibrationFile, calibrate};

use crate::lab::Lab;

const MACHINE: &str = "structure = \"w b X t\"\n[axes]\nX.travel = [0, 1000]\n";

fn truth(x: f64, sign: &str) -> f64 {
    let half = if sign == "+" { 0.8 } else { -0.8 };
    0.02 * x + 3.0 * (x / 130.0).sin() + half
}

/// Targets every 50 mm in both directions. Run 2 is 40 µm higher and ends, with `last`, at that target (mm) of its forward part.
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
    assert!(
        notes.contains("x.csv: run 2 + holds 11 of 21 targets"),
        "{notes}"
    );
    assert!(
        notes.contains("the runs are aligned by their offsets"),
        "{notes}"
    );
}

#[test]
fn band_and_samples_are_those_of_complete_runs() {
    let [complete, stopped] =
        [None, Some(500.0)].map(|last| file("{ poly = { order = 3 } }", last));
    let [a, b] = [&complete, &stopped].map(|file| calibrate(file, |_, _| {}).expect("calibrated"));
    for (a, b) in a.curves.iter().zip(&b.curves) {
        let Some(direction) = a.direction else {
            panic!("both directions were run")
        };
        let [a, b] = [a, b].map(|curve| curve.band().expect("a band"));
        assert_eq!(a.at, b.at);
        // The backward direction was run once, so it has only residuals.
        let same = a.source == b.source;
        assert_eq!(same, direction.name() == "forward");
        for (a, b) in a.half_width.iter().zip(&b.half_width).filter(|_| same) {
            assert!((a / b - 1.0).abs() < 1e-9, "{a} {b}");
        }
    }
    for trial in 0..5 {
        let shifts = [&complete, &stopped].map(|file| {
            let varied = file.varied(1, trial);
            let shift = |from: &CalibrationFile, to: &CalibrationFile, place: usize| {
                let [from, to] =
                    [from, to].map(|file| file.measurements[0].readings.readings[place]);
                to.deviation - from.deviation
            };
            // The first forward run has the same targets in both files.
            (0..21)
                .map(|place| shift(file, &varied, place))
                .collect::<Vec<f64>>()
        });
        for (a, b) in shifts[0].iter().zip(&shifts[1]) {
            assert!((a - b).abs() < 1e-9, "{a} {b}");
        }
    }
}
