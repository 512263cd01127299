//! The records of the audit log, and their texts with advice to the operator.

use std::{collections::BTreeMap, fmt::Write};

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use time::{OffsetDateTime, format_description::well_known::Rfc3339};
use volcomp_guard::Reasons;
use volcomp_port::Description;
use volcomp_runtime::Model;
use volcomp_vocabulary::AxisName;

use crate::documents::{ByAxis, StateName};

/// Changed limits, rates and accelerations by configuration key: old and new value.
pub type LimitChanges = BTreeMap<String, [Option<f64>; 2]>;

/// The JSON part of one line of the audit log.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Record {
    /// Record number from 1, continued from file to file.
    pub seq: u64,
    /// The kernel's boot ID.
    pub boot: String,
    /// Time since that boot by the monotonic clock, s.
    pub monotonic_s: f64,
    /// Wall time, ISO 8601 in UTC.
    pub time: String,
    /// The requester: the name of a token, `local user without a token` for a disarm on the gateway's own computer,
    /// `signal`, `auto_arm`, `centre` with the beginning of its key, `unknown` for a manifest that no trusted key has
    /// signed, or `gateway` for events without a request.
    pub who: String,
    /// Short description of the event.
    pub what: String,
    /// Details of the event.
    pub details: Details,
    /// Number of records directly before this one that could not be written because the disk was
    /// full, removed or did not respond.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub lost: u64,
    /// Checksum of the previous record; empty in the first.
    pub previous: String,
}

#[expect(clippy::trivially_copy_pass_by_ref, reason = "serde passes a reference")]
fn is_zero(count: &u64) -> bool {
    *count == 0
}

/// State at the time of a record, and details of the event.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Details {
    /// Hash of the active machine file.
    pub model: String,
    /// Correction applied to each linear axis at the time of the record, µm; empty if unknown.
    #[serde(default)]
    #[schemars(with = "BTreeMap<String, f64>")]
    pub output_um: ByAxis,
    /// Correction applied to each rotary axis at the time of the record, µrad; empty if unknown.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    #[schemars(with = "BTreeMap<String, f64>")]
    pub output_urad: ByAxis,
    /// Details specific to this kind of event.
    pub what: Event,
}

/// Details specific to the kind of event.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(untagged)]
pub enum Event {
    /// The gateway started.
    Start(Start),
    /// The state of the guard changed.
    StateChange(StateChange),
    /// The gateway stopped.
    Stop(Stop),
    /// The configuration was reloaded.
    Reload {
        /// Hash of the previous model.
        from: String,
        /// Hash of the new model.
        to: String,
        /// Changed limits, rates and accelerations by configuration key: old and new value; null if
        /// missing.
        #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
        limits: LimitChanges,
        /// Source of the model; only if a person chose it.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        model_of: Option<String>,
    },
    /// A request of an operator, a program or a signal.
    Request {
        /// The state when the request was received.
        state: StateName,
    },
    /// A refusal, with its reason.
    Refused(String),
    /// The event has no details.
    Nothing,
}

/// State of the audit log at start-up, and the version of the gateway.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct Start {
    /// Complete records in the current file of the log.
    pub records: u64,
    /// Length of an incomplete last record that was cut off, bytes.
    pub cut_bytes: u64,
    /// The file with a broken chain that was moved aside.
    pub broken: Option<Broken>,
    /// The version of the gateway.
    pub version: String,
}

/// A file of the log whose chain was broken.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct Broken {
    /// Number of the first line that does not continue the chain, from 1.
    pub line: u64,
    /// Name under which the file was moved aside.
    pub aside: String,
}

/// A change of the state of the guard.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct StateChange {
    /// The new state.
    pub state: StateName,
    /// Index of the active controller, from 0.
    pub controller: usize,
    /// Reasons for the state, causes first.
    pub reasons: Vec<String>,
    /// Number of the cycle in which the state changed.
    pub cycle: u64,
    /// Whether the state is `arming` with a test shift, before the correction ramps in.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub test_shift: bool,
}

/// The state in which the gateway left the machine.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Stop {
    /// State of the guard at the end.
    pub state: StateName,
    /// Correction that remained applied to each linear axis, µm; empty if unknown.
    #[schemars(with = "BTreeMap<String, f64>")]
    pub left_um: ByAxis,
    /// Correction that remained applied to each rotary axis, µrad; empty if unknown.
    #[schemars(with = "BTreeMap<String, f64>")]
    pub left_urad: ByAxis,
}

