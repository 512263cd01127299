//! What the centre knows, as plain data: machines, models, versions, roll-outs, alarms, and its own audit log.
//!
//! Times are seconds since 1970 by the clock of the centre, and are for people: no machine decides anything by them.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};
use volcomp_fleet::{Identity, MachineId, Outcome};
use volcomp_vocabulary::AxisName;

/// A machine that is registered.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Machine {
    /// Its site and its name.
    #[serde(flatten)]
    pub identity: Identity,
    /// The serial number of the machine tool, as its gateway has it.
    pub serial: String,
    /// The structure code, such as `w X' b Y Z t`.
    pub structure: String,
    /// The axes in machine order.
    pub axes: Vec<AxisName>,
    /// The public nkey of its gateway, `U…`; `None`: it has no access to the server yet.
    #[serde(default)]
    pub nkey: Option<String>,
    /// Where its control or its gateway was found, for people.
    #[serde(default)]
    pub address: String,
    /// The make of its control, for people.
    #[serde(default)]
    pub control: String,
    /// Whether it may be corrected.
    pub enable: bool,
    /// Whether it is among the first of a roll-out.
    #[serde(default)]
    pub canary: bool,
    /// Days after a calibration until the next one is due; `None`: never.
    #[serde(default)]
    pub due_days: Option<u32>,
    /// Seconds between two conditions; `None`: 1.
    #[serde(default)]
    pub condition_s: Option<u32>,
    /// Seconds between two whole states; `None`: 10.
    #[serde(default)]
    pub telemetry_s: Option<u32>,
    /// What else is to be known.
    #[serde(default)]
    pub note: String,
}

impl Machine {
    /// A machine that may be corrected and of which nothing else is known.
    pub fn new(identity: Identity, serial: String, structure: String, axes: Vec<AxisName>) -> Self {
        Self {
            identity,
            serial,
            structure,
            axes,
            nkey: None,
            address: String::new(),
            control: String::new(),
            enable: true,
            canary: false,
            due_days: None,
            condition_s: None,
            telemetry_s: None,
            note: String::new(),
        }
    }

    /// A machine of which no condition came for longer than this is not heard, s: five of its intervals, and at least 15 s.
    /// Alarms, roll-outs, the page and the command line go by it alike.
    pub fn silent_after_s(&self) -> f64 {
        (5.0 * f64::from(self.condition_s.unwrap_or(1))).max(Self::SILENT_S)
    }

    /// Whether it is not heard any more: its last condition is older than [`silent_after_s`](Self::silent_after_s).
    pub fn is_silent(&self, age_s: f64) -> bool {
        age_s > self.silent_after_s()
    }

    /// No machine is silent before this, s.
    pub const SILENT_S: f64 = 15.0;
}

/// Where a model comes from.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "kebab-case")]
pub enum Origin {
    /// A machine file.
    #[serde(alias = "form")]
    File {
        /// Its name; empty where the interface received a text alone.
        #[serde(default)]
        name: String,
    },
    /// A calibration file: in databases of earlier programs.
    Calibration {
        /// The path of the calibration file.
        path: String,
    },
}

/// A model: the text of a machine file, stored once under its checksum.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Model {
    /// SHA-256 of its text, 64 hexadecimal digits.
    pub sha256: String,
    /// Its length, bytes.
    pub bytes: u64,
    /// The checksum of what it states, as a gateway tells it of the model that corrects.
    pub checksum: String,
    /// The name in the machine file.
    pub name: String,
    /// The structure code.
    pub structure: String,
    /// The axes in machine order.
    pub axes: Vec<AxisName>,
    /// Where it comes from.
    pub origin: Origin,
    /// When the measurements behind it were made, `2026-11-25`; empty where that is not known.
    #[serde(default)]
    pub measured: String,
    /// When it was added, s.
    pub added_s: f64,
    /// Who added it.
    pub by: String,
    /// What a person should read: errors not measured, odd values.
    #[serde(default)]
    pub notes: Vec<String>,
}

/// A manifest that was issued for a machine, and what became of it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Version {
    pub machine: MachineId,
    /// The version, larger than that of every one before.
    pub version: u64,
    /// The checksum of the model.
    pub model: String,
    /// Whether the machine may be corrected.
    pub enable: bool,
    /// The hash by which a person confirmed it.
    pub confirm: Option<String>,
    /// Seconds between two conditions; `None`: 1.
    #[serde(default)]
    pub condition_s: Option<u32>,
    /// Seconds between two whole states; `None`: 10.
    #[serde(default)]
    pub telemetry_s: Option<u32>,
    /// SHA-256 of the bytes of the signed value.
    pub value_sha256: String,
    /// The roll-out to which it belongs.
    pub rollout: Option<u64>,
    /// When it was issued, s.
    pub issued_s: f64,
    /// Who issued it.
    pub by: String,
    /// The last answer of the machine.
    pub outcome: Option<Outcome>,
    /// When that came, s.
    pub answered_s: Option<f64>,
    /// Whether another version was put under the key of the machine in its place because its roll-out had stopped before the
    /// machine told that this one is in force. A machine that has taken it all the same corrects with it until it takes the other one.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub withdrawn: bool,
}

/// How bad an alarm is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Severity {
    Note,
    /// A person should look when there is time.
    Warning,
    /// A person must look now.
    Alarm,
}

