//! Tests of the driver with a simulated bridge.

use std::{
    net::UdpSocket,
    time::{Duration, Instant},
};

use assert_no_alloc::assert_no_alloc;
use volcomp_guard::{
    barrier::{Barrier, FRAME_WORDS, Report},
    protocol::{Counts, Session},
};
use volcomp_linuxcnc::{Flags, LinuxCncConfig, LinuxCncController, STATE_BYTES};
use volcomp_port::{Controller, DeviceError, Fault, Snapshot, Words, contract};
use volcomp_vocabulary::{AxisName, Displacement, Mm, PerChannel};

use crate::bridge::{Behaviour, Bridge, KEY, MACHINE, settings, state};

fn soon() -> Instant {
    Instant::now() + Duration::from_secs(5)
}

fn until(controller: &mut LinuxCncController, done: impl Fn(&Result<Snapshot, Fault>) -> bool) {
    let end = soon();
    loop {
        let read = controller.read(soon());
        if done(&read) {
            return;
        }
        assert!(Instant::now() < end, "last: {read:?}");
        std::thread::sleep(Duration::from_millis(1));
    }
}

#[test]
fn the_controller_contract() {
    let bridge = Bridge::start();
    let mut controller = LinuxCncController::new(&bridge.config()).unwrap();
    contract::controller(&mut controller);
}

/// Reports arrive, frames that answer these reports are accepted, and the barrier applies the values sent.
#[test]
fn the_barrier_applies_a_correction() {
    let bridge = Bridge::start();
    let mut controller = LinuxCncController::new(&bridge.config()).unwrap();
    let snapshot = controller.read(soon()).unwrap();
    let (x, c) = (snapshot.positions[0], snapshot.positions[1]);
    assert_eq!(x, 100.0);
    assert!((c - std::f64::consts::FRAC_PI_2).abs() < 1e-12, "{c} rad");
    assert!(snapshot.state.referenced && !snapshot.state.alarm && !snapshot.state.emergency_stop);
    let mut session = Session::new(77);
    let wanted: Counts = PerChannel::leading([12_345, -678]);
    let end = soon();
    loop {
        let (report, settings) = (controller.read(soon()).unwrap().report.unwrap(), settings());
        let report = Report::decode(MACHINE, settings.axes, report.as_slice()).unwrap();
        if report.applied == wanted {
            break;
        }
        session.read(report.head());
        let mut words = [0; FRAME_WORDS];
        let length = session.frame(&wanted).unwrap().encode(&settings, &mut words);
        controller.post(&Words::new(&words[..length]).unwrap(), soon()).unwrap();
        assert!(Instant::now() < end, "{report:?}");
        std::thread::sleep(Duration::from_millis(1));
    }
    assert_eq!(bridge.barrier.lock().unwrap().memory().link.owner, 77);
    assert_eq!(controller.health().broken, 0);
}

/// A correction that the bridge reports as applied, but the control has not applied, is an alarm even without the flag
/// `LOST`.
#[test]
fn a_missing_offset_is_an_alarm() {
    let bridge = Bridge::start();
    let mut controller = LinuxCncController::new(&bridge.config()).unwrap();
    assert!(!controller.read(soon()).unwrap().state.alarm);
    let all: Counts = PerChannel::leading([3500, 0]);
    *bridge.barrier.lock().unwrap() = Barrier::start(settings(), 0, 0, &all).unwrap();
    bridge.behaviour.lock().unwrap().stuck = true;
    until(&mut controller, |read| read.is_ok_and(|read| read.state.alarm));
    bridge.behaviour.lock().unwrap().stuck = false;
    until(&mut controller, |read| read.is_ok_and(|read| !read.state.alarm));
}