/// The file `output.json` in the folder of the log: the output at the end, for controllers without read-back. Only a
/// gateway that ended properly leaves it, and the next start removes it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct LastOutput {
    /// The kernel's boot ID when the file was written; the output is ignored after a reboot.
    pub boot: String,
    /// Time of writing by the monotonic clock of that boot, s.
    pub monotonic_s: f64,
    /// Letters of the machine's axes in the order of its chain. The output is ignored if they
    /// differ.
    pub axes: String,
    /// Devices of the controllers in order. The output is ignored if they differ.
    pub controllers: Vec<String>,
    /// The output of each axis in the order of the machine's chain: mm for linear axes, rad for rotary ones.
    pub correction: Vec<f64>,
}

impl LastOutput {
    pub(crate) fn belongs_to(model: &Model, controllers: &[Description]) -> (String, Vec<String>) {
        let axes = model.axes.iter().map(|name| name.letter()).collect();
        let devices = controllers.iter().map(|one| one.device.clone());
        (axes, devices.collect())
    }
}

/// State that survives a restart of the gateway: the text in the slots of the file `standing.slots` in the folder of the log.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct Standing {
    /// Name in the audit log of the operator who disarmed last, `unknown` if the file was
    /// unreadable; null after the next arming by an operator.
    pub disarmed_by: Option<String>,
    /// The reasons of an unacknowledged fault; null without one.
    pub faulted: Option<Vec<String>>,
    /// Names of the sensors that are rejected because their value jumped.
    #[serde(default)]
    pub jumped: Vec<String>,
    /// Letters of the axes whose position is rejected because it jumped. Automatic arming waits until an operator arms.
    #[serde(default)]
    #[schemars(with = "Vec<String>")]
    pub jumped_axes: Vec<AxisName>,
    /// The interlocks that each controller, by its device, showed last. They apply until the same controller reports them clear, or an
    /// operator acknowledges them.
    #[serde(default)]
    pub interlocks: BTreeMap<String, Vec<String>>,
}

/// The file `confirmed-limits.json` in the folder of the log: the limits, rates and accelerations at the last arming, by
/// configuration key, and the keys of controllers and thermometers. A value that is not a number is part of its key, which has the value 1.
pub type ConfirmedLimits = BTreeMap<String, f64>;

/// The answer to `GET /api/log`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct EventLog {
    /// The events, newest first.
    pub events: Vec<LogEvent>,
}

/// One record of the audit log.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct LogEvent {
    /// Number of the record.
    pub seq: u64,
    /// Wall time, s since 1970 by the clock of the gateway's computer.
    pub time_s: f64,
    /// Kind of the event.
    pub kind: EventKind,
    /// The requester; missing for events without a request.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub who: Option<String>,
    /// The event in words.
    pub text: String,
    /// What the operator can do, causes first; empty: nothing.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub advice: Vec<String>,
}

/// Kind of an event.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum EventKind {
    /// The gateway started or stopped.
    Program,
    /// A request that took effect or will.
    Request,
    /// A request that was refused.
    Refused,
    /// Configuration or machine file were read again, or another model was activated.
    Reload,
    /// The test shift before the correction ramps in.
    TestShift,
    /// The correction ramps in.
    Arming,
    /// The correction follows the model.
    Compensating,
    /// The correction is held.
    Holding,
    /// The correction ramps to zero.
    RampingOut,
    /// Nothing is written.
    Disarmed,
    /// A fault.
    Faulted,
    /// Something else.
    Other,
}

