//! The document of a rehearsal, as `rehearse --json` prints it.

use schemars::JsonSchema;
use serde::Serialize;
use volcomp_vocabulary::AxisName;

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
