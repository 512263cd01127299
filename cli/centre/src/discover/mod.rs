//! Finds controls, modules and gateways in the given subnets by read requests; nothing is written to any device.
//!
//! Only addresses of these subnets are probed. Responses are untrusted: their duration and length are bounded, and
//! their texts are sanitized before they are shown.
//!
//! Results are proposals for the user; no machine is registered here. A control reports the letters of its axes but not
//! how the axes are stacked. The proposed structures are the types of the generalised model, the most common designs
//! first.

use std::{
    fmt,
    net::{IpAddr, Ipv4Addr, SocketAddr},
    str::FromStr,
    sync::Arc,
    time::Duration,
};

use serde::{Deserialize, Serialize};
use tokio::{
    net::TcpStream,
    sync::{Mutex, Semaphore},
    task::JoinSet,
    time::{Instant, sleep_until, timeout_at},
};
use volcomp_kinematics::Structure;
use volcomp_vocabulary::{AxisKind, AxisName};

mod probes;

pub use probes::{Identification, parse_identification};

const MAX_CONCURRENT: usize = 64;

#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Kind {
    Gateway,
    Focas,
    /// An OPC UA server, such as a SINUMERIK control. Only its open port is detected; no request is sent.
    OpcUa,
    /// A module with temperatures or digital lines (Modbus TCP).
    Modbus,
}

impl Kind {
    pub const ALL: [Self; 4] = [Self::Gateway, Self::Focas, Self::OpcUa, Self::Modbus];

    pub fn name(self) -> &'static str {
        match self {
            Self::Gateway => "gateway",
            Self::Focas => "FOCAS",
            Self::OpcUa => "OPC UA",
            Self::Modbus => "Modbus TCP",
        }
    }
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Device {
    pub address: IpAddr,
    pub port: u16,
    /// The protocol that belongs to the port.
    pub kind: Kind,
    /// True if the port answered in the protocol of `kind`; false if another service listens there.
    pub answers: bool,
    /// Make and type as reported by the device; empty if not reported.
    pub control: String,
    /// Name or serial number as reported by the device; empty if not reported.
    pub name: String,
    /// Axis letters in the control's order; empty if not reported.
    pub axes: Vec<char>,
    /// Structure code as reported by a gateway; other devices do not report it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub structure: Option<String>,
    pub note: String,
    /// Possible structures for the axes of the device, the most common first.
    #[serde(default, skip_deserializing)]
    pub proposals: Vec<Proposal>,
}

impl Device {
    fn at(address: SocketAddr, kind: Kind) -> Self {
        Self {
            address: address.ip(),
            port: address.port(),
            kind,
            answers: true,
            control: String::new(),
            name: String::new(),
            axes: Vec::new(),
            structure: None,
            note: String::new(),
            proposals: Vec::new(),
        }
    }

    fn other(address: SocketAddr, kind: Kind, why: impl AsRef<str>) -> Self {
        Self { answers: false, note: clean(why.as_ref()), ..Self::at(address, kind) }
    }
}

#[derive(Clone, Debug, PartialEq)]
pub struct Search {
    /// The subnets; each must have passed [`Subnet::check`].
    pub subnets: Vec<Subnet>,
    /// Ports to probe, with the protocol expected on each.
    pub ports: Vec<(Kind, u16)>,
    pub per_second: f64,
    pub connect_within: Duration,
    /// Timeout for all responses of a device together.
    pub answer_within: Duration,
}

/// The default ports: 8193, 4840, 502; 8080 and 8443 for gateways.
pub const PORTS: [(Kind, u16); 5] = [
    (Kind::Gateway, 8080),
    (Kind::Gateway, 8443),
    (Kind::Focas, 8193),
    (Kind::OpcUa, 4840),
    (Kind::Modbus, 502),
];

pub const PER_SECOND: f64 = 50.0;
pub const MAX_PER_SECOND: f64 = 1000.0;

