//! Loss and recovery of the connection: a write from before an outage must not reach the control afterwards. A proxy
//! holds sent bytes, like the sender's kernel while a cable is unplugged, and then checks whether the sender has reset
//! the connection.

use std::{
    io::{Read, Write},
    net::{SocketAddr, TcpListener, TcpStream},
    sync::{
        Arc,
        atomic::{AtomicBool, AtomicUsize, Ordering},
    },
    thread,
    time::{Duration, Instant},
};

use volcomp_focas::{
    FocasConfig, FocasController,
    simulator::{Options, Simulator},
};
use volcomp_port::{Controller, Fault};
use volcomp_vocabulary::AxisName;

use crate::{
    TIMEOUT, config,
    controller::{connected, soon, um},
    simulator, until,
};

struct Cable {
    address: SocketAddr,
    out: Arc<AtomicBool>,
    /// Number of connections whose held bytes were discarded because the sender had reset.
    reset: Arc<AtomicUsize>,
    /// Number of connections whose held bytes were delivered after an outage.
    late: Arc<AtomicUsize>,
}

impl Cable {
    fn to(simulator: &Simulator) -> Self {
        let (listener, control) = (TcpListener::bind("127.0.0.1:0").unwrap(), simulator.address());
        let cable = Self {
            address: listener.local_addr().unwrap(),
            out: Arc::default(),
            reset: Arc::default(),
            late: Arc::default(),
        };
        let shared = (Arc::clone(&cable.out), Arc::clone(&cable.reset), Arc::clone(&cable.late));
        thread::spawn(move || {
            for near in listener.incoming().flatten() {
                let far = TcpStream::connect(control).unwrap();
                let (out, reset, late) = shared.clone();
                let back = (near.try_clone().unwrap(), far.try_clone().unwrap());
                thread::spawn(move || forward(back.1, back.0));
                thread::spawn(move || hold_and_forward(near, far, &out, &reset, &late));
            }
        });
        cable
    }

    fn config(&self, simulator: &Simulator) -> FocasConfig {
        FocasConfig {
            port: self.address.port(),
            ..config(simulator, &[AxisName::X, AxisName::Y, AxisName::Z])
        }
    }
}

fn forward(mut from: TcpStream, mut to: TcpStream) {
    let mut bytes = [0; 4096];
    while let Ok(count @ 1..) = from.read(&mut bytes) {
        if to.write_all(&bytes[..count]).is_err() {
            return;
        }
    }
    let _ = to.shutdown(std::net::Shutdown::Write);
}

/// Forwards the driver's bytes. While the cable is unplugged, holds them. Afterwards delivers the held bytes, unless
/// the driver has reset the connection, in which case its kernel would have nothing to send.
fn hold_and_forward(
    mut from: TcpStream,
    mut to: TcpStream,
    out: &AtomicBool,
    reset: &AtomicUsize,
    late: &AtomicUsize,
) {
    // A connection that starts during the outage carries no bytes from before.
    let mut began_before = !out.load(Ordering::SeqCst);
    let mut bytes = [0; 4096];
    while let Ok(count @ 1..) = from.read(&mut bytes) {
        if out.load(Ordering::SeqCst) {
            while out.load(Ordering::SeqCst) {
                thread::sleep(Duration::from_millis(1));
            }
            let is_reset = from.take_error().is_ok_and(|error| error.is_some());
            let counter = if is_reset { reset } else { late };
            if began_before {
                counter.fetch_add(1, Ordering::SeqCst);
            }
            began_before = true;
            if is_reset {
                let _ = to.shutdown(std::net::Shutdown::Both);
                return;
            }
        }
        if to.write_all(&bytes[..count]).is_err() {
            return;
        }
    }
    let _ = to.shutdown(std::net::Shutdown::Write);
}

/// In each of ten outages the old write is discarded. An orderly close would deliver it.
#[test]
fn an_old_write_is_not_delivered_after_an_outage() {
    let simulator = simulator(Options::default());
    let cable = Cable::to(&simulator);
    let mut controller = connected(cable.config(&simulator));
    for outage in 1..=10 {
        controller.apply(&um(10.0, 0.0, 0.0), soon()).unwrap();
        cable.out.store(true, Ordering::SeqCst);
        let deadline = Instant::now() + Duration::from_millis(5);
        let lost = controller.apply(&um(40.0, 40.0, 40.0), deadline);
        assert_eq!(lost, Err(Fault::TimedOut));
        // The call itself must have reset the connection, before the socket is closed.
        thread::sleep(Duration::from_millis(20));
        cable.out.store(false, Ordering::SeqCst);
        until("the cable is back", || {
            let seen = cable.reset.load(Ordering::SeqCst) + cable.late.load(Ordering::SeqCst);
            seen == outage
        });
        thread::sleep(Duration::from_millis(5));
        assert_eq!(simulator.world().shifts()[..3], [0.010, 0.0, 0.0]);
        assert_eq!(cable.late.load(Ordering::SeqCst), 0, "outage {outage}");
        controller.wait(TIMEOUT).unwrap();
        let end = Instant::now() + TIMEOUT;
        while controller.read(soon()).is_err() {
            assert!(Instant::now() < end, "{:?}", controller.last_error());
            thread::sleep(Duration::from_millis(1));
        }
    }
}

