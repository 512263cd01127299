//! Finds controls, modules and gateways in stated subnets, by asking; nothing is written to anything.
//!
//! What is found is a proposal for a person: nothing here registers a machine. Whatever comes over the wire may be a lie; it is
//! bounded in time and length, and its texts are made harmless before they are shown.

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
pub use targets::{NotSearched, Subnet};

/// So many addresses are asked at one time.
const AT_ONCE: usize = 64;

/// What a device is, by the language that it answers in.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Kind {
    /// A gateway of volcomp.
    Gateway,
    /// A FANUC control (FOCAS).
    Focas,
    /// An OPC UA server, such as a SINUMERIK control: its port is open, nothing is asked.
    OpcUa,
    /// A module with temperatures or lines (Modbus TCP).
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

/// A device that was found.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Device {
    pub address: IpAddr,
    pub port: u16,
    /// The language that belongs to the port.
    pub kind: Kind,
    /// Whether it answered in that language; otherwise something else listens there.
    pub answers: bool,
    /// The make and type, as it tells them; empty where it does not.
    pub control: String,
    /// Its name or serial number, as it tells it; empty where it does not.
    pub name: String,
    /// The letters of its axes in its own order; empty where it does not tell them.
    pub axes: Vec<char>,
    /// The structure code where it tells one, as gateways do.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub structure: Option<String>,
    /// What else it says, or what is wrong with its answers.
    pub note: String,
    /// The structures that its axes may mean, the more usual first.
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

    /// Something else listens there.
    fn other(address: SocketAddr, kind: Kind, why: impl AsRef<str>) -> Self {
        Self {
            answers: false,
            note: clean(why.as_ref()),
            ..Self::at(address, kind)
        }
    }
}

/// How the search is done.
#[derive(Clone, Debug, PartialEq)]
pub struct Search {
    /// The subnets, each of which was checked.
    pub subnets: Vec<Subnet>,
    /// The ports that are tried, with the language that is expected there.
    pub ports: Vec<(Kind, u16)>,
    /// New connections a second, over all addresses.
    pub per_second: f64,
    /// A connection is made within this time, or nobody is there.
    pub connect_within: Duration,
    /// All answers of a device come within this time.
    pub answer_within: Duration,
}

/// The usual ports: 8193, 4840, 502; of gateways 8080 and 8443.
pub const PORTS: [(Kind, u16); 5] = [
    (Kind::Gateway, 8080),
    (Kind::Gateway, 8443),
    (Kind::Focas, 8193),
    (Kind::OpcUa, 4840),
    (Kind::Modbus, 502),
];

/// Connections a second unless something else is asked for.
pub const PER_SECOND: f64 = 50.0;
/// The most connections a second that may be asked for.
pub const FASTEST_PER_SECOND: f64 = 1000.0;

impl Search {
    /// A search with the usual ports and times.
    pub fn new(subnets: Vec<Subnet>) -> Self {
        Self {
            subnets,
            ports: PORTS.to_vec(),
            per_second: PER_SECOND,
            connect_within: Duration::from_secs(1),
            answer_within: Duration::from_secs(4),
        }
    }

    /// How many addresses are asked.
    pub fn addresses(&self) -> usize {
        self.subnets.iter().map(|one| one.addresses().count()).sum()
    }

    /// How many connections are tried at least.
    pub fn connections(&self) -> usize {
        self.addresses() * self.ports.len()
    }