impl Search {
    /// A search of [`PORTS`] at [`PER_SECOND`], with timeouts of 1 s to connect and 4 s to answer.
    pub fn new(subnets: Vec<Subnet>) -> Self {
        Self {
            subnets,
            ports: PORTS.to_vec(),
            per_second: PER_SECOND,
            connect_within: Duration::from_secs(1),
            answer_within: Duration::from_secs(4),
        }
    }

    pub fn addresses(&self) -> usize {
        self.subnets.iter().map(|one| one.addresses().count()).sum()
    }

    /// Minimum number of connection attempts: one for each port. Probes of gateways and FANUC controls open further
    /// connections.
    pub fn connections(&self) -> usize {
        self.addresses() * self.ports.len()
    }

    /// Runs the search; calls `progress` with the number of completed addresses. Devices are sorted by address and port.
    pub async fn run(&self, mut progress: impl FnMut(usize)) -> Vec<Device> {
        let pace = Arc::new(RateLimiter::new(self.per_second));
        let places = Arc::new(Semaphore::new(MAX_CONCURRENT));
        let mut tasks: JoinSet<Vec<Device>> = JoinSet::new();
        let (mut found, mut done) = (Vec::new(), 0);
        let mut take = |joined: Result<Vec<Device>, tokio::task::JoinError>| {
            done += 1;
            progress(done);
            // A task that panicked contributes no devices.
            found.extend(joined.unwrap_or_default());
        };
        for address in self.subnets.iter().flat_map(Subnet::addresses) {
            while let Some(joined) = tasks.try_join_next() {
                take(joined);
            }
            // The semaphore is never closed.
            let Ok(place) = Arc::clone(&places).acquire_owned().await else {
                break;
            };
            let (search, pace) = (self.clone(), Arc::clone(&pace));
            tasks.spawn(async move {
                let devices = search.one(address, &pace).await;
                drop(place);
                devices
            });
        }
        while let Some(joined) = tasks.join_next().await {
            take(joined);
        }
        found.sort_by_key(|device| (device.address, device.port));
        found
    }

    async fn one(&self, address: IpAddr, pace: &RateLimiter) -> Vec<Device> {
        let mut found = Vec::new();
        for &(kind, port) in &self.ports {
            let at = SocketAddr::new(address, port);
            let Some(stream) = self.connect(at, pace).await else {
                continue;
            };
            let deadline = Instant::now() + self.answer_within;
            let probe = async {
                match kind {
                    Kind::Gateway => {
                        probes::probe_gateway(at, stream, pace, self.connect_within).await
                    }
                    Kind::Focas => {
                        // The FOCAS client opens its own connection.
                        drop(stream);
                        pace.wait().await;
                        probes::probe_focas(at, self.answer_within / 2).await
                    }
                    Kind::OpcUa => Device {
                        note: "its port is open; it was not queried".to_owned(),
                        ..Device::at(at, kind)
                    },
                    Kind::Modbus => probes::probe_modbus(at, stream).await,
                }
            };
            let device = timeout_at(deadline, probe).await;
            let mut device = device.unwrap_or_else(|_| {
                let within = self.answer_within.as_secs_f64();
                Device::other(
                    at,
                    kind,
                    format!(
                        "accepts a connection, but sends no complete response within {within} s"
                    ),
                )
            });
            device.proposals = proposals(&device.axes);
            found.push(device);
        }
        found
    }

    async fn connect(&self, at: SocketAddr, pace: &RateLimiter) -> Option<TcpStream> {
        pace.wait().await;
        let connected = tokio::time::timeout(self.connect_within, TcpStream::connect(at)).await;
        let stream = connected.ok()?.ok()?;
        // Without any listener, a TCP connection to oneself can succeed on a free port (simultaneous open).
        (stream.local_addr().ok()? != at).then_some(stream)
    }
}

/// A rate limiter that spaces turns evenly, first come, first served.
#[derive(Debug)]
pub struct RateLimiter {
    every: Duration,
    next: Mutex<Instant>,
}

