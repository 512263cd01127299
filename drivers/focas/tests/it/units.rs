//! A control that reports, or may come to report, positions in inches is rejected.

use std::{
    cell::RefCell,
    time::{Duration, Instant},
};

use volcomp_focas::{FocasController, inspect, simulator::Options};
use volcomp_port::Controller;
use volcomp_vocabulary::AxisName;

use crate::{config, simulator, until};

#[test]
fn unit_parameters_are_checked_on_connection() {
    // Parameters 1001, 3104 and 0, and the expected message.
    for (parameters, expected) in [
        ([0.0, 0.0, 0.0], None),
        // A program in inches does not change the unit of positions; bits other than the unit bits are ignored.
        ([254.0, 254.0, 255.0], None),
        (
            [1.0, 0.0, 0.0],
            Some("parameter 1001#0 of the control (machine system in inches): found 1, expected 0"),
        ),
        (
            [0.0, 1.0, 4.0],
            Some(
                "parameter 3104#0 of the control (machine positions in the unit of the program): found 1, expected 0, mm independent of G20 and G21 in the program: parameter 0#2 selects inches now",
            ),
        ),
        ([0.0, 1.0, 0.0], Some("parameter 0#2 selects mm now")),
    ] {
        let simulator = simulator(Options::default());
        for (number, value) in [1001, 3104, 0].into_iter().zip(parameters) {
            simulator.world().parameters.insert((number, 0), value);
        }
        let config = config(&simulator, &[AxisName::X, AxisName::Y]);
        let found = inspect(&config)
            .map(|_| ())
            .map_err(|error| error.to_string());
        match expected {
            None => assert_eq!(found, Ok(())),
            Some(expected) => assert!(
                found.as_ref().is_err_and(|error| error.contains(expected)),
                "{found:?}"
            ),
        }
    }
}

#[test]
fn a_changed_unit_prevents_reconnection() {
    let simulator = simulator(Options::default());
    let config = config(&simulator, &[AxisName::X, AxisName::Y]);
    let controller = RefCell::new(FocasController::new(config).unwrap());
    let answers = || {
        let deadline = Instant::now() + Duration::from_millis(50);
        controller.borrow_mut().read(deadline).is_ok()
    };
    until("reads succeed", answers);
    simulator.world().report_inches(true);
    simulator.disconnect_all();
    until("reads fail", || !answers());
    // Ten further attempts fail too.
    for _ in 0..10 {
        assert!(!answers());
    }
    simulator.world().report_inches(false);
    until("reads succeed again", answers);
}