    /// Searches, and tells `told` how many addresses are done. What was found comes in the order of addresses and ports.
    pub async fn run(&self, mut told: impl FnMut(usize)) -> Vec<Device> {
        let pace = Arc::new(Pace::new(self.per_second));
        let places = Arc::new(Semaphore::new(AT_ONCE));
        let mut tasks: JoinSet<Vec<Device>> = JoinSet::new();
        let (mut found, mut done) = (Vec::new(), 0);
        let mut take = |joined: Result<Vec<Device>, tokio::task::JoinError>| {
            done += 1;
            told(done);
            // A task that panicked has found nothing.
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

    /// Everything at one address.
    async fn one(&self, address: IpAddr, pace: &Pace) -> Vec<Device> {
        let mut found = Vec::new();
        for &(kind, port) in &self.ports {
            let at = SocketAddr::new(address, port);
            let Some(stream) = self.connect(at, pace).await else {
                continue;
            };
            let deadline = Instant::now() + self.answer_within;
            let asked = async {
                match kind {
                    Kind::Gateway => gateway::ask(at, stream, pace, self.connect_within).await,
                    Kind::Focas => {
                        // The client makes a connection of its own.
                        drop(stream);
                        pace.turn().await;
                        focas::ask(at, self.answer_within / 2).await
                    }
                    Kind::OpcUa => Device {
                        note: "its port is open; it was asked nothing".to_owned(),
                        ..Device::at(at, kind)
                    },
                    Kind::Modbus => modbus::ask(at, stream).await,
                }
            };
            let device = timeout_at(deadline, asked).await;
            let mut device = device.unwrap_or_else(|_| {
                let within = self.answer_within.as_secs_f64();
                Device::other(
                    at,
                    kind,
                    format!("accepts a connection, but gives no whole answer within {within} s"),
                )
            });
            device.proposals = proposals(&device.axes);
            found.push(device);
        }
        found
    }

    async fn connect(&self, at: SocketAddr, pace: &Pace) -> Option<TcpStream> {
        pace.turn().await;
        let connected = tokio::time::timeout(self.connect_within, TcpStream::connect(at)).await;
        let stream = connected.ok()?.ok()?;
        // Without a word from the other side a connection to oneself can come about at a port that is free.
        (stream.local_addr().ok()? != at).then_some(stream)
    }
}

/// Gives turns evenly in time, to whoever asks first.
#[derive(Debug)]
pub struct Pace {
    every: Duration,
    next: Mutex<Instant>,
}

impl Pace {
    /// So many turns a second; between 0.1 and 10 000.
    pub fn new(per_second: f64) -> Self {
        let per_second = if per_second.is_finite() {
            per_second.clamp(0.1, 10_000.0)
        } else {
            1.0
        };
        Self {
            every: Duration::from_secs_f64(1.0 / per_second),
            next: Mutex::new(Instant::now()),
        }
    }

    /// Waits for a turn. What was not used is not saved up: after a pause there is no burst.
    pub async fn turn(&self) {
        let at = {
            let mut next = self.next.lock().await;
            let at = (*next).max(Instant::now());
            *next = at + self.every;
            at
        };
        sleep_until(at).await;
    }
}

/// Maximum length of a text that is kept, characters.
const MAX_TEXT: usize = 100;

/// A text as it may be shown: one line of at most a hundred characters, without control characters (which move a terminal's
/// cursor) and without those that turn the direction of writing.
pub fn clean(text: &str) -> String {
    let shown: String = text
        .chars()
        .map(|c| if is_harmless(c) { c } else { ' ' })
        .take(4 * MAX_TEXT)
        .collect();
    let words: Vec<&str> = shown.split_whitespace().collect();
    words.join(" ").chars().take(MAX_TEXT).collect()
}

fn is_harmless(c: char) -> bool {
    let turns = matches!(c, '\u{200b}'..='\u{200f}' | '\u{2028}'..='\u{202e}' | '\u{2060}'..='\u{206f}' | '\u{feff}');
    !c.is_control() && !turns
}

/// What was found, as lines of text: a device each, with the first proposal and how many there are.
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
    fn nothing_moves_a_terminal() {
        assert_eq!(clean("  31i\u{1b}[2J\r\n B\0 "), "31i [2J B");
        assert_eq!(clean("a\u{202e}b"), "a b");
        assert_eq!(clean(&"ä".repeat(500)).chars().count(), 100);
    }

    #[tokio::test(start_paused = true)]
    async fn turns_come_evenly_and_are_not_saved_up() {
        let pace = Pace::new(10.0);
        let begun = Instant::now();
        for _ in 0..11 {
            pace.turn().await;
        }
        assert_eq!(begun.elapsed().as_millis(), 1000);
        tokio::time::sleep(Duration::from_secs(60)).await;
        let begun = Instant::now();
        for _ in 0..11 {
            pace.turn().await;
        }
        assert_eq!(begun.elapsed().as_millis(), 1000);
    }
}
