//! At an end of travel every form of the model has the error of that end, in spite of the conversion to radians and back.

use volcomp_kinematics::Form;
use volcomp_model::{Machine, Temperatures};
use volcomp_runtime::{GuardSettings, Model};
use volcomp_vocabulary::{AxisName, PerAxis};

use crate::rig::guard;

/// A rotary table with ECC = C/400 µrad, which nearly closes, and a head with EBB = B/10 µrad, each over its whole travel.
fn machine(turns: [f64; 2], tilts: f64) -> Machine {
    let [low, high] = turns;
    let text = format!(
        "structure = \"w C' b X Y Z B t\"\n[axes]\nX.travel = [0, 500]\nY.travel = [0, 500]\nZ.travel = [0, 500]\n\
         C = {{ travel = [{low:?}, {high:?}], modulo = 360.0 }}\nB.travel = [{0:?}, {tilts:?}]\n\
         [errors]\nECC = {{ poly = [0.0, 0.0025] }}\nEBB = {{ table = [[{0:?}, {1:?}], [{tilts:?}, {2:?}]] }}\n",
        -tilts,
        -tilts / 10.0,
        tilts / 10.0,
    );
    Machine::parse(&text, "end.toml").expect("a machine")
}

#[test]
fn an_end_of_travel_has_the_error_of_its_own_side() {
    let GuardSettings { fading, .. } = guard();
    let warm = Temperatures::new();
    // Includes ends that conversion to radians and back makes larger or smaller, such as 105, 125, 192, 210 and 255.
    for degrees in 1..=359 {
        let high = f64::from(degrees);
        let machine = machine([high - 360.0, high], high);
        let model = Model::new(&machine, fading).expect("a model");
        let none = PerAxis::default();
        for (end, side) in [(high, 1.0), (high - 360.0, -1.0)] {
            let at = [(AxisName::X, 100.0), (AxisName::B, side * high), (AxisName::C, end)];
            let state = machine.state(&at).expect("a state");
            let exact = machine.error_at(&state, Form::Exact, &warm);
            let [reported, _] = model.errors(&state, &none);
            // To second order ECC of the table turns the tool about Z, and EBB acts about Y.
            for found in [exact.rotation_rad.z, reported.rotation_rad[2]] {
                assert!(
                    (found * 1e6 - end / 400.0).abs() < 0.01,
                    "{end} deg: {} µrad",
                    found * 1e6
                );
            }
            assert_eq!(machine.outside_range(&state), [], "{end} deg");
            assert_eq!(machine.outside_travel(&state), [], "{end} deg");
            assert!(!model.is_outside_range(&state), "{end} deg");
        }
        // A position beyond the end is outside.
        let state = machine.state(&[(AxisName::B, high + 1e-6)]).expect("a state");
        assert_eq!(machine.outside_travel(&state), [AxisName::B]);
        assert!(model.is_outside_range(&state));
    }
}
