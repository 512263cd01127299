//! The connection to a control: lost, late, found again, and nothing left behind.

use std::time::{Duration, Instant};

use volcomp_focas::{
    FocasController,
    simulator::{Options, Simulator},
};
use volcomp_port::{Controller, Fault};
use volcomp_vocabulary::AxisName;

use crate::{
    PATIENCE, config,
    controller::{connected, soon, um},
    simulator, until,
};

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
