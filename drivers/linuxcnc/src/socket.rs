//! Opens the socket to a bridge, and requests a single state from it.

use std::{
    net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddr, ToSocketAddrs, UdpSocket},
    time::{Duration, Instant},
};

use volcomp_port::DeviceError;

use crate::{COMMAND_BYTES, Command, Content, Key, STATE_BYTES, State};

const REQUEST_INTERVAL: Duration = Duration::from_millis(100);

pub(crate) fn device(host: &str, port: u16) -> String {
    format!("linuxcnc://{host}:{port}")
}

pub(crate) fn open(host: &str, port: u16, remote: bool) -> Result<UdpSocket, DeviceError> {
    let bridge = resolve(host, port, remote)?;
    let own: IpAddr = match (bridge.ip(), bridge.ip().is_loopback()) {
        (IpAddr::V4(_), true) => Ipv4Addr::LOCALHOST.into(),
        (IpAddr::V4(_), false) => Ipv4Addr::UNSPECIFIED.into(),
        (IpAddr::V6(_), true) => Ipv6Addr::LOCALHOST.into(),
        (IpAddr::V6(_), false) => Ipv6Addr::UNSPECIFIED.into(),
    };
    let socket = UdpSocket::bind((own, 0)).and_then(|socket| {
        socket.set_nonblocking(true)?;
        socket.connect(bridge)?;
        Ok(socket)
    });
    socket.map_err(|e| {
        let found = format!("a UDP socket cannot be opened: {e}");
        DeviceError::open(device(host, port), found, "check the network of this computer")
    })
}

fn resolve(host: &str, port: u16, remote: bool) -> Result<SocketAddr, DeviceError> {
    let failed = |found: String| {
        DeviceError::open(device(host, port), found, "check the host of the bridge")
    };
    let name = host.trim_start_matches('[').trim_end_matches(']');
    let found = (name, port).to_socket_addrs();
    let found: Vec<SocketAddr> =
        found.map_err(|e| failed(format!("the host cannot be found: {e}")))?.collect();
    let allowed = |address: &&SocketAddr| remote || address.ip().is_loopback();
    if let Some(address) = found.iter().find(allowed) {
        return Ok(*address);
    }
    Err(match found.first() {
        None => failed("the host has no address".to_owned()),
        Some(address) => DeviceError::option(
            device(host, port),
            format!("{} is another computer", address.ip()),
            "let the gateway run on the control's computer, or add ?remote=true where the network is a separate one",
        ),
    })
}

/// Requests one state from a bridge with any machine number and axes.
///
/// # Errors
/// A host that cannot be resolved, or is another computer although `remote` is `false`; no state of this version and
/// key within `at_most`.
pub fn read_state(
    host: &str,
    port: u16,
    remote: bool,
    key: &Key,
    at_most: Duration,
) -> Result<State, DeviceError> {
    let socket = open(host, port, remote)?;
    let failed = |e: std::io::Error| {
        let found = format!("the socket fails: {e}");
        DeviceError::open(device(host, port), found, "check the network of this computer")
    };
    socket.set_nonblocking(false).map_err(failed)?;
    socket.set_read_timeout(Some(REQUEST_INTERVAL)).map_err(failed)?;
    let command = Command { machine: 0, answers: [0; 2], content: Content::Listen };
    let mut bytes = [0; COMMAND_BYTES];
    let length = command.encode(key, &mut bytes);
    let end = Instant::now() + at_most;
    let mut found = "the bridge does not answer".to_owned();
    while Instant::now() < end {
        // An error "connection refused" means that no bridge is listening yet.
        let _ = socket.send(&bytes[..length]);
        let mut state = [0; STATE_BYTES + 1];
        match socket.recv(&mut state) {
            Ok(length) => match State::decode(&state[..length], key) {
                Ok(state) => return Ok(state),
                Err(broken) => found = broken.to_string(),
            },
            // No bridge is listening, so wait before the next request.
            Err(e) if e.kind() == std::io::ErrorKind::ConnectionRefused => {
                std::thread::sleep(REQUEST_INTERVAL.min(at_most));
            }
            Err(_) => {}
        }
    }
    Err(DeviceError::no_answer(
        device(host, port),
        found,
        "start LinuxCNC with the bridge, and compare [VOLCOMP]PORT and KEY_FILE of its INI file",
    ))
}
