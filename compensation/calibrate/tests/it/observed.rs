//! Lines together with observations of the whole machine.
//!
//! The unknown location errors are identified. Their contributions are removed from the lines, which were measured
//! relative to the commanded pose.

use std::{fmt::Write as _, path::Path};

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use volcomp_calibrate::{CalibrationFile, calibrate, calibrated_machine};
use volcomp_kinematics::Form;
use volcomp_model::{Machine, Temperatures};
use volcomp_test_support::cases;
use volcomp_vocabulary::{AxisName, ErrorName};

use crate::lab::{Lab, Noise};
use crate::located::{GEOMETRY, LOCATIONS, MORE, largest_difference_um, lines, slope, truth};

/// Error motions of rotary axes that are measured along a line; the true machine has no other error motions of rotary
/// axes.
const MEASURED: [&str; 3] = ["EAA", "EBA", "ECC"];
const UNKNOWN: &str =
    "unknown = [\"EY0A\", \"EZ0A\", \"EB0A\", \"EC0A\", \"EX0C\", \"EY0C\", \"EA0C\", \"EB0C\"]\n";

/// The machine with only those error motions of its rotary axes that have a line.
fn partial_truth() -> Machine {
    let full = truth();
    let mut machine = full.clone();
    machine.clear_errors();
    for (name, curve) in full.errors() {
        if !name.axis.is_rotary() || MEASURED.contains(&name.to_string().as_str()) {
            machine.set_error(name, curve.clone()).expect("an error");
        }
    }
    for (name, value) in full.locations() {
        machine.set_location(*name, *value).expect("a location error");
    }
    machine
}

/// Observations of the tip position in a displaced frame, as from a laser tracker.
pub(crate) fn tracker(lab: &Lab, truth: &Machine, poses: usize, sigma_um: f64) {
    use AxisName::{A, C, X, Y, Z};
    let mut random = ChaCha8Rng::seed_from_u64(21);
    let mut noise = Noise::new(22);
    let none = Temperatures::new();
    let mut text = String::from("X,Y,Z,A,C,x,y,z\n");
    for _ in 0..poses {
        let mut at = |low: f64, high: f64| random.random_range(low..high);
        let q = [
            (X, at(0.0, 600.0)),
            (Y, at(0.0, 500.0)),
            (Z, at(0.0, 400.0)),
            (A, at(-100.0, 30.0)),
            (C, at(0.0, 360.0)),
        ];
        let state = truth.state(&q).expect("a state");
        let tip = truth.chain().ideal_tip_mm(&state)
            + truth.error_at(&state, Form::Exact, &none).position_mm;
        let seen = [-tip.y + 700.0, tip.x - 200.0, tip.z + 30.0];
        let seen = seen.map(|x| x + noise.normal(sigma_um * 1e-3));
        let numbers = q.iter().map(|(_, q)| *q).chain(seen);
        let numbers: Vec<String> = numbers.map(|number| format!("{number:?}")).collect();
        writeln!(text, "{}", numbers.join(",")).expect("a String");
    }
    lab.write("tracker.csv", &text);
}

fn value_of(name: &str) -> f64 {
    let all = LOCATIONS.iter().chain(&MORE);
    let found = all.clone().find(|(known, _)| *known == name);
    found.expect("a location error").1
}

#[test]
fn unknown_locations_are_found_and_the_lines_cleared_of_them() {
    let lab = Lab::new(GEOMETRY);
    let truth = partial_truth();
    tracker(&lab, &truth, 60, 1.0);
    let mut text = format!("{UNKNOWN}folds = 4\n");
    text += &lines(&lab, &truth, |error| MEASURED.contains(&error));
    for (name, value) in &LOCATIONS[..3] {
        writeln!(text, "[[location]]\nerror = \"{name}\"\nvalue_urad = {value}").expect("a String");
    }
    text += "[[observation]]\nkind = \"points\"\nfile = \"tracker.csv\"\nframe = \"unknown\"\n";
    let found = lab.calibrated(&text);
    let identified = found.identified.expect("identified");
    assert!(identified.rounds > 2, "{}", identified.rounds);
    let message = format!("identified {} times", identified.rounds);
    assert!(found.warnings.iter().any(|w| w.contains(&message)), "{:?}", found.warnings);
    let mut count = 0;
    for parameter in &identified.found.parameters {
        if parameter.name.contains("frame") {
            continue;
        }
        let expected = value_of(&parameter.name);
        let u = parameter.uncertainty.expect("determined");
        // The lines add an uncertainty of 0.3 µm and 0.3 µrad to that of the rows.
        let allowed = 4.0 * u + 1.0;
        assert!((parameter.value - expected).abs() < allowed, "{parameter:?} {expected}");
        let name: ErrorName = parameter.name.parse().expect("a name");
        let written = found.machine.locations()[&name];
        assert!((written - parameter.value).abs() < 1e-9);
        count += 1;
    }
    assert_eq!(count, 8);
    assert!(identified.found.left_out.is_some());
    let left = largest_difference_um(&found.machine, &truth);
    assert!(left <= 3.0, "{left} µm are left");
    let [found_slope, expected] =
        [&found.machine, &truth].map(|machine| slope(machine, "EBA", -30.0, 30.0));
    assert!((found_slope - expected).abs() < 0.02, "{found_slope} for {expected}");
}

