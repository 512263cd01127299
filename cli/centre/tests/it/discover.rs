//! The network search with a simulated control, a Modbus server, a gateway, and services that hang or send garbage.

use std::{
    io::{Read, Write},
    net::{SocketAddr, TcpListener},
    sync::{
        Arc, Mutex,
        atomic::{AtomicBool, Ordering},
        mpsc,
    },
    thread,
    time::{Duration, Instant},
};

use proptest::prelude::*;
use volcomp_centre::discover::{
    Device, Kind, Search, Subnet, SubnetError, parse_identification, proposals, table,
};
use volcomp_focas::simulator::{Options, Simulator, World};

/// A server that passes each connection to a function; stopped on drop.
struct Peer {
    address: SocketAddr,
    ends: Arc<AtomicBool>,
}

impl Peer {
    fn start(serve: impl Fn(std::net::TcpStream) + Send + Sync + 'static) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").expect("a port");
        let address = listener.local_addr().expect("bound");
        let ends = Arc::new(AtomicBool::new(false));
        let (serve, ending) = (Arc::new(serve), Arc::clone(&ends));
        thread::spawn(move || {
            while let Ok((stream, _)) = listener.accept() {
                if ending.load(Ordering::Relaxed) {
                    return;
                }
                let serve = Arc::clone(&serve);
                thread::spawn(move || serve(stream));
            }
        });
        Self { address, ends }
    }

    /// A service that sends these bytes to every client.
    fn says(bytes: &'static [u8]) -> Self {
        Self::start(move |mut stream| {
            let mut some = [0; 64];
            let _ = stream.read(&mut some);
            let _ = stream.write_all(bytes);
            let _ = stream.set_read_timeout(Some(Duration::from_secs(5)));
            while matches!(stream.read(&mut some), Ok(1..)) {}
        })
    }

    fn port(&self) -> u16 {
        self.address.port()
    }
}

impl Drop for Peer {
    fn drop(&mut self) {
        self.ends.store(true, Ordering::Relaxed);
        let _ = std::net::TcpStream::connect(self.address);
    }
}

fn search(ports: &[(Kind, u16)], answer_within: Duration) -> Vec<Device> {
    let mut search = Search::new(vec!["127.0.0.1".parse().expect("an address")]);
    search.ports = ports.to_vec();
    search.per_second = 1000.0;
    search.connect_within = Duration::from_secs(20);
    search.answer_within = answer_within;
    let runtime = tokio::runtime::Builder::new_multi_thread()
        .worker_threads(1)
        .enable_all()
        .build()
        .expect("a thread");
    let mut last = 0;
    let found = runtime.block_on(search.run(|done| last = done));
    assert_eq!(last, 1);
    found
}

const LONG: Duration = Duration::from_secs(60);

#[test]
fn a_control_with_axes_yields_structure_proposals() {
    let world = World::new(&['X', 'Y', 'Z', 'A', 'C']);
    let control = Simulator::start("127.0.0.1:0", Options::default(), world).expect("a port");
    let found = search(&[(Kind::Focas, control.address().port())], LONG);
    assert_eq!(found.len(), 1);
    let device = &found[0];
    assert!(device.answers, "{device:?}");
    assert!(device.control.starts_with("FANUC"), "{device:?}");
    assert_eq!(device.axes, ['X', 'Y', 'Z', 'A', 'C']);
    // 24 structures have these axes: several are proposed, none is selected.
    assert_eq!(device.proposals.len(), 24);
    assert_eq!(device.structure, None);
    let text = table(&found);
    assert!(text.contains("FOCAS") && text.contains("or one of 23 others"), "{text}");
    let json = serde_json::to_value(&found).expect("JSON");
    assert_eq!(json[0]["kind"], "focas");
    assert!(control.world().shifts().iter().all(|shift| *shift == 0.0));
}

/// A Modbus server that answers read device identification, and records every requested function code.
fn modbus(functions: Arc<Mutex<Vec<u8>>>) -> Peer {
    Peer::start(move |mut stream| {
        let mut request = [0; 11];
        while stream.read_exact(&mut request).is_ok() {
            functions.lock().expect("ours").push(request[7]);
            let pdu: &[u8] = b"\x2b\x0e\x01\x01\x00\x00\x03\x00\x06Vendor\x01\x04PT-8\x02\x031.2";
            let mut answer = request[..4].to_vec();
            answer.extend_from_slice(&u16::try_from(pdu.len() + 1).expect("short").to_be_bytes());
            answer.push(request[6]);
            answer.extend_from_slice(pdu);
            let _ = stream.write_all(&answer);
        }
    })
}