impl From<&Record> for LogEvent {
    fn from(record: &Record) -> Self {
        let who = Some(&record.who).filter(|who| *who != "gateway").cloned();
        let mut advice = Vec::new();
        let (kind, mut text) = match &record.details.what {
            Event::Start(start) => {
                let mut text = format!("Gateway {} started", start.version);
                if let Some(broken) = &start.broken {
                    let _ = write!(
                        text,
                        "; line {} of the audit log did not belong to its chain: the file is now {}",
                        broken.line, broken.aside
                    );
                }
                (EventKind::Program, text)
            }
            Event::StateChange(change) => {
                advice = advice_on(change);
                in_words(change)
            }
            Event::Stop(_) => (EventKind::Program, format!("Gateway {}", record.what)),
            Event::Reload { from, to, limits, .. } => {
                let mut text = capital(&record.what);
                if from != to {
                    let _ = write!(text, ": machine file {} replaces {}", short(to), short(from));
                }
                for (key, [old, new]) in limits {
                    let value =
                        |value: &Option<f64>| value.map_or("none".to_owned(), |v| v.to_string());
                    let _ = write!(text, "; {key}: {} → {}", value(old), value(new));
                }
                (EventKind::Reload, text)
            }
            Event::Request { .. } => (EventKind::Request, capital(&record.what)),
            Event::Refused(why) => {
                (EventKind::Refused, format!("{}: {why}", capital(&record.what)))
            }
            Event::Nothing => {
                let reason = Reasons::with_text(&record.what).and_then(Reasons::advice);
                advice.extend(reason.map(str::to_owned));
                (EventKind::Other, capital(&record.what))
            }
        };
        if record.lost > 0 {
            let _ = write!(text, "; {} records before it could not be written", record.lost);
        }
        Self {
            seq: record.seq,
            time_s: seconds(&record.time).unwrap_or_default(),
            kind,
            who,
            text,
            advice,
        }
    }
}

/// Kind and text of the event that a change of state becomes.
fn in_words(change: &StateChange) -> (EventKind, String) {
    let (kind, state) = match change.state {
        StateName::Disarmed => (EventKind::Disarmed, "Disarmed: nothing is written"),
        StateName::Arming if change.test_shift => {
            (EventKind::TestShift, "Test shift: does the reported position contain the correction?")
        }
        StateName::Arming => (EventKind::Arming, "The correction ramps in"),
        StateName::Compensating => (EventKind::Compensating, "The correction follows the model"),
        StateName::Holding => (EventKind::Holding, "The correction is held"),
        StateName::RampingOut => (EventKind::RampingOut, "The correction ramps to zero"),
        StateName::Faulted => (EventKind::Faulted, "Fault: the correction ramps to zero"),
        StateName::Unknown => (EventKind::Other, "The state is unknown"),
    };
    let mut text = state.to_owned();
    if change.controller > 0 {
        let _ = write!(text, ", on path {}", change.controller + 1);
    }
    if explains(change) && !change.reasons.is_empty() {
        let _ = write!(text, ": {}", change.reasons.join(", "));
    }
    (kind, text)
}

/// Whether the reasons of a state explain why nothing, or less than the model requires, is corrected.
fn explains(change: &StateChange) -> bool {
    matches!(change.state, StateName::Holding | StateName::RampingOut | StateName::Faulted)
}

/// Missing positions and confirmations: the action on the first of these, or on what causes them, is the action on all.
const CONSEQUENCES: [Reasons; 3] =
    [Reasons::POSITIONS_LOST, Reasons::POSITIONS_STALE, Reasons::UNCONFIRMED];
const CAUSES: [Reasons; 5] = [
    Reasons::NO_CONTROLLER,
    Reasons::AXIS_UNKNOWN,
    Reasons::OUTSIDE_TRAVEL,
    Reasons::JUMPED,
    Reasons::NOT_A_NUMBER,
];

/// Maximum number of recommended operator actions per event. Reasons list causes first, so actions on consequences are
/// cut.
const MAX_ADVICE: usize = 2;

fn advice_on(change: &StateChange) -> Vec<String> {
    let mut advice: Vec<String> = Vec::new();
    let reasons = change.reasons.iter();
    let reasons = reasons.filter_map(|reason| Reasons::with_text(reason));
    // The operator's own disarm needs no advice.
    let is_wanted = |reason: Reasons| reason == Reasons::DISARMED_BY_PERSON;
    if !explains(change) || reasons.clone().any(is_wanted) {
        return advice;
    }
    let mut is_explained = false;
    for reason in reasons {
        let follows = CONSEQUENCES.contains(&reason);
        if follows && is_explained {
            continue;
        }
        is_explained |= follows || CAUSES.contains(&reason);
        let one = reason.advice();
        if let Some(one) = one.filter(|one| !advice.iter().any(|known| known == one)) {
            advice.push(one.to_owned());
        }
    }
    advice.truncate(MAX_ADVICE);
    advice
}

fn capital(text: &str) -> String {
    let mut letters = text.chars();
    let first = letters.next().into_iter().flat_map(char::to_uppercase);
    first.chain(letters).collect()
}

/// The first digits of a hash without its kind.
fn short(hash: &str) -> &str {
    let digits = hash.rsplit(':').next().unwrap_or(hash);
    digits.get(..8).unwrap_or(digits)
}

