//! Data records of the centre: machines, models, versions, roll-outs, alarms and its own audit log.
//!
//! Times are seconds since 1970 by the centre's clock. They are for display: no machine makes decisions from them.

use std::{collections::BTreeMap, fmt::Display};

use serde::{Deserialize, Serialize};
use volcomp_fleet::{Condition, Identity, MachineId, Outcome, is_public_nkey};
use volcomp_kinematics::Structure;
use volcomp_vocabulary::AxisName;

use crate::Error;

/// Maximum length of a text field of a machine, characters.
const MAX_TEXT: usize = 500;
/// Maximum interval of conditions and of full telemetry, s.
const MAX_INTERVAL_S: u32 = 86_400;
const MAX_DUE_DAYS: u32 = 36_500;

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Machine {
    #[serde(flatten)]
    pub identity: Identity,
    /// Serial number of the machine tool, as configured in its gateway.
    pub serial: String,
    /// The structure code, such as `w X' b Y Z t`.
    pub structure: String,
    pub axes: Vec<AxisName>,
    /// Public nkey of the machine's gateway, `U…`; `None`: no access to the server yet.
    #[serde(default)]
    pub nkey: Option<String>,
    /// Network address of the machine's control or gateway, for display.
    #[serde(default)]
    pub address: String,
    #[serde(default)]
    pub control: String,
    pub enable: bool,
    /// True if the machine is a canary, which receives the model of a roll-out first.
    #[serde(default)]
    pub canary: bool,
    /// Days after a calibration until the next one is due; `None`: never.
    #[serde(default)]
    pub due_days: Option<u32>,
    /// Seconds between two conditions; `None`: 1.
    #[serde(default)]
    pub condition_s: Option<u32>,
    /// Seconds between two full telemetry messages; `None`: 10.
    #[serde(default)]
    pub telemetry_s: Option<u32>,
    #[serde(default)]
    pub note: String,
}

impl Machine {
    /// A machine that is enabled, with every optional field empty.
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

    /// Age of the last condition beyond which a machine is silent, s: five condition intervals, but at least 15 s.
    /// Alarms, roll-outs, the web interface and the command line all use this limit.
    pub fn silent_after_s(&self) -> f64 {
        (5.0 * f64::from(self.condition_s.unwrap_or(1))).max(Self::SILENT_S)
    }

    /// True if the machine's last condition is older than [`silent_after_s`](Self::silent_after_s).
    pub fn is_silent(&self, age_s: f64) -> bool {
        age_s > self.silent_after_s()
    }

    /// Lower bound of [`silent_after_s`](Self::silent_after_s), s.
    pub const SILENT_S: f64 = 15.0;