/// Unknowns that do not affect any line are identified in one round; samples also vary the observations.
#[test]
fn lines_independent_of_the_unknowns_are_fitted_once() {
    let lab = Lab::new(GEOMETRY);
    let mut truth = partial_truth();
    truth.clear_errors();
    for (name, value) in MORE {
        truth.set_location(name.parse().expect("a name"), value).expect("a location error");
    }
    tracker(&lab, &truth, 30, 0.0);
    let text = "unknown = [\"EZ0A\", \"EX0C\", \"EY0C\", \"EB0C\"]\n[[observation]]\nkind = \"points\"\nfile = \"tracker.csv\"\n";
    let found = lab.calibrated(text);
    assert_eq!(found.identified.expect("identified").rounds, 1);
    for (name, value) in MORE {
        let written = found.machine.locations()[&name.parse().expect("a name")];
        assert!((written - value).abs() < 1e-3, "{name}: {written}");
    }
    let file = lab.read(text).expect("read");
    let drawn = calibrate(&file.varied(1, 1), |_, _| {}).expect("calibrated");
    let name: ErrorName = "EX0C".parse().expect("a name");
    let shift = (drawn.machine.locations()[&name] - 15.0).abs();
    assert!(shift > 1e-3 && shift < 5.0, "{shift}");
}

