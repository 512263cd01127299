//! The JSON documents of `check`, which is the plan that follows from a configuration, and of `rehearse`.

use std::collections::BTreeMap;

use schemars::JsonSchema;
use serde::Serialize;
use serde_json::{Map, Value};
use volcomp_devices::{ControlMemory, Inspected};
use volcomp_vocabulary::{AxisKind, AxisName};

use crate::documents::ByAxis;

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

/// Behaviour of the axes of a simulated machine under each fault. No device is opened.
#[derive(Clone, Debug, PartialEq, Serialize, JsonSchema)]
pub struct RehearsalDocument {
    /// Whether no rule was violated.
    pub passed: bool,
    /// Start time, ISO 8601 in UTC.
    pub time: String,
    /// Version of the program.
    pub version: String,
    /// User name on the computer.
    pub user: String,
    /// Host name of the computer.
    pub host: String,
    /// Name of the machine in its file.
    pub machine: String,
    /// Checksum of the machine file.
    pub hash: String,
    /// The path of the configuration file.
    pub config: String,
    /// Checksum of the configuration file as it was read.
    pub config_hash: String,
    /// The requested faults; empty: the whole catalogue.
    pub selection: Vec<String>,
    /// Number of faults in the catalogue.
    pub catalogue: usize,
    /// Seed of the random number generator.
    pub seed: u64,
    /// Cycle time of the gateway, ms.
    pub cycle_ms: f64,
    /// Simulated time, s.
    pub simulated_s: f64,
    /// Effects that a rehearsal cannot show.
    pub not_rehearsed: Vec<String>,
    /// The controllers in order of preference; each is rehearsed alone on a separate simulated
    /// machine.
    pub controllers: Vec<RehearsedPath>,
}

/// One controller of a rehearsal.
#[derive(Clone, Debug, PartialEq, Serialize, JsonSchema)]
pub struct RehearsedPath {
    /// URL of the controller that is replaced by the simulation.
    pub url: String,
    /// Scheme of the simulated control: `barrier`, `plain` (values can be read back) or
    /// `no-read-back` (values cannot be read back).
    pub scheme: String,
    /// Age of the positions from which the correction is held, ms.
    pub hold_ms: f64,
    /// Age of the positions from which the correction is ramped to zero, ms.
    pub zero_after_ms: f64,
    /// Duration of a ramp, s.
    pub ramp_s: f64,
    /// Barrier in the simulated control; null: none.
    pub barrier: Option<RehearsedBarrier>,
    /// Active limits of each axis.
    pub limits: Vec<RehearsedLimits>,
    /// The simulated faults and their results.
    pub faults: Vec<RehearsedFault>,
    /// Sensor faults that were skipped because no thermometer is configured.
    pub left_out: Vec<String>,
}

/// Settings of the barrier in the simulated control. The real control must have the same.
#[derive(Clone, Debug, PartialEq, Serialize, JsonSchema)]
pub struct RehearsedBarrier {
    /// Number of the machine, which every frame carries.
    pub machine: u16,
    /// Scan time of the control, ms.
    pub scan_ms: f64,
    /// Maximum age of the report that a frame answers, ms.
    pub hold_ms: f64,
    /// Time without a frame after which the axes go to zero, ms.
    pub time_out_ms: f64,
}

/// Limits of one axis. Limits of a correction are whole numbers of steps.
#[derive(Clone, Debug, PartialEq, Serialize, JsonSchema)]
pub struct RehearsedLimits {
    /// The letter of the axis.
    #[schemars(with = "String")]
    pub axis: AxisName,
    /// Limits of a linear axis, µm.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub um: Option<AxisBounds>,
    /// Limits of a rotary axis, µrad.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub urad: Option<AxisBounds>,
}

/// Limits of the correction of one axis, in µm or µrad.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, JsonSchema)]
pub struct AxisBounds {
    /// Maximum correction in either direction.
    pub limit: f64,
    /// Maximum rate of the correction, per second.
    pub slew_per_s: f64,
    /// Maximum acceleration, per second squared; null: unlimited.
    pub accel_per_s2: Option<f64>,
    /// Smallest step of the correction.
    pub step: f64,
    /// Maximum rate of the barrier, per second; null: no barrier.
    pub barrier_per_s: Option<f64>,
}

/// One fault in one phase of the correction.
#[derive(Clone, Debug, PartialEq, Serialize, JsonSchema)]
pub struct RehearsedFault {
    /// Name of the fault, as accepted by `--fault`.
    pub fault: String,
    /// What the fault simulates.
    pub meaning: String,
    /// State when the fault began: `compensating` or `ramping`.
    pub phase: String,
    /// Whether no rule was violated.
    pub passed: bool,
    /// The violated rules.
    pub broken: Vec<String>,
    /// Whether this fault can cause an undetectable step without a barrier, bounded only by the
    /// limit.
    pub bounded_by_limit: bool,
    /// Whether this fault hides an interlock from the gateway. Without a barrier the axes may then
    /// move during the interlock.
    pub interlock_hidden: bool,
    /// Worst state from the fault until compensation resumed.
    pub state: String,
    /// Time from the end of the fault until compensation resumed, s; null: not within the simulated
    /// time.
    pub compensating_after_s: Option<f64>,
    /// Operator actions until compensation resumed, in order: `acknowledge`, `arm`; at most six.
    pub needed: Vec<String>,
    /// Number of scans (without a barrier: writes) that moved an axis during emergency stop, alarm
    /// or without reference.
    pub moved_while_held: u64,
    /// Extremes of the correction of each axis.
    pub axes: Vec<RehearsedAxis>,
}

/// Extremes of the correction of one axis.
#[derive(Clone, Debug, PartialEq, Serialize, JsonSchema)]
pub struct RehearsedAxis {
    /// The letter of the axis.
    #[schemars(with = "String")]
    pub axis: AxisName,
    /// Correction of a linear axis, µm.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub um: Option<Excursion>,
    /// Correction of a rotary axis, µrad.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub urad: Option<Excursion>,
}

impl RehearsedAxis {
    /// Extremes of the correction: µm for a linear axis, µrad for a rotary axis.
    pub fn excursion(&self) -> Option<&Excursion> {
        self.um.as_ref().or(self.urad.as_ref())
    }
}

/// Extremes of the correction of an axis during a fault, with their limits, µm or µrad.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, JsonSchema)]
pub struct Excursion {
    /// Largest change of the correction from one scan (without a barrier: write) to the next.
    pub largest_change: f64,
    /// Allowed maximum of `largest_change`.
    pub allowed_change: f64,
    /// Largest correction in either direction.
    pub furthest: f64,
    /// Allowed maximum of `furthest`.
    pub limit: f64,
}
