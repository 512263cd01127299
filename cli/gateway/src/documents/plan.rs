//! The plan that follows from a configuration: the document of `check --json`.

use std::collections::BTreeMap;

use schemars::JsonSchema;
use serde::Serialize;
use serde_json::{Map, Value};
use volcomp_devices::{ControlMemory, Inspected};
use volcomp_vocabulary::{AxisKind, AxisName};

use super::ByAxis;

/// The effective configuration and the plan derived from it.
#[derive(Clone, Debug, PartialEq, Serialize, JsonSchema)]
pub struct PlanDocument {
    /// Warnings and notes; none of them prevents the start.
    pub notes: Vec<String>,
    /// Every key of the configuration that has an effect, with its value in the unit of the file.
    pub configuration: Map<String, Value>,
    /// Full names of the keys with default values, which the file does not state, such as
    /// `controller[0].channel`.
    pub defaults: Vec<String>,
    /// The machine that is corrected.
    pub machine: MachinePlan,
    /// The controllers in order of preference, read-only ones last.
    pub controllers: Vec<ControllerPlan>,
    /// The configured temperature sensors, and those named by thermal terms of the machine.
    pub sensors: Vec<SensorPlan>,
    /// The tokens of the dashboard, without the secrets.
    pub tokens: Vec<TokenPlan>,
    /// The model and permission received from the centre; missing without `[fleet]`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub fleet: Option<FleetPlan>,
    /// Properties reported by the controls, in the order of the configuration; only of buses that
    /// report some. Missing without `--online`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub online: Option<Vec<OnlinePlan>>,
}

/// The model and permission received from the centre of the fleet.
#[derive(Clone, Debug, PartialEq, Serialize, JsonSchema)]
pub struct FleetPlan {
    /// The public nkey with which the machine authenticates to the server.
    pub nkey: String,
    /// Version of the manifest whose machine file is active; 0: the configured machine file is
    /// active.
    pub version: u64,
    /// Highest accepted version of a manifest; 0: none.
    pub accepted: u64,
    /// Whether the centre permits correction.
    pub enabled: bool,
}

/// The properties that a control reports.
#[derive(Clone, Debug, PartialEq, Serialize, JsonSchema)]
pub struct OnlinePlan {
    /// The URL of the control.
    pub url: String,
    /// Properties reported by the control.
    #[serde(flatten)]
    pub control: Inspected,
    /// The barrier according to its report; missing if none is configured.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub barrier: Option<OnlineBarrier>,
    /// Remarks that do not prevent the start.
    pub notes: Vec<String>,
}

/// The barrier settings reported by a control. Times are scans of the control, converted with the
/// configured `scan_ms`.
#[derive(Clone, Debug, PartialEq, Serialize, JsonSchema)]
pub struct OnlineBarrier {
    /// Number of the machine, which every frame carries.
    pub machine: u16,
    /// Number that encodes the axes and their order, as the key `layout` of the barrier.
    pub layout: u32,
    /// Number of the gateway whose frames the barrier accepts; 0: the next sender becomes the
    /// owner.
    pub owner: u16,
    /// Measured scan time, ms; null: not measured.
    pub scan_ms: Option<f64>,
    /// Maximum age of an accepted frame, ms.
    pub hold_ms: f64,
    /// Time without a frame after which the barrier ramps the correction to zero, ms.
    pub time_out_ms: f64,
    /// The axes in the order of the barrier.
    pub axes: Vec<OnlineBarrierAxis>,
}

/// The settings of one axis of a barrier.
#[derive(Clone, Debug, PartialEq, Serialize, JsonSchema)]
pub struct OnlineBarrierAxis {
    /// The letter of the axis.
    #[schemars(with = "String")]
    pub name: AxisName,
    /// Unit of `limit` and `rate_per_s`: `µm` or `µrad`.
    pub unit: String,
    /// Maximum correction that the barrier passes on.
    pub limit: f64,
    /// Maximum rate of the correction, per second.
    pub rate_per_s: f64,
}

