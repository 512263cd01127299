//! Loss and recovery of the connection.

use std::time::{Duration, Instant};

use volcomp_focas::{
    FocasController,
    simulator::{Options, Simulator},
};
use volcomp_port::{Controller, Fault};
use volcomp_vocabulary::AxisName;

use crate::{
    TIMEOUT, config,
    controller::{connected, soon, um},
    simulator, until,
};

/// The controller reconnects after a disconnection, a late response and a power cycle, and never takes a late response for
/// the next one.
#[test]
fn it_reconnects_automatically() {
    let options = Options {
        latency: Duration::from_millis(5),
        ..Options::default()
    };
    let mut simulator = Some(simulator(options.clone()));
    let mut controller = connected(config(
        simulator.as_ref().unwrap(),
        &[AxisName::X, AxisName::Y, AxisName::Z],
    ));
    let reconnect = |controller: &mut FocasController| {
        let end = Instant::now() + TIMEOUT;
        while controller.read(soon()).is_err() {
            assert!(
                Instant::now() < end,
                "no connection: {:?}",
                controller.last_error()
            );
            std::thread::sleep(Duration::from_millis(1));
        }
    };
    simulator.as_ref().unwrap().disconnect_all();
    assert_eq!(controller.read(soon()), Err(Fault::Disconnected));
    reconnect(&mut controller);
    let late = Instant::now() + Duration::from_millis(1);
    assert_eq!(controller.read(late), Err(Fault::TimedOut));
    reconnect(&mut controller);
    let address = simulator.as_ref().unwrap().address().to_string();
    drop(simulator.take());
    assert!(controller.read(soon()).is_err());
    assert!(controller.apply(&um(1.0, 0.0, 0.0), soon()).is_err());
    let world = volcomp_focas::simulator::World::new(&['X', 'Y', 'Z', 'C']);
    simulator = Some(Simulator::start(&address, options, world).unwrap());
    reconnect(&mut controller);
    drop(simulator);
}

/// A thousand connections leak no file descriptors.
#[test]
fn a_thousand_connections_leak_nothing() {
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
            controller.wait(TIMEOUT).unwrap();
            // The locked simulator responds too late, so the connection is dropped.
            let _world = simulator.world();
            assert_eq!(
                controller.read(Instant::now() + later),
                Err(Fault::TimedOut)
            );
        }
        until("the sessions end", || simulator.open_sessions() <= 2);
        descriptors()
    };
    let early = count_at(&mut controller, 20);
    let late = count_at(&mut controller, 1000);
    // Other tests of this program open a few at the same time.
    assert!(late <= early + 60, "{early} descriptors, then {late}");
}
