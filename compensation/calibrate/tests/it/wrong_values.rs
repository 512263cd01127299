//! Machines of several turns, error motions that turn with their axis, and stated values in another unit, halved or doubled.

use std::{fs, path::Path};

use volcomp_calibrate::{CalibrateError, Calibration, CalibrationFile, calibrate};
use volcomp_kinematics::Form;
use volcomp_model::{Machine, Temperatures};
use volcomp_vocabulary::AxisName;

use crate::{located::GEOMETRY, observed::tracker};

const POINTS: &str = "[[observation]]\nkind = \"points\"\nfile = \"tracker.csv\"\n";

fn read(folder: &Path, machine: &str, text: &str) -> Result<CalibrationFile, CalibrateError> {
    fs::write(folder.join("machine.toml"), machine).expect("written");
    let path = folder.join("calibration.toml");
    fs::write(&path, format!("machine = \"machine.toml\"\n{text}")).expect("written");
    CalibrationFile::read(&path)
}

fn tried(folder: &Path, machine: &str, text: &str) -> Result<Calibration, CalibrateError> {
    calibrate(&read(folder, machine, text)?, |_, _| {})
}

/// The machine with these errors, and what a tracker sees of it.
fn seen(folder: &Path, machine: &str, errors: &str, sigma_um: f64) {
    let truth = format!("{machine}[errors]\n{errors}");
    let truth = Machine::parse(&truth, "truth").expect("a machine");
    tracker(folder, &truth, 60, sigma_um);
}

/// EXC and EAC turn with C: by the exact model of the kinematics, which knows the frame by itself.
#[test]
fn error_motions_that_turn_with_their_axis_are_found() {
    let folder = tempfile::tempdir().expect("a folder");
    let machine = GEOMETRY.replace("[axes.C]\n", "[axes.C]\nmotion_frame = \"turning\"\n");
    let wave = |cos: f64, sin: f64| {
        format!("{{ fourier = [0.0, 0.0, 0.0, {cos:?}, {sin:?}], period = 360.0 }}")
    };
    let errors = format!("EXC = {}\nEAC = {}\n", wave(20.0, -6.0), wave(5.0, 9.0));
    seen(folder.path(), &machine, &errors, 0.0);
    let text = format!(
        "folds = 0\nunknown = [{{ error = \"EXC\", fourier = 2 }}, {{ error = \"EAC\", fourier = 2 }}]\n{POINTS}"
    );
    let found = tried(folder.path(), &machine, &text).expect("calibrated");
    let found = found.identified.expect("identified").found;
    assert!(found.residual.max_um < 1e-3, "{:?}", found.residual);
    for (name, expected) in [
        ("EXC cos 2", 20.0),
        ("EXC sin 2", -6.0),
        ("EAC cos 2", 5.0),
        ("EAC sin 2", 9.0),
    ] {
        let parameter = found.parameters.iter().find(|p| p.name == name);
        let value = parameter.expect("an unknown").value;
        assert!((value - expected).abs() < 0.01, "{name}: {value}");
    }
}

/// However many turns C has: 10 µm of EX0C move the tool by 20 µm over half a turn, and the lines of EXC and EYC hold it.
#[test]
fn axes_of_several_turns_are_looked_at_over_one() {
    for turns in ["-360.0, 360.0", "-1440.0, 1440.0", "-36000.0, 36000.0"] {
        let folder = tempfile::tempdir().expect("a folder");
        let machine = GEOMETRY
            .replace("travel = [0.0, 360.0]", &format!("travel = [{turns}]"))
            .replace("modulo = 360\n", "");
        seen(folder.path(), &machine, "", 1.0);
        let text = format!("folds = 0\nunknown = [\"EY0C\"]\n{POINTS}");
        let found = tried(folder.path(), &machine, &text).expect("calibrated");
        let expected =
            "EX0C was not measured and is taken as 0: 10 µm of it move the tool by up to 20.0 µm";
        assert!(
            found
                .not_measured
                .iter()
                .any(|note| note.starts_with(expected)),
            "{turns}: {:?}",
            found.not_measured
        );
        let line = |error: &str| {
            let readings: Vec<String> = (0..=12)
                .map(|k| format!("{},{}\n", 30 * k, k % 3))
                .collect();
            let readings = readings.concat();
            fs::write(
                folder.path().join(format!("{error}.csv")),
                format!("target,deviation\n{readings}"),
            )
            .expect("written");
            format!("[[measurement]]\nerror = \"{error}\"\nfile = \"{error}.csv\"\nunit = \"um\"\n")
        };
        let text = format!(
            "unknown = [\"EX0C\"]\n{}{}{POINTS}",
            line("EXC"),
            line("EYC")
        );
        let refused = read(folder.path(), &machine, &text)
            .expect_err("held")
            .to_string();
        assert!(
            refused.contains("EX0C is unknown here, and the lines of EXC and EYC"),
            "{turns}: {refused}"
        );
    }
}