/// After an orderly close the proxy delivers the held bytes. This proves that the proxy can detect a late delivery.
#[test]
fn the_proxy_delivers_late_after_an_orderly_close() {
    let simulator = simulator(Options::default());
    let cable = Cable::to(&simulator);
    let mut sender = TcpStream::connect(cable.address).unwrap();
    sender.write_all(&volcomp_focas::frame::open_frame()).unwrap();
    // Read everything, because unread data turn the close into a reset.
    sender.read_exact(&mut [0; 10 + 360]).unwrap();
    cable.out.store(true, Ordering::SeqCst);
    sender.write_all(&volcomp_focas::frame::close_frame()).unwrap();
    drop(sender);
    thread::sleep(Duration::from_millis(20));
    cable.out.store(false, Ordering::SeqCst);
    until("delivered", || cable.late.load(Ordering::SeqCst) == 1);
    until("closed", || simulator.open_sessions() == 0);
}

#[test]
fn dropping_the_controller_discards_a_write_in_flight() {
    let simulator = simulator(Options::default());
    let cable = Cable::to(&simulator);
    let mut controller = connected(cable.config(&simulator));
    cable.out.store(true, Ordering::SeqCst);
    let deadline = Instant::now() + Duration::from_millis(5);
    assert!(controller.apply(&um(40.0, 0.0, 0.0), deadline).is_err());
    drop(controller);
    thread::sleep(Duration::from_millis(20));
    cable.out.store(false, Ordering::SeqCst);
    until("reset", || cable.reset.load(Ordering::SeqCst) == 1);
    thread::sleep(Duration::from_millis(20));
    assert_eq!(simulator.world().shifts()[0], 0.0);
}

/// A healthy session is closed with a closing frame, so that the control need not time out.
#[test]
fn a_healthy_session_is_closed_in_order() {
    let simulator = simulator(Options::default());
    let mut controller = connected(config(&simulator, &[AxisName::X]));
    controller.read(soon()).unwrap();
    assert_eq!(simulator.open_sessions(), 1);
    drop(controller);
    until("closed", || simulator.open_sessions() == 0);
}

/// A write after its deadline sends nothing, and the session stays open.
#[test]
fn a_write_whose_deadline_has_passed_is_not_sent() {
    let simulator = simulator(Options::default());
    let mut controller = connected(config(&simulator, &[AxisName::X]));
    controller.read(soon()).unwrap();
    let requests = simulator.requests();
    let late = controller.apply(&um(40.0, 0.0, 0.0), Instant::now());
    assert_eq!(late, Err(Fault::TimedOut));
    assert!(controller.read(soon()).is_ok());
    assert_eq!(simulator.requests(), requests + 1, "only the read");
    assert_eq!(controller.connections(), 1);
}

/// If the deadline passes between the requests of a write, the session ends, so that the control does not continue with
/// half a write.
#[test]
fn half_a_write_ends_the_session() {
    let latency = Duration::from_millis(4);
    let simulator =
        simulator(Options { one_point: true, one_command: true, latency, ..Options::default() });
    let mut controller = connected(config(&simulator, &[AxisName::X, AxisName::Y, AxisName::Z]));
    controller.read(soon()).unwrap();
    let late = controller.apply(&um(1.0, 2.0, 3.0), Instant::now() + latency * 2);
    assert_eq!(late, Err(Fault::TimedOut));
    // A busy computer may have connected again already.
    let read = controller.read(soon()).map(drop);
    assert!(read.is_ok() || read == Err(Fault::NotConnected), "{read:?}");
    controller.wait(TIMEOUT).unwrap();
    assert_eq!(controller.connections(), 2);
}

/// A call ends at its deadline, long before the control answers.
#[test]
fn no_call_blocks_longer_than_its_deadline() {
    let simulator = simulator(Options::default());
    let mut controller = connected(config(&simulator, &[AxisName::X]));
    simulator.world().pause(TIMEOUT);
    let begun = Instant::now();
    let read = controller.read(begun + Duration::from_millis(20));
    assert_eq!(read, Err(Fault::TimedOut));
    let took = begun.elapsed();
    assert!(took < TIMEOUT / 2, "{took:?}");
}

/// The controller reconnects after a disconnection, a late response and a power cycle. A late response is never taken
/// for the response to the next request.
#[test]
fn it_reconnects_automatically() {
    let options = Options { latency: Duration::from_millis(5), ..Options::default() };
    let mut simulator = Some(simulator(options.clone()));
    let mut controller =
        connected(config(simulator.as_ref().unwrap(), &[AxisName::X, AxisName::Y, AxisName::Z]));
    let reconnect = |controller: &mut FocasController| {
        let end = Instant::now() + TIMEOUT;
        while controller.read(soon()).is_err() {
            assert!(Instant::now() < end, "no connection: {:?}", controller.last_error());
            thread::sleep(Duration::from_millis(1));
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

#[test]
fn a_thousand_connections_leak_nothing() {
    let simulator = simulator(Options { sessions: 50, ..Options::default() });
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
            assert_eq!(controller.read(Instant::now() + later), Err(Fault::TimedOut));
        }
        until("the sessions end", || simulator.open_sessions() <= 2);
        descriptors()
    };
    let early = count_at(&mut controller, 20);
    let late = count_at(&mut controller, 1000);
    // Other tests of this process open descriptors meanwhile.
    assert!(late <= early + 60, "{early} descriptors, then {late}");
}