#[test]
fn flags_forbid_correction() {
    let bridge = Bridge::start();
    let mut controller = LinuxCncController::new(&bridge.config()).unwrap();
    let good = Flags::ENABLED | Flags::HOMED;
    let cases = [
        (good, [true, false, false]),
        (good | Flags::PROBING, [true, false, false]),
        (Flags::ENABLED, [false, false, false]),
        (Flags::HOMED, [true, true, false]),
        (good | Flags::LIMITED, [true, true, false]),
        (good | Flags::LOST, [true, true, false]),
        (good | Flags::EMERGENCY_STOP, [true, false, true]),
        (0, [false, true, false]),
    ];
    for (flags, expected) in cases {
        bridge.behaviour.lock().unwrap().flags = flags;
        let end = soon();
        loop {
            let state = controller.read(soon()).unwrap().state;
            let found = [state.referenced, state.alarm, state.emergency_stop];
            if controller.state().unwrap().flags.0 == flags {
                assert_eq!(found, expected, "{flags:#b}");
                break;
            }
            assert!(Instant::now() < end);
        }
    }
}

#[test]
fn a_bridge_of_another_machine_or_count_size_is_rejected() {
    let bridge = Bridge::start();
    let mut other = bridge.config();
    other.step_linear = Displacement::Length(Mm(1e-5));
    let mut controller = LinuxCncController::new(&other).unwrap();
    let refused = |read: &Result<Snapshot, Fault>, what: &str| matches!(read, Err(Fault::Protocol(behaviour)) if behaviour.contains(what));
    until(&mut controller, |read| refused(read, "different count sizes"));
    let mut other = bridge.config();
    other.axes.reverse();
    let mut controller = LinuxCncController::new(&other).unwrap();
    until(&mut controller, |read| refused(read, "other axes"));
    let mut controller = LinuxCncController::new(&bridge.config()).unwrap();
    controller.read(soon()).unwrap();
    bridge.behaviour.lock().unwrap().machine = 8;
    until(&mut controller, |read| refused(read, "another machine number"));
    bridge.behaviour.lock().unwrap().machine = MACHINE;
    until(&mut controller, Result::is_ok);
    assert!(controller.health().foreign > 0);
}

/// The last state of a bridge that has become silent stays valid, and its age grows. A restart of the bridge is
/// counted.
#[test]
fn a_silent_bridge_ages_and_restarts() {
    let bridge = Bridge::start();
    let mut controller = LinuxCncController::new(&bridge.config()).unwrap();
    controller.read(soon()).unwrap();
    bridge.behaviour.lock().unwrap().silent = true;
    std::thread::sleep(Duration::from_millis(50));
    let last = controller.read(soon()).unwrap();
    std::thread::sleep(Duration::from_millis(50));
    let again = controller.read(soon()).unwrap();
    assert_eq!(last.taken, again.taken);
    assert!(again.taken.elapsed() >= Duration::from_millis(50));
    {
        let mut behaviour = bridge.behaviour.lock().unwrap();
        (behaviour.silent, behaviour.run) = (false, 2);
    }
    until(&mut controller, |read| read.is_ok_and(|read| read.taken > again.taken));
    assert_eq!(controller.health().restarts, 1);
}

#[test]
fn without_a_bridge_a_read_ends_at_its_deadline() {
    // This port is free, because its socket was just closed.
    let port = UdpSocket::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
    let bridge = Bridge::start();
    let config = LinuxCncConfig { port, ..bridge.config() };
    let mut controller = LinuxCncController::new(&config).unwrap();
    let deadline = Instant::now() + Duration::from_millis(30);
    assert_eq!(controller.read(deadline), Err(Fault::TimedOut));
    assert!(Instant::now() >= deadline);
}