/// What an alarm is about.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum AlarmKind {
    /// The guard of the machine is faulted.
    Faulted,
    /// The machine is not heard.
    Silent,
    /// Two gateways have the identity of one machine.
    Clone,
    /// Messages of the machine are missing.
    Gap,
    /// The value of its key was another one than the centre's, and was put back.
    Clobbered,
    /// The machine refused a manifest.
    Refused,
    /// A change must be confirmed by a person.
    NeedsConfirmation,
    /// A roll-out waits for the machine to compensate.
    Idle,
    /// A temperature is broken.
    Sensor,
    /// A message could not be read.
    Unreadable,
    /// The machine runs another model than it shall.
    OtherModel,
    /// The machine has the model of a roll-out that stopped or was ended before it was done.
    Suspect,
    /// A calibration is due.
    Due,
    /// A roll-out was stopped.
    Rollout,
    /// The database takes nothing.
    Store,
    /// The server is not reached.
    Server,
}

impl AlarmKind {
    /// The name as it stands in JSON and in the database.
    pub fn name(self) -> &'static str {
        match self {
            Self::Faulted => "faulted",
            Self::Silent => "silent",
            Self::Clone => "clone",
            Self::Gap => "gap",
            Self::Clobbered => "clobbered",
            Self::Refused => "refused",
            Self::NeedsConfirmation => "needs-confirmation",
            Self::Idle => "idle",
            Self::Sensor => "sensor",
            Self::Unreadable => "unreadable",
            Self::OtherModel => "other-model",
            Self::Suspect => "suspect",
            Self::Due => "due",
            Self::Rollout => "rollout",
            Self::Store => "store",
            Self::Server => "server",
        }
    }

    /// How bad it is.
    pub fn severity(self) -> Severity {
        match self {
            Self::Due | Self::Gap => Severity::Note,
            Self::Silent
            | Self::NeedsConfirmation
            | Self::Idle
            | Self::Sensor
            | Self::Unreadable
            | Self::OtherModel
            | Self::Suspect => Severity::Warning,
            Self::Faulted
            | Self::Clone
            | Self::Clobbered
            | Self::Refused
            | Self::Rollout
            | Self::Store
            | Self::Server => Severity::Alarm,
        }
    }
}

/// Something that a person should see: open until what caused it has gone.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Alarm {
    /// Its number.
    pub id: u64,
    /// The machine; `None`: the centre itself.
    pub machine: Option<MachineId>,
    /// What it is about.
    pub kind: AlarmKind,
    /// How bad it is.
    pub severity: Severity,
    /// What happened, a sentence.
    pub text: String,
    /// Since when, s.
    pub since_s: f64,
    /// When the cause went away, s; `None`: it is there.
    pub until_s: Option<f64>,
    pub seen_by: Option<String>,
}

/// A resolution of the history of conditions.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Resolution {
    /// Every condition as it came, kept for a day.
    Raw,
    /// Means of minutes, kept for a month.
    Minute,
    /// Means of hours, kept for ever.
    Hour,
}

/// One point of the history of a machine.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Point {
    /// When it begins, s.
    pub at_s: f64,
    /// How many conditions it was made of.
    pub count: u64,
    /// The state of the guard; of several the worst.
    pub state: String,
    /// The mean residual, µm; `None` while it was not known.
    pub residual_um: Option<f64>,
    /// The largest residual, µm.
    pub residual_max_um: Option<f64>,
    /// The mean correction by linear axis, µm.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub correction_um: BTreeMap<AxisName, f64>,
    /// The mean correction by rotary axis, µrad.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub correction_urad: BTreeMap<AxisName, f64>,
    /// The mean temperatures, °C; one that was broken all the time is left out.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub temperatures_degc: BTreeMap<String, f64>,
    /// The largest 99th percentile of the time of a cycle, µs.
    pub cycle_p99_us: f64,
    /// Cycles that took too long since the start of the gateway, the last value.
    pub overruns: u64,
    /// Exchanges with controllers that failed since the start of the gateway, the last value.
    pub faults: u64,
}

/// What is known of a machine now.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Live {
    pub machine: MachineId,
    /// When its last message was stored at the server, s.
    pub heard_s: f64,
    /// The gateway that sent it, drawn at its start.
    pub instance: String,
    /// The version of the manifest that is in force; 0: none.
    pub version: u64,
    /// The checksum of the machine file that corrects, as the gateway tells it.
    pub model: String,
    /// The last condition.
    pub condition: Option<volcomp_fleet::Condition>,
    /// Messages that are missing for good.
    pub lost: u64,
    /// When the last condition was made; `None`: there is none, or it was stored by an older program.
    #[serde(default)]
    pub made: Option<ConditionMade>,
}

/// When a condition was made.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct ConditionMade {
    /// s by the clock of the server.
    pub at_s: f64,
    /// For how long it waited and was on its way until the server stored it, s.
    pub late_s: f64,
}

impl Live {
    /// A machine of which no more is known.
    pub fn new(machine: MachineId, heard_s: f64, version: u64) -> Self {
        Self {
            machine,
            heard_s,
            instance: String::new(),
            version,
            model: String::new(),
            condition: None,
            lost: 0,
            made: None,
        }
    }

    /// When the last condition was made. Of an older program: when the last message was stored.
    pub fn made(&self) -> Option<ConditionMade> {
        let stored = ConditionMade {
            at_s: self.heard_s,
            late_s: 0.0,
        };
        self.condition.as_ref().map(|_| self.made.unwrap_or(stored))
    }
}

/// One record of the centre's own audit log. Its hash covers the one before.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct AuditRecord {
    /// Its number, from 1.
    pub number: u64,
    /// When, s.
    pub at_s: f64,
    /// Who: the name of a user, or `centre` for what the program did by itself.
    pub by: String,
    /// What was done, such as `machine.add`.
    pub action: String,
    /// To what: the name of a machine, the checksum of a model, the number of a roll-out, the name of a user.
    pub object: String,
    /// Further facts.
    pub details: serde_json::Value,
    /// SHA-256 of the hash of the record before and of this one as it is stored, hexadecimal.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub hash: String,
}
