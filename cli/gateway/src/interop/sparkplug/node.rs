//! The edge node: which messages are due, with their numbers. It knows no connection.

use std::time::SystemTime;

use srad_types::{
    constants::{DBIRTH, DDATA, NBIRTH, NCMD, NDATA, NDEATH, NODE_CONTROL_REBIRTH, SPBV01},
    payload::{Message as _, Metric, Payload, metric},
};

use super::{
    super::quantities::{Kind, Quality, Quantity, Reading, Shape, Unit, Value, quantities},
    payload::{bd_seq, payload, property, quantity, rebirth},
};
use crate::{config::Deadbands, documents::Status};

/// How much the age of something must change before it is told again, ms.
const AGE_DEADBAND_MS: f64 = 1000.0;

/// A message with its topic.
#[derive(Clone, Debug, PartialEq)]
pub struct Message {
    /// The topic on which it is published.
    pub topic: String,
    /// The payload, encoded.
    pub payload: Vec<u8>,
}

/// The names under which the gateway is known.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Names {
    /// The group.
    pub group: String,
    /// The edge node: the gateway.
    pub node: String,
    /// The device: the machine.
    pub device: String,
}

/// The edge node. State: the numbers of the last message and of the birth, and what was told of each quantity.
pub struct Node {
    names: Names,
    /// Those of the gateway, then those of the machine.
    parts: [Part; 2],
    deadbands: Deadbands,
    seq: u8,
    bd_seq: u8,
}

/// The quantities of the node or of the device.
struct Part {
    quantities: Vec<Quantity>,
    told: Vec<Option<Reading>>,
}

impl Part {
    fn of(quantities: Vec<Quantity>) -> Self {
        let told = vec![None; quantities.len()];
        Self { quantities, told }
    }

    /// All metrics, which then count as told.
    fn birth(&mut self, status: &Status, now: SystemTime) -> Vec<Metric> {
        let told = self.quantities.iter().zip(&mut self.told);
        told.map(|(own, told)| {
            let reading = own.what.of(status);
            let metric = quantity(own, &reading, true, now);
            *told = Some(reading);
            metric
        })
        .collect()
    }

    /// The metrics that have changed, which then count as told.
    fn data(&mut self, status: &Status, deadbands: &Deadbands, now: SystemTime) -> Vec<Metric> {
        let told = self.quantities.iter().zip(&mut self.told);
        told.filter_map(|(own, told)| {
            let reading = own.what.of(status);
            let is_new = told
                .as_ref()
                .is_none_or(|told| has_changed(own.kind, told, &reading, deadbands));
            is_new.then(|| {
                let metric = quantity(own, &reading, false, now);
                *told = Some(reading);
                metric
            })
        })
        .collect()
    }
}

/// Whether something is told again: another quality, or another value beyond the deadband.
fn has_changed(kind: Kind, told: &Reading, found: &Reading, deadbands: &Deadbands) -> bool {
    // What is doubtful is told as good.
    let quality = |reading: &Reading| match reading.quality {
        Quality::Doubtful => Quality::Good,
        quality => quality,
    };
    if quality(told) != quality(found) {
        return true;
    }
    match (kind, &told.value, &found.value) {
        (Kind::Number(unit), Some(Value::Number(told)), Some(Value::Number(found))) => {
            let deadband = match unit {
                Unit::Mm => deadbands.mm,
                Unit::Deg => deadbands.deg,
                Unit::Um => deadbands.um,
                Unit::Urad => deadbands.urad,
                Unit::Degc => deadbands.degc,
                Unit::Ms => AGE_DEADBAND_MS,
            };
            // With a deadband of zero every change counts.
            (told - found).abs() > deadband
        }
        (_, told, found) => told != found,
    }
}

impl Node {
    /// A node that was never born. `first`: the number of its first birth.
    pub fn new(names: Names, shape: &Shape, deadbands: Deadbands, first: u8) -> Self {
        let is_of_node = |own: &Quantity| {
            let folder = own.folder.first().map(String::as_str);
            matches!(folder, Some("Gateway" | "Controllers"))
        };
        let (node, device) = quantities(shape).into_iter().partition(is_of_node);
        Self {
            names,
            parts: [Part::of(node), Part::of(device)],
            deadbands,
            seq: 0,
            bd_seq: first,
        }
    }

    /// The message that tells its death: what the broker keeps for the next connection.
    pub fn death(&self, now: SystemTime) -> Message {
        let metrics = vec![bd_seq(self.bd_seq, now)];
        self.message(NDEATH, None, &payload(metrics, None, now))
    }

    /// The messages that tell everything: node, then device. Their numbers begin anew.
    pub fn birth(&mut self, status: &Status, now: SystemTime) -> [Message; 2] {
        self.seq = 0;
        let mut metrics = vec![bd_seq(self.bd_seq, now), rebirth(now)];
        let version = env!("CARGO_PKG_VERSION");
        metrics.push(property("Properties/Version", version, now));
        metrics.extend(self.parts[0].birth(status, now));
        let node = self.message(NBIRTH, None, &payload(metrics, Some(0), now));
        let metrics = self.parts[1].birth(status, now);
        let seq = self.next_seq();
        let device = Some(self.names.device.as_str());
        let device = self.message(DBIRTH, device, &payload(metrics, Some(seq), now));
        [node, device]
    }

    /// The messages that tell what has changed since.
    pub fn data(&mut self, status: &Status, now: SystemTime) -> Vec<Message> {
        let mut messages = Vec::new();
        for (part, kind) in [(0, NDATA), (1, DDATA)] {
            let metrics = self.parts[part].data(status, &self.deadbands, now);
            if !metrics.is_empty() {
                let seq = self.next_seq();
                let device = (part == 1).then_some(self.names.device.as_str());
                messages.push(self.message(kind, device, &payload(metrics, Some(seq), now)));
            }
        }
        messages
    }

    /// The next connection has a birth and a death of its own.
    pub fn next_life(&mut self) {
        self.bd_seq = self.bd_seq.wrapping_add(1);
    }

    /// The topic of commands.
    pub fn commands(&self) -> String {
        self.topic(NCMD, None)
    }

    /// Whether a message asks for a birth, the only thing that is answered.
    pub fn asks_for_birth(&self, topic: &str, payload: &[u8]) -> bool {
        topic == self.commands()
            && Payload::decode(payload).is_ok_and(|payload| {
                payload.metrics.iter().any(|metric| {
                    metric.name.as_deref() == Some(NODE_CONTROL_REBIRTH)
                        && metric.value == Some(metric::Value::BooleanValue(true))
                })
            })
    }

    fn next_seq(&mut self) -> u8 {
        self.seq = self.seq.wrapping_add(1);
        self.seq
    }

    fn message(&self, kind: &str, device: Option<&str>, payload: &Payload) -> Message {
        Message {
            topic: self.topic(kind, device),
            payload: payload.encode_to_vec(),
        }
    }

    fn topic(&self, kind: &str, device: Option<&str>) -> String {
        let Names { group, node, .. } = &self.names;
        let device = device.map_or(String::new(), |device| format!("/{device}"));
        format!("{SPBV01}/{group}/{kind}/{node}{device}")
    }
}
