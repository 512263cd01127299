//! SocketCAN on vcan0 and vcan1: frames of can-utils, error frames, and a node of PyPI's canopen.
//!
//! An interface goes down and up. The tests run on this computer's interfaces if present, and in the guest by `./test`.

#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

use std::{
    io::{BufRead, BufReader, Write},
    path::Path,
    process::{Command, Stdio},
    sync::{Mutex, MutexGuard, PoisonError},
    time::{Duration, Instant},
};

use volcomp_can::{
    BridgeConfig, CanController, CanPort, CanSocket, Frame, Received, SHIPPED_DBC, SignalTable,
    canopen::{CanopenThermometer, Channel, Number, SdoClient},
};
use volcomp_port::{Controller, Fault, Quality, Reason, Thermometer};
use volcomp_test_support::{Running, peers};
use volcomp_vocabulary::{AxisName, PerChannel};

/// Locks the virtual buses for one test. If they are missing, prints a line on standard error and returns `None`.
fn buses() -> Option<MutexGuard<'static, ()>> {
    static BUSES: Mutex<()> = Mutex::new(());
    let buses = BUSES.lock().unwrap_or_else(PoisonError::into_inner);
    if ["vcan0", "vcan1"].iter().all(|name| Path::new("/sys/class/net").join(name).exists()) {
        return Some(buses);
    }
    // Written directly, because the test harness captures the output of `eprintln!`.
    let _ = std::io::stderr().write_all(
        b"not run: this machine has no vcan0 and vcan1. Add them: ip link add dev vcan0 type vcan; ip link set vcan0 mtu 72 up\n",
    );
    None
}

fn soon() -> Instant {
    Instant::now() + Duration::from_secs(2)
}

fn run(program: &str, arguments: &[&str]) {
    let status = Command::new(program).args(arguments).status().unwrap();
    assert!(status.success(), "{program} {arguments:?}");
}

fn next_frame(socket: &mut CanSocket) -> Frame {
    match socket.receive(soon()) {
        Ok(Some(Received::Frame(frame, _))) => frame,
        other => panic!("{other:?}"),
    }
}

#[test]
fn frames_of_cansend_are_received() {
    let Some(_buses) = buses() else {
        return;
    };
    let mut socket = CanSocket::open("vcan0").unwrap();
    assert_eq!(socket.receive(Instant::now()), Ok(None));
    for (text, id, extended, fd, data) in [
        ("123#DEADBEEF", 0x123, false, false, &[0xde, 0xad, 0xbe, 0xef][..]),
        ("12345678#0102030405060708", 0x1234_5678, true, false, &[1, 2, 3, 4, 5, 6, 7, 8]),
        ("7FF#", 0x7ff, false, false, &[]),
        (
            "456##1000102030405060708090A0B",
            0x456,
            false,
            true,
            &[0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11],
        ),
    ] {
        run("cansend", &["vcan0", text]);
        let frame = next_frame(&mut socket);
        assert_eq!((frame.id, frame.extended, frame.fd, frame.data()), (id, extended, fd, data));
    }
    // A remote frame is ignored; error frames and bus-off are reported.
    run("cansend", &["vcan0", "123#R"]);
    run("cansend", &["vcan0", "20000004#0000000000000000"]);
    assert_eq!(socket.receive(soon()), Ok(Some(Received::Error)));
    run("cansend", &["vcan0", "20000040#0000000000000000"]);
    assert_eq!(socket.receive(soon()), Ok(Some(Received::BusOff)));
}

#[test]
fn candump_receives_sent_frames() {
    let Some(_buses) = buses() else {
        return;
    };
    let mut dump = Running::start(
        Command::new("candump").args(["-L", "-n", "2", "vcan0"]).stdout(Stdio::piped()),
    );
    // Wait until candump has opened its socket.
    while !std::fs::read_to_string("/proc/net/can/rcvlist_all")
        .is_ok_and(|list| list.contains("raw"))
    {
        std::thread::sleep(Duration::from_millis(10));
    }
    let mut socket = CanSocket::open("vcan0").unwrap();
    let classic = Frame::new(0x110, false, false, &[1, 2, 0xff]).unwrap();
    let fd = Frame::new(0x1000_0111, true, true, &[7; 16]).unwrap();
    socket.send(&classic, soon()).unwrap();
    socket.send(&fd, soon()).unwrap();
    let lines: Vec<String> =
        BufReader::new(dump.stdout.take().unwrap()).lines().map(Result::unwrap).collect();
    assert!(lines[0].ends_with("vcan0 110#0102FF"), "{lines:?}");
    assert!(lines[1].contains("10000111##") && lines[1].ends_with(&"07".repeat(16)), "{lines:?}");
}

