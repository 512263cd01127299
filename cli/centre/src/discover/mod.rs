//! Finds controls, modules and gateways in stated subnets, by asking; nothing is written to anything.
//!
//! What is found is a proposal for a person: nothing here registers a machine. Whatever comes over the wire may be a lie; it is
//! bounded in time and length, and its texts are made harmless before they are shown.

mod clean;
mod focas;
mod gateway;
mod modbus;
mod pace;
mod propose;
mod table;
mod targets;

use std::{
    net::{IpAddr, SocketAddr},
    sync::Arc,
    time::Duration,
};

use serde::{Deserialize, Serialize};
use tokio::{
    net::TcpStream,
    sync::Semaphore,
    task::JoinSet,
    time::{Instant, timeout_at},
};

pub use clean::clean;
pub use modbus::{Identification, parse_identification};
pub use pace::Pace;
pub use propose::{Proposal, proposals};
pub use table::table;
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
    /// Every kind.
    pub const ALL: [Self; 4] = [Self::Gateway, Self::Focas, Self::OpcUa, Self::Modbus];

    /// The name for people.
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
    /// Its address.
    pub address: IpAddr,
    /// The port on which it answers.
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
