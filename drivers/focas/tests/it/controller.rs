use std::{
    sync::Arc,
    time::{Duration, Instant},
};

use volcomp_focas::{
    Abilities, FocasConfig, FocasController, Packing, PmcAddress, PmcArea,
    simulator::{Options, Simulator},
};
use volcomp_port::{Controller, Fault, contract};
use volcomp_vocabulary::{AxisName, Mm, PerChannel};

use crate::{PATIENCE, config, simulator, until};

fn soon() -> Instant {
    Instant::now() + Duration::from_secs(1)
}

fn connected(config: FocasConfig) -> FocasController {
    let mut controller = FocasController::new(config).unwrap();
    controller.wait(PATIENCE).unwrap();
    controller
}

/// Corrections of the first three axes, um.
fn um(x: f64, y: f64, z: f64) -> PerChannel<f64> {
    PerChannel::leading([x * 1e-3, y * 1e-3, z * 1e-3])
}

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
    let simulator = simulator(Options::default());
    let mut config = config(&simulator, &[AxisName::X]);
    // Outputs to the machine can be read, not written.
    config.shift.first = PmcAddress {
        area: PmcArea::Y,
        at: 100,
    };
    let mut controller = connected(config);
    controller.read(soon()).unwrap();
    let refused = controller.apply(&um(1.0, 0.0, 0.0), soon()).unwrap_err();
    assert_eq!(
        refused.to_string(),
        "refused with code 3: EW_NUMBER, the number, address or range does not exist"
    );
    // The heartbeat of the refused write may have moved: that is no other gateway.
    assert!(controller.read(soon()).is_ok(), "the session lives on");
}

#[test]
fn shifts_reach_the_axes_of_their_names() {
    let simulator = simulator(Options::default());
    simulator.world().shift.in_positions = true;
    simulator.world().motion = Arc::new(|_| vec![10.0, 20.0, 30.0, 90.0]);
    // Another order than the control's, and one axis left out.
    let mut controller = connected(config(&simulator, &[AxisName::Z, AxisName::X]));
    controller.apply(&um(5.0, -12.0, 0.0), soon()).unwrap();
    assert_eq!(simulator.world().shifts(), [-0.012, 0.0, 0.005, 0.0]);
    let snapshot = controller.read(soon()).unwrap();
    assert!((snapshot.positions[0] - 30.005).abs() < 1e-12);
    assert!((snapshot.positions[1] - 9.988).abs() < 1e-12);
    assert_eq!(snapshot.positions[2..], [0.0; 7]);
    let applied = snapshot.applied.unwrap();
    assert!((applied[0] - 0.005).abs() < 1e-12 && (applied[1] + 0.012).abs() < 1e-12);
    assert!(snapshot.uncertainty < Duration::from_millis(500));
}

#[test]
fn a_shift_is_held_within_its_word() {
    let simulator = simulator(Options::default());
    let mut controller = connected(config(&simulator, &[AxisName::X, AxisName::Y, AxisName::Z]));
    let wild = PerChannel::leading([f64::INFINITY, -1e9, f64::NAN]);
    controller.apply(&wild, soon()).unwrap();
    assert_eq!(simulator.world().shifts(), [32.767, -32.768, 0.0, 0.0]);
}

#[test]
fn rotary_axes_are_in_radians() {
    let simulator = simulator(Options::default());
    simulator.world().motion = Arc::new(|_| vec![1.0, 2.0, 3.0, 180.0]);
    let mut config = config(&simulator, &[AxisName::X]);
    config.axes = vec![AxisName::C, AxisName::X];
    let mut controller = connected(config);
    let snapshot = controller.read(soon()).unwrap();
    assert!((snapshot.positions[0] - std::f64::consts::PI).abs() < 1e-12);
    assert!((snapshot.positions[1] - 1.0).abs() < 1e-12);
    let mut corrections = PerChannel::ZERO;
    corrections[0] = 0.004_f64.to_radians();
    controller.apply(&corrections, soon()).unwrap();
    assert_eq!(simulator.world().shifts()[3], 0.004);
}

#[test]
fn states_are_told() {
    let simulator = simulator(Options::default());
    let mut controller = connected(config(&simulator, &[AxisName::X, AxisName::Y, AxisName::Z]));
    let state = |controller: &mut FocasController| controller.read(soon()).unwrap().state;
    assert!(state(&mut controller).referenced && !state(&mut controller).alarm);
    simulator.world().write(PmcArea::F, 120, &[0b1011]);
    assert!(!state(&mut controller).referenced);
    simulator.world().emergency_stop = true;
    simulator.world().alarms.push((1, String::new()));
    let found = state(&mut controller);
    assert!(found.alarm && found.emergency_stop);
}

#[test]
fn the_heartbeat_moves_with_every_correction_and_shows_another_gateway() {
    let simulator = simulator(Options::default());
    let mut controller = connected(config(&simulator, &[AxisName::X]));
    let beat = |simulator: &Simulator| simulator.world().read(PmcArea::R, 120, 1).unwrap()[0];
    for expected in 1..=3 {
        controller.read(soon()).unwrap();
        controller.apply(&um(1.0, 0.0, 0.0), soon()).unwrap();
        assert_eq!(beat(&simulator), expected);
    }
    controller.read(soon()).unwrap();
    simulator.world().write(PmcArea::R, 120, &[77]);
    assert_eq!(controller.read(soon()), Err(Fault::OtherGateway));
    assert!(controller.read(soon()).is_ok(), "told once for each move");
}

