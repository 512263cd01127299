//! Machines with axes of several turns, and stated values in another unit, halved or doubled.

use volcomp_calibrate::CalibrateError;
use volcomp_kinematics::Form;
use volcomp_model::{Machine, Temperatures};
use volcomp_vocabulary::AxisName;

use crate::{lab::Lab, located::GEOMETRY, observed::tracker};

const POINTS: &str = "[[observation]]\nkind = \"points\"\nfile = \"tracker.csv\"\n";

/// Folder with this machine, and with the observations of a tracker on the machine with these errors.
fn seen(machine: &str, errors: &str) -> Lab {
    let lab = Lab::new(machine);
    let truth = format!("{machine}[errors]\n{errors}");
    let truth = Machine::parse(&truth, "truth").expect("a machine");
    tracker(&lab, &truth, 60, 1.0);
    lab
}

/// For any number of turns of C, 10 µm of EX0C move the tool by 20 µm over half a turn. EX0C as an unknown is rejected
/// if the lines of EXC and EYC contain its contribution.
#[test]
fn axes_of_several_turns_are_evaluated_over_one() {
    for turns in ["-360.0, 360.0", "-1440.0, 1440.0", "-36000.0, 36000.0"] {
        let machine = GEOMETRY
            .replace("travel = [0.0, 360.0]", &format!("travel = [{turns}]"))
            .replace("modulo = 360\n", "");
        let lab = seen(&machine, "");
        let text = format!("folds = 0\nunknown = [\"EY0C\"]\n{POINTS}");
        let found = lab.calibrated(&text);
        let expected =
            "EX0C was not measured and is taken as 0: 10 µm of it move the tool by up to 20.0 µm";
        assert!(
            found.not_measured.iter().any(|note| note.starts_with(expected)),
            "{turns}: {:?}",
            found.not_measured
        );
        let line = |error: &str| {
            let readings: Vec<String> =
                (0..=12).map(|k| format!("{},{}\n", 30 * k, k % 3)).collect();
            let readings = readings.concat();
            lab.write(&format!("{error}.csv"), &format!("target,deviation\n{readings}"));
            format!("[[measurement]]\nerror = \"{error}\"\nfile = \"{error}.csv\"\nunit = \"um\"\n")
        };
        let text = format!("unknown = [\"EX0C\"]\n{}{}{POINTS}", line("EXC"), line("EYC"));
        let refused = lab.refused(&text);
        assert!(
            refused.contains("EX0C is unknown here, and the lines of EXC and EYC"),
            "{turns}: {refused}"
        );
    }
}

/// EX0C is 23.8 µm, and is stated with wrong sign or unit, doubled or halved: the first note names the stated value as
/// contradicted, and the rows are not blamed.
#[test]
fn a_value_contradicted_by_observations_is_noted() {
    let lab = seen(GEOMETRY, "EX0C = 23.8\nEY0C = -13.0\n");
    let tried = |value: &str| {
        let text = format!(
            "folds = 0\nunknown = [\"EY0C\"]\n[[location]]\nerror = \"EX0C\"\nvalue_um = {value}\nuncertainty_um = 1\n{POINTS}uncertainty_um = 1\n"
        );
        lab.tried(&text)
    };
    for (value, stated) in [
        ("-23.8", "-23.8"),
        ("47.6", "47.6"),
        ("11.9", "11.9"),
        ("60", "60.0"),
        ("0.0238", "0.0238"),
    ] {
        let first = tried(value).expect("calibrated").identified.expect("identified");
        let first = first.found.warnings[0].to_string();
        let expected = format!(
            "EX0C in [[location]]: the observations contradict its {stated} µm and fit with 2"
        );
        assert!(first.starts_with(&expected), "{value}: {first}");
    }
    // The deviation is so large that the rows are rejected.
    let refused = tried("23800").expect_err("23.8 mm");
    assert!(matches!(refused, CalibrateError::Identify(_)), "{refused}");
    for value in ["23.8", "24.5"] {
        let found = tried(value).expect("calibrated");
        let named = found.warnings.iter().find(|note| note.contains("[[location]]"));
        assert_eq!(named, None, "{value}");
    }
}

/// The example of the book: an indicator on the head of Z travels 300 mm up a mandrel on the table, at C 0° and 180°.
/// The reading is the position of the mandrel relative to the tip along the dial's direction, positive if the plunger
/// is pressed in.
#[test]
fn a_dial_along_a_mandrel_reads_as_the_book_states() {
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
        // Displacement of the tip relative to the mandrel in bed axes; C rotates the table.
        let reading = |z: f64, c: f64| {
            let state = machine.state(&[(AxisName::Z, z), (AxisName::C, c)]).expect("a state");
            let error = machine.error_at(&state, Form::Exact, &Temperatures::new());
            let turned = machine.chain().ideal_pose(&state).rotation;
            -(turned.transpose() * error.position_mm)[axis] * 1e3
        };
        let rise = |c: f64| reading(300.0, c) - reading(0.0, c);
        let found = 0.5 * (rise(0.0) + rise(180.0));
        assert!((found - expected_um).abs() < 0.01, "{errors}: {found}");
    }
}

#[test]
fn a_squareness_of_the_wrong_sign_is_noted() {
    let lab = seen(GEOMETRY, "EX0C = 23.8\nEC0Y = 40.0\n");
    let tried = |value: &str| {
        let text = format!(
            "folds = 0\nunknown = [\"EX0C\", \"EY0C\"]\n[[squareness]]\nerror = \"EC0Y\"\nvalue_urad = {value}\n[uncertainty]\nsquare_urad = 1\n{POINTS}uncertainty_um = 1\n"
        );
        let found = lab.calibrated(&text);
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
    assert!(tried("40.0").iter().all(|note| !note.contains("contradict its")));
}