impl RateLimiter {
    /// `per_second` turns per second, clamped to 0.1 to 10 000.
    pub fn new(per_second: f64) -> Self {
        let per_second = if per_second.is_finite() { per_second.clamp(0.1, 10_000.0) } else { 1.0 };
        Self { every: Duration::from_secs_f64(1.0 / per_second), next: Mutex::new(Instant::now()) }
    }

    /// Waits for a turn. Unused turns are not saved up: there is no burst after a pause.
    pub async fn wait(&self) {
        let at = {
            let mut next = self.next.lock().await;
            let at = (*next).max(Instant::now());
            *next = at + self.every;
            at
        };
        sleep_until(at).await;
    }
}

const MAX_TEXT: usize = 100;

/// Sanitizes a text for display: one line of at most 100 characters, without control characters (which move a terminal's cursor) and without
/// characters that change the writing direction.
pub fn clean(text: &str) -> String {
    let shown: String =
        text.chars().map(|c| if is_harmless(c) { c } else { ' ' }).take(4 * MAX_TEXT).collect();
    let words: Vec<&str> = shown.split_whitespace().collect();
    words.join(" ").chars().take(MAX_TEXT).collect()
}

fn is_harmless(c: char) -> bool {
    let turns = matches!(c, '\u{200b}'..='\u{200f}' | '\u{2028}'..='\u{202e}' | '\u{2060}'..='\u{206f}' | '\u{feff}');
    !c.is_control() && !turns
}

/// Formats the devices as lines of text, each with the first proposal and the number of proposals.
pub fn table(devices: &[Device]) -> String {
    if devices.is_empty() {
        return "Nothing was found.\n".to_owned();
    }
    let head = ["address", "what", "control", "axes", "structure"];
    let mut rows = vec![head.map(str::to_owned).to_vec()];
    for device in devices {
        let axes: Vec<String> = device.axes.iter().map(ToString::to_string).collect();
        let control: Vec<&str> = [device.control.as_str(), &device.name]
            .into_iter()
            .filter(|text| !text.is_empty())
            .collect();
        let not = if device.answers { "" } else { "not " };
        rows.push(vec![
            format!("{}:{}", device.address, device.port),
            format!("{not}{}", device.kind.name()),
            control.join(", "),
            axes.join(" "),
            structure(device),
        ]);
    }
    let columns = crate::columns(&rows);
    let mut lines: Vec<String> = Vec::new();
    for (place, line) in columns.lines().enumerate() {
        lines.push(line.to_owned());
        let device = place.checked_sub(1).and_then(|place| devices.get(place));
        if let Some(device) = device.filter(|device| !device.note.is_empty()) {
            lines.push(format!("    {}", device.note));
        }
    }
    lines.join("\n") + "\n"
}

fn structure(device: &Device) -> String {
    if let Some(stated) = &device.structure {
        return stated.clone();
    }
    match &device.proposals[..] {
        [] => String::new(),
        [only] => format!("{}?", only.structure),
        [first, rest @ ..] => format!("{}? or one of {} others", first.structure, rest.len()),
    }
}

/// Prefix length of the largest subnet: 65 536 addresses.
const SHORTEST_PREFIX: u8 = 16;

/// An IPv4 subnet or a single address.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Subnet {
    first: Ipv4Addr,
    prefix: u8,
}

#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum SubnetError {
    #[error(
        "found {found:?}, expected an address or a subnet of IPv4, such as 192.0.2.17 or 192.0.2.0/24"
    )]
    Unreadable { found: String },
    /// The address has bits set beyond its prefix, so it is ambiguous.
    #[error("found {found}, expected {expected}: the address has bits beyond its prefix")]
    Bits {
        found: String,
        /// The subnet that contains the address.
        expected: Subnet,
    },
    #[error(
        "found {found} with {addresses} addresses, expected at most 65536 (/{SHORTEST_PREFIX}): state the subnets of the machines"
    )]
    TooLarge {
        found: Subnet,
        /// Number of addresses in the subnet.
        addresses: u64,
    },
    /// The range is public and may belong to others.
    #[error(
        "{found} is not a private range: it may contain computers of others. If it is yours, add --yes-these-are-mine"
    )]
    Public { found: Subnet },
    /// A range without individual hosts, such as multicast.
    #[error("{found} contains no hosts: it is multicast, broadcast or reserved")]
    Reserved { found: Subnet },
}

