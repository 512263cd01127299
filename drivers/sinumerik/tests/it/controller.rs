//! Tests of the controller and the thermometer with a simulated control, with and without faults.

use std::time::{Duration, Instant};

use volcomp_port::{Backoff, Controller, Fault, Quality, Snapshot, Thermometer};
use volcomp_sinumerik::{
    Nodes, Sensor, Server, Sign, SinumerikConfig, SinumerikController, SinumerikError, User,
    inspect, list_axes, poll_temperatures,
};
use volcomp_test_support::until;
use volcomp_vocabulary::{AxisName, PerChannel};

use crate::{Peer, TIMEOUT};

const XYZ: [AxisName; 3] = [AxisName::X, AxisName::Y, AxisName::Z];

fn config(url: &str) -> SinumerikConfig {
    let mut server = Server::new(url);
    // A long timeout, because the computer may be busy.
    server.time_out = Duration::from_secs(5);
    server.backoff = Backoff { first: Duration::from_millis(50), most: Duration::from_millis(200) };
    let mut config = SinumerikConfig::new(server, &XYZ);
    config.nodes.emergency_stop = Some("/Plc/DB10.DBX106.1".to_owned());
    config.nodes.alarm = Some("/Plc/DB10.DBX109.0".to_owned());
    config.nodes.referenced = Some("/Plc/DB{db}.DBX60.4".to_owned());
    config
}

fn open(config: SinumerikConfig) -> SinumerikController {
    let mut controller = SinumerikController::new(config).unwrap();
    controller.wait(TIMEOUT).unwrap();
    controller
}

fn soon() -> Instant {
    Instant::now() + TIMEOUT
}

fn read(controller: &mut SinumerikController) -> Snapshot {
    controller.read(soon()).expect("a connected control")
}

/// Waits for a snapshot whose reading began after this call.
fn next(controller: &mut SinumerikController) -> Snapshot {
    let now = Instant::now();
    until("a new reading", TIMEOUT, || {
        controller.read(soon()).is_ok_and(|s| s.correction_taken > now + s.uncertainty)
    });
    read(controller)
}

#[test]
fn positions_states_and_corrections() {
    let Some(mut peer) = Peer::start(&["--at", "X=100.5,Y=-20", "--md32000", "12000"]) else {
        return;
    };
    let mut controller = open(config(&peer.url));
    let found = controller.inspection().expect("a session");
    assert_eq!(found.notes, [""; 0]);
    assert_eq!(found.axes[1].name.as_deref(), Some("Y"));
    assert_eq!(found.axes[1].fastest_per_min, Some(120.0));

    let snapshot = read(&mut controller);
    assert_eq!(snapshot.positions, PerChannel::leading([100.5, -20.0, 0.0]));
    assert!(snapshot.state.referenced && !snapshot.state.alarm && !snapshot.state.emergency_stop);
    assert_eq!(snapshot.applied, Some(PerChannel::ZERO));

    // The settings are rounded to 0.1 µm and have the sign of the control.
    let expected = PerChannel::leading([-0.03004, 0.00005, 0.007]);
    controller.apply(&expected, soon()).unwrap();
    until("the correction is read back", TIMEOUT, || {
        let applied = read(&mut controller).applied.unwrap();
        (applied[0] + 0.03).abs() < 1e-9 && (applied[2] - 0.007).abs() < 1e-9
    });
    until("the axis has the correction", TIMEOUT, || peer.number("correction_um", "X") == -30.0);
    assert_eq!(read(&mut controller).positions[0], 100.5);

    // A setting that already has its value is not written again.
    let [written, missed] = controller.writes();
    controller.apply(&expected, soon()).unwrap();
    next(&mut controller);
    next(&mut controller);
    assert_eq!(controller.writes(), [written, missed]);
    // A setting that another client changed is written again.
    peer.type_in("set X=0");
    until("the change is seen", TIMEOUT, || read(&mut controller).applied.unwrap()[0] == 0.0);
    controller.apply(&expected, soon()).unwrap();
    until("it is written again", TIMEOUT, || peer.number("setting_um", "X") == -30.0);
    // A write after its deadline is not sent.
    let [written, _] = controller.writes();
    controller.apply(&PerChannel::ZERO, Instant::now()).unwrap();
    until("the write is dropped", TIMEOUT, || controller.writes() == [written, 1]);
    assert_eq!(peer.number("setting_um", "X"), -30.0);

    for (command, check) in [
        ("alarm on", (|s: &Snapshot| s.state.alarm) as fn(&Snapshot) -> bool),
        ("estop on", |s| s.state.emergency_stop),
        ("unreferenced on", |s| !s.state.referenced),
    ] {
        peer.type_in(command);
        until(command, TIMEOUT, || check(&read(&mut controller)));
    }
}

