//! Controls that accept less and less: each is asked in the form that it understands, and a refusal is told in words.

use std::{
    sync::Arc,
    time::{Duration, Instant},
};

use volcomp_focas::{
    Abilities, FocasConfig, FocasController, Packing, PmcAddress, PmcArea,
    simulator::{Options, Simulator, World},
};
use volcomp_port::{Controller, Fault, contract};
use volcomp_vocabulary::{AxisName, Mm};

use crate::{
    PATIENCE, config,
    controller::{connected, soon, um},
    simulator, until,
};

/// Controls that accept less and less, and in which form each is asked: found without configuration.
fn controls() -> [(Options, Abilities, u64); 6] {
    let options = Options::default;
    let all = Abilities {
        packing: Packing::OneFrame,
        ranges: true,
        all_axes: true,
    };
    let points = Abilities {
        ranges: false,
        ..all
    };
    let one_by_one = Abilities {
        packing: Packing::OneByOne,
        ranges: false,
        all_axes: false,
    };
    let by_target = Abilities {
        packing: Packing::ByTarget,
        ..all
    };
    // The requests of a read and a write of three axes with a heartbeat and a byte of referenced axes.
    [
        (options(), all, 2),
        (
            Options {
                version: 2,
                slots: 8,
                one_point: true,
                ..options()
            },
            points,
            2,
        ),
        (
            Options {
                one_point: true,
                one_axis: true,
                ..options()
            },
            Abilities {
                all_axes: false,
                ..points
            },
            2,
        ),
        (
            Options {
                version: 4,
                refuses_mix: true,
                fragment: 11,
                ..options()
            },
            by_target,
            3,
        ),
        (
            Options {
                one_point: true,
                one_axis: true,
                refuses_mix: true,
                ..options()
            },
            Abilities {
                packing: Packing::ByTarget,
                ..one_by_one
            },
            3,
        ),
        (
            Options {
                one_point: true,
                one_axis: true,
                one_command: true,
                ..options()
            },
            one_by_one,
            13,
        ),
    ]
}

#[test]
fn the_contract_of_controllers_on_every_control_without_configuration() {
    for (options, expected, _) in controls() {
        let simulator = simulator(options);
        simulator.world().readback_delay = Duration::from_millis(3);
        let mut config = config(&simulator, &[AxisName::X, AxisName::Y, AxisName::Z]);
        // What is seen late cannot show who moved the heartbeat.
        config.heartbeat = None;
        let mut controller = connected(config);
        assert_eq!(controller.abilities(), Some(expected));
        contract::controller(&mut controller);
    }
}

/// The number of exchanges of a cycle is what the form needs, and a deadline holds for all of them together.
#[test]
fn a_cycle_stays_bounded_on_every_control() {
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
        // One deadline for all exchanges: it ends in the middle of them, in time.
        let begun = Instant::now();
        let late = controller.read(begun + latency / 2);
        assert_eq!(late, Err(Fault::TimedOut));
        assert!(begun.elapsed() < PATIENCE / 5, "{:?}", begun.elapsed());
    }
}

/// What cannot be read in any form is told with the return code of the control in words, and where it was.
#[test]
fn a_refusal_at_connection_is_told_in_words() {
    let simulator = simulator(Options::default());
    let mut config = config(&simulator, &[AxisName::X, AxisName::Y]);
    config.heartbeat = Some(PmcAddress {
        area: PmcArea::D,
        at: 20_000,
    });
    let mut controller = FocasController::new(config).unwrap();
    until("told", || controller.last_error().is_some());
    let error = controller.wait(Duration::from_millis(1)).unwrap_err();
    assert!(
        error.to_string().contains(
            "reading the heartbeat at D20000 was refused with code 3: EW_NUMBER, the number, address or range does not exist"
        ),
        "{error}"
    );
}

/// In a cycle, too, a refusal has its code and its words.
#[test]
fn a_refusal_in_a_cycle_is_told_in_words() {
    let simulator = simulator(Options {
        write_protected: true,
        ..Options::default()
    });
    let config = config(&simulator, &[AxisName::X]);
    let mut controller = connected(config);
    controller.read(soon()).unwrap();
    let refused = controller.apply(&um(1.0, 0.0, 0.0), soon()).unwrap_err();
    assert_eq!(
        refused.to_string(),
        "refused with code 7: EW_PROT, writing is protected"
    );
    // The heartbeat of the refused write may have moved: that is no other gateway.
    assert!(controller.read(soon()).is_ok(), "the session lives on");
}

#[test]
fn what_the_control_lacks_is_named() {
    let simulator = simulator(Options::default());
    let mut controller =
        FocasController::new(config(&simulator, &[AxisName::X, AxisName::B])).unwrap();
    until("told", || controller.last_error().is_some());
    let error = controller.wait(Duration::from_millis(1)).unwrap_err();
    assert!(
        error
            .to_string()
            .contains("the control has no axis B, found XYZC"),
        "{error}"
    );
    for (axes, expected) in [
        (&[][..], "found 0 axes"),
        (&[AxisName::X, AxisName::X][..], "axis X: found twice"),
    ] {
        let refused = FocasController::new(config(&simulator, axes))
            .err()
            .unwrap();
        assert!(refused.to_string().contains(expected), "{refused}");
    }
    let mut senseless = config(&simulator, &[AxisName::X]);
    senseless.shift.count_linear = Mm(0.0);
    let refused = FocasController::new(senseless).err().unwrap();
    assert!(
        refused.to_string().contains("a resolution of 0 µm"),
        "{refused}"
    );
}

/// Of two axes whose names begin with the same letter (FANUC names have suffixes, `Z2`) the first was corrected, silently.
#[test]
fn a_letter_that_several_axes_have_is_refused() {
    let world = World::new(&['Z', 'Y', 'Z']);
    let simulator = Simulator::start("127.0.0.1:0", Options::default(), world).unwrap();
    let mut controller =
        FocasController::new(config(&simulator, &[AxisName::Y, AxisName::Z])).unwrap();
    until("told", || controller.last_error().is_some());
    let error = controller.wait(Duration::from_millis(1)).unwrap_err();
    let expected =
        "axis Z: found several axes of the control whose names begin with this letter, ZYZ";
    assert!(error.to_string().contains(expected), "{error}");
}

/// A byte tells of eight axes: the ninth always counted as referenced.
#[test]
fn the_ninth_axis_of_a_control_is_not_taken_for_referenced() {
    let world = World::new(&['X', 'Y', 'Z', 'A', 'B', 'C', 'U', 'V', 'W']);
    let simulator = Simulator::start("127.0.0.1:0", Options::default(), world).unwrap();
    let mut config = config(&simulator, &[AxisName::W]);
    let referenced = |config: &FocasConfig| {
        let mut controller = connected(config.clone());
        controller.read(soon()).unwrap().state.referenced
    };
    assert!(!referenced(&config));
    config.referenced = None;
    assert!(
        referenced(&config),
        "the configuration says that nobody tells it"
    );
}