/// The bridge corrects a control within 1 µm, before and after the interface goes down and up, with the same sockets.
#[test]
fn the_bridge_survives_an_interface_going_down() {
    let Some(_buses) = buses() else {
        return;
    };
    let table = SignalTable::parse(SHIPPED_DBC).unwrap();
    let mut control = CanSocket::open("vcan0").unwrap();
    let mut controller = CanController::new(
        CanSocket::open("vcan0").unwrap(),
        &BridgeConfig {
            table: table.clone(),
            channel: "bridge".to_owned(),
            axes: vec![AxisName::X],
            reads: Vec::new(),
            includes_correction: false,
        },
    )
    .unwrap();
    let mut counter = 0;
    let mut sends = |control: &mut CanSocket, x: f64| {
        counter += 1;
        for (name, signal, value) in [("POSITION_XY", "X_POS", x), ("STATE", "REFERENCED", 1.0)] {
            let message = table.messages.iter().find(|m| m.name == name).unwrap();
            let mut frame = message.frame().unwrap();
            let signal = message.signals.iter().find(|s| s.name == signal).unwrap();
            signal.put(frame.data_mut(), value);
            message.seal(frame.data_mut(), counter % 16);
            control.send(&frame, soon()).unwrap();
        }
    };
    for step in 0..200 {
        let x = 5.0 * f64::from(step);
        sends(&mut control, x);
        let mut found = controller.read(soon()).unwrap();
        while (found.positions[0] - x).abs() > 1e-9 {
            found = controller.read(soon()).unwrap();
        }
        assert!(found.state.referenced);
        controller.apply(&PerChannel([1e-5 * x; 9]), soon()).unwrap();
        let sent = loop {
            let frame = next_frame(&mut control);
            if frame.id == 0x110 {
                break frame;
            }
        };
        let message = &table.messages[table.message_of(&sent).unwrap()];
        assert!(message.is_whole(sent.data()));
        let um = message.signals[0].value(sent.data());
        assert!((um - (1e-2 * x).round()).abs() <= 1.0, "{um} at {x}");
    }
    assert_eq!(controller.health(), volcomp_can::Health::default());
    let down = Instant::now();
    run("ip", &["link", "set", "vcan0", "down"]);
    assert_eq!(controller.apply(&PerChannel::ZERO, soon()), Err(Fault::Disconnected));
    std::thread::sleep(Duration::from_millis(600));
    let late = Instant::now() + Duration::from_millis(20);
    // While the interface is down, the last values are returned with their arrival times.
    let found = controller.read(late).unwrap();
    assert!(found.youngest() <= down);
    let up = Instant::now();
    run("ip", &["link", "set", "vcan0", "up"]);
    // When the interface is up again, the same sockets work.
    while control.receive(Instant::now()).is_err() {}
    sends(&mut control, 7.0);
    let end = Instant::now() + Duration::from_secs(2);
    let found = loop {
        match controller.read(soon()) {
            Ok(found) if found.taken > up => break found,
            other => assert!(Instant::now() < end, "{other:?}"),
        }
    };
    assert!((found.positions[0] - 7.0).abs() < 1e-9);
    controller.apply(&PerChannel([0.001; 9]), soon()).unwrap();
}

/// A frame keeps its kernel arrival time while it waits in the queue of the socket. Positions read late have that
/// earlier time.
#[test]
fn queued_frames_keep_their_kernel_timestamps() {
    let Some(_buses) = buses() else {
        return;
    };
    let mut control = CanSocket::open("vcan0").unwrap();
    let mut socket = CanSocket::open("vcan0").unwrap();
    let ms = Duration::from_millis;
    assert_eq!(socket.receive(Instant::now()), Ok(None));
    std::thread::sleep(ms(100));
    let frame = Frame::new(0x123, false, false, &[1]).unwrap();
    let before = Instant::now();
    control.send(&frame, soon()).unwrap();
    let after = Instant::now();
    std::thread::sleep(ms(150));
    let Ok(Some(Received::Frame(_, taken))) = socket.receive(soon()) else {
        panic!("a frame waits")
    };
    let slack = ms(20);
    assert!(
        before <= taken + slack && taken <= after + slack,
        "{:?} after it was sent",
        taken.saturating_duration_since(before)
    );
    let table = SignalTable::parse(SHIPPED_DBC).unwrap();
    let config = BridgeConfig {
        table: table.clone(),
        channel: "bridge".to_owned(),
        axes: vec![AxisName::X],
        reads: Vec::new(),
        includes_correction: false,
    };
    let mut bridge = CanController::new(socket, &config).unwrap();
    let message = table.messages.iter().find(|m| m.name == "POSITION_XY");
    let mut send = |counter: u64| {
        let mut frame = message.unwrap().frame().unwrap();
        message.unwrap().seal(frame.data_mut(), counter);
        control.send(&frame, soon()).unwrap();
    };
    for counter in 0..5 {
        send(counter);
    }
    let sent = Instant::now();
    std::thread::sleep(ms(200));
    let snapshot = bridge.read(soon()).unwrap();
    assert!(snapshot.taken <= sent, "as old as the frames");
    send(5);
    while bridge.read(soon()).unwrap().taken <= sent {}
    assert!(snapshot.state.emergency_stop, "no state received, so it counts as pressed");
}

