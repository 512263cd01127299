//! Controls that accept ever fewer request forms. The driver finds the accepted form, and reports rejections in words.

use std::{
    sync::Arc,
    time::{Duration, Instant},
};

use volcomp_focas::{
    Abilities, FocasConfig, FocasController, Packing, PmcArea,
    simulator::{Options, Simulator, World},
};
use volcomp_port::{Controller, Fault, contract};
use volcomp_vocabulary::{AxisName, Mm};

use crate::{
    TIMEOUT, at, config,
    controller::{connected, soon, um},
    simulator, until,
};

/// Controls that accept ever fewer request forms. Each comes with the form that the driver must find, and with the
/// number of requests to read and write three axes with a heartbeat and a byte of referenced axes.
fn controls() -> [(Options, Abilities, u64); 6] {
    use Packing::{ByTarget, OneByOne, OneFrame};
    let options = |change: fn(&mut Options)| {
        let mut options = Options::default();
        change(&mut options);
        options
    };
    let points = |o: &mut Options| (o.one_point, o.one_axis) = (true, true);
    let form = |packing, ranges, all_axes| Abilities { packing, ranges, all_axes };
    [
        (options(|_| {}), form(OneFrame, true, true), 2),
        (
            options(|o| (o.version, o.slots, o.one_point) = (2, 8, true)),
            form(OneFrame, false, true),
            2,
        ),
        (options(points), form(OneFrame, false, false), 2),
        (
            options(|o| (o.version, o.refuses_mix, o.fragment) = (4, true, 11)),
            form(ByTarget, true, true),
            3,
        ),
        (
            options(|o| (o.one_point, o.one_axis, o.refuses_mix) = (true, true, true)),
            form(ByTarget, false, false),
            3,
        ),
        (
            options(|o| (o.one_point, o.one_axis, o.one_command) = (true, true, true)),
            form(OneByOne, false, false),
            13,
        ),
    ]
}

fn connection_error(config: FocasConfig) -> String {
    let mut controller = FocasController::new(config).unwrap();
    until("the error is reported", || controller.last_error().is_some());
    let error = controller.wait(Duration::from_millis(1)).unwrap_err();
    error.to_string()
}

#[test]
fn every_control_fulfils_the_controller_contract() {
    for (options, expected, _) in controls() {
        let simulator = simulator(options);
        simulator.world().readback_delay = Duration::from_millis(3);
        let mut config = config(&simulator, &[AxisName::X, AxisName::Y, AxisName::Z]);
        // While written bytes cannot be read back yet, a change of the heartbeat cannot be attributed.
        config.heartbeat = None;
        let mut controller = connected(config);
        assert_eq!(controller.abilities(), Some(expected));
        contract::controller(&mut controller);
    }
}

/// A cycle takes no more exchanges than its request form requires, and one deadline covers all exchanges.
#[test]
fn a_cycle_is_bounded_on_every_control() {
    for (options, expected, exchanges) in controls() {
        let latency = Duration::from_millis(4);
        let simulator = simulator(Options { latency, ..options });
        simulator.world().motion = Arc::new(|_| vec![1.0, 2.0, 3.0, 4.0]);
        let axes = [AxisName::X, AxisName::Y, AxisName::Z];
        let mut controller = connected(config(&simulator, &axes));
        let before = simulator.requests();
        let snapshot = controller.read(soon()).unwrap();
        controller.apply(&um(1.0, -2.0, 3.0), soon()).unwrap();
        assert_eq!(simulator.requests() - before, exchanges, "{expected:?}");
        assert_eq!(snapshot.positions[..3], [1.0, 2.0, 3.0]);
        assert_eq!(simulator.world().shifts(), [0.001, -0.002, 0.003, 0.0]);
        // The deadline passes between the exchanges.
        let begun = Instant::now();
        let late = controller.read(begun + latency / 2);
        assert_eq!(late, Err(Fault::TimedOut));
        assert!(begun.elapsed() < TIMEOUT / 5, "{:?}", begun.elapsed());
    }
}

/// A value that no form can read is reported with its address and the control's return code.
#[test]
fn a_rejection_on_connection_names_address_and_code() {
    let simulator = simulator(Options::default());
    let mut config = config(&simulator, &[AxisName::X, AxisName::Y]);
    config.heartbeat = Some(at(PmcArea::D, 20_000));
    let error = connection_error(config);
    assert!(
        error.contains(
            "reading the heartbeat at D20000 was refused with code 3: EW_NUMBER, the number, address or range does not exist"
        ),
        "{error}"
    );
}

#[test]
fn a_rejection_in_a_cycle_names_the_code() {
    let simulator = simulator(Options { write_protected: true, ..Options::default() });
    let config = config(&simulator, &[AxisName::X]);
    let mut controller = connected(config);
    controller.read(soon()).unwrap();
    let refused = controller.apply(&um(1.0, 0.0, 0.0), soon()).unwrap_err();
    assert_eq!(refused.to_string(), "refused with code 7: EW_PROT, writing is protected");
    // The rejected write may have changed the heartbeat, which must not be attributed to another gateway.
    assert!(controller.read(soon()).is_ok(), "the session stays open");
}

#[test]
fn a_missing_axis_is_named() {
    let simulator = simulator(Options::default());
    let error = connection_error(config(&simulator, &[AxisName::X, AxisName::B]));
    assert!(error.contains("the control has no axis B, found XYZC"), "{error}");
    for (axes, expected) in
        [(&[][..], "found 0 axes"), (&[AxisName::X, AxisName::X][..], "axis X: found twice")]
    {
        let refused = FocasController::new(config(&simulator, axes)).err().unwrap();
        assert!(refused.to_string().contains(expected), "{refused}");
    }
    let mut invalid = config(&simulator, &[AxisName::X]);
    invalid.shift.count_linear = Mm(0.0);
    let refused = FocasController::new(invalid).err().unwrap();
    assert!(refused.to_string().contains("a resolution of 0 µm"), "{refused}");
}

/// FANUC axis names have suffixes (`Z2`): a letter that two axes have is rejected.
#[test]
fn an_ambiguous_axis_letter_is_rejected() {
    let world = World::new(&['Z', 'Y', 'Z']);
    let simulator = Simulator::start("127.0.0.1:0", Options::default(), world).unwrap();
    let error = connection_error(config(&simulator, &[AxisName::Y, AxisName::Z]));
    let expected =
        "axis Z: found several axes of the control whose names begin with this letter, ZYZ";
    assert!(error.contains(expected), "{error}");
}

#[test]
fn the_ninth_axis_counts_as_not_referenced() {
    let world = World::new(&['X', 'Y', 'Z', 'A', 'B', 'C', 'U', 'V', 'W']);
    let simulator = Simulator::start("127.0.0.1:0", Options::default(), world).unwrap();
    let mut config = config(&simulator, &[AxisName::W]);
    let referenced = |config: &FocasConfig| {
        let mut controller = connected(config.clone());
        controller.read(soon()).unwrap().state.referenced
    };
    assert!(!referenced(&config));
    config.referenced = None;
    assert!(referenced(&config), "not reported according to the configuration");
}