/// Late, reordered and duplicate datagrams and datagrams of an earlier run are ignored; a datagram that waited in the
/// queue keeps its age.
#[test]
fn late_duplicate_and_queued_states_are_distinguished() {
    let socket = UdpSocket::bind("127.0.0.1:0").unwrap();
    let bridge = Bridge::start();
    let config = LinuxCncConfig { port: socket.local_addr().unwrap().port(), ..bridge.config() };
    let mut controller = LinuxCncController::new(&config).unwrap();
    let _ = controller.read(Instant::now());
    let (_, to) = socket.recv_from(&mut [0; 100]).unwrap();
    let clock = Instant::now();
    let send = |run: u32, sequence: u32, at: f64, time: Duration| {
        let behaviour = Behaviour {
            machine: MACHINE,
            run,
            flags: Flags::ENABLED | Flags::HOMED,
            at: [at, 0.0],
            silent: false,
            stuck: false,
        };
        let mut bytes = [0; STATE_BYTES];
        let length = state(&behaviour, sequence, time, Words::EMPTY).encode(&KEY, &mut bytes);
        socket.send_to(&bytes[..length], to).unwrap();
    };
    let base = Duration::from_secs(100);
    let x =
        |controller: &mut LinuxCncController| controller.read(soon()).map(|read| read.positions[0]);
    send(1, u32::MAX, 1.0, base + clock.elapsed());
    assert_eq!(x(&mut controller), Ok(1.0));
    // The sequence number wraps around.
    send(1, 1, 2.0, base + clock.elapsed());
    assert_eq!(x(&mut controller), Ok(2.0));
    send(1, 1, 3.0, base + clock.elapsed());
    send(1, 0, 4.0, base + clock.elapsed());
    send(9, 50, 5.0, base);
    // A datagram recorded in an earlier run, on a computer that had been running longer.
    send(9, 51, 5.5, base + Duration::from_secs(5000));
    assert_eq!(x(&mut controller), Ok(2.0));
    let health = controller.health();
    assert_eq!((health.late, health.lost, health.restarts), (4, 1, 0));
    // A datagram that waited in the queue keeps its age.
    send(1, 2, 6.0, base + clock.elapsed());
    let sent = Instant::now();
    std::thread::sleep(Duration::from_millis(100));
    let read = controller.read(soon()).unwrap();
    assert_eq!(read.positions[0], 6.0);
    assert!(read.taken <= sent + Duration::from_millis(50), "as young as if it had just arrived");
    assert_eq!(read.report, None);
}

#[test]
fn positions_alone_can_be_read() {
    let bridge = Bridge::start();
    let mut config = bridge.config();
    (config.axes, config.reads) = (Vec::new(), vec![AxisName::C]);
    // A configuration that only reads positions needs no machine number.
    config.machine = 0;
    let mut controller = LinuxCncController::new(&config).unwrap();
    let read = controller.read(soon()).unwrap();
    assert!((read.positions[0] - std::f64::consts::FRAC_PI_2).abs() < 1e-12);
    assert_eq!((read.report, read.applied), (None, None));
    let refused = controller.post(&Words::EMPTY, soon());
    assert!(matches!(refused, Err(Fault::Unsupported(_))), "{refused:?}");
    config.reads = vec![AxisName::Y];
    let mut controller = LinuxCncController::new(&config).unwrap();
    until(&mut controller, |read| matches!(read, Err(Fault::Protocol(_))));
}

#[test]
fn another_computer_must_be_allowed_explicitly() {
    let bridge = Bridge::start();
    let mut config = LinuxCncConfig { host: "192.0.2.1".to_owned(), ..bridge.config() };
    let refused = LinuxCncController::new(&config).err().expect("refused");
    assert!(matches!(refused, DeviceError::Option(_)), "{refused}");
    assert!(refused.to_string().contains("another computer"), "{refused}");
    config.remote = true;
    assert!(config.describe().is_ok());
    config.step_linear = Displacement::Length(Mm(1.5e-6));
    let refused = config.describe().expect_err("no whole nanometres");
    assert!(refused.to_string().contains("whole nanometres"), "{refused}");
}

#[test]
fn exchanges_do_not_allocate() {
    let bridge = Bridge::start();
    let mut controller = LinuxCncController::new(&bridge.config()).unwrap();
    controller.read(soon()).unwrap();
    let frame = Words::new(&[1; 8]).unwrap();
    for _ in 0..50 {
        assert_no_alloc(|| {
            controller.read(soon()).unwrap();
            controller.post(&frame, soon()).unwrap();
        });
        std::thread::sleep(Duration::from_millis(1));
    }
    assert_eq!(controller.post(&frame, Instant::now()), Err(Fault::TimedOut));
}