#[test]
fn duplicate_and_inseparable_errors_are_refused() {
    let lab = Lab::new(GEOMETRY);
    let truth = partial_truth();
    tracker(&lab, &truth, 20, 1.0);
    let measured = lines(&lab, &truth, |_| true);
    for [top, lines, table, expected] in &cases(
        r#"
unknown = ["EA0Z", { error = "EXX", legendre = 2 }] | yes | POINTS | toml:2: unknown[1].error: EXX is unknown here and measured by [[measurement]] with
unknown = ["EC0Y"] | yes | [[squareness]]\nerror = "EC0Y"\nvalue_urad = 1\nPOINTS | unknown[0]: EC0Y is unknown here and measured by [[squareness]]
unknown = ["EX0C"] | no | [[location]]\nerror = "EX0C"\nvalue_um = 1\nPOINTS | unknown[0]: EX0C is unknown here and measured by [[location]]
unknown = ["EA0C"] | yes | POINTS | unknown[0]: EA0C is unknown here, and the lines of EAC and EBC (
folds = 3 | yes | | folds: expected only together with `unknown`
unknown = ["EX0C"] | yes | | key `observation` is missing
| no | POINTS | key `unknown` is missing
"#,
    ) {
        let points = "[[observation]]\nkind = \"points\"\nfile = \"tracker.csv\"";
        let lines = if lines == "yes" { &measured[..] } else { "" };
        let table = table.replace("POINTS", points);
        let read = lab.read(&format!("{top}\n{lines}\n{table}\n"));
        let message = read.expect_err(expected).to_string();
        assert!(message.contains(expected), "{expected}: {message}");
    }
}

/// Checks the uncertainties of unknowns against repeated calibrations with other readings.
fn uncertainties_are_those_of_repeats(mut file: CalibrationFile) {
    const REPEATS: u64 = 40;
    let stated = &mut file.uncertainty;
    (stated.reading_um, stated.reading_urad) = (1.0, 1.0);
    let found = calibrate(&file, |_, _| {}).expect("found");
    let alone = calibrated_machine(&file).expect("found");
    assert!(alone.errors().eq(found.machine.errors()));
    assert_eq!(alone.locations(), found.machine.locations());
    let found = found.identified.expect("unknowns").found;
    let repeat = |trial| calibrated_machine(&file.varied(3, trial)).expect("found");
    // A second core computes half of the repeats.
    let (half, others) = (0..REPEATS / 2, REPEATS / 2..REPEATS);
    let repeated: Vec<Machine> = std::thread::scope(|scope| {
        let others = scope.spawn(|| others.map(repeat).collect::<Vec<_>>());
        let half: Vec<_> = half.map(repeat).collect();
        let others = others.join().expect("no panic");
        half.into_iter().chain(others).collect()
    });
    for parameter in found.parameters.iter().filter(|p| p.error.is_some()) {
        let error = parameter.error.expect("an error");
        let values = || repeated.iter().map(|of| of.locations()[&error]);
        let mean = values().sum::<f64>() / REPEATS as f64;
        let squares: f64 = values().map(|value| (value - mean).powi(2)).sum();
        let spread = (squares / (REPEATS - 1) as f64).sqrt();
        let uncertainty = parameter.uncertainty.expect("determined");
        // Four standard deviations of a standard deviation that is estimated from this number of repeats.
        let allowed = 4.0 / (2.0 * (REPEATS - 1) as f64).sqrt();
        assert!(
            (uncertainty / spread - 1.0).abs() < allowed,
            "{}: {uncertainty} {spread}",
            parameter.name
        );
    }
}

#[test]
fn uncertainties_of_unknowns_identified_together_with_lines() {
    let lab = Lab::new(GEOMETRY);
    let truth = partial_truth();
    tracker(&lab, &truth, 60, 1.0);
    let mut text = format!("{UNKNOWN}folds = 0\n");
    text += &lines(&lab, &truth, |error| MEASURED.contains(&error));
    for (name, value) in &LOCATIONS[..3] {
        writeln!(
            text,
            "[[location]]\nerror = \"{name}\"\nvalue_urad = {value}\nuncertainty_urad = 2"
        )
        .expect("a String");
    }
    text += "[uncertainty]\nreading_um = 1.0\nreading_urad = 1.0\n[[observation]]\nkind = \"points\"\nfile = \"tracker.csv\"\nframe = \"unknown\"\nuncertainty_um = 1.0\n";
    uncertainties_are_those_of_repeats(lab.read(&text).expect("read"));
}

#[test]
fn uncertainties_of_unknowns_that_lines_follow() {
    let tilt = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/tilt/c.toml");
    uncertainties_are_those_of_repeats(CalibrationFile::read(&tilt).expect("read"));
}

#[test]
fn a_location_with_the_wrong_sign_is_noted() {
    let lab = Lab::new(GEOMETRY);
    let mut truth = partial_truth();
    truth.clear_errors();
    for (name, value) in MORE {
        truth.set_location(name.parse().expect("a name"), value).expect("a location error");
    }
    tracker(&lab, &truth, 30, 1.0);
    // EX0C is 15 µm, EY0C −13 µm, EZ0A −12 µm, EB0C 12 µrad.
    let notes = |unknown: &str, locations: &[(&str, f64, f64)], noise_um: f64| {
        let mut text = format!("unknown = [{unknown}]\nfolds = 0\n");
        for (name, value, uncertainty) in locations {
            let unit = if name.starts_with("EB") { "urad" } else { "um" };
            writeln!(
                text,
                "[[location]]\nerror = \"{name}\"\nvalue_{unit} = {value}\nuncertainty_{unit} = {uncertainty}"
            )
            .expect("a String");
        }
        write!(
            text,
            "[[observation]]\nkind = \"points\"\nfile = \"tracker.csv\"\nuncertainty_um = {noise_um}\n"
        )
        .expect("a String");
        let found = lab.calibrated(&text);
        let all = found.warnings.into_iter();
        all.filter(|note| note.contains("the observations contradict its")).collect::<Vec<_>>()
    };
    let others = "\"EZ0A\", \"EY0C\", \"EB0C\"";
    let said = notes(others, &[("EX0C", -15.0, 1.0)], 1.0);
    let expected = "EX0C in [[location]]: the observations contradict its -15.0 µm and fit with 1";
    assert!(said.len() == 1 && said[0].starts_with(expected), "{said:?}");
    let two = [("EX0C", 15.0, 1.0), ("EB0C", -12.0, 0.0), ("EY0C", 13.0, 2.0)];
    let said = notes("\"EZ0A\"", &two, 1.0);
    assert_eq!(said.len(), 2, "{said:?}");
    assert!(said[0].contains("EB0C") && said[1].contains("EY0C"), "{said:?}");
    assert_eq!(notes(others, &[("EX0C", 60.0, 1.0)], 1.0).len(), 1);
    // No note for the correct value, for a deviation that is small relative to the stated uncertainty, and for one that
    // is small relative to the uncertainty of the observations.
    for (value, uncertainty, noise_um) in [(15.0, 1.0, 1.0), (-15.0, 10.0, 1.0), (-15.0, 1.0, 60.0)]
    {
        let said = notes(others, &[("EX0C", value, uncertainty)], noise_um);
        assert!(said.is_empty(), "{value} {uncertainty} {noise_um}: {said:?}");
    }
}

#[test]
fn invalid_uncertainties_are_refused_and_implausible_ones_noted() {
    let lab = Lab::new(GEOMETRY);
    for (error, unit) in [("EX0C", "um"), ("EA0C", "urad")] {
        let read = |uncertainty: &str| {
            lab.read(&format!(
                "[[location]]\nerror = \"{error}\"\nvalue_{unit} = 5\nuncertainty_{unit} = {uncertainty}\n"
            ))
        };
        let message = read("1e9").expect_err("absurd").to_string();
        let expected = "found a standard uncertainty of 1000000000, expected at most 100000: no machine tool is wrong by more";
        assert!(message.contains(expected), "{message}");
        for (uncertainty, is_odd) in [("2000", true), ("900", false)] {
            let file = read(uncertainty).expect("read");
            let found = calibrate(&file, |_, _| {}).expect("calibrated");
            let odd = |note: &String| {
                note.starts_with(error) && note.contains("a standard uncertainty of 2")
            };
            assert_eq!(found.warnings.iter().any(odd), is_odd, "{:?}", found.warnings);
        }
    }
}
