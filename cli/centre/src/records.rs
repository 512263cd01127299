//! What the centre knows, as plain data: machines, models, versions, roll-outs, alarms, and its own audit log.
//!
//! Times are seconds since 1970 by the clock of the centre, and are for people: no machine decides anything by them.

use std::{collections::BTreeMap, fmt::Display};

use serde::{Deserialize, Serialize};
use volcomp_fleet::{Condition, Identity, MachineId, Outcome, is_public_nkey};
use volcomp_kinematics::Structure;
use volcomp_vocabulary::AxisName;

use crate::Error;

/// Maximum length of a text of a machine, characters.
const MAX_TEXT: usize = 500;
/// Maximum interval of conditions and of whole states, s.
const MAX_INTERVAL_S: u32 = 86_400;
/// Maximum time between two calibrations, days.
const MAX_DUE_DAYS: u32 = 36_500;

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Machine {
    #[serde(flatten)]
    pub identity: Identity,
    /// The serial number of the machine tool, as its gateway has it.
    pub serial: String,
    /// The structure code, such as `w X' b Y Z t`.
    pub structure: String,
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

    /// Checks what is known of a machine, wherever it comes from, before it is stored: its axes are those of its structure in chain
    /// order, its texts are single lines, its nkey is a public one, and its times are within range.
    ///
    /// # Errors
    /// The first that is wrong.
    pub fn check(&self) -> Result<(), Error> {
        let structure: Structure = self.structure.parse().map_err(|error| {
            let expected = format!("a structure code: {error}");
            invalid("structure", format!("{:?}", self.structure), expected)
        })?;
        if structure.axes() != self.axes {
            let expected = letters(structure.axes());
            let expected = format!("those of the structure in its order, {expected}");
            return Err(invalid("axes", letters(&self.axes), expected));
        }
        if self.serial.trim().is_empty() {
            let found = format!("{:?}", self.serial);
            return Err(invalid(
                "serial",
                found,
                "the serial number of the machine tool",
            ));
        }
        for (key, text) in [
            ("serial", &self.serial),
            ("address", &self.address),
            ("control", &self.control),
            ("note", &self.note),
        ] {
            if text.chars().count() > MAX_TEXT || text.contains(char::is_control) {
                let found: String = text.chars().take(80).collect();
                let expected = format!("one line of at most {MAX_TEXT} characters");
                return Err(invalid(key, format!("{found:?}"), expected));
            }
        }
        if let Some(nkey) = self.nkey.as_ref().filter(|nkey| !is_public_nkey(nkey)) {
            // What was found may be the seed, which belongs into no message.
            let found = format!("{} characters", nkey.chars().count());
            let expected = "the public nkey of the gateway's user, U and 55 letters and digits";
            return Err(invalid("nkey", found, expected));
        }
        for (key, value, max, unit) in [
            ("condition_s", self.condition_s, MAX_INTERVAL_S, "s"),
            ("telemetry_s", self.telemetry_s, MAX_INTERVAL_S, "s"),
            ("due_days", self.due_days, MAX_DUE_DAYS, "days"),
        ] {
            if let Some(found) = value.filter(|value| !(1..=max).contains(value)) {
                return Err(invalid(key, found, format!("1 to {max} {unit}")));
            }
        }
        Ok(())
    }
}

fn invalid(key: &str, found: impl Display, expected: impl Display) -> Error {
    Error::Wrong(format!("{key}: found {found}, expected {expected}"))
}

/// The letters of axes, separated by blanks.
pub(crate) fn letters(axes: &[AxisName]) -> String {
    let letters: Vec<String> = axes.iter().map(ToString::to_string).collect();
    letters.join(" ")
}

#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "kebab-case")]
pub enum Origin {
    #[serde(alias = "form")]
    File {
        /// Its name; empty where the interface received a text alone.
        #[serde(default)]
        name: String,
    },
    /// A calibration file: in databases of earlier programs.
    Calibration { path: String },
}

/// A model: the text of a machine file, stored once under its checksum.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Model {
    /// SHA-256 of its text, 64 hexadecimal digits.
    pub sha256: String,
    pub bytes: u64,
    /// The checksum of what it states, as a gateway tells it of the model that corrects.
    pub checksum: String,
    pub name: String,
    pub structure: String,
    pub axes: Vec<AxisName>,
    pub origin: Origin,
    /// When the measurements behind it were made, `2026-11-25`; empty where that is not known.
    #[serde(default)]
    pub measured: String,
    pub added_s: f64,
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
    pub model: String,
    pub enable: bool,
    pub confirm: Option<String>,
    /// Seconds between two conditions; `None`: 1.
    #[serde(default)]
    pub condition_s: Option<u32>,
    /// Seconds between two whole states; `None`: 10.
    #[serde(default)]
    pub telemetry_s: Option<u32>,
    /// SHA-256 of the bytes of the signed value.
    pub value_sha256: String,
    pub rollout: Option<u64>,
    pub issued_s: f64,
    pub by: String,
    pub outcome: Option<Outcome>,
    pub answered_s: Option<f64>,
    /// Whether another version was put under the key of the machine in its place because its roll-out had stopped before the
    /// machine told that this one is in force. A machine that has taken it all the same corrects with it until it takes the other one.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub withdrawn: bool,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Severity {
    Note,
    /// A person should look when there is time.
    Warning,
    /// A person must look now.
    Alarm,
}

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
    Refused,
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
    Due,
    Rollout,
    /// The database takes nothing.
    Store,
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
    pub id: u64,
    /// The machine; `None`: the centre itself.
    pub machine: Option<MachineId>,
    pub kind: AlarmKind,
    pub severity: Severity,
    /// What happened, a sentence.
    pub text: String,
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