impl FromStr for Subnet {
    type Err = SubnetError;

    fn from_str(text: &str) -> Result<Self, SubnetError> {
        let unreadable = || SubnetError::Unreadable { found: text.to_owned() };
        let (address, prefix) = match text.split_once('/') {
            Some((address, prefix)) => {
                let digits = prefix.bytes().all(|byte| byte.is_ascii_digit());
                let prefix: Option<u8> = prefix.parse().ok().filter(|_| digits);
                (address, prefix.filter(|prefix| *prefix <= 32))
            }
            None => (text, Some(32)),
        };
        let address: Ipv4Addr = address.parse().map_err(|_| unreadable())?;
        let prefix = prefix.ok_or_else(unreadable)?;
        let first = Ipv4Addr::from(u32::from(address) & mask(prefix));
        let subnet = Self { first, prefix };
        if first == address {
            Ok(subnet)
        } else {
            Err(SubnetError::Bits { found: text.to_owned(), expected: subnet })
        }
    }
}

impl fmt::Display for Subnet {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}/{}", self.first, self.prefix)
    }
}

fn mask(prefix: u8) -> u32 {
    u32::MAX.checked_shl(32 - u32::from(prefix.min(32))).unwrap_or(0)
}

impl Subnet {
    fn last(self) -> u32 {
        u32::from(self.first) | !mask(self.prefix)
    }

    /// Checks whether the subnet may be searched; `mine` confirms that a public range belongs to the user.
    pub fn check(&self, mine: bool) -> Result<(), SubnetError> {
        let addresses = u64::from(self.last() - u32::from(self.first)) + 1;
        if self.prefix < SHORTEST_PREFIX {
            return Err(SubnetError::TooLarge { found: *self, addresses });
        }
        let [a, ..] = self.first.octets();
        if a == 0 || a >= 224 {
            return Err(SubnetError::Reserved { found: *self });
        }
        let private = PRIVATE.iter().any(|(range, prefix)| {
            u32::from(self.first) & mask(*prefix) == u32::from(*range) && self.prefix >= *prefix
        });
        if private || mine { Ok(()) } else { Err(SubnetError::Public { found: *self }) }
    }

    /// Host addresses. Subnets of more than two addresses exclude their network and broadcast addresses.
    pub fn addresses(&self) -> impl Iterator<Item = IpAddr> + use<> {
        let (first, last) = (u32::from(self.first), self.last());
        let ends = u32::from(self.prefix < 31);
        (first + ends..=last - ends).map(|address| IpAddr::V4(Ipv4Addr::from(address)))
    }
}

/// Ranges in which a shop has its machines: private (RFC 1918), loopback, link-local, shared (RFC 6598), documentation (RFC 5737) and benchmarking
/// (RFC 2544).
const PRIVATE: [(Ipv4Addr, u8); 10] = [
    (Ipv4Addr::new(10, 0, 0, 0), 8),
    (Ipv4Addr::new(172, 16, 0, 0), 12),
    (Ipv4Addr::new(192, 168, 0, 0), 16),
    (Ipv4Addr::new(127, 0, 0, 0), 8),
    (Ipv4Addr::new(169, 254, 0, 0), 16),
    (Ipv4Addr::new(100, 64, 0, 0), 10),
    (Ipv4Addr::new(192, 0, 2, 0), 24),
    (Ipv4Addr::new(198, 51, 100, 0), 24),
    (Ipv4Addr::new(203, 0, 113, 0), 24),
    (Ipv4Addr::new(198, 18, 0, 0), 15),
];

#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Proposal {
    /// The structure code, such as `w X' b Y Z t`.
    pub structure: String,
    /// Type number of the linear axes: number of X, Y and Z that carry the workpiece.
    pub translational: u8,
    /// Type number of the rotary axes: 0 none, 1 both carry the workpiece, 2 both carry the tool, 3
    /// one carries the workpiece and the other the tool.
    pub rotary: u8,
    /// Rotary axes from the workpiece to the tool.
    pub rotary_axes: Vec<AxisName>,
    pub design: String,
}

