//! Tests single requests of the client, and the simulator with an independent client (pyfocas).

use std::{process::Command, time::Duration};

use volcomp_focas::{
    Client, FocasError, PmcArea, PositionKind, ReturnCode,
    simulator::{Options, Simulator},
};
use volcomp_port::Fault;

use crate::{TIMEOUT, simulator, until};

fn client(simulator: &Simulator) -> Client {
    Client::open("127.0.0.1", simulator.address().port(), TIMEOUT).unwrap()
}

/// Controls of every generation answer every request; unused slots contain garbage, and responses arrive in pieces.
#[test]
fn every_request_is_answered_by_every_generation() {
    for (version, slots, fragment) in [(2, 8, 0), (3, 32, 7), (4, 32, 0), (3, 32, 1)] {
        let simulator = simulator(Options { version, slots, fragment, ..Options::default() });
        {
            let mut world = simulator.world();
            world.motion = std::sync::Arc::new(|_| vec![-598.358, 0.001, 1234.5, 90.0]);
            world.alarms = vec![(10, "SERVO OFF".to_owned())];
            world.parameters.insert((1280, 0), 100.0);
            world.parameters.insert((1281, 2), -7.0);
        }
        let mut client = client(&simulator);
        assert_eq!(client.version(), version);
        let system = client.system_info().unwrap();
        assert_eq!(usize::from(system.max_axes), slots);
        assert_eq!((&*system.series, &*system.axes), ("D4G3", "04"));
        assert_eq!(client.axis_names().unwrap(), ['X', 'Y', 'Z', 'C']);
        let positions = client.positions(PositionKind::Machine, 4).unwrap();
        assert_eq!(positions, [-598.358, 0.001, 1234.5, 90.0]);
        let status = client.status().unwrap();
        assert!(status.alarm != 0 && status.emergency == 0 && status.run == 3);
        let alarms = client.alarms().unwrap();
        assert_eq!((alarms[0].number, &*alarms[0].text), (10, "SERVO OFF"));
        assert_eq!(client.read_parameter(1280, None).unwrap(), 100.0);
        assert_eq!(client.read_parameter(1281, Some(2)).unwrap(), -7.0);
        client.write_pmc(PmcArea::D, 200, &[1, 2, 0xff]).unwrap();
        assert_eq!(client.read_pmc(PmcArea::D, 199, 5).unwrap(), [0, 1, 2, 0xff, 0]);
        client.write_macro(500, -2.25).unwrap();
        assert_eq!(client.read_macro(500).unwrap(), Some(-2.25));
        assert_eq!(client.read_macro(501).unwrap(), None);
        client.write_work_offset(1, 2, -0.012).unwrap();
        assert_eq!(client.read_work_offset(1, 2).unwrap(), -0.012);
    }
}

#[test]
fn rejections_name_their_code_and_keep_the_session_open() {
    let simulator = simulator(Options::default());
    let mut client = client(&simulator);
    let refused = client.read_parameter(9999, None).unwrap_err();
    assert_eq!(
        refused.to_string(),
        "reading a parameter was refused with code -17: EW_PROTOCOL, the request is not what the protocol allows here"
    );
    let refused = client.write_pmc(PmcArea::Y, 0, &[1]).unwrap_err();
    let FocasError::Refused { code, .. } = refused else {
        panic!("{refused}");
    };
    assert_eq!((code, code.name()), (ReturnCode(3), Some("EW_NUMBER")));
    assert!(client.status().is_ok());
    let garbage = client.positions(PositionKind::Machine, 33).unwrap_err();
    assert!(
        garbage.to_string().contains("a position that is not a number"),
        "slots after the axes contain garbage: {garbage}"
    );
}

/// The 31 names and numbers of the manufacturer's library are known, each once.
#[test]
fn return_codes_have_names() {
    let mut names: Vec<&str> = (-20..=20).filter_map(|c| ReturnCode(c).name()).collect();
    assert_eq!(names.len(), 31);
    names.sort_unstable();
    names.dedup();
    assert_eq!(names.len(), 31);
    assert_eq!(ReturnCode(6).name(), Some("EW_NOOPT"));
    assert_eq!(ReturnCode(99).name(), None);
    assert_eq!(ReturnCode(99).to_string(), "code 99: unknown code");
}

#[test]
fn sessions_are_limited_and_freed() {
    let simulator = simulator(Options { sessions: 2, ..Options::default() });
    let first = client(&simulator);
    let _second = client(&simulator);
    let port = simulator.address().port();
    let refused = Client::open("127.0.0.1", port, TIMEOUT).unwrap_err();
    assert_eq!(
        refused.of("focas://host").to_string(),
        "focas://host: the session was refused; end another program that talks to this control; it supports few sessions"
    );
    drop(first);
    until("the session is free again", || simulator.open_sessions() == 1);
    assert!(Client::open("127.0.0.1", port, TIMEOUT).is_ok());
}

