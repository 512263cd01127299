use std::time::{Duration, Instant};

use volcomp_port::{
    Clock, Controller, DigitalIo, Fault, InputLevels, MockController, MockDigitalIo, Quality,
    Thermometer, contract,
    inject::{Faults, Faulty},
};
use volcomp_vocabulary::PerChannel;

use crate::machine;

fn soon() -> Instant {
    Instant::now() + Duration::from_millis(20)
}

#[test]
fn without_faults_the_device_is_unchanged() {
    let (controller, thermometer, _) = machine(Clock::system()).start();
    contract::controller(&mut Faulty::new(controller, Faults::default(), 1));
    contract::thermometer(&mut Faulty::new(thermometer, Faults::default(), 1));
}

/// Equal seeds give equal faults, different seeds different ones. Their number is about as requested.
#[test]
fn faults_are_seeded() {
    let faults =
        Faults { drop: 0.1, corrupt: 0.1, disconnect: 0.02, calls: 3, ..Faults::default() };
    let run = |seed| {
        let (controller, _, _) = machine(Clock::manual()).start();
        let mut faulty = Faulty::new(controller, faults, seed);
        let outcome = |_| match faulty.read(soon()) {
            Ok(snapshot) if snapshot.positions == PerChannel::ZERO => 'o',
            Ok(_) => 'c',
            Err(Fault::TimedOut) => 't',
            Err(Fault::NotConnected) => 'd',
            Err(other) => panic!("{other}"),
        };
        (0..2000).map(outcome).collect::<String>()
    };
    let first = run(7);
    assert_eq!(first, run(7));
    assert_ne!(first, run(8));
    let count = |what| first.matches(what).count();
    assert!((140..260).contains(&count('t')), "{}", count('t'));
    assert!((110..260).contains(&count('c')), "{}", count('c'));
    assert!((60..180).contains(&count('d')), "{}", count('d'));
}

#[test]
fn frozen_responses_repeat_the_last_one() {
    let clock = Clock::manual();
    let (controller, _, _) = machine(clock.clone()).start();
    let mut faulty = Faulty::new(controller, Faults::default(), 1);
    let first = faulty.read(soon()).unwrap();
    faulty.faults.freeze = 1.0;
    faulty.faults.calls = 5;
    clock.advance(Duration::from_millis(300));
    for _ in 0..5 {
        assert_eq!(faulty.read(soon()).unwrap().positions, first.positions);
    }
    faulty.faults.freeze = 0.0;
    assert_ne!(faulty.read(soon()).unwrap().positions, first.positions);
}

#[test]
fn a_delay_ends_at_the_deadline() {
    let (controller, _, _) = machine(Clock::manual()).start();
    let faults = Faults { delay: Duration::from_secs(3600), ..Faults::default() };
    let mut faulty = Faulty::new(controller, faults, 1);
    assert_eq!(faulty.read(soon()), Err(Fault::TimedOut));
    faulty.faults.delay = Duration::from_millis(1);
    assert!(faulty.read(soon()).is_ok());
}

#[test]
fn one_bit_of_a_mocked_device_is_flipped() {
    let mut port = MockDigitalIo::new();
    port.expect_inputs().return_const(8_u32);
    port.expect_read().returning(|_| Ok(InputLevels::now(0b1010_0101)));
    let faults = Faults { corrupt: 1.0, ..Faults::default() };
    let mut faulty = Faulty::new(port, faults, 3);
    for _ in 0..50 {
        let levels = faulty.read(soon()).unwrap().levels;
        assert_eq!((levels ^ 0b1010_0101).count_ones(), 1);
    }
    let mut controller = MockController::new();
    controller.expect_apply().returning(|_, _| Err(Fault::Disconnected));
    assert_eq!(controller.apply(&PerChannel::ZERO, soon()), Err(Fault::Disconnected));
}

#[test]
fn corrupted_temperatures() {
    let (_, thermometer, _) = machine(Clock::manual()).start();
    let faults = Faults { corrupt: 1.0, ..Faults::default() };
    let mut faulty = Faulty::new(thermometer, faults, 3);
    let mut seen_nan = false;
    for _ in 0..50 {
        let found = faulty.latest()[0];
        assert_eq!(found.quality, Quality::Good);
        assert_ne!(found.degc, Some(20.0));
        seen_nan |= found.degc.is_some_and(f64::is_nan);
    }
    assert!(seen_nan);
}

/// Stored settings without the keys of read-back faults are read with the default values of these keys.
#[test]
fn old_documents_are_accepted() {
    let old = r#"{"delay":{"secs":0,"nanos":3000000},"jitter":false,"drop":0.25,"corrupt":0.0,"freeze":0.0,"disconnect":0.0,"calls":0}"#;
    let read: Faults = serde_json::from_str(old).unwrap();
    assert_eq!((read.drop, read.lie, read.lag), (0.25, 0.0, 0));
}
