//! A control that tells positions in inches, or may come to do so, is not corrected.

use std::{
    cell::RefCell,
    time::{Duration, Instant},
};

use volcomp_focas::{FocasController, inspect, simulator::Options};
use volcomp_port::Controller;
use volcomp_vocabulary::AxisName;

use crate::{config, simulator, until};

#[test]
fn the_parameters_of_units_are_read_at_a_connection() {
    // Parameters 1001, 3104 and 0, and what is said.
    for (parameters, said) in [
        ([0.0, 0.0, 0.0], None),
        // A program in inches: positions are in mm all the same. Bits other than those of the unit do not count.
        ([254.0, 254.0, 255.0], None),
        (
            [1.0, 0.0, 0.0],
            Some("parameter 1001#0 of the control (machine system in inches): found 1, expected 0"),
        ),
        (
            [0.0, 1.0, 4.0],
            Some(
                "parameter 3104#0 of the control (machine positions in the unit of the program): found 1, expected 0, mm whatever a program says with G20 and G21: parameter 0#2 says inches now",
            ),
        ),
        ([0.0, 1.0, 0.0], Some("parameter 0#2 says mm now")),
    ] {
        let simulator = simulator(Options::default());
        for (number, value) in [1001, 3104, 0].into_iter().zip(parameters) {
            simulator.world().parameters.insert((number, 0), value);
        }
        let config = config(&simulator, &[AxisName::X, AxisName::Y]);
        let found = inspect(&config)
            .map(|_| ())
            .map_err(|error| error.to_string());
        match said {
            None => assert_eq!(found, Ok(())),
            Some(said) => assert!(
                found.as_ref().is_err_and(|error| error.contains(said)),
                "{found:?}"
            ),
        }
    }
}

#[test]
fn a_unit_that_changed_is_a_fault_at_the_next_connection() {
    let simulator = simulator(Options::default());
    let config = config(&simulator, &[AxisName::X, AxisName::Y]);
    let controller = RefCell::new(FocasController::new(config).unwrap());
    let answers = || {
        let deadline = Instant::now() + Duration::from_millis(50);
        controller.borrow_mut().read(deadline).is_ok()
    };
    until("it answers", answers);
    simulator.world().tell_inches(true);
    simulator.disconnect_all();
    until("it says nothing", || !answers());
    // For ten attempts: none of them succeeds.
    for _ in 0..10 {
        assert!(!answers());
    }
    simulator.world().tell_inches(false);
    until("it answers again", answers);
}