#[test]
fn the_configured_sign_applies_and_rotary_axes_are_in_degrees() {
    let Some(mut peer) = Peer::start(&["--axes", "X,C", "--at", "X=1,C=90", "--sign", "-1"]) else {
        return;
    };
    let mut config = config(&peer.url);
    config.axes = vec![AxisName::X, AxisName::C];
    config.sign = Sign::Subtracts;
    let mut controller = open(config);
    let step = controller.description().axes[1].step();
    assert!((read(&mut controller).positions[1] - std::f64::consts::FRAC_PI_2).abs() < 1e-12);
    let expected = PerChannel::leading([0.01, 4.0 * step]);
    controller.apply(&expected, soon()).unwrap();
    until("the correction is read back", TIMEOUT, || {
        let applied = read(&mut controller).applied.unwrap();
        (applied[0] - 0.01).abs() < 1e-9 && (applied[1] - 4.0 * step).abs() < 1e-12
    });
    // The setting is negative, and the axis moves in the direction of the correction.
    assert_eq!(peer.number("setting_um", "X"), -10.0);
    until("the axis has the correction", TIMEOUT, || peer.number("correction_um", "X") == 10.0);
    assert!((peer.number("true_deg", "C") - 90.0004).abs() < 1e-6);
}

#[test]
fn a_control_that_ignores_corrections_is_rejected() {
    let Some(mut peer) = Peer::start(&["--md32750", "2"]) else {
        return;
    };
    let error = inspect(&config(&peer.url)).unwrap_err();
    assert_eq!(error, SinumerikError::SwitchedOff { axis: AxisName::X, found: 2 });
    let mut controller = SinumerikController::new(config(&peer.url)).unwrap();
    let mut text = String::new();
    until("the error is reported", TIMEOUT, || {
        text = controller.last_error().map(|error| error.to_string()).unwrap_or_default();
        !text.is_empty()
    });
    assert!(
        text.contains("axis X: MD32750 $MA_TEMP_COMP_TYPE is 2; expected bit 0 set (1 or 3): the control ignores SD43900"),
        "{text}"
    );
    assert_eq!(controller.apply(&PerChannel::leading([0.01]), soon()), Err(Fault::NotConnected));
    // The axis is accepted once its compensation is switched on, and rejected if the compensation is switched off in
    // operation.
    peer.type_in("md32750 3");
    until("it connects", TIMEOUT, || controller.read(soon()).is_ok());
    peer.type_in("md32750 0");
    until("the fault is detected", TIMEOUT, || controller.read(soon()) == Err(Fault::NotConnected));
    assert!(peer.report().contains("\"written\": 0"));
}