/// Number of linear axes that carry the workpiece, the most common design first: for milling machines a table that
/// moves in two directions or in one, then a gantry, then a knee.
const WORKPIECE_AXES_BY_FREQUENCY: [u8; 4] = [2, 1, 0, 3];

/// Possible structures for a control's axis letters; letters that name no axis are ignored. Empty unless X, Y and Z are
/// all present with no or two rotary axes: the type numbers cover no other machines, so the user must enter the
/// structure.
pub fn proposals(letters: &[char]) -> Vec<Proposal> {
    let mut axes: Vec<AxisName> = Vec::new();
    for axis in letters.iter().filter_map(|letter| axis_of(*letter)) {
        if !axes.contains(&axis) {
            axes.push(axis);
        }
    }
    let has_linear = [AxisName::X, AxisName::Y, AxisName::Z].iter().all(|axis| axes.contains(axis));
    let mut rotary: Vec<AxisName> =
        axes.into_iter().filter(|axis| axis.kind() == AxisKind::Rotary).collect();
    rotary.sort_unstable();
    if !has_linear {
        return Vec::new();
    }
    let orders = match rotary[..] {
        [] => vec![(0, Vec::new())],
        // The last letter names the axis that turns about the spindle direction: the rotary table on a tilting table,
        // or the carrier of a tilting head.
        [first, last] => vec![
            (1, vec![last, first]),
            (3, vec![last, first]),
            (2, vec![last, first]),
            (1, vec![first, last]),
            (2, vec![first, last]),
            (3, vec![first, last]),
        ],
        _ => Vec::new(),
    };
    let proposed = orders.iter().flat_map(|(number, order)| {
        WORKPIECE_AXES_BY_FREQUENCY
            .iter()
            .filter_map(move |translational| proposal(*translational, *number, order))
    });
    proposed.collect()
}

fn axis_of(letter: char) -> Option<AxisName> {
    AxisName::ALL.into_iter().find(|axis| axis.to_string() == letter.to_string())
}

fn proposal(translational: u8, rotary: u8, axes: &[AxisName]) -> Option<Proposal> {
    let structure = Structure::from_type(translational, rotary, axes).ok()?;
    let linear = match translational {
        0 => "the tool moves in X, Y and Z",
        1 => "the table moves in X",
        2 => "the table moves in X and Y",
        _ => "the table moves in X, Y and Z",
    };
    let list: Vec<String> = axes.iter().map(ToString::to_string).collect();
    let rotary_part = match rotary {
        0 => String::new(),
        1 => format!(", {} turn the workpiece", list.join(" and ")),
        2 => format!(", {} turn the tool", list.join(" and ")),
        _ => format!(", {} turns the workpiece and {} the tool", list.first()?, list.last()?),
    };
    Some(Proposal {
        structure: structure.to_string(),
        translational,
        rotary,
        rotary_axes: axes.to_vec(),
        design: format!("{linear}{rotary_part}"),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn control_characters_are_removed() {
        assert_eq!(clean("  31i\u{1b}[2J\r\n B\0 "), "31i [2J B");
        assert_eq!(clean("a\u{202e}b"), "a b");
        assert_eq!(clean(&"ä".repeat(500)).chars().count(), 100);
    }

    #[tokio::test(start_paused = true)]
    async fn turns_are_evenly_spaced_without_bursts() {
        let pace = RateLimiter::new(10.0);
        let begun = Instant::now();
        for _ in 0..11 {
            pace.wait().await;
        }
        assert_eq!(begun.elapsed().as_millis(), 1000);
        tokio::time::sleep(Duration::from_secs(60)).await;
        let begun = Instant::now();
        for _ in 0..11 {
            pace.wait().await;
        }
        assert_eq!(begun.elapsed().as_millis(), 1000);
    }
}