#[test]
fn a_modbus_module_is_identified_by_reads_only() {
    let functions = Arc::default();
    let module = modbus(Arc::clone(&functions));
    let found = search(&[(Kind::Modbus, module.port())], LONG);
    assert_eq!(found[0].control, "Vendor PT-8");
    assert_eq!(found[0].note, "revision 1.2");
    assert_eq!(*functions.lock().expect("ours"), [0x2b]);
    // A module that does not support the function is still listed.
    let plain = Peer::start(|mut stream| {
        let mut request = [0; 11];
        while stream.read_exact(&mut request).is_ok() {
            let answer = [request[0], request[1], 0, 0, 0, 3, request[6], 0xab, 1];
            let _ = stream.write_all(&answer);
        }
    });
    let found = search(&[(Kind::Modbus, plain.port())], LONG);
    assert!(found[0].answers && found[0].note.contains("exception 1"), "{found:?}");
}

/// A service that hangs or sends garbage is reported as another service, in bounded time and with sanitized text.
#[test]
fn hanging_and_garbage_services_are_reported_as_other_services() {
    let silent = Peer::start(|stream| {
        let _ = stream.set_read_timeout(Some(LONG));
        let mut stream = stream;
        let mut some = [0; 64];
        while matches!(stream.read(&mut some), Ok(1..)) {}
    });
    let closes = Peer::start(drop);
    let garbage = Peer::says(&[0xa5; 5000]);
    let web = Peer::says(b"HTTP/1.1 200 OK\r\nContent-Length: 5\r\n\r\nhello");
    let terminal = Peer::says(b"\x1b[2J\x1b]0;title\x07 SSH-2.0-x\r\n");
    for peer in [&silent, &closes, &garbage, &web, &terminal] {
        // OPC UA is left out, because an open port suffices for it.
        let asked = [Kind::Gateway, Kind::Focas, Kind::Modbus];
        let ports = asked.map(|kind| (kind, peer.port()));
        let begun = Instant::now();
        let found = search(&ports, Duration::from_secs(2));
        assert!(begun.elapsed() < Duration::from_secs(60), "it ends");
        assert_eq!(found.len(), 3);
        for device in &found {
            assert!(!device.answers, "{device:?}");
            assert!(!device.note.is_empty());
            assert!(!device.note.contains(char::is_control), "{device:?}");
        }
        assert!(!table(&found).contains('\u{1b}'));
    }
}

#[test]
fn closed_ports_yield_no_devices() {
    let port = volcomp_test_support::free_port();
    assert!(search(&[(Kind::Focas, port)], LONG).is_empty());
    assert_eq!(table(&[]), "Nothing was found.\n");
}

/// An OPC UA server is found by its open port, without a query.
#[test]
fn an_open_opc_ua_port_is_not_queried() {
    let (sends, received) = mpsc::channel();
    let sends = Mutex::new(sends);
    let server = Peer::start(move |mut stream| {
        let count = stream.read(&mut [0]).unwrap_or(1);
        let _ = sends.lock().expect("no panic").send(count);
    });
    let found = search(&[(Kind::OpcUa, server.port())], LONG);
    let device = &found[0];
    assert_eq!(device.note, "its port is open; it was not queried");
    assert_eq!(received.recv_timeout(LONG), Ok(0));
    assert!(device.axes.is_empty() && device.proposals.is_empty());
}

