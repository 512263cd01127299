//! Axes of a control that may not correct: nothing is ever written to them but zero.

use volcomp_model::{Fading, Machine};
use volcomp_runtime::{
    AxisSettings, GuardSettings, Model, Replacement,
    guard::{Reasons, Request},
};
use volcomp_vocabulary::{AxisName, Um, Urad};

use crate::rig::{NAMES, Rig, guard, machine};

const FILE: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../../examples/five-axis.toml");
const PLACE: [f64; 5] = [-100.0, 40.0, 200.0, 50.0, 300.0];

/// The five-axis machine of the examples, of which only these axes may correct.
fn correcting(names: &str) -> Machine {
    let text = std::fs::read_to_string(FILE).expect("shipped");
    let text = format!("correct = [{names}]\n{text}");
    Machine::parse(&text, "held").expect("valid")
}

/// Settings with a test shift for linear and rotary axes.
fn shifting() -> GuardSettings {
    let mut guard = guard();
    guard.linear.test_shift = Um(5.0);
    guard.rotary = Some(AxisSettings {
        test_shift: Urad(20.0),
        ..AxisSettings::new(Urad(250.0), Urad(500.0))
    });
    guard
}

/// Arms, and gives the largest output of each axis of the machine until some time after the arming.
fn largest_outputs(rig: &mut Rig, machine: &Machine) -> Vec<(AxisName, f64)> {
    let joints = machine.chain().joints();
    let mut largest: Vec<_> = joints.iter().map(|joint| (joint.name, 0.0_f64)).collect();
    rig.run(10);
    rig.step(Some(Request::Arm));
    for _ in 0..3000 {
        let report = rig.step(None);
        for ((_, largest), output) in largest.iter_mut().zip(&report.correction.0) {
            *largest = largest.max(output.abs());
        }
    }
    assert_eq!(rig.step(None).state.name(), "compensating");
    largest
}

/// Neither the test shift nor the correction reaches an axis that may not correct, whether or not limits are stated
/// for axes of its kind; the others make their test shift.
#[test]
fn nothing_is_written_to_axes_that_do_not_correct() {
    let machine = correcting("\"X\", \"Y\", \"Z\"");
    for guard in [
        shifting(),
        GuardSettings {
            rotary: None,
            ..shifting()
        },
    ] {
        let mut rig = Rig::of(&machine, &guard, PLACE, &NAMES);
        for (name, largest) in largest_outputs(&mut rig, &machine) {
            if name.is_rotary() {
                assert_eq!(largest, 0.0, "axis {name} may not correct");
            } else {
                assert!(largest > 0.0049, "axis {name} corrects: {largest} mm");
            }
        }
    }
}

/// A linear axis along the direction of another one does not correct, and is not shifted either.
#[test]
fn a_redundant_linear_axis_is_not_shifted() {
    let text = "structure = \"w b X Y Z C t\"
[axes.X]
travel = [0.0, 500.0]
[axes.Y]
travel = [-500.0, 500.0]
direction = [1.0, 0.0, 0.0]
[axes.Z]
travel = [-500.0, 500.0]
[axes.C]
travel = [-360.0, 360.0]
[errors]
EXX = { poly = [0.0, 0.02] }
";
    let machine = Machine::parse(text, "redundant").expect("valid");
    let names = [AxisName::X, AxisName::Y, AxisName::Z, AxisName::C];
    let mut rig = Rig::of(&machine, &shifting(), PLACE, &names);
    let outputs = largest_outputs(&mut rig, &machine);
    let of = |name| outputs.iter().find(|(axis, _)| *axis == name).map(|o| o.1);
    assert_eq!(of(AxisName::Y), Some(0.0), "Y lies along X");
    assert!(of(AxisName::X) > Some(0.0049) && of(AxisName::Z) > Some(0.0049));
}

/// A model that lets fewer axes correct takes their test shift away as well.
#[test]
fn another_model_takes_the_test_shift_of_the_axes_that_no_longer_correct() {
    let before = machine();
    let mut rig = Rig::of(&before, &shifting(), PLACE, &NAMES);
    let after = correcting("\"X\", \"Y\", \"Z\"");
    let model = Model::new(&after, Fading::default()).expect("compiles");
    let mut replacement = Replacement::new(Box::new(model), &[]);
    rig.cycle
        .swap_model(&mut replacement)
        .expect("the same axes");
    for (name, largest) in largest_outputs(&mut rig, &after) {
        assert_eq!(largest > 0.0, !name.is_rotary(), "axis {name}: {largest}");
    }
    // And limits that were planned for the old model do not bring it back.
    let mut rig = Rig::of(&before, &shifting(), PLACE, &NAMES);
    let limits = rig.limits;
    let model = Model::new(&after, Fading::default()).expect("compiles");
    rig.cycle
        .swap_model(&mut Replacement::new(Box::new(model), &[]))
        .expect("the same axes");
    rig.cycle.set_limits(0, &limits).expect("as before");
    for (name, largest) in largest_outputs(&mut rig, &after) {
        assert_eq!(largest > 0.0, !name.is_rotary(), "axis {name}: {largest}");
    }
}

/// Rotary axes without a test shift beside linear ones that have one: nobody was told that they are not proven.
#[test]
fn axes_without_a_test_shift_are_told_as_not_proven() {
    let rotary = shifting();
    let mut linear = shifting();
    if let Some(rotary) = &mut linear.rotary {
        rotary.test_shift = Urad(0.0);
    }
    for (guard, told) in [(rotary, false), (linear, true)] {
        let mut rig = Rig::of(&machine(), &guard, PLACE, &NAMES);
        let report = rig.run(5);
        let reasons = report.reasons;
        assert_eq!(reasons.contains(Reasons::NOT_PROVEN), told, "{reasons:?}");
    }
}