#[test]
fn wrong_axes_namespaces_and_users_are_rejected() {
    let Some(peer) = Peer::start(&["--axes", "X,Z,Y", "--user", "gateway:key"]) else {
        return;
    };
    let mut wrong = config(&peer.url);
    assert!(matches!(inspect(&wrong), Err(SinumerikError::Connect(_))), "anonymous");
    let user = |password: &str| {
        let (name, password) = ("gateway".to_owned(), password.to_owned());
        Some(User { name, password })
    };
    wrong.server.user = user("lock");
    assert!(matches!(inspect(&wrong), Err(SinumerikError::Connect(_))), "another password");
    wrong.server.user = user("key");
    assert_eq!(
        format!("{:?}", wrong.server.user.as_ref().unwrap()),
        "User { name: \"gateway\", .. }"
    );
    let error = inspect(&wrong).unwrap_err();
    assert_eq!(
        error,
        SinumerikError::OtherAxis { axis: AxisName::Y, number: 2, found: "Z".to_owned() }
    );
    let mut right = wrong.clone();
    right.numbers = vec![1, 3, 2];
    assert_eq!(inspect(&right).unwrap().axes[1].number, 3);
    let mut nowhere = right.clone();
    nowhere.nodes.position = "/Channel/Other/actToolBasePos[u1,{axis}]".to_owned();
    let error = inspect(&nowhere).unwrap_err().to_string();
    assert!(error.contains("/Channel/Other/actToolBasePos[u1,1]: BadNodeIdUnknown"), "{error}");
    right.server.namespace = "urn:elsewhere".to_owned();
    let error = inspect(&right).unwrap_err().to_string();
    assert!(error.contains("SinumerikVarProvider, expected urn:elsewhere among them"), "{error}");
}

#[test]
fn positions_age_while_the_sampler_stalls() {
    let Some(mut peer) = Peer::start(&["--stroke-mm", "100", "--period-s", "2"]) else {
        return;
    };
    let mut controller = open(config(&peer.url));
    let age = |snapshot: &Snapshot| snapshot.correction_taken.duration_since(snapshot.taken);
    until("fresh", TIMEOUT, || age(&read(&mut controller)) < Duration::from_secs(1));
    for fault in ["stall", "frozen-timestamps"] {
        peer.type_in(&format!("{fault} on"));
        until(fault, TIMEOUT, || age(&read(&mut controller)) > Duration::from_secs(1));
        // The time of the applied correction is that of the exchange.
        assert!(next(&mut controller).applied.is_some());
        peer.type_in(&format!("{fault} off"));
        until("fresh again", TIMEOUT, || age(&read(&mut controller)) < Duration::from_secs(1));
    }
    // Without timestamps, the time of the values is that of the exchange.
    peer.type_in("no-timestamps on");
    let snapshot = next(&mut controller);
    next(&mut controller);
    assert!(age(&snapshot) <= snapshot.uncertainty + Duration::from_secs(1));
    // False timestamps can be detected only while axes move, so they are not detected here.
    peer.type_in("stick on");
    let [first, second] = [next(&mut controller), next(&mut controller)];
    assert_eq!(age(&second), Duration::ZERO);
    let _ = first;
}

#[test]
fn source_timestamps_can_be_ignored() {
    let Some(mut peer) = Peer::start(&[]) else {
        return;
    };
    let mut config = config(&peer.url);
    config.server.source_timestamps = false;
    let mut controller = open(config);
    peer.type_in("stall on");
    std::thread::sleep(Duration::from_millis(1100));
    let snapshot = next(&mut controller);
    assert_eq!(snapshot.taken, snapshot.correction_taken);
}

#[test]
fn dropped_rejected_and_falsified_writes() {
    let Some(mut peer) = Peer::start(&["--drop-writes"]) else {
        return;
    };
    let mut controller = open(config(&peer.url));
    let expected = PerChannel::leading([0.005]);
    controller.apply(&expected, soon()).unwrap();
    until("the write is answered", TIMEOUT, || controller.writes()[0] == 1);
    assert_eq!(next(&mut controller).applied, Some(PerChannel::ZERO));
    // The correction is written again until the control has applied it.
    controller.apply(&expected, soon()).unwrap();
    until("the write is answered again", TIMEOUT, || controller.writes()[0] == 2);

    peer.type_in("drop-writes off");
    peer.type_in("refuse-writes on");
    until("the write is rejected", TIMEOUT, || {
        matches!(controller.apply(&expected, soon()), Err(Fault::Refused { .. }))
    });
    peer.type_in("refuse-writes off");
    until("the correction is applied", TIMEOUT, || {
        let _ = controller.apply(&expected, soon());
        read(&mut controller).applied.unwrap()[0] == 0.005
    });
    until("writes are accepted again", TIMEOUT, || controller.apply(&expected, soon()).is_ok());
    peer.type_in("read-back X=12");
    until("the falsified value is reported", TIMEOUT, || {
        read(&mut controller).applied.unwrap()[0] == 0.012
    });
}