    /// Validates a machine record from any source before it is stored: its axes must be those of its structure in chain order, its texts single
    /// lines, its nkey a public one, and its times within range.
    ///
    /// # Errors
    /// The first invalid field.
    pub fn check(&self) -> Result<(), Error> {
        let structure: Structure = self.structure.parse().map_err(|error| {
            let expected = format!("a structure code: {error}");
            invalid("structure", format!("{:?}", self.structure), expected)
        })?;
        if structure.axes() != self.axes {
            let expected = letters(structure.axes());
            let expected = format!("the axes of the structure in its order, {expected}");
            return Err(invalid("axes", letters(&self.axes), expected));
        }
        if self.serial.trim().is_empty() {
            let found = format!("{:?}", self.serial);
            return Err(invalid("serial", found, "the serial number of the machine tool"));
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
            // The text may be the secret seed, so messages must not contain it.
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

pub(crate) fn letters(axes: &[AxisName]) -> String {
    let letters: Vec<String> = axes.iter().map(ToString::to_string).collect();
    letters.join(" ")
}

#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "kebab-case")]
pub enum Origin {
    #[serde(alias = "form")]
    File {
        /// Name; empty if the text was submitted without a file.
        #[serde(default)]
        name: String,
    },
    /// A calibration file; only in databases of earlier program versions.
    Calibration { path: String },
}

/// A model: the text of a machine file, stored once under its checksum.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Model {
    /// SHA-256 of the model's text, 64 hexadecimal digits.
    pub sha256: String,
    pub bytes: u64,
    /// Checksum of the model's content, in the form in which a gateway reports its active model.
    pub checksum: String,
    pub name: String,
    pub structure: String,
    pub axes: Vec<AxisName>,
    pub origin: Origin,
    /// Day of the measurements, `2026-11-25`; empty if unknown.
    #[serde(default)]
    pub measured: String,
    pub added_s: f64,
    pub by: String,
    /// Notes for the user: errors that were not measured, unusual values.
    #[serde(default)]
    pub notes: Vec<String>,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Version {
    pub machine: MachineId,
    /// Version number, higher than every earlier one of the machine.
    pub version: u64,
    pub model: String,
    pub enable: bool,
    pub confirm: Option<String>,
    /// Seconds between two conditions; `None`: 1.
    #[serde(default)]
    pub condition_s: Option<u32>,
    /// Seconds between two full telemetry messages; `None`: 10.
    #[serde(default)]
    pub telemetry_s: Option<u32>,
    /// SHA-256 of the bytes of the signed value.
    pub value_sha256: String,
    pub rollout: Option<u64>,
    pub issued_s: f64,
    pub by: String,
    pub outcome: Option<Outcome>,
    pub answered_s: Option<f64>,
    /// True if another version replaced this one under the machine's key, because its roll-out stopped before the
    /// machine reported this version as active. A machine that accepted this version nevertheless uses it until it
    /// accepts the replacement.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub withdrawn: bool,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Severity {
    Note,
    /// Needs attention, but not urgently.
    Warning,
    /// Needs attention immediately.
    Alarm,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum AlarmKind {
    Faulted,
    /// No condition is received from the machine.
    Silent,
    /// Two gateways have the identity of one machine.
    Clone,
    /// Messages of the machine are missing.
    Gap,
    /// The value under the machine's key was foreign, and the centre restored its own.
    Clobbered,
    Refused,
    NeedsConfirmation,
    /// A roll-out waits for the machine to compensate.
    Idle,
    Sensor,
    /// A message could not be read.
    Unreadable,
    OtherModel,
    /// The machine has the model of a roll-out that stopped or was aborted before completion.
    Suspect,
    Due,
    Rollout,
    /// The database rejects writes.
    Store,
    Server,
}

impl AlarmKind {
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

/// A problem for the user: open until its cause has ended.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Alarm {
    pub id: u64,
    /// The machine; `None`: the centre itself.
    pub machine: Option<MachineId>,
    pub kind: AlarmKind,
    pub severity: Severity,
    pub text: String,
    pub since_s: f64,
    /// Time at which the cause ended, s; `None`: the cause persists.
    pub until_s: Option<f64>,
    pub seen_by: Option<String>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Resolution {
    /// Every received condition, kept for a day.
    Raw,
    /// One-minute means, kept for a month.
    Minute,
    /// One-hour means, kept indefinitely.
    Hour,
}

#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Point {
    pub at_s: f64,
    pub count: u64,
    /// State of the guard; for a mean, the worst state of the combined points.
    pub state: String,
    /// Mean residual, µm; `None` if unknown.
    pub residual_um: Option<f64>,
    pub residual_max_um: Option<f64>,
    /// Mean correction by linear axis, µm.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub correction_um: BTreeMap<AxisName, f64>,
    /// Mean correction by rotary axis, µrad.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub correction_urad: BTreeMap<AxisName, f64>,
    /// Mean temperatures, °C; sensors that were broken the whole time are omitted.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub temperatures_degc: BTreeMap<String, f64>,
    pub cycle_p99_us: f64,
    /// Number of cycles since the gateway started that exceeded their period; latest value.
    pub overruns: u64,
    /// Number of failed exchanges with controllers since the gateway started; latest value.
    pub faults: u64,
}

/// States of the guard from best to worst. A mean has the worst state of its conditions.
const STATES: [&str; 7] =
    ["compensating", "disarmed", "arming", "holding", "ramping-out", "unknown", "faulted"];

/// Severity of a state; an unlisted state is as severe as `faulted`.
fn badness(state: &str) -> usize {
    let place = STATES.iter().position(|one| *one == state);
    place.unwrap_or(STATES.len() - 1)
}

/// Rounds to three decimals, which exceeds the resolution of any instrument.
fn round(value: f64) -> f64 {
    (value * 1e3).round() / 1e3 + 0.0
}

/// Rounds a value; `None` if the result is not finite. JSON cannot represent such values, so their row could not be
/// read again.
fn finite(value: f64) -> Option<f64> {
    Some(round(value)).filter(|value| value.is_finite())
}

impl Point {
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

    /// Combines points, given in ascending order of time. Means are weighted by count over the points in which the
    /// value is known. `None` if `points` is empty.
    pub(crate) fn mean(points: &[Self], at_s: f64) -> Option<Self> {
        let last = points.last()?;
        let worst = points.iter().max_by_key(|point| badness(&point.state))?;
        let residuals = points.iter().filter_map(|point| Some((point.count, point.residual_um?)));
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

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Live {
    pub machine: MachineId,
    /// Time at which the server stored the machine's last message, s.
    pub heard_s: f64,
    pub instance: String,
    /// Version of the active manifest; 0: none.
    pub version: u64,
    /// Checksum of the active machine file, as reported by the gateway.
    pub model: String,
    pub condition: Option<Condition>,
    /// Number of permanently lost messages.
    pub lost: u64,
    /// Creation time of the last condition; `None` without a condition, or if an older program stored the condition.
    #[serde(default)]
    pub made: Option<CreationTime>,
}

#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct CreationTime {
    /// Creation time, s by the server's clock.
    pub at_s: f64,
    /// Delay until the server stored the condition (queue and transit), s; 0 if unknown.
    pub late_s: f64,
}

impl Live {
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

    /// Creation time of the last condition. For data of an older program: storage time of the last message.
    pub fn made(&self) -> Option<CreationTime> {
        let stored = CreationTime { at_s: self.heard_s, late_s: 0.0 };
        self.condition.as_ref().map(|_| self.made.unwrap_or(stored))
    }
}

/// Record of the centre's own audit log. Its hash also covers the hash of the previous record.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct AuditRecord {
    /// Number of the record, from 1.
    pub number: u64,
    pub at_s: f64,
    /// Author: a user name, or `centre` for automatic actions.
    pub by: String,
    /// Action, such as `machine.add`.
    pub action: String,
    /// Object of the action: machine name, model checksum, roll-out number or user name.
    pub object: String,
    pub details: serde_json::Value,
    /// SHA-256 over the hash of the previous record and this record as stored, hexadecimal.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub hash: String,
}
