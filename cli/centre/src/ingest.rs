//! Stores messages of machines: each message once, each batch in one transaction. Maintains the current state of each machine.
//!
//! State: the gateways of each machine, and its last state. It equals the store's content: a failed transaction changes
//! neither.

use std::{
    collections::{BTreeMap, BTreeSet},
    time::{Duration, Instant},
};

use serde::de::DeserializeOwned;
use volcomp_fleet::{Acknowledgement, Condition, Envelope, Kind, Lane, MachineId, Received};

use crate::{
    Error,
    instance::{Header, Instances},
    records::{CreationTime, Live, Point},
    rollout::Observation,
    store::{Store, history, machines::put_live, models},
};

/// Maximum length of a gateway's instance identifier, bytes; the database indexes it.
const MAX_INSTANCE_BYTES: usize = 256;

/// Maximum plausible residual, µm (1 km); larger values are discarded.
const MAX_RESIDUAL_UM: f64 = 1e9;

/// Maximum mean rate at which conditions and telemetry of a machine are stored, bytes a second: 25 times that of the default intervals.
const MAX_BYTES_PER_S: f64 = 16.0 * 1024.0;
/// Maximum burst, bytes: twice what a gateway queues on disk while the server is unreachable.
const MAX_BURST_BYTES: f64 = 128.0 * 1024.0 * 1024.0;
/// Overhead of a stored row, bytes.
const ROW_BYTES: f64 = 256.0;

/// Token bucket for the stored conditions and telemetry of a machine, so that a stolen nkey cannot fill the disk. Audit
/// records and acknowledgements need no bucket: the server rejects them when their stream is full. The bucket uses the
/// server's time, because a backlog is collected in a burst.
#[derive(Clone, Debug, Default)]
struct TokenBucket {
    used_bytes: f64,
    at_s: f64,
}

impl TokenBucket {
    /// Whether a message may be stored.
    fn take(&mut self, message: &Received) -> bool {
        let since_s = (message.stored_s - self.at_s).max(0.0);
        self.at_s = message.stored_s;
        self.used_bytes = (self.used_bytes - since_s * MAX_BYTES_PER_S).max(0.0);
        let used_bytes = self.used_bytes + message.bytes.len() as f64 + ROW_BYTES;
        if used_bytes <= MAX_BURST_BYTES {
            self.used_bytes = used_bytes;
        }
        used_bytes <= MAX_BURST_BYTES
    }
}

#[derive(Clone, Debug, Default)]
pub struct Reception {
    pub live: Option<Live>,
    pub instances: Instances,
    pub events: NewEvents,
    /// Arrival time of the last message that could not be read or exceeded the storage rate, and
    /// the reason.
    pub unreadable: Option<(Instant, String)>,
    /// When the newest condition was created, by a monotonic clock; `None` if none was received since the program started. Other messages do not
    /// show the current state of the machine.
    pub condition_at: Option<Instant>,
    bucket: TokenBucket,
}

fn corrects(condition: &Condition) -> bool {
    condition.state == "compensating"
}

#[derive(Clone, Debug, Default, PartialEq)]
pub struct NewEvents {
    pub conditions: u64,
    pub faulted: Option<String>,
    /// Sum and number of the known residuals, µm.
    pub residual: (f64, u64),
}

impl NewEvents {
    fn add(&mut self, before: Self) {
        self.conditions += before.conditions;
        if self.faulted.is_none() {
            self.faulted = before.faulted;
        }
        self.residual.0 += before.residual.0;
        self.residual.1 += before.residual.1;
    }
}

#[derive(Debug, Default)]
pub struct BatchCounts {
    pub stored: u64,
    pub duplicates: u64,
}

pub struct Ingest {
    machines: BTreeMap<MachineId, Reception>,
    changed: BTreeSet<MachineId>,
    start: Instant,
}

impl Ingest {
    pub fn of(store: &Store) -> Result<Self, Error> {
        let mut machines: BTreeMap<MachineId, Reception> = BTreeMap::new();
        for (machine, live) in store.live()? {
            machines.entry(machine).or_default().live = Some(live);
        }
        for (machine, instance) in store.instances()? {
            let reception = machines.entry(machine).or_default();
            reception.instances.each.push(instance);
        }
        Ok(Self { machines, changed: BTreeSet::new(), start: Instant::now() })
    }