#[test]
fn silence_resets_the_session_without_blocking() {
    let Some(mut peer) = Peer::start(&[]) else {
        return;
    };
    let mut config = config(&peer.url);
    config.server.time_out = Duration::from_millis(700);
    let mut controller = open(config);
    let before = controller.sessions();
    peer.type_in("pause 2");
    controller
        .apply(&PerChannel::leading([0.02]), Instant::now() + Duration::from_secs(1))
        .unwrap();
    until("the session is closed", TIMEOUT, || {
        assert_no_alloc::assert_no_alloc(|| controller.read(soon())) == Err(Fault::NotConnected)
    });
    until("a new session is open", TIMEOUT, || controller.read(soon()).is_ok());
    assert!(controller.sessions() > before);
    // A write requested in the previous session is not sent in the new session.
    let [written, missed] = controller.writes();
    next(&mut controller);
    next(&mut controller);
    assert_eq!(controller.writes(), [written, missed]);

    peer.type_in("disconnect");
    until("the fault is detected", TIMEOUT, || controller.read(soon()).is_err());
    until("a new session is open", TIMEOUT, || controller.read(soon()).is_ok());
    assert_no_alloc::assert_no_alloc(|| {
        controller.apply(&PerChannel::leading([0.001]), soon()).unwrap();
    });
    until("the correction is applied", TIMEOUT, || {
        read(&mut controller).applied.unwrap()[0] == 0.001
    });
}

#[test]
fn an_unreachable_server_is_reported() {
    let port = volcomp_test_support::free_port();
    let url = format!("opc.tcp://127.0.0.1:{port}");
    assert!(matches!(inspect(&config(&url)), Err(SinumerikError::Connect(_))));
    let mut controller = SinumerikController::new(config(&url)).unwrap();
    assert_eq!(controller.read(soon()), Err(Fault::NotConnected));
    let error = controller.wait(Duration::from_millis(500)).unwrap_err();
    assert!(!error.is_input(), "{error}");
}

#[test]
fn axes_of_an_unknown_control_are_listed() {
    let Some(peer) = Peer::start(&["--axes", "X,C", "--at", "X=3.5,C=90"]) else {
        return;
    };
    let found = list_axes(&config(&peer.url).server, &Nodes::default()).unwrap();
    assert_eq!(found, [("X".to_owned(), 3.5), ("C".to_owned(), 90.0)]);
}

#[test]
fn temperatures_keep_their_age() {
    let sensors = ["bed=20.5", "column=30"].map(|sensor| format!("--temperature={sensor}"));
    let Some(mut peer) = Peer::start(&[&sensors[0], &sensors[1]]) else {
        return;
    };
    let sensor = |name: &str, node: &str| Sensor { name: name.to_owned(), node: node.to_owned() };
    let mut server = Server::new(&*peer.url);
    server.time_out = Duration::from_secs(5);
    server.backoff = Backoff { first: Duration::from_millis(50), most: Duration::from_millis(200) };
    let sensors = [
        sensor("column", "/Plc/DB5.DBD4:REAL"),
        sensor("bed", "/Plc/DB5.DBD0:REAL"),
        sensor("nothing", "/Plc/DB6.DBD0:REAL"),
    ];
    let mut thermometer = poll_temperatures(server, &sensors).unwrap();
    until("both are good", TIMEOUT, || thermometer.latest()[1].quality == Quality::Good);
    let [column, bed, nothing] = thermometer.latest() else { panic!("three") };
    assert_eq!([column.degc, bed.degc, nothing.degc], [Some(30.0), Some(20.5), None]);
    peer.type_in("temperature bed=24");
    until("the new value is read", TIMEOUT, || thermometer.latest()[1].degc == Some(24.0));
    peer.type_in("stall on");
    until("it ages", TIMEOUT, || {
        thermometer.latest()[1].taken.is_some_and(|taken| taken.elapsed() > Duration::from_secs(4))
    });
    drop(peer);
    until("it is bad", TIMEOUT, || matches!(thermometer.latest()[1].quality, Quality::Bad(_)));
}
