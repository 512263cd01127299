use std::collections::BTreeMap;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use volcomp_port::Description;
use volcomp_runtime::Model;

use super::{ByAxis, StateName};

/// Changed limits, rates and accelerations by configuration key: old and new value.
pub type LimitChanges = BTreeMap<String, [Option<f64>; 2]>;

/// One line of the audit log, behind its checksum.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Record {
    /// The number of the record, from 1, going on over the files of the log.
    pub seq: u64,
    /// Which boot of the computer, as the kernel names it.
    pub boot: String,
    /// Monotonic time since that boot, s.
    pub monotonic_s: f64,
    /// Wall time, ISO 8601 in UTC.
    pub time: String,
    /// The requester: the name of a token, `signal`, `auto_arm`, `centre` with the beginning of its key, `unknown` for a
    /// manifest that no trusted key has signed, or `gateway` for events without a request.
    pub who: String,
    /// The event in a few words.
    pub what: String,
    /// The particulars of the event.
    pub details: Details,
    /// How many records just before this one could not be written: the disk was full, gone, or did not answer.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub lost: u64,
    /// The checksum of the record before; empty in the first.
    pub previous: String,
}

#[expect(
    clippy::trivially_copy_pass_by_ref,
    reason = "serde passes a reference"
)]
fn is_zero(count: &u64) -> bool {
    *count == 0
}

/// The particulars of a record.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Details {
    /// The hash of the machine file that corrects.
    pub model: String,
    /// The correction that is applied to each linear axis when the record is made, µm; empty while that is not known.
    #[serde(default)]
    #[schemars(with = "BTreeMap<String, f64>")]
    pub output_um: ByAxis,
    /// The correction that is applied to each rotary axis when the record is made, µrad; empty while that is not known.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    #[schemars(with = "BTreeMap<String, f64>")]
    pub output_urad: ByAxis,
    /// The particulars that the kind of event has.
    pub what: Event,
}

/// The particulars that the kind of event has.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(untagged)]
pub enum Event {
    /// The start of the gateway.
    Start(Start),
    /// The state of the guard changed.
    StateChange(StateChange),
    /// The end of the gateway.
    Stop(Stop),
    /// The configuration was read again.
    Reload {
        /// The hash of the model before.
        from: String,
        /// The hash of the model after.
        to: String,
        /// The limits, rates and accelerations that changed, by the key of the configuration: the old and the new
        /// value; null if missing.
        #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
        limits: LimitChanges,
        /// Where the model comes from, where a person has chosen it.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        model_of: Option<String>,
    },
    /// A request, with the state that it found.
    Request {
        /// The state when it came.
        state: StateName,
    },
    /// Why something was refused.
    Refused(String),
    /// Nothing more to be said.
    Nothing,
}

/// The state of the audit log that the gateway found when it started, and the version of the gateway.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct Start {
    /// Whole records in the current file of the log.
    pub records: u64,
    /// Bytes of a record that was half written, cut off.
    pub cut_bytes: u64,
    /// A log that did not belong together, put aside.
    pub broken: Option<Broken>,
    /// The version of the gateway.
    pub version: String,
}

/// A file of the log whose chain was broken.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct Broken {
    /// The first line that does not belong to the chain.
    pub line: u64,
    /// The name under which the file was put aside.
    pub aside: String,
}

/// A change of the state of the guard.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct StateChange {
    /// The state from now on.
    pub state: StateName,
    /// The place of the controller that corrects, from 0.
    pub controller: usize,
    /// Reasons for it.
    pub reasons: Vec<String>,
    /// The number of the cycle.
    pub cycle: u64,
}

/// How the gateway left the machine.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Stop {
    /// The state at the end.
    pub state: StateName,
    /// The correction that stayed applied to each linear axis, µm; empty where that is not known.
    #[schemars(with = "BTreeMap<String, f64>")]
    pub left_um: ByAxis,
    /// The correction that stayed applied to each rotary axis, µrad; empty where that is not known.
    #[schemars(with = "BTreeMap<String, f64>")]
    pub left_urad: ByAxis,
}

/// The file `output.json` in the folder of the log: the last output, for controllers without read-back.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct LastOutput {
    /// The boot in which it was written: after another boot it is not used.
    pub boot: String,
    /// When it was written, s on the monotonic clock of that boot.
    #[serde(default)]
    pub monotonic_s: f64,
    /// Whether the gateway ended with it; otherwise it may have sent another one afterwards.
    #[serde(default)]
    pub ended: bool,
    /// The letters of the machine's axes in the order of its chain: with other ones, or in another order, it is not used.
    #[serde(default)]
    pub axes: String,
    /// The devices of the controllers in their order: with other ones it is not used.
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
    /// The name of the token of the person who disarmed it last; null once a person has armed it again.
    pub disarmed_by: Option<String>,
    /// The reasons of an unacknowledged fault; null without one.
    pub faulted: Option<Vec<String>>,
    /// The names of the sensors that jumped and are not believed again.
    #[serde(default)]
    pub jumped: Vec<String>,
}

/// The file `confirmed-limits.json` in the folder of the log: the limits, rates and accelerations at the last arming, by
/// configuration key.
pub type ConfirmedLimits = BTreeMap<String, f64>;
