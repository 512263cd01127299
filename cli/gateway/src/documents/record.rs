use std::collections::BTreeMap;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use volcomp_port::Description;
use volcomp_runtime::Model;
use volcomp_vocabulary::AxisName;

use super::{ByAxis, StateName};

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

/// The file `output.json` in the folder of the log: the last output, for controllers without read-back.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct LastOutput {
    /// The kernel's boot ID when the file was written; the output is ignored after a reboot.
    pub boot: String,
    /// Time of writing by the monotonic clock of that boot, s.
    #[serde(default)]
    pub monotonic_s: f64,
    /// Whether the gateway ended properly with this output; otherwise it may have sent another one
    /// afterwards.
    #[serde(default)]
    pub ended: bool,
    /// Letters of the machine's axes in the order of its chain. The output is ignored if they
    /// differ.
    #[serde(default)]
    pub axes: String,
    /// Devices of the controllers in order. The output is ignored if they differ.
    #[serde(default)]
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
