//! A control that takes the shifts of its axes from other words than the configuration says is not corrected.

use std::time::Duration;

use volcomp_focas::{
    BarrierArea, FocasConfig, FocasController, FocasError, PmcAddress, PmcArea, ShiftSource,
    inspect, simulator::Options,
};
use volcomp_vocabulary::AxisName;

use crate::{PATIENCE, config, simulator, until};

fn at(area: PmcArea, at: u16) -> PmcAddress {
    PmcAddress { area, at }
}

/// What is found where parameters 1203 and 1280 hold these numbers.
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
    let told = |in_use, first| ShiftSource::Told { in_use, first };
    let refused = |parameters: [f64; 2], change: fn(&mut FocasConfig), expected: &str| {
        let error = found(parameters, change).unwrap_err().to_string();
        assert!(error.contains(expected), "{error}");
    };
    let copied: fn(&mut FocasConfig) = |config| config.copied = true;
    let direct: fn(&mut FocasConfig) = |_| {};
    // Bit 0 alone counts.
    assert_eq!(
        found([0x81.into(), 100.0], direct).unwrap(),
        told(true, 100)
    );
    refused(
        [0x80.into(), 100.0],
        direct,
        "parameter 1203#0 of the control (extended external machine zero point shift in use): found 0, expected 1, since",
    );
    refused(
        [1.0, 300.0],
        direct,
        "parameter 1280 of the control (first R address of the words from which the control takes the shifts): found 300, \
         expected 100 as area says",
    );
    refused(
        [1.0, 100.0],
        |config| config.shift.first = at(PmcArea::D, 100),
        "found 100, expected words in R, which area D100 does not name",
    );
    // A ladder copies: then other words, and none of ours.
    assert_eq!(found([1.0, 300.0], copied).unwrap(), told(true, 300));
    assert_eq!(found([0.0, 0.0], copied).unwrap(), told(false, 0));
    refused([1.0, 100.0], copied, "overlap");
    // The last of the four axes of the control, of which only two are corrected.
    refused([1.0, 94.0], copied, "overlap");
    assert!(found([1.0, 92.0], copied).is_ok());
    refused(
        [1.0, 114.0],
        copied,
        "the heartbeat R120 lies within the words from which",
    );
    refused([1.0, 70_000.0], copied, "found 70000");
}

/// Frame and report of a barrier would move the axes by epoch and tick if the control took them for shifts.
#[test]
fn frame_and_report_are_not_the_words_of_the_axes() {
    let barrier = |config: &mut FocasConfig| {
        config.barrier = Some(BarrierArea {
            frame: at(PmcArea::R, 200),
            report: at(PmcArea::R, 240),
        });
    };
    // The frame of two axes ends at R215, the report at R271; the control has four axes.
    for (first, expected) in [
        (100.0, None),
        (192.0, None),
        (
            193.0,
            Some("the words of the frame R200 to R215 overlap the words from which"),
        ),
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

/// An old control, or one without the option, is noted, not refused.
#[test]
fn a_control_that_does_not_tell_is_noted() {
    let simulator = simulator(Options::default());
    simulator.world().tells_shift_source = false;
    let config = config(&simulator, &[AxisName::X]);
    let found = inspect(&config).unwrap();
    assert!(matches!(found.shift_source, ShiftSource::Untold { .. }));
    assert!(
        found.notes[0].contains(
            "the control does not tell parameters 1203 and 1280 (reading a parameter was refused with code -17"
        ),
        "{:?}",
        found.notes
    );
    // A number that is no address is no answer either.
    simulator.world().tells_shift_source = true;
    simulator.world().parameters.insert((1280, 0), -3.0);
    let found = inspect(&config).unwrap();
    assert!(
        found.notes[0].contains("parameter 1280 holds -3"),
        "{:?}",
        found.notes
    );
}

/// Not only when it is asked for: no controller works with such a control.
#[test]
fn such_a_control_is_not_corrected() {
    let simulator = simulator(Options::default());
    simulator.world().parameters.insert((1280, 0), 300.0);
    let mut controller = FocasController::new(config(&simulator, &[AxisName::X])).unwrap();
    until("told", || controller.last_error().is_some());
    let error = controller.wait(Duration::from_millis(1)).unwrap_err();
    assert!(error.to_string().contains("parameter 1280"), "{error}");
    // As soon as it is put right, it works.
    simulator.world().parameters.insert((1280, 0), 100.0);
    controller.wait(PATIENCE).unwrap();
    assert_eq!(
        controller.inspection().unwrap().shift_source,
        ShiftSource::Told {
            in_use: true,
            first: 100
        }
    );
}