    /// Stores a batch in one transaction: either all of it or none.
    ///
    /// # Errors
    /// The database rejects the change (full disk, locked by another program). The caller may pass the same batch
    /// again.
    pub fn take(&mut self, store: &Store, batch: &[Received]) -> Result<BatchCounts, Error> {
        let mut changed: BTreeMap<MachineId, Reception> = BTreeMap::new();
        let taken = store.write(|database| {
            let mut taken = BatchCounts::default();
            for message in batch {
                let name = &message.identity.machine;
                if !changed.contains_key(name) {
                    let reception = self.machines.get(name).cloned().unwrap_or_default();
                    changed.insert(name.clone(), reception);
                }
                // The entry was inserted just above.
                if let Some(reception) = changed.get_mut(name) {
                    store_message(database, &mut taken, reception, message)?;
                }
            }
            for (machine, reception) in &changed {
                let before = self.machines.get(machine);
                for instance in &reception.instances.each {
                    let same =
                        before.is_some_and(|before| before.instances.each.contains(instance));
                    if !same {
                        history::put_instance(database, machine, instance)?;
                    }
                }
                for gone in before.iter().flat_map(|before| &before.instances.each) {
                    let mut kept = reception.instances.each.iter();
                    if !kept.any(|one| one.instance == gone.instance) {
                        history::remove_instance(database, machine, &gone.instance)?;
                    }
                }
            }
            Ok(taken)
        })?;
        self.changed.extend(changed.keys().cloned());
        self.machines.append(&mut changed);
        Ok(taken)
    }

    /// Stores the last state of each machine that changed since the previous call. Calling it once a second is enough,
    /// since every message is stored separately.
    pub fn store_live(&mut self, store: &Store) -> Result<(), Error> {
        if self.changed.is_empty() {
            return Ok(());
        }
        store.write(|database| {
            let reception = self.changed.iter();
            let reception = reception.filter_map(|name| self.machines.get(name)?.live.as_ref());
            for live in reception {
                put_live(database, live)?;
            }
            Ok(())
        })?;
        self.changed.clear();
        Ok(())
    }

    /// Every machine from which a message was ever received.
    pub fn machines(&self) -> impl Iterator<Item = (&MachineId, &Reception)> {
        self.machines.iter()
    }

    pub fn machine(&self, machine: &MachineId) -> Option<&Reception> {
        self.machines.get(machine)
    }

    /// Age of a machine's last condition, s; before the first one, the time since the program started.
    pub fn silence_s(&self, machine: &MachineId) -> f64 {
        let condition_at = self.machines.get(machine).and_then(|reception| reception.condition_at);
        condition_at.unwrap_or(self.start).elapsed().as_secs_f64()
    }

    /// Returns each machine's observation for roll-outs and its events since the last pass, and resets the events. An
    /// observation is `reachable` if the last condition is at most `fresh_s` old, s.
    pub fn take_observations(
        &mut self,
        fresh_s: impl Fn(&MachineId) -> f64,
    ) -> (BTreeMap<MachineId, Observation>, BTreeMap<MachineId, NewEvents>) {
        let look = |(machine, reception): (&MachineId, &mut Reception)| {
            let since = std::mem::take(&mut reception.events);
            let (sum, count) = since.residual;
            let live = reception.live.as_ref();
            let seen = Observation {
                reachable: (reception.condition_at)
                    .is_some_and(|at| at.elapsed().as_secs_f64() <= fresh_s(machine)),
                version: live.map_or(0, |live| live.version),
                model: live.map(|live| live.model.clone()).unwrap_or_default(),
                corrects: (live.and_then(|live| live.condition.as_ref())).is_some_and(corrects),
                faulted: since.faulted.clone(),
                residual_um: (count > 0).then(|| sum / count as f64),
            };
            ((machine.clone(), seen), (machine.clone(), since))
        };
        self.machines.iter_mut().map(look).unzip()
    }

    /// Counts the messages that are permanently lost. Call it once a minute.
    pub fn count_missing(&mut self) {
        for reception in self.machines.values_mut() {
            let missing = reception.instances.count_missing();
            if let Some(live) = &mut reception.live {
                live.lost = missing;
            }
        }
    }

    /// Returns the events of [`take_observations`](Self::take_observations) after a failed pass, so that the next pass
    /// processes them.
    pub fn restore_events(&mut self, looked: BTreeMap<MachineId, NewEvents>) {
        for (machine, before) in looked {
            if let Some(reception) = self.machines.get_mut(&machine) {
                reception.events.add(before);
            }
        }
    }
}

