//! A simulated gateway without a machine. It accepts signed values, acknowledges them, and sends conditions. The load
//! example uses it too.

use std::{
    collections::BTreeMap,
    sync::{
        Arc, Mutex,
        atomic::{AtomicU64, Ordering},
    },
    time::{Duration, Instant},
};

use volcomp_fleet::{
    Acknowledgement, Condition, Desired, Envelope, Identity, Kind, LinkSettings, MachineLink,
    ModelRef, Outcome, Trust, VerifyingKey,
};
use volcomp_vocabulary::AxisName;

#[derive(Clone)]
pub(crate) struct Plan {
    pub(crate) link: LinkSettings,
    pub(crate) identity: Identity,
    pub(crate) serial: String,
    pub(crate) trusted: Vec<VerifyingKey>,
    pub(crate) instance: String,
    pub(crate) condition_every: Duration,
    pub(crate) telemetry_every: Duration,
    /// Body of the telemetry; if it is empty, no telemetry is sent.
    pub(crate) telemetry: Arc<serde_json::value::RawValue>,
    pub(crate) residual_um: Arc<Mutex<f64>>,
}

#[derive(Clone, Default)]
pub(crate) struct GatewayState {
    pub(crate) version: Arc<AtomicU64>,
    /// Number of conditions that the server has acknowledged.
    pub(crate) conditions: Arc<AtomicU64>,
    /// Number of messages that the server has acknowledged.
    pub(crate) all: Arc<AtomicU64>,
    /// Number of rejected values, not counting old versions.
    pub(crate) refused: Arc<AtomicU64>,
}

struct Gateway {
    plan: Plan,
    reported: GatewayState,
    start: Instant,
    number: u64,
    trust: Trust,
    model: String,
}

pub(crate) async fn run(plan: Plan, reported: GatewayState) {
    let mut link = MachineLink::connect(&plan.link, &plan.identity).await.unwrap();
    let mut gateway = Gateway {
        trust: Trust {
            keys: plan.trusted.clone(),
            machine: plan.identity.machine.clone(),
            serial: plan.serial.clone(),
            axes: vec![AxisName::X, AxisName::Y, AxisName::Z],
            highest: 0,
        },
        reported,
        start: Instant::now(),
        number: 0,
        model: String::new(),
        plan,
    };
    let mut condition = tokio::time::interval(gateway.plan.condition_every);
    let mut telemetry = tokio::time::interval(gateway.plan.telemetry_every);
    for interval in [&mut condition, &mut telemetry] {
        interval.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Delay);
    }
    let full = gateway.plan.telemetry.get().len() > 2;
    loop {
        tokio::select! {
            value = link.next_desired() => gateway.desired(&link, &value).await,
            _ = condition.tick() => gateway.condition(&link).await,
            _ = telemetry.tick(), if full => {
                let body = Arc::clone(&gateway.plan.telemetry);
                gateway.send(&link, Kind::Telemetry, &*body).await;
            }
        }
    }
}

impl Gateway {
    /// Retries until the server has stored the message. The gateway creates no other message meanwhile, as with a full
    /// spool.
    async fn send<T: serde::Serialize>(&mut self, link: &MachineLink, kind: Kind, body: T) {
        self.number += 1;
        let envelope = Envelope {
            instance: self.plan.instance.clone(),
            number: self.number,
            uptime_s: self.start.elapsed().as_secs_f64(),
            wall_s: 0.0,
            version: self.reported.version.load(Ordering::Relaxed),
            model: self.model.clone(),
            body,
        };
        let bytes = bytes::Bytes::from(serde_json::to_vec(&envelope).unwrap());
        let id = format!("{}-{}", self.plan.instance, self.number);
        while link.publish(kind, &id, bytes.clone()).await.is_err() {
            tokio::time::sleep(Duration::from_millis(200)).await;
        }
        self.reported.all.fetch_add(1, Ordering::Relaxed);
        if kind == Kind::Condition {
            self.reported.conditions.fetch_add(1, Ordering::Relaxed);
        }
    }

    async fn condition(&mut self, link: &MachineLink) {
        let residual_um = *self.plan.residual_um.lock().unwrap();
        let axes = [AxisName::X, AxisName::Y, AxisName::Z];
        let sensors = ["bed", "column", "ram", "scale-x", "scale-y", "scale-z"];
        let condition = Condition {
            state: "compensating".to_owned(),
            reasons: Vec::new(),
            armed: true,
            correction_um: axes.map(|axis| (axis, 12.345)).into(),
            correction_urad: BTreeMap::new(),
            residual_um: Some(residual_um),
            temperatures_degc: sensors.map(|name| (name.to_owned(), Some(21.375))).into(),
            cycle_p99_us: 183.25,
            overruns: 3,
            faults: 1,
        };
        self.send(link, Kind::Condition, condition).await;
    }

    async fn desired(&mut self, link: &MachineLink, value: &[u8]) {
        let Ok(desired) = Desired::parse(value) else {
            self.reported.refused.fetch_add(1, Ordering::Relaxed);
            return;
        };
        let (version, outcome) = match self.trust.accept(&desired) {
            Ok(accepted) => {
                let version = accepted.manifest.version;
                let text = match accepted.model {
                    Some(text) => text,
                    None => link.fetch_model(&accepted.manifest.model).await.unwrap(),
                };
                let machine = volcomp_model::Machine::parse(&text, "model").unwrap();
                self.model = machine.checksum();
                self.trust.highest = version;
                self.reported.version.store(version, Ordering::Relaxed);
                (version, Outcome::Activated)
            }
            Err(volcomp_fleet::ManifestRejection::Version { .. }) => return,
            Err(error) => {
                self.reported.refused.fetch_add(1, Ordering::Relaxed);
                let why = error.to_string();
                (0, Outcome::Refused { why })
            }
        };
        let answer = Acknowledgement { version, value_sha256: ModelRef::of(value).sha256, outcome };
        self.send(link, Kind::Ack, answer).await;
    }
}
