//! The plan that follows from a configuration: the document of `check --json`.

use std::collections::BTreeMap;

use schemars::JsonSchema;
use serde::Serialize;
use serde_json::{Map, Value};
use volcomp_devices::{ControlMemory, Inspected};
use volcomp_vocabulary::{AxisKind, AxisName};

use super::ByAxis;

/// The effective configuration, and what follows from it.
#[derive(Clone, Debug, PartialEq, Serialize, JsonSchema)]
pub struct PlanDocument {
    /// Warnings and notes in words, to be read before the first start; none of them forbids it.
    pub notes: Vec<String>,
    /// Every key of the configuration that has an effect, with its value, as the file states it.
    pub configuration: Map<String, Value>,
    /// The full keys in it that the file does not state, such as `controller[0].channel`: their values are defaults.
    pub defaults: Vec<String>,
    /// The machine that is corrected.
    pub machine: MachinePlan,
    /// The controllers in the order of preference, those that are only read last.
    pub controllers: Vec<ControllerPlan>,
    /// The sensors of the thermometers, and those that thermal terms of the machine name.
    pub sensors: Vec<SensorPlan>,
    /// The tokens of the dashboard, without the secrets.
    pub tokens: Vec<TokenPlan>,
    /// The state of the fleet; missing without a fleet.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub fleet: Option<FleetPlan>,
    /// What the controls reported (`--online`), in the order of the configuration; only those whose bus has something to
    /// compare. Missing without `--online`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub online: Option<Vec<OnlinePlan>>,
}

/// What the centre of the fleet has activated.
#[derive(Clone, Debug, PartialEq, Serialize, JsonSchema)]
pub struct FleetPlan {
    /// The public nkey by which the server knows the machine.
    pub nkey: String,
    /// The version of the manifest whose machine file corrects; 0: the configured machine file does.
    pub version: u64,
    /// The version of the highest manifest that was accepted; 0: none was.
    pub accepted: u64,
    /// Whether the centre allows correcting.
    pub enabled: bool,
}

/// The properties that a control reports.
#[derive(Clone, Debug, PartialEq, Serialize, JsonSchema)]
pub struct OnlinePlan {
    /// The URL of the control.
    pub url: String,
    /// Its properties.
    #[serde(flatten)]
    pub control: Inspected,
    /// The barrier according to its report; missing if none is configured.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub barrier: Option<OnlineBarrier>,
    /// What deserves to be known and forbids nothing, in words.
    pub notes: Vec<String>,
}

/// The barrier of a control according to its report. Times are scans of the control with the configured `scan_ms`.
#[derive(Clone, Debug, PartialEq, Serialize, JsonSchema)]
pub struct OnlineBarrier {
    /// The number of the machine.
    pub machine: u16,
    /// The number of its axes in their order, as `layout` of the barrier.
    pub layout: u32,
    /// Owner number of the gateway whose frames it accepts; 0: free, the next sender becomes the owner.
    pub owner: u16,
    /// The time of a scan as it was counted, ms; null: not counted.
    pub scan_ms: Option<f64>,
    /// The oldest frame that it takes, ms.
    pub hold_ms: f64,
    /// The time without a frame after which it ramps the correction out, ms.
    pub time_out_ms: f64,
    /// Its axes in their order.
    pub axes: Vec<OnlineBarrierAxis>,
}

/// The settings of one axis of a barrier.
#[derive(Clone, Debug, PartialEq, Serialize, JsonSchema)]
pub struct OnlineBarrierAxis {
    /// The letter of the axis.
    #[schemars(with = "String")]
    pub name: AxisName,
    /// The unit of the numbers below: `µm` or `µrad`.
    pub unit: String,
    /// The largest correction that it lets through.
    pub limit: f64,
    /// Maximum rate of the correction, per second.
    pub rate_per_s: f64,
}