/// The kernel sorts out the frames of other devices: more of them than the queue of a socket holds do not cost a frame
/// that is used.
#[test]
fn frames_of_other_devices_take_no_place() {
    let Some(_buses) = buses() else {
        return;
    };
    let mut others = CanSocket::open("vcan0").unwrap();
    let mut socket = CanSocket::open("vcan0").unwrap();
    socket.accept_only(&[(0x123, false), (0x124, true)]);
    let frame = |id, extended| Frame::new(id, extended, false, &[1]).unwrap();
    let flood = |others: &mut CanSocket| {
        for _ in 0..2000 {
            for (id, extended) in [(0x122, false), (0x123, true), (0x124, false), (0x1123, true)] {
                others.send(&frame(id, extended), soon()).unwrap();
            }
        }
    };
    flood(&mut others);
    for used in [frame(0x123, false), frame(0x124, true)] {
        others.send(&used, soon()).unwrap();
    }
    flood(&mut others);
    assert_eq!(next_frame(&mut socket), frame(0x123, false));
    assert_eq!(next_frame(&mut socket), frame(0x124, true));
    assert_eq!(socket.receive(Instant::now()), Ok(None));
    run("cansend", &["vcan0", "20000004#0000000000000000"]);
    assert_eq!(socket.receive(soon()), Ok(Some(Received::Error)));
}

#[test]
fn a_missing_interface_is_named() {
    let Some(_buses) = buses() else {
        return;
    };
    let message = CanSocket::open("can77").unwrap_err().to_string();
    assert!(message.starts_with("can://can77: the interface cannot be opened"), "{message}");
    assert!(message.contains("ip link set can0 up"), "{message}");
}

/// A node of PyPI's canopen is started, its objects are read and written, its temperatures are received, and its loss
/// is reported.
#[test]
fn a_canopen_node_is_started_and_read() {
    let Some(_buses) = buses() else {
        return;
    };
    let Some(python) = peers::python() else {
        return;
    };
    let program = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/peers/canopen_node.py");
    let node = Running::start_ready(Command::new(python).arg(program));
    let mut client = SdoClient::new(CanSocket::open("vcan1").unwrap());
    assert_eq!(client.read(5, (0x6132, 1), soon()), Ok(1));
    assert_eq!(client.write(5, (0x1017, 0), &40_u16.to_le_bytes(), soon()), Ok(()));
    assert_eq!(client.read(5, (0x1017, 0), soon()), Ok(40));
    assert!(matches!(client.read(5, (0x2000, 0), soon()), Err(Fault::Refused { .. })));
    let channel = |name: &str, at| Channel {
        name: name.to_owned(),
        node: 5,
        pdo: 1,
        at,
        number: Number::I16 { decimals: 1 },
        status_at: Some(4),
    };
    let mut thermometer = CanopenThermometer::new(
        client.into_port(),
        vec![channel("bed", 0), channel("column", 2)],
        Duration::from_millis(500),
    )
    .unwrap();
    let end = soon() + Duration::from_secs(5);
    while thermometer.latest().iter().any(|t| t.quality != Quality::Good) {
        assert!(Instant::now() < end, "{:?}", thermometer.latest());
        std::thread::sleep(Duration::from_millis(5));
    }
    let degc: Vec<Option<f64>> = thermometer.latest().iter().map(|t| t.degc).collect();
    assert_eq!(degc, [Some(21.5), Some(-3.2)]);
    drop(node);
    let end = soon();
    while thermometer.latest()[0].quality != Quality::Bad(Reason::NoAnswer) {
        assert!(Instant::now() < end, "{:?}", thermometer.latest());
        std::thread::sleep(Duration::from_millis(5));
    }
}
