//! The key `correct`: the axes that corrections move.

use volcomp_kinematics::{CorrectionOptions, State};
use volcomp_model::{CorrectRefusal, Machine, ModelError, Temperatures, Tolerance};
use volcomp_vocabulary::AxisName;

/// U is parallel to X, C is under the workpiece; every axis could correct some errors.
const WITH_U_AND_C: &str = r#"
structure = "w C' X' b U Y Z t"
[axes.X]
travel = [0.0, 800.0]
[axes.U]
travel = [0.0, 800.0]
[axes.Y]
travel = [0.0, 500.0]
[axes.Z]
travel = [-400.0, 0.0]
[axes.C]
travel = [-360.0, 360.0]
[tool]
tip = [0.0, 0.0, -150.0]
axis = [0.3, 0.0, 1.0]
[errors]
EXX = { poly = [0.0, 0.02] }
EYX = 10.0
ECX = 25.0
EZC = 3.0
"#;

fn machine(correct: &str) -> Machine {
    Machine::parse(&format!("{correct}\n{WITH_U_AND_C}"), "m.toml").unwrap()
}

/// Letters of the axes that the correction moves, in chain order.
fn moved(machine: &Machine, options: &CorrectionOptions) -> String {
    let state =
        machine.state(&[(AxisName::X, 400.0), (AxisName::Y, 200.0), (AxisName::C, 30.0)]).unwrap();
    let found = machine.correction_at(&state, &Temperatures::new(), options);
    let joints = machine.chain().joints().iter().zip(&found.delta);
    joints.filter(|(_, delta)| **delta != 0.0).map(|(joint, _)| joint.name.letter()).collect()
}

#[test]
fn the_machine_file_says_which_axes_correct() {
    let default = CorrectionOptions::default();
    assert_eq!(moved(&machine(""), &default), "CXYZ");
    assert_eq!(moved(&machine("correct = [\"X\", \"Y\", \"Z\"]"), &default), "XYZ");
    assert_eq!(moved(&machine("correct = [\"U\", \"X\", \"Y\", \"Z\"]"), &default), "UYZ");
    assert_eq!(moved(&machine("correct = [\"Y\"]"), &default), "Y");
    // The key also applies to the first-order step; explicit options override it.
    let file = machine("correct = [\"Y\"]");
    assert_eq!(moved(&file, &CorrectionOptions::first_order()), "Y");
    let asked = CorrectionOptions { correct: Some([AxisName::Z].into_iter().collect()), ..default };
    assert_eq!(moved(&file, &asked), "Z");
}

#[test]
fn the_compiled_machine_corrects_the_same_axes() {
    for correct in ["", "correct = [\"X\", \"Z\"]", "correct = [\"U\", \"Y\", \"C\"]"] {
        let machine = machine(correct);
        let compiled = machine.compile(Tolerance::default()).unwrap();
        let state = State::new(
            machine.chain(),
            [
                (AxisName::C, 0.5),
                (AxisName::X, 400.0),
                (AxisName::U, 20.0),
                (AxisName::Y, 200.0),
                (AxisName::Z, -100.0),
            ],
        )
        .unwrap();
        let exact =
            machine.correction_at(&state, &Temperatures::new(), &CorrectionOptions::first_order());
        let compiled = compiled.first_order(&state);
        for (exact, compiled) in exact.delta.iter().zip(&compiled.delta) {
            assert!((exact - compiled).abs() < 2e-6, "{correct}: {exact} {compiled}");
            assert_eq!(*exact == 0.0, *compiled == 0.0, "{correct}");
        }
    }
}

#[test]
fn the_key_is_written_back_and_is_part_of_the_checksum() {
    let machine = machine("correct = [\"Z\", \"X\"]");
    let text = machine.to_toml();
    assert!(text.contains("correct = [\"Z\", \"X\"]\n"), "{text}");
    let again = Machine::parse(&text, "again.toml").unwrap();
    assert_eq!(again.correct(), Some(&[AxisName::Z, AxisName::X][..]));
    assert_eq!(again, machine);
    // A file is written without the key if it had none, so that its checksum does not change.
    let mut every = machine;
    every.set_correct(None).unwrap();
    assert!(!every.to_toml().contains("correct"));
    assert_ne!(every.checksum(), again.checksum());
}

#[test]
fn lists_that_cannot_be_are_refused() {
    let mut machine = machine("correct = [\"Y\"]");
    let mut set = |axes: &[AxisName]| machine.set_correct(Some(axes));
    assert!(matches!(set(&[]), Err(ModelError::Correct(CorrectRefusal::Empty))));
    let axis = AxisName::X;
    assert!(matches!(
        set(&[axis, axis]),
        Err(ModelError::Correct(CorrectRefusal::Twice { axis: AxisName::X }))
    ));
    assert!(matches!(set(&[AxisName::B]), Err(ModelError::NoSuchAxis { axis: AxisName::B, .. })));
    assert_eq!(machine.correct(), Some(&[AxisName::Y][..]));
}
