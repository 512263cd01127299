//! Temperatures of CiA 404 nodes.

use std::time::{Duration, Instant};

use volcomp_port::{DeviceError, Reason, Temperature, Thermometer};

use super::nodes::Nodes;
use crate::frame::{CanPort, Frame};

/// Encoding of a temperature in a CiA 404 node's process data.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum Number {
    /// Two-byte integer, times 10^−decimals °C (object 7130h).
    I16 {
        /// Decimal digits set in the node (object 6132h).
        decimals: u8,
    },
    /// Four-byte floating-point number, °C (object 6130h).
    F32,
}

impl Number {
    fn bytes(self) -> usize {
        match self {
            Self::I16 { .. } => 2,
            Self::F32 => 4,
        }
    }

    fn value(self, data: &[u8]) -> Option<f64> {
        match self {
            Self::I16 { decimals } => {
                let raw = f64::from(i16::from_le_bytes(*data.first_chunk()?));
                Some(raw / 10_f64.powi(i32::from(decimals)))
            }
            Self::F32 => Some(f64::from(f32::from_le_bytes(*data.first_chunk()?))),
        }
    }
}

/// One temperature in the process data of a node.
#[derive(Clone, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Channel {
    pub name: String,
    /// Number of the node, 1 to 127.
    pub node: u8,
    /// Number of the process data object, 1 to 4.
    pub pdo: u8,
    /// Byte offset of the number in the process data.
    pub at: usize,
    pub number: Number,
    /// Byte offset of the channel's status byte in the same process data (object 6150h; 0 is good); `None` if the
    /// channel has no status byte.
    pub status_at: Option<usize>,
}

/// Temperatures of CiA 404 nodes. The consumer starts the nodes and supervises their heartbeat. Reading processes the
/// received frames and does not block.
pub struct CanopenThermometer<P> {
    port: P,
    nodes: Nodes,
    channels: Vec<Channel>,
    names: Vec<String>,
    latest: Vec<Temperature>,
}

impl<P: CanPort> CanopenThermometer<P> {
    /// Creates a thermometer with these channels. If the heartbeat of a node is older than `silent_after`, the data of
    /// the node are not used. This is the heartbeat consumer time of CiA 301; choose it by the heartbeat period of the
    /// node. The age of the process data of a running node is not checked.
    ///
    /// # Errors
    /// Invalid channels.
    pub fn new(
        mut port: P,
        channels: Vec<Channel>,
        silent_after: Duration,
    ) -> Result<Self, DeviceError> {
        let refused =
            |what: String| DeviceError::option(port.device(), what, "correct the channels");
        if channels.is_empty() {
            return Err(refused("no channel is named".to_owned()));
        }
        for (index, channel) in channels.iter().enumerate() {
            let Channel { name, node, pdo, at, number, status_at } = channel;
            let fits = at + number.bytes() <= 8 && status_at.is_none_or(|at| at < 8);
            if !fits || !(1..=127).contains(node) || !(1..=4).contains(pdo) {
                return Err(refused(format!(
                    "{name}: node {node}, process data {pdo}, byte {at}, expected nodes 1 to 127, process data 1 to 4 of 8 bytes"
                )));
            }
            if channels[..index].iter().any(|other| other.name == *name) {
                return Err(refused(format!("the sensor {name} is listed twice")));
            }
        }
        Ok(Self {
            nodes: Nodes::new(&mut port, channels.iter().map(|c| c.node), silent_after),
            names: channels.iter().map(|c| c.name.clone()).collect(),
            latest: vec![Temperature::NOT_READ; channels.len()],
            channels,
            port,
        })
    }
}

fn take(
    channels: &[Channel],
    latest: &mut [Temperature],
    (node, number): (u8, u8),
    frame: &Frame,
    taken: Instant,
) {
    for (channel, latest) in channels.iter().zip(latest) {
        if (channel.node, channel.pdo) != (node, number) {
            continue;
        }
        let data = frame.data();
        let status = channel.status_at.map(|at| data.get(at).copied());
        let value = data.get(channel.at..).and_then(|data| channel.number.value(data));
        *latest = match (value, status) {
            (Some(degc), None | Some(Some(0))) => Temperature::good(degc, taken),
            (_, Some(Some(_))) => Temperature::bad(Reason::Reported, taken),
            _ => Temperature::bad(Reason::NotANumber, taken),
        };
    }
}

impl<P: CanPort> Thermometer for CanopenThermometer<P> {
    fn device(&self) -> &str {
        self.port.device()
    }

    fn names(&self) -> &[String] {
        &self.names
    }

    fn latest(&mut self) -> &[Temperature] {
        let (channels, latest) = (&self.channels, &mut self.latest);
        let take = |node, number, frame: &Frame, taken| {
            take(channels, latest, (node, number), frame, taken);
        };
        // The error may be ignored: if the bus is lost, the heartbeats stop as well.
        let _ = self.nodes.listen(&mut self.port, take);
        for (channel, latest) in self.channels.iter().zip(&mut self.latest) {
            let failure = self.nodes.failure(channel.node);
            if let (Some(reason), Some(taken)) = (failure, latest.taken) {
                *latest = Temperature::bad(reason, taken);
            }
        }
        &self.latest
    }
}