#[test]
fn the_sequence_counts_after_the_shifts() {
    let simulator = simulator(Options::default());
    let mut config = config(&simulator, &[AxisName::X, AxisName::Z]);
    config.sequence = Some(PmcAddress {
        area: PmcArea::D,
        at: 7,
    });
    for (heartbeat, beats) in [(config.heartbeat, 3), (None, 0)] {
        simulator.world().write(PmcArea::R, 120, &[0]);
        simulator.world().write(PmcArea::D, 7, &[0]);
        config.heartbeat = heartbeat;
        let mut controller = connected(config.clone());
        for expected in 1..=3 {
            controller
                .apply(&um(f64::from(expected), 0.0, 0.0), soon())
                .unwrap();
            let mut world = simulator.world();
            assert_eq!(world.read(PmcArea::D, 7, 1), Some(vec![expected]));
            assert_eq!(world.shifts()[0], f64::from(expected) * 0.001);
        }
        assert_eq!(
            simulator.world().read(PmcArea::R, 120, 1),
            Some(vec![beats])
        );
    }
    // After a reconnection it goes on: a ladder that waits for another number sees the first correction.
    let mut controller = connected(config);
    controller.apply(&um(1.0, 0.0, 0.0), soon()).unwrap();
    let number = simulator.world().read(PmcArea::D, 7, 1);
    assert_eq!(number, Some(vec![4]));
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

/// A cut connection, an answer that comes too late, a control that is switched off and on again: the
/// controller comes back by itself, and no late answer is taken for the next one's.
#[test]
fn it_comes_back_by_itself() {
    let options = Options {
        latency: Duration::from_millis(5),
        ..Options::default()
    };
    let mut simulator = Some(simulator(options.clone()));
    let mut controller = connected(config(
        simulator.as_ref().unwrap(),
        &[AxisName::X, AxisName::Y, AxisName::Z],
    ));
    let back = |controller: &mut FocasController| {
        let end = Instant::now() + PATIENCE;
        while controller.read(soon()).is_err() {
            assert!(
                Instant::now() < end,
                "not back: {:?}",
                controller.last_error()
            );
            std::thread::sleep(Duration::from_millis(1));
        }
    };
    simulator.as_ref().unwrap().disconnect_all();
    assert_eq!(controller.read(soon()), Err(Fault::Disconnected));
    back(&mut controller);
    let late = Instant::now() + Duration::from_millis(1);
    assert_eq!(controller.read(late), Err(Fault::TimedOut));
    back(&mut controller);
    let address = simulator.as_ref().unwrap().address().to_string();
    drop(simulator.take());
    assert!(controller.read(soon()).is_err());
    assert!(controller.apply(&um(1.0, 0.0, 0.0), soon()).is_err());
    let world = volcomp_focas::simulator::World::new(&['X', 'Y', 'Z', 'C']);
    simulator = Some(Simulator::start(&address, options, world).unwrap());
    back(&mut controller);
    drop(simulator);
}

/// Nothing is left behind by a thousand connections: descriptors counted.
#[test]
fn a_thousand_connections_leave_nothing() {
    let simulator = simulator(Options {
        sessions: 50,
        ..Options::default()
    });
    let later = Duration::from_micros(300);
    let mut config = config(&simulator, &[AxisName::X]);
    config.backoff.most = Duration::from_millis(1);
    let mut controller = connected(config);
    let descriptors = || std::fs::read_dir("/proc/self/fd").unwrap().count();
    let count_at = |controller: &mut FocasController, connections: u64| {
        while controller.connections() < connections {
            controller.wait(PATIENCE).unwrap();
            // The simulator is held up, so the answer is too late and the connection given up.
            let _world = simulator.world();
            assert_eq!(
                controller.read(Instant::now() + later),
                Err(Fault::TimedOut)
            );
        }
        until("sessions end", || simulator.open_sessions() <= 2);
        descriptors()
    };
    let early = count_at(&mut controller, 20);
    let late = count_at(&mut controller, 1000);
    // Other tests of this program open a few at the same time.
    assert!(late <= early + 60, "{early} descriptors, then {late}");
}

#[test]
fn places_in_memory_are_configured() {
    let simulator = simulator(Options::default());
    {
        let mut world = simulator.world();
        world.shift.area = PmcArea::D;
        world.shift.first = 1000;
        world.shift.width = volcomp_focas::Width::Long;
        world.shift.count = 0.0001;
    }
    let mut config = config(&simulator, &[AxisName::Y, AxisName::Z]);
    config.shift.first = PmcAddress {
        area: PmcArea::D,
        at: 1000,
    };
    config.shift.width = volcomp_focas::Width::Long;
    config.shift.count_linear = Mm(0.0001);
    let mut controller = connected(config);
    controller.apply(&um(123.4, -5.55, 0.0), soon()).unwrap();
    let shifts = simulator.world().shifts();
    assert!(
        (shifts[1] - 0.1234).abs() < 1e-12 && (shifts[2] + 0.0056).abs() < 1e-12,
        "{shifts:?}"
    );
}

/// A heartbeat in the words of the corrections would be a correction itself: 0 to 255 counts of an axis.
#[test]
fn a_heartbeat_within_the_words_of_the_shifts_is_refused() {
    let config = |heartbeat: u16| {
        let mut config = FocasConfig::new("127.0.0.1", &[AxisName::X]);
        config.heartbeat = Some(PmcAddress {
            area: PmcArea::R,
            at: heartbeat,
        });
        config
    };
    for (heartbeat, refused) in [(99, false), (100, true), (101, true), (102, false)] {
        assert_eq!(
            config(heartbeat).describe().is_err(),
            refused,
            "R{heartbeat}"
        );
    }
}
