//! The document of a rehearsal, as `rehearse --json` prints it.

use schemars::JsonSchema;
use serde::Serialize;
use volcomp_vocabulary::AxisName;

/// What the axes of a simulated machine did under each fault. No device was opened.
#[derive(Clone, Debug, PartialEq, Serialize, JsonSchema)]
pub struct RehearsalDocument {
    /// Whether no rule was broken.
    pub passed: bool,
    /// When it was begun, UTC, as ISO 8601.
    pub time: String,
    /// The version of the program.
    pub version: String,
    /// Who ran it: the name of the user on the computer.
    pub user: String,
    /// The name of the computer.
    pub host: String,
    /// The name of the machine as its file states it.
    pub machine: String,
    /// The checksum of the machine file's content.
    pub hash: String,
    /// The path of the configuration file.
    pub config: String,
    /// The checksum of the configuration file as it was read.
    pub config_hash: String,
    /// The requested faults; empty: the whole catalogue.
    pub selection: Vec<String>,
    /// How many faults the catalogue has.
    pub catalogue: usize,
    /// The seed of all that happened by chance.
    pub seed: u64,
    /// The time of a cycle, ms.
    pub cycle_ms: f64,
    /// How much time passed on the simulated machines, s.
    pub simulated_s: f64,
    /// What a rehearsal cannot show, in words.
    pub not_rehearsed: Vec<String>,
    /// The controllers in the order of preference; each was rehearsed alone, on its own simulated machine.
    pub controllers: Vec<RehearsedPath>,
}

/// One controller of a rehearsal.
#[derive(Clone, Debug, PartialEq, Serialize, JsonSchema)]
pub struct RehearsedPath {
    /// The URL of the controller whose place the simulated machine took.
    pub url: String,
    /// What the simulated control was: `barrier`, `plain` (values that can be read back) or `no-read-back` (values that cannot).
    pub scheme: String,
    /// How old positions may be until the correction is held, ms.
    pub hold_ms: f64,
    /// How old positions may be until the correction goes to zero, ms.
    pub zero_after_ms: f64,
    /// The time of a ramp, s.
    pub ramp_s: f64,
    /// The barrier in the simulated control; null: it had none.
    pub barrier: Option<RehearsedBarrier>,
    /// The limits that held, axis by axis.
    pub limits: Vec<RehearsedLimits>,
    /// What was done to it, and what came of it.
    pub faults: Vec<RehearsedFault>,
    /// Faults of sensors that were left out, since no thermometer is configured.
    pub left_out: Vec<String>,
}

/// The barrier in a simulated control. The one in the real control has to be set alike.
#[derive(Clone, Debug, PartialEq, Serialize, JsonSchema)]
pub struct RehearsedBarrier {
    /// The number of the machine.
    pub machine: u16,
    /// The time of a scan, ms.
    pub scan_ms: f64,
    /// How old the report may be that a frame answers, ms.
    pub hold_ms: f64,
    /// After so much time without a frame the axes go to zero, ms.
    pub time_out_ms: f64,
}

/// The limits of one axis, each a whole number of steps where it is a correction.
#[derive(Clone, Debug, PartialEq, Serialize, JsonSchema)]
pub struct RehearsedLimits {
    /// The letter of the axis.
    #[schemars(with = "String")]
    pub axis: AxisName,
    /// Of a linear axis, µm.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub um: Option<AxisBounds>,
    /// Of a rotary axis, µrad.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub urad: Option<AxisBounds>,
}

/// What holds for the correction of one axis, in µm or µrad.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, JsonSchema)]
pub struct AxisBounds {
    /// The largest correction, in either direction.
    pub limit: f64,
    /// The largest change in a second.
    pub slew_per_s: f64,
    /// The largest change of the slew in a second; null: not limited.
    pub accel_per_s2: Option<f64>,
    /// The smallest step.
    pub step: f64,
    /// The rate of the barrier; null: no barrier.
    pub barrier_per_s: Option<f64>,
}

/// One fault in one phase of the correction.
#[derive(Clone, Debug, PartialEq, Serialize, JsonSchema)]
pub struct RehearsedFault {
    /// The name of the fault, as `--fault` takes it.
    pub fault: String,
    /// What it simulates.
    pub meaning: String,
    /// When it began: `compensating` or `ramping`.
    pub phase: String,
    /// Whether it broke no rule.
    pub passed: bool,
    /// The rules that were broken, in words.
    pub broken: Vec<String>,
    /// Whether this fault can make a step that cannot be detected without a barrier, so that only the limit bounds it.
    pub bounded_by_limit: bool,
    /// Whether this fault hides an interlock from the gateway, so that without a barrier the axes may move in it.
    pub interlock_hidden: bool,
    /// The worst state that was reached from the fault until it compensated again.
    pub state: String,
    /// How long after the fault was taken away it compensated again, s; null: not within the time of the rehearsal.
    pub compensating_after_s: Option<f64>,
    /// What a person had to do for that, in order: `acknowledge`, `arm`; after six times it is given up.
    pub needed: Vec<String>,
    /// How many scans (without a barrier: writes) moved an axis in emergency stop, alarm or without reference.
    pub moved_while_held: u64,
    /// What each axis did.
    pub axes: Vec<RehearsedAxis>,
}

/// What one axis did.
#[derive(Clone, Debug, PartialEq, Serialize, JsonSchema)]
pub struct RehearsedAxis {
    /// The letter of the axis.
    #[schemars(with = "String")]
    pub axis: AxisName,
    /// Of a linear axis, µm.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub um: Option<Excursion>,
    /// Of a rotary axis, µrad.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub urad: Option<Excursion>,
}

impl RehearsedAxis {
    /// The motion of the axis, in the unit of its kind.
    pub fn excursion(&self) -> Option<&Excursion> {
        self.um.as_ref().or(self.urad.as_ref())
    }
}

/// How an axis moved, in µm or µrad.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, JsonSchema)]
pub struct Excursion {
    /// The largest change of the correction from one scan (without a barrier: write) to the next.
    pub largest_change: f64,
    /// The largest change that is allowed.
    pub allowed_change: f64,
    /// The largest correction, in either direction.
    pub furthest: f64,
    /// The largest correction that is allowed.
    pub limit: f64,
}