#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Point {
    pub at_s: f64,
    /// How many conditions it was made of.
    pub count: u64,
    /// The state of the guard; of several the worst.
    pub state: String,
    /// The mean residual, µm; `None` while it was not known.
    pub residual_um: Option<f64>,
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

/// The states of the guard, the best first: of several the last one counts.
const STATES: [&str; 7] = [
    "compensating",
    "disarmed",
    "arming",
    "holding",
    "ramping-out",
    "unknown",
    "faulted",
];

/// How bad a state is; one that is not known is worse than `unknown`.
fn badness(state: &str) -> usize {
    let place = STATES.iter().position(|one| *one == state);
    place.unwrap_or(STATES.len() - 1)
}

/// Three digits behind the point are more than any instrument has told.
fn round(value: f64) -> f64 {
    (value * 1e3).round() / 1e3 + 0.0
}

/// A number that is still one when it is rounded: JSON has no other, and a row that holds another is never read again.
fn finite(value: f64) -> Option<f64> {
    Some(round(value)).filter(|value| value.is_finite())
}

impl Point {
    /// The point of one condition.
    pub(crate) fn of(condition: &Condition, at_s: f64) -> Self {
        let known = condition.residual_um.and_then(finite);
        Self {
            at_s: round(at_s),
            count: 1,
            state: condition.state.clone(),
            residual_um: known,
            residual_max_um: known,
            correction_um: rounded(&condition.correction_um),
            correction_urad: rounded(&condition.correction_urad),
            temperatures_degc: (condition.temperatures_degc.iter())
                .filter_map(|(name, degc)| Some((name.clone(), finite((*degc)?)?)))
                .collect(),
            cycle_p99_us: finite(condition.cycle_p99_us).unwrap_or(0.0),
            overruns: condition.overruns,
            faults: condition.faults,
        }
    }

    /// One point for several, in rising order of time: means weighted by their counts, over the points in which the value is
    /// known. `None`: there are none.
    pub(crate) fn mean(points: &[Self], at_s: f64) -> Option<Self> {
        let last = points.last()?;
        let worst = points.iter().max_by_key(|point| badness(&point.state))?;
        let residuals = points
            .iter()
            .filter_map(|point| Some((point.count, point.residual_um?)));
        let largest = points.iter().filter_map(|point| point.residual_max_um);
        Some(Self {
            at_s,
            count: points.iter().map(|point| point.count).sum(),
            state: worst.state.clone(),
            residual_um: weighted(residuals),
            residual_max_um: largest.reduce(f64::max),
            correction_um: by_name(points, |point| &point.correction_um),
            correction_urad: by_name(points, |point| &point.correction_urad),
            temperatures_degc: by_name(points, |point| &point.temperatures_degc),
            cycle_p99_us: (points.iter().map(|point| point.cycle_p99_us)).fold(0.0, f64::max),
            overruns: last.overruns,
            faults: last.faults,
        })
    }
}

fn rounded<K: Ord + Clone>(values: &BTreeMap<K, f64>) -> BTreeMap<K, f64> {
    let known = |(key, value): (&K, &f64)| Some((key.clone(), finite(*value)?));
    values.iter().filter_map(known).collect()
}

fn weighted(values: impl Iterator<Item = (u64, f64)>) -> Option<f64> {
    let (mut weight, mut sum) = (0.0, 0.0);
    for (count, value) in values {
        weight += count as f64;
        sum += count as f64 * value;
    }
    finite(sum / weight)
}

fn by_name<K: Ord + Clone>(
    points: &[Point],
    values: impl Fn(&Point) -> &BTreeMap<K, f64>,
) -> BTreeMap<K, f64> {
    let mut sums: BTreeMap<K, (f64, f64)> = BTreeMap::new();
    for point in points {
        for (name, value) in values(point) {
            let (weight, sum) = sums.entry(name.clone()).or_default();
            *weight += point.count as f64;
            *sum += point.count as f64 * value;
        }
    }
    let known = |(name, (weight, sum)): (K, (f64, f64))| Some((name, finite(sum / weight)?));
    sums.into_iter().filter_map(known).collect()
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
    pub condition: Option<Condition>,
    /// Messages that are missing for good.
    pub lost: u64,
    /// When the last condition was made; `None`: there is none, or it was stored by an older program.
    #[serde(default)]
    pub made: Option<Made>,
}

/// When a message was made.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Made {
    /// s by the clock of the server.
    pub at_s: f64,
    /// For how long it waited and was on its way until the server stored it, s; 0 where that is not known.
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
    pub fn made(&self) -> Option<Made> {
        let stored = Made {
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
    pub at_s: f64,
    /// Who: the name of a user, or `centre` for what the program did by itself.
    pub by: String,
    /// What was done, such as `machine.add`.
    pub action: String,
    /// To what: the name of a machine, the checksum of a model, the number of a roll-out, the name of a user.
    pub object: String,
    pub details: serde_json::Value,
    /// SHA-256 of the hash of the record before and of this one as it is stored, hexadecimal.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub hash: String,
}