/// A simulated gateway that serves the page and then the state: the search reports its machine, or that it needs a token.
#[test]
fn a_gateway_reports_its_machine_or_requires_a_token() {
    let answers = |state: &'static str| {
        Peer::start(move |mut stream| {
            let mut request = [0; 2048];
            let count = stream.read(&mut request).unwrap_or(0);
            let text = String::from_utf8_lossy(&request[..count]).into_owned();
            let page = "HTTP/1.1 200 OK\r\nContent-Type: text/html\r\n\r\n<!DOCTYPE html><title>volcomp gateway</title>";
            let answer = if text.starts_with("GET / ") { page } else { state };
            let _ = stream.write_all(answer.as_bytes());
        })
    };
    let open = answers(
        "HTTP/1.1 200 OK\r\n\r\n{\"state\":\"compensating\",\"simulated\":true,\"machine\":{\"name\":\"gantry\",\"structure\":\"w X' b Y Z t\",\"axes\":[\"X\",\"Y\",\"\\u001b[2J\",\"Z\"]}}",
    );
    let found = search(&[(Kind::Gateway, open.port())], LONG);
    let device = &found[0];
    assert_eq!((device.name.as_str(), device.note.as_str()), ("gantry", "compensating, simulated"));
    assert_eq!(device.structure.as_deref(), Some("w X' b Y Z t"));
    assert_eq!(device.axes, ['X', 'Y', 'Z']);
    let closed =
        answers("HTTP/1.1 401 Unauthorized\r\n\r\n{\"error\":\"a valid token is needed\"}");
    let found = search(&[(Kind::Gateway, closed.port())], LONG);
    assert!(found[0].answers && found[0].note.contains("token"), "{found:?}");
}

#[test]
fn only_stated_private_subnets_are_searched() {
    let check = |text: &str, mine: bool| {
        let subnet: Subnet = text.parse().expect("a subnet");
        subnet.check(mine)
    };
    for fine in [
        "192.168.7.0/24",
        "10.1.0.0/16",
        "172.31.255.0/24",
        "192.0.2.9",
        "127.0.0.1",
        "169.254.0.0/16",
    ] {
        assert_eq!(check(fine, false), Ok(()), "{fine}");
    }
    for public in ["8.8.8.8", "172.32.0.0/16", "192.169.0.0/16", "1.1.1.0/24", "192.0.3.0/24"] {
        assert!(matches!(check(public, false), Err(SubnetError::Public { .. })), "{public}");
        assert_eq!(check(public, true), Ok(()), "{public}");
    }
    for large in ["10.0.0.0/8", "192.168.0.0/15", "0.0.0.0/0"] {
        assert!(matches!(check(large, true), Err(SubnetError::TooLarge { .. })), "{large}");
    }
    for reserved in ["224.0.0.1", "255.255.255.255", "0.0.0.0/24", "240.0.0.0/16"] {
        assert!(matches!(check(reserved, true), Err(SubnetError::Reserved { .. })), "{reserved}");
    }
    for wrong in [
        "",
        "192.168.1",
        "192.168.1.0/33",
        "192.168.1.0/+4",
        "192.168.1.0/",
        "::1",
        "host",
        "192.168.1.0/24/1",
    ] {
        assert!(matches!(wrong.parse::<Subnet>(), Err(SubnetError::Unreadable { .. })), "{wrong}");
    }
    let bits = "192.168.1.7/24".parse::<Subnet>().expect_err("bits beyond the prefix");
    assert!(bits.to_string().contains("192.168.1.0/24"), "{bits}");
    let of = |text: &str| text.parse::<Subnet>().expect("a subnet").addresses().count();
    assert_eq!(
        (of("192.168.1.0/24"), of("192.0.2.4/31"), of("192.0.2.4"), of("10.1.0.0/16")),
        (254, 2, 1, 65_534)
    );
}

#[test]
fn axis_names_yield_structure_proposals() {
    let three = proposals(&['X', 'Y', 'Z']);
    assert_eq!(three.len(), 4);
    assert!(three.iter().any(|one| one.structure == "w X' b Y Z t"));
    // Repeated letters, spindles and unknown axes do not count.
    assert_eq!(proposals(&['Z', 'Y', 'X', 'X', 'S', '?']), three);
    assert!(proposals(&['X', 'Z']).is_empty(), "a lathe has none of the types");
    assert!(proposals(&['X', 'Y', 'Z', 'C']).is_empty());
    assert!(proposals(&['X', 'Y', 'Z', 'A', 'B', 'C']).is_empty());
    for one in proposals(&['X', 'Y', 'Z', 'A', 'C']) {
        let structure: volcomp_kinematics::Structure = one.structure.parse().expect("a structure");
        let numbers = structure.type_numbers().expect("one of the types");
        assert_eq!((numbers.translational, numbers.rotary), (one.translational, one.rotary));
    }
}

proptest! {
    #[test]
    fn the_identification_decoder_accepts_any_bytes(bytes in proptest::collection::vec(any::<u8>(), 0..600)) {
        let _ = parse_identification(&bytes);
    }
}
