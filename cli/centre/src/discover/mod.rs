//! Finds controls, modules and gateways in the given subnets by read requests; nothing is written to any device.
//!
//! Results are proposals for the user: no machine is registered here. Responses are untrusted: they are bounded in time and length, and their texts
//! are sanitized before they are shown.

mod focas;
mod gateway;
mod modbus;
mod propose;
mod targets;

use std::{
    net::{IpAddr, SocketAddr},
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

pub use modbus::{Identification, parse_identification};
pub use propose::{Proposal, proposals};
pub use targets::{Subnet, SubnetError};

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
                    Kind::Gateway => gateway::probe(at, stream, pace, self.connect_within).await,
                    Kind::Focas => {
                        // The FOCAS client opens its own connection.
                        drop(stream);
                        pace.wait().await;
                        focas::probe(at, self.answer_within / 2).await
                    }
                    Kind::OpcUa => Device {
                        note: "its port is open; it was not queried".to_owned(),
                        ..Device::at(at, kind)
                    },
                    Kind::Modbus => modbus::probe(at, stream).await,
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
