//! A control is rejected if its parameters show that it takes shifts from other words, or that its positions may be in
//! inches.

use std::{
    cell::RefCell,
    time::{Duration, Instant},
};

use volcomp_focas::{
    BarrierArea, FocasConfig, FocasController, FocasError, PmcArea, ShiftSource, inspect,
    simulator::Options,
};
use volcomp_port::Controller;
use volcomp_vocabulary::AxisName;

use crate::{TIMEOUT, at, config, simulator, until};

/// Inspects a control with these values of parameters 1203 and 1280.
fn found(
    parameters: [f64; 2],
    change: impl Fn(&mut FocasConfig),
) -> Result<ShiftSource, FocasError> {
    let simulator = simulator(Options::default());
    for (number, value) in [1203, 1280].into_iter().zip(parameters) {
        simulator.world().parameters.insert((number, 0), value);
    }
    let mut config = config(&simulator, &[AxisName::X, AxisName::Y]);
    change(&mut config);
    inspect(&config).map(|found| found.shift_source)
}

#[test]
fn the_parameters_of_the_control_are_compared_with_the_configuration() {
    let reported = |in_use, first| ShiftSource::Reported { in_use, first };
    let refused = |parameters: [f64; 2], change: fn(&mut FocasConfig), expected: &str| {
        let error = found(parameters, change).unwrap_err().to_string();
        assert!(error.contains(expected), "{error}");
    };
    let copied: fn(&mut FocasConfig) = |config| config.copied = true;
    let direct: fn(&mut FocasConfig) = |_| {};
    // Only bit 0 is evaluated.
    assert_eq!(found([0x81.into(), 100.0], direct).unwrap(), reported(true, 100));
    refused(
        [0x80.into(), 100.0],
        direct,
        "parameter 1203#0 of the control (extended external machine zero point shift in use): found 0, expected 1, since",
    );
    refused(
        [1.0, 300.0],
        direct,
        "parameter 1280 of the control (first R address of the words from which the control takes the shifts): found 300, \
         expected 100 as configured in area",
    );
    refused(
        [1.0, 100.0],
        |config| config.shift.first = at(PmcArea::D, 100),
        "found 100, expected words in R, but area is D100",
    );
    // With a copying ladder, the words from which the control takes the shift must differ from the words that the
    // driver writes.
    assert_eq!(found([1.0, 300.0], copied).unwrap(), reported(true, 300));
    assert_eq!(found([0.0, 0.0], copied).unwrap(), reported(false, 0));
    refused([1.0, 100.0], copied, "overlap");
    // The shift words of all four axes count, although only two axes are corrected. The word of the last axis overlaps
    // the driver's words.
    refused([1.0, 94.0], copied, "overlap");
    assert!(found([1.0, 92.0], copied).is_ok());
    refused([1.0, 114.0], copied, "the heartbeat R120 lies within the words from which");
    refused([1.0, 70_000.0], copied, "found 70000");
}

/// Frame and report must not overlap the axis words, because epoch and tick would move the axes.
#[test]
fn frame_and_report_must_not_overlap_the_axis_words() {
    let barrier = |config: &mut FocasConfig| {
        config.barrier =
            Some(BarrierArea { frame: at(PmcArea::R, 200), report: at(PmcArea::R, 240) });
    };
    // The frame of two axes ends at R215, the report at R271; the control has four axes.
    for (first, expected) in [
        (100.0, None),
        (192.0, None),
        (193.0, Some("the words of the frame R200 to R215 overlap the words from which")),
        (215.0, Some("the words of the frame R200 to R215 overlap")),
        (216.0, None),
        (232.0, None),
        (271.0, Some("the words of the report R240 to R271 overlap")),
        (272.0, None),
    ] {
        let found = found([1.0, first], barrier).map_err(|error| error.to_string());
        match (found, expected) {
            (Ok(_), None) => {}
            (Err(error), Some(expected)) if error.contains(expected) => {}
            (found, expected) => panic!("1280 = {first}: {found:?}, {expected:?}"),
        }
    }
}

/// A control that does not report its shift source, because it is old or lacks the option, is accepted with a note.
#[test]
fn an_unreported_shift_source_is_noted() {
    let simulator = simulator(Options::default());
    simulator.world().reports_shift_source = false;
    let config = config(&simulator, &[AxisName::X]);
    let found = inspect(&config).unwrap();
    assert!(matches!(found.shift_source, ShiftSource::Unreported { .. }));
    assert!(
        found.notes[0].contains(
            "the control does not report parameters 1203 and 1280 (reading a parameter was refused with code -17"
        ),
        "{:?}",
        found.notes
    );
    // A value that is not an address counts as unreported.
    simulator.world().reports_shift_source = true;
    simulator.world().parameters.insert((1280, 0), -3.0);
    let found = inspect(&config).unwrap();
    assert!(found.notes[0].contains("parameter 1280 holds -3"), "{:?}", found.notes);
}

/// A controller rejects a conflicting shift source like `inspect`, and connects once the parameter is corrected.
#[test]
fn a_conflicting_shift_source_prevents_connection() {
    let simulator = simulator(Options::default());
    simulator.world().parameters.insert((1280, 0), 300.0);
    let mut controller = FocasController::new(config(&simulator, &[AxisName::X])).unwrap();
    until("the error is reported", || controller.last_error().is_some());
    let error = controller.wait(Duration::from_millis(1)).unwrap_err();
    assert!(error.to_string().contains("parameter 1280"), "{error}");
    simulator.world().parameters.insert((1280, 0), 100.0);
    controller.wait(TIMEOUT).unwrap();
    assert_eq!(
        controller.inspection().unwrap().shift_source,
        ShiftSource::Reported { in_use: true, first: 100 }
    );
}

#[test]
fn unit_parameters_are_checked_on_connection() {
    // Parameters 1001, 3104 and 0, and the expected message.
    for (parameters, expected) in [
        ([0.0, 0.0, 0.0], None),
        // A program in inches does not change the unit of positions; other bits are ignored.
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
        let found = inspect(&config).map(|_| ()).map_err(|error| error.to_string());
        match expected {
            None => assert_eq!(found, Ok(())),
            Some(expected) => {
                assert!(found.as_ref().is_err_and(|error| error.contains(expected)), "{found:?}");
            }
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