/// The machine of a plan.
#[derive(Clone, Debug, PartialEq, Serialize, JsonSchema)]
pub struct MachinePlan {
    /// The path of the machine file.
    pub file: String,
    /// The name as the file states it.
    pub name: String,
    /// The checksum of its content.
    pub hash: String,
    /// The structure code of the machine.
    pub structure: String,
    /// The letters of its axes in the order X Y Z A B C U V W.
    #[schemars(with = "Vec<String>")]
    pub axes: Vec<AxisName>,
}

/// What follows for one controller.
#[derive(Clone, Debug, PartialEq, Serialize, JsonSchema)]
pub struct ControllerPlan {
    /// The URL of the device.
    pub url: String,
    /// The name of the channel by which its corrections reach the axes.
    pub channel: String,
    /// Whether the control's side notices when the gateway stops, and `unwatched` does not state otherwise.
    pub watched: bool,
    /// Whether a second gateway on this controller is noticed.
    pub sees_other_gateways: bool,
    /// The shortest cycle that it keeps up with, ms.
    pub shortest_cycle_ms: f64,
    /// The axes that correct, in the order X Y Z A B C U V W.
    pub axes: Vec<AxisPlan>,
    /// The axes that do not correct, in the same order: they are held, and nothing but zero is written to them.
    #[schemars(with = "Vec<String>")]
    pub held: Vec<AxisName>,
    /// The largest correction of each of them that the machine file needs over a grid of the travels, without what
    /// temperatures add: µm, µrad. More than the limit is not corrected.
    #[schemars(with = "BTreeMap<String, f64>")]
    pub needs: ByAxis,
    /// The largest change of the correction of each of them by temperatures for each kelvin of the sensors: µm, µrad.
    /// Missing for axes that no thermal term moves.
    #[schemars(with = "BTreeMap<String, f64>")]
    pub needs_per_k: ByAxis,
    /// The barrier in the control, as the configuration states it; missing where it states none.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub barrier: Option<BarrierPlan>,
    /// The memory of the control that it uses.
    #[serde(flatten)]
    pub memory: ControlMemory,
}

/// What holds for one axis of a controller, in µm for linear and µrad for rotary axes.
#[derive(Clone, Debug, PartialEq, Serialize, JsonSchema)]
pub struct AxisPlan {
    /// The letter of the axis.
    #[schemars(with = "String")]
    pub name: AxisName,
    /// The unit of the numbers below: `µm` or `µrad`.
    pub unit: String,
    /// The largest correction that is written, in either direction: whole steps within the configured limits.
    pub limit: f64,
    /// The smallest step of a correction.
    pub resolution: f64,
    /// The shift at arming that shows whether positions contain the correction; 0: not made.
    pub test_shift: f64,
}

impl AxisPlan {
    /// Unit of the correction of an axis: µm or µrad.
    pub fn unit_of(kind: AxisKind) -> &'static str {
        match kind {
            AxisKind::Linear => "µm",
            AxisKind::Rotary => "µrad",
        }
    }
}

/// The barrier in a control, as the configuration states it.
#[derive(Clone, Debug, PartialEq, Serialize, JsonSchema)]
pub struct BarrierPlan {
    /// The number of the machine, `machine` of the barrier.
    pub machine: u16,
    /// The number that `layout` of the barrier must have: a digit for each axis, in their order.
    pub layout: u32,
    /// The axes in the order of the barrier's words.
    #[schemars(with = "Vec<String>")]
    pub axes: Vec<AxisName>,
    /// The time of a scan of the control, ms.
    pub scan_ms: f64,
}

/// A sensor that thermal terms name.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, JsonSchema)]
pub struct SensorPlan {
    /// The name as the file states it.
    pub name: String,
    /// The thermal terms that it feeds, such as `expansion EXX`.
    pub feeds: Vec<String>,
    /// The thermometer that measures it; null: none, and its terms are left out.
    pub thermometer: Option<String>,
}

/// A token of a plan.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, JsonSchema)]
pub struct TokenPlan {
    /// The name of its holder.
    pub name: String,
    /// The role of its holder: `view` (read only), `operate` or `engineer`.
    pub role: String,
}