/// EX0C is 23.8 µm, and stated in another sign or unit, doubled or halved. Rows that are right must not be blamed.
#[test]
fn a_value_that_the_observations_contradict_is_named() {
    let folder = tempfile::tempdir().expect("a folder");
    seen(folder.path(), GEOMETRY, "EX0C = 23.8\nEY0C = -13.0\n", 1.0);
    let tried = |value: &str| {
        let text = format!(
            "folds = 0\nunknown = [\"EY0C\"]\n[[location]]\nerror = \"EX0C\"\nvalue_um = {value}\nuncertainty_um = 1\n{POINTS}uncertainty_um = 1\n"
        );
        tried(folder.path(), GEOMETRY, &text)
    };
    for (value, stated) in [
        ("-23.8", "-23.8"),
        ("47.6", "47.6"),
        ("11.9", "11.9"),
        ("60", "60.0"),
        ("0.0238", "0.0238"),
    ] {
        let first = tried(value)
            .expect("calibrated")
            .identified
            .expect("identified");
        let first = first.found.warnings[0].to_string();
        let expected = format!(
            "EX0C in [[location]]: the observations contradict its {stated} µm and fit with 2"
        );
        assert!(first.starts_with(&expected), "{value}: {first}");
    }
    // So far off that the rows are refused.
    let refused = tried("23800").expect_err("23.8 mm");
    assert!(matches!(refused, CalibrateError::Identify(_)), "{refused}");
    for value in ["23.8", "24.5"] {
        let found = tried(value).expect("calibrated");
        let named = found
            .warnings
            .iter()
            .find(|note| note.contains("[[location]]"));
        assert_eq!(named, None, "{value}");
    }
}

/// The example of the book: an indicator on the head of Z runs 300 mm up a mandrel on the table, at C 0 and 180°. It reads where the
/// mandrel is against the tip, along the direction of the dial, and rises where its plunger is pressed in.
#[test]
fn a_dial_along_a_mandrel_reads_what_the_book_says() {
    let geometry = "structure = \"w C' X' b Y Z t\"\naxes.X.travel = [-300, 300]\naxes.Y.travel = [-300, 300]\naxes.Z.travel = [0, 400]\naxes.C.travel = [-360, 360]\n";
    for (errors, axis, expected_um) in [
        ("EB0C = 40", 0, 12.0),
        ("EB0Z = -40", 0, 12.0),
        ("EA0C = -40", 1, 12.0),
        ("EA0Z = 40", 1, 12.0),
        ("EA0C = 40", 1, -12.0),
        ("EA0C = 40", 0, 0.0),
    ] {
        let machine =
            Machine::parse(&format!("{geometry}[errors]\n{errors}\n"), "truth").expect("a machine");
        // Tip against mandrel in the axes of the bed; the table has turned by C.
        let reading = |z: f64, c: f64| {
            let state = machine
                .state(&[(AxisName::Z, z), (AxisName::C, c)])
                .expect("a state");
            let error = machine.error_at(&state, Form::Exact, &Temperatures::new());
            let turned = machine.chain().ideal_pose(&state).rotation;
            -(turned.transpose() * error.position_mm)[axis] * 1e3
        };
        let rise = |c: f64| reading(300.0, c) - reading(0.0, c);
        let found = 0.5 * (rise(0.0) + rise(180.0));
        assert!((found - expected_um).abs() < 0.01, "{errors}: {found}");
    }
}

/// A squareness that is stated with the wrong sign is named where it stands.
#[test]
fn a_squareness_of_the_wrong_sign_is_named() {
    let folder = tempfile::tempdir().expect("a folder");
    seen(folder.path(), GEOMETRY, "EX0C = 23.8\nEC0Y = 40.0\n", 1.0);
    let tried = |value: &str| {
        let text = format!(
            "folds = 0\nunknown = [\"EX0C\", \"EY0C\"]\n[[squareness]]\nerror = \"EC0Y\"\nvalue_urad = {value}\n[uncertainty]\nsquare_urad = 1\n{POINTS}uncertainty_um = 1\n"
        );
        let found = tried(folder.path(), GEOMETRY, &text).expect("calibrated");
        let notes = found.identified.expect("identified").found.warnings;
        notes.iter().map(ToString::to_string).collect::<Vec<_>>()
    };
    let first = &tried("-40.0")[0];
    assert!(
        first.starts_with(
            "EC0Y in [[squareness]]: the observations contradict its -40.0 µrad and fit with 39"
        ),
        "{first}"
    );
    assert!(
        tried("40.0")
            .iter()
            .all(|note| !note.contains("contradict its"))
    );
}