fn store_message(
    database: &rusqlite::Connection,
    taken: &mut BatchCounts,
    reception: &mut Reception,
    message: &Received,
) -> Result<(), Error> {
    let machine = &message.identity.machine;
    let is_stored = Lane::of(message.kind) == Lane::Kept || reception.bucket.take(message);
    if !is_stored {
        let why = format!(
            "{}: the machine sends more than {} KiB a second, the excess is shown but not stored",
            message.kind.name(),
            MAX_BYTES_PER_S / 1024.0
        );
        reception.unreadable = Some((Instant::now(), why));
    }
    let read = match message.kind {
        Kind::Condition => read(message).map(Body::Condition),
        Kind::Telemetry => read(message).map(Body::Telemetry),
        Kind::Audit => read(message).map(Body::Record),
        Kind::Ack => read(message).map(Body::Answer),
    };
    let body = match read {
        Ok(body) => body,
        Err(_) if !is_stored => return Ok(()),
        Err(error) => {
            // Unreadable messages are stored unchanged for inspection.
            let why = format!("{}: {error}", message.kind.name());
            reception.unreadable = Some((Instant::now(), why));
            let text = String::from_utf8_lossy(&message.bytes);
            let text: String = text.chars().take(1000).collect();
            let document = serde_json::json!({ "unreadable": text, "why": error.to_string() });
            // The server redelivers messages if the centre was killed before acknowledging them. A redelivered message
            // is recognized by its sequence number in the stream and its storage time; the time differs if the stream
            // was recreated.
            let kind = message.kind.name();
            let key = format!("{kind} {} {}", message.sequence, message.stored_s);
            let text = document.to_string();
            return history::add_record(database, machine, message.stored_s, &text, Some(&key));
        }
    };
    let header = body.header(message);
    let Some(made) = reception.instances.take(&header) else {
        taken.duplicates += 1;
        return Ok(());
    };
    let at_s = made.at_s;
    taken.stored += 1;
    let live =
        reception.live.get_or_insert_with(|| Live::new(machine.clone(), message.stored_s, 0));
    live.heard_s = live.heard_s.max(message.stored_s);
    match body {
        Body::Condition(envelope) => {
            let condition = envelope.body;
            if is_stored {
                let text = serde_json::to_string(&Point::of(&condition, at_s))?;
                history::add_recent(database, machine, at_s, &text)?;
            }
            reception.events.conditions += 1;
            if condition.state == "faulted" {
                reception.events.faulted = Some(condition.reasons.join("; "));
            }
            let residual_um = condition.residual_um.filter(|_| corrects(&condition));
            if let Some(um) = residual_um.filter(|um| um.abs() < MAX_RESIDUAL_UM) {
                reception.events.residual.0 += um;
                reception.events.residual.1 += 1;
            }
            live.instance = envelope.instance;
            live.version = envelope.version;
            live.model = envelope.model;
            live.condition = Some(condition);
            // A message that waited at the gateway shows an earlier state. There is no `Instant` before this computer's start.
            let waited = Duration::try_from_secs_f64(made.late_s).unwrap_or_default();
            let made_at = Instant::now().checked_sub(waited);
            reception.condition_at = reception.condition_at.max(made_at);
            live.made =
                Some(CreationTime { at_s: message.stored_s - made.late_s, late_s: made.late_s });
        }
        Body::Telemetry(envelope) => {
            if is_stored {
                history::add_telemetry(database, machine, at_s, envelope.body.get())?;
            }
        }
        Body::Record(envelope) => {
            let text = String::from_utf8_lossy(&message.bytes);
            history::add_record(database, machine, at_s, &text, envelope.body.key().as_deref())?;
        }
        Body::Answer(envelope) => {
            models::answer(database, machine, message.stored_s, &envelope.body)?;
        }
    }
    Ok(())
}

fn read<T: DeserializeOwned>(message: &Received) -> Result<Envelope<T>, serde_json::Error> {
    let envelope: Envelope<T> = serde_json::from_slice(&message.bytes)?;
    let length = envelope.instance.len();
    if length > MAX_INSTANCE_BYTES {
        return Err(serde::de::Error::custom(format!(
            "found an instance of {length} bytes, expected at most {MAX_INSTANCE_BYTES}"
        )));
    }
    Ok(envelope)
}

enum Body {
    Condition(Envelope<Condition>),
    Telemetry(Envelope<Box<serde_json::value::RawValue>>),
    Record(Envelope<Record>),
    Answer(Envelope<Acknowledgement>),
}

/// An audit record, of which the centre parses only the checksum.
#[derive(serde::Deserialize)]
struct Record {
    #[serde(default)]
    checksum: String,
}

impl Record {
    /// Key that identifies a redelivered record: its checksum. Each record contains the checksum of its predecessor, so
    /// the checksums of a machine's records are unique. `None` if the record has no valid checksum.
    fn key(self) -> Option<String> {
        let is_checksum =
            self.checksum.len() == 64 && self.checksum.bytes().all(|byte| byte.is_ascii_hexdigit());
        is_checksum.then_some(self.checksum)
    }
}

impl Body {
    fn header(&self, message: &Received) -> Header<'_> {
        let (instance, number, uptime_s, passes) = match self {
            Self::Condition(one) => (&one.instance, one.number, one.uptime_s, true),
            Self::Telemetry(one) => (&one.instance, one.number, one.uptime_s, true),
            Self::Record(one) => (&one.instance, one.number, one.uptime_s, false),
            Self::Answer(one) => (&one.instance, one.number, one.uptime_s, false),
        };
        Header {
            instance,
            number,
            uptime_s,
            stored_s: message.stored_s,
            passing: passes.then_some(message.sequence),
        }
    }
}