/// Seconds since 1970 of a time in the form of [`crate::audit::utc`]; `None` for other text and earlier times.
fn seconds(time: &str) -> Option<f64> {
    let at = OffsetDateTime::parse(time, &Rfc3339).ok()?;
    Some(at.unix_timestamp_nanos() as f64 * 1e-9).filter(|s| *s >= 0.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        audit::utc,
        documents::{ByAxis, Details, Start},
    };

    fn event(who: &str, what: &str, event: Event) -> LogEvent {
        LogEvent::from(&Record {
            seq: 7,
            boot: String::new(),
            monotonic_s: 1.0,
            time: "2026-11-30T13:08:03.250Z".to_owned(),
            who: who.to_owned(),
            what: what.to_owned(),
            details: Details {
                model: String::new(),
                output_um: ByAxis::new(),
                output_urad: ByAxis::new(),
                what: event,
            },
            lost: 0,
            previous: String::new(),
        })
    }

    fn state(state: StateName, reasons: &[&str]) -> LogEvent {
        let change = StateChange {
            state,
            controller: 0,
            reasons: reasons.iter().map(|&reason| reason.to_owned()).collect(),
            cycle: 1,
            test_shift: false,
        };
        event("gateway", "state", Event::StateChange(change))
    }

    #[test]
    fn a_stop_says_why_and_what_to_do() {
        let held =
            state(StateName::Holding, &["positions stale", "applied correction not confirmed"]);
        assert_eq!(
            held.text,
            "The correction is held: positions stale, applied correction not confirmed"
        );
        assert_eq!(held.advice, ["Check the cable."]);
        assert_eq!((held.kind, held.who), (EventKind::Holding, None));
        let gone = ["controller does not answer", "positions lost"];
        let gone = state(StateName::RampingOut, &gone);
        assert_eq!(gone.advice, ["Check the cable, the control and its address."]);
        let two = ["emergency stop", "positions stale"];
        let two = state(StateName::Holding, &two);
        assert_eq!(two.advice, ["Release the emergency stop at the control.", "Check the cable."]);
        let jumped = ["position jumped: X 4000.000 mm", "positions lost", "rate limited"];
        let jumped = state(StateName::RampingOut, &jumped);
        assert_eq!(
            jumped.advice,
            ["Compare the shown position with the control. If it is right, disarm and arm."]
        );
        let disarmed = Reasons::DISARMED_BY_PERSON.texts().next().expect("one");
        let wanted = state(StateName::RampingOut, &["positions stale", disarmed]);
        assert!(wanted.advice.is_empty());
        let degraded = event("gateway", "degraded: bed", Event::Nothing);
        assert_eq!(degraded.text, "Degraded: bed");
        assert_eq!(degraded.advice, ["Check the sensor. If its new value is right, acknowledge."]);
        let fine = state(StateName::Compensating, &["no barrier", "degraded"]);
        assert_eq!(fine.text, "The correction follows the model");
        assert!(fine.advice.is_empty());
    }

    #[test]
    fn requests_and_reloads_name_the_requester_and_the_change() {
        let request = Event::Request { state: StateName::Disarmed };
        let armed = event("anna", "arm", request);
        assert_eq!((armed.text.as_str(), armed.who.as_deref()), ("Arm", Some("anna")));
        let reload = Event::Reload {
            from: "sha256:0123456789".to_owned(),
            to: "sha256:abcdef0123".to_owned(),
            limits: [("limit_um".to_owned(), [Some(100.0), None])].into(),
            model_of: None,
        };
        assert_eq!(
            event("anna", "reload", reload).text,
            "Reload: machine file abcdef01 replaces 01234567; limit_um: 100 → none"
        );
        let start = Start { records: 1, cut_bytes: 0, broken: None, version: "1.2.3".to_owned() };
        let started = event("gateway", "started", Event::Start(start));
        assert_eq!(started.text, "Gateway 1.2.3 started");
        assert_eq!(started.kind, EventKind::Program);
    }

    #[test]
    fn times_are_those_of_the_records() {
        let at = std::time::UNIX_EPOCH + std::time::Duration::from_millis(1_796_044_083_250);
        let event = state(StateName::Disarmed, &[]);
        assert_eq!(utc(at), "2026-11-30T13:08:03.250Z");
        assert!((event.time_s - 1_796_044_083.25).abs() < 1e-6);
        for wrong in ["", "yesterday", "2026-13-30T13:08:03.250Z", "2026-11-30T25:08:03.250Z"] {
            assert_eq!(seconds(wrong), None, "{wrong}");
        }
    }
}