/// The machine in a plan, by its machine file.
#[derive(Clone, Debug, PartialEq, Serialize, JsonSchema)]
pub struct MachinePlan {
    /// The path of the machine file.
    pub file: String,
    /// Name of the machine in its file.
    pub name: String,
    /// Checksum of the machine file.
    pub hash: String,
    /// Structure code: the order of the axes from workpiece to tool.
    pub structure: String,
    /// Letters of the axes in the order X Y Z A B C U V W.
    #[schemars(with = "Vec<String>")]
    pub axes: Vec<AxisName>,
}

/// The settings of one controller that follow from the configuration.
#[derive(Clone, Debug, PartialEq, Serialize, JsonSchema)]
pub struct ControllerPlan {
    /// The URL of the device.
    pub url: String,
    /// Name of the channel through which corrections reach the axes.
    pub channel: String,
    /// Whether the control detects that the gateway has stopped; false if `unwatched` is set.
    pub watched: bool,
    /// Whether a second gateway on this controller is detected.
    pub sees_other_gateways: bool,
    /// Shortest supported cycle time, ms.
    pub shortest_cycle_ms: f64,
    /// The corrected axes, in the order X Y Z A B C U V W.
    pub axes: Vec<AxisPlan>,
    /// The axes that are not corrected, in the same order. Only zero is written to them.
    #[schemars(with = "Vec<String>")]
    pub held: Vec<AxisName>,
    /// Largest correction of each corrected axis that the machine file requires on a grid over the
    /// travels, without thermal terms: µm, µrad. The part above the limit is not corrected.
    #[schemars(with = "BTreeMap<String, f64>")]
    pub needs: ByAxis,
    /// Largest change of the correction of each corrected axis per kelvin of sensor temperature:
    /// µm, µrad. Axes without a thermal term are missing.
    #[schemars(with = "BTreeMap<String, f64>")]
    pub needs_per_k: ByAxis,
    /// The configured barrier in the control; missing if none is configured.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub barrier: Option<BarrierPlan>,
    /// Memory of the control used by the gateway.
    #[serde(flatten)]
    pub memory: ControlMemory,
}

/// The settings of one corrected axis, in µm for linear and µrad for rotary axes.
#[derive(Clone, Debug, PartialEq, Serialize, JsonSchema)]
pub struct AxisPlan {
    /// The letter of the axis.
    #[schemars(with = "String")]
    pub name: AxisName,
    /// Unit of the numbers below: `µm` or `µrad`.
    pub unit: String,
    /// Maximum correction in either direction: the configured limit, rounded down to whole steps.
    pub limit: f64,
    /// Smallest step of a correction.
    pub resolution: f64,
    /// Size of the test shift at arming, which shows whether reported positions contain the
    /// correction; 0: no test shift.
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

/// The configured barrier in a control.
#[derive(Clone, Debug, PartialEq, Serialize, JsonSchema)]
pub struct BarrierPlan {
    /// Machine number, the key `machine` of the barrier.
    pub machine: u16,
    /// Required value of the key `layout` of the barrier: one digit per axis, in the barrier's
    /// order.
    pub layout: u32,
    /// The axes in the order of the barrier's words.
    #[schemars(with = "Vec<String>")]
    pub axes: Vec<AxisName>,
    /// Scan time of the control, ms.
    pub scan_ms: f64,
}

/// A temperature sensor that thermal terms name.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, JsonSchema)]
pub struct SensorPlan {
    /// Name of the sensor in the machine file.
    pub name: String,
    /// The thermal terms that use the sensor, such as `expansion EXX`.
    pub feeds: Vec<String>,
    /// The thermometer with this sensor; null: none, and the terms that use it are inactive.
    pub thermometer: Option<String>,
}

/// A token of the dashboard in a plan, without its secret.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, JsonSchema)]
pub struct TokenPlan {
    /// Name of the holder.
    pub name: String,
    /// `view` (read only), `operate` or `engineer`.
    pub role: String,
}