#[test]
fn connection_errors_name_their_cause() {
    let error = Client::open("127.0.0.1", 1, Duration::from_millis(200)).unwrap_err();
    assert!(error.to_string().starts_with("no connection to 127.0.0.1:1: "), "{error}");
    let error = Client::open("no.such.host.invalid", 1, TIMEOUT).unwrap_err();
    assert!(error.to_string().contains("cannot be resolved"), "{error}");
    let silent = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let port = silent.local_addr().unwrap().port();
    let error = Client::open("127.0.0.1", port, Duration::from_millis(100)).unwrap_err();
    assert!(error.to_string().contains("no answer before the deadline"), "{error}");
}

#[test]
fn truncated_responses_are_faults() {
    use std::io::{Read, Write};
    use volcomp_focas::frame::{self, Kind, Target, frame, push_block};
    let command =
        frame::Command { target: Target::Cnc, path: 1, function: 0x19, args: [0; 5], data: &[] };
    let mut payload = vec![0, 1];
    push_block(&mut payload, &command, 0, &[0; 14]).unwrap();
    let answer = frame(3, Kind::Answer, &payload).unwrap();
    let opened = frame(3, Kind::Opened, &[0; 360]).unwrap();
    let listener = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let port = listener.local_addr().unwrap().port();
    let whole = answer.len();
    let peer = std::thread::spawn(move || {
        for cut in 0..=answer.len() {
            let (mut stream, _) = listener.accept().unwrap();
            stream.read_exact(&mut [0; 12]).unwrap();
            stream.write_all(&opened).unwrap();
            stream.read_exact(&mut [0; 40]).unwrap();
            stream.write_all(&answer[..cut]).unwrap();
            stream.shutdown(std::net::Shutdown::Write).unwrap();
            let _ = stream.read(&mut [0; 64]);
        }
    });
    for cut in 0..=whole {
        let mut client = Client::open("127.0.0.1", port, TIMEOUT).unwrap();
        let found = client.status();
        if cut == whole {
            assert!(found.is_ok());
        } else {
            let fault = |found: Result<_, FocasError>| match found {
                Err(FocasError::Failed { source, .. }) => Some(source),
                _ => None,
            };
            assert_eq!(fault(found), Some(Fault::Disconnected), "{cut}");
            assert_eq!(fault(client.status()), Some(Fault::NotConnected));
        }
    }
    peer.join().unwrap();
}

#[cfg(feature = "serde")]
#[test]
fn json_round_trip() {
    use volcomp_focas::{FocasConfig, PmcAddress, Shift};
    use volcomp_vocabulary::AxisName;
    let shift = FocasConfig::new("host", &[AxisName::X]).shift;
    let text = serde_json::to_string(&shift).unwrap();
    assert_eq!(
        text,
        r#"{"first":{"area":"R","at":100},"width":"Word","count_linear":0.001,"count_rotary":0.000017453292519943296}"#
    );
    assert_eq!(serde_json::from_str::<Shift>(&text).unwrap(), shift);
    let address: PmcAddress = serde_json::from_str(r#"{"area":"D","at":7}"#).unwrap();
    assert_eq!(address.to_string(), "D7");
    let options = Options::default();
    let text = serde_json::to_string(&options).unwrap();
    assert_eq!(serde_json::from_str::<Options>(&text).unwrap(), options);
}

#[test]
fn pyfocas_understands_the_simulator() {
    let Some(python) = volcomp_test_support::peers::python() else {
        return;
    };
    for version in [2, 3, 4] {
        let simulator = simulator(Options { version, ..Options::default() });
        simulator.world().macros.insert(100, -12.5);
        let program = "import sys\n\
            from pyfocas.protocol.protocol import FOCAS\n\
            f = FOCAS('127.0.0.1', int(sys.argv[1]))\n\
            assert f.connect()\n\
            info = f.get_sys_info()\n\
            assert (info.series, info.version, info.axes) == ('D4G3', '28.0', '04'), info\n\
            status = f.get_status_info()\n\
            assert (status.run, status.emergency, status.alarm) == (3, 0, 0), status\n\
            f.write_macro_double(500, 1.5)\n\
            assert f.read_macro(500) == {500: 1.5}\n\
            assert f.read_macro(100) == {100: -12.5}\n";
        let output = Command::new(&python)
            .args(["-c", program, &simulator.address().port().to_string()])
            .output()
            .unwrap();
        assert!(output.status.success(), "{output:?}");
        assert_eq!(simulator.world().macros[&500], 1.5);
    }
}
