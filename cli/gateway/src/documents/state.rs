//! The state of the gateway, as served by `GET /api/state`, exported as metrics and printed by `status`.

use std::collections::BTreeMap;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use volcomp_vocabulary::AxisName;

/// One value per axis, in the order X Y Z A B C U V W.
pub type ByAxis = BTreeMap<AxisName, f64>;

/// The state of the guard, as one word.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum StateName {
    /// Nothing is written to the control.
    Disarmed,
    /// The correction ramps in; before that a test shift may be made.
    Arming,
    /// The correction follows the model.
    Compensating,
    /// The last correction is held.
    Holding,
    /// The correction ramps to zero.
    RampingOut,
    /// A fault that an operator must acknowledge; the correction ramps to zero.
    Faulted,
    /// The control thread has stopped telling: what is applied now is not known.
    Unknown,
}

impl StateName {
    /// All names, in the order of the metrics.
    pub const ALL: [Self; 7] = [
        Self::Disarmed,
        Self::Arming,
        Self::Compensating,
        Self::Holding,
        Self::RampingOut,
        Self::Faulted,
        Self::Unknown,
    ];

    /// The name used in JSON.
    pub fn name(self) -> &'static str {
        match self {
            Self::Disarmed => "disarmed",
            Self::Arming => "arming",
            Self::Compensating => "compensating",
            Self::Holding => "holding",
            Self::RampingOut => "ramping-out",
            Self::Faulted => "faulted",
            Self::Unknown => "unknown",
        }
    }
}

impl From<volcomp_guard::State> for StateName {
    fn from(state: volcomp_guard::State) -> Self {
        use volcomp_guard::State;
        match state {
            State::Disarmed => Self::Disarmed,
            State::Arming(_) => Self::Arming,
            State::Compensating => Self::Compensating,
            State::Holding(_) => Self::Holding,
            State::RampingOut(_) => Self::RampingOut,
            State::Faulted(_) => Self::Faulted,
        }
    }
}

/// The state of the gateway at one cycle.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[expect(
    clippy::struct_excessive_bools,
    reason = "each is a key of the document"
)]
pub struct Status {
    /// The state of the guard; `unknown` when the control thread has reported nothing for some time.
    pub state: StateName,
    /// Why the state is what it is, and what else is to be known.
    pub reasons: Vec<String>,
    /// Whether it corrects, or will resume automatically.
    pub armed: bool,
    /// Whether it arms itself after the start.
    pub auto_arm: bool,
    /// Whether the machine is the built-in simulation.
    pub simulated: bool,
    /// The machine whose model corrects.
    pub machine: MachineState,
    /// Whether a token that may operate is configured: without one, disarming on its own computer is all that can be done over HTTP.
    #[serde(default)]
    pub operable: bool,
    /// The controller that corrects.
    pub controller: Option<ControllerState>,
    /// Every configured controller in the order of preference: how it is, the one that corrects and those that stand by.
    #[serde(default)]
    pub controllers: Vec<PathState>,
    /// Positions of the linear axes without the correction, mm. An axis whose position is not known is left out.
    #[schemars(with = "BTreeMap<String, f64>")]
    pub positions_mm: ByAxis,
    /// Positions of the rotary axes without the correction, deg.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    #[schemars(with = "BTreeMap<String, f64>")]
    pub positions_deg: ByAxis,
    /// Whether the correction that the control applies was confirmed within `hold_ms`. Otherwise `correction_um` and
    /// `correction_urad` are what was confirmed last, and what is applied now is not known.
    #[serde(default)]
    pub correction_known: bool,
    /// The correction that the control was last confirmed to apply to each linear axis that the controller which corrects
    /// writes, µm; empty where none was ever confirmed.
    #[schemars(with = "BTreeMap<String, f64>")]
    pub correction_um: ByAxis,
    /// The correction that the control was last confirmed to apply to each rotary axis, µrad.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    #[schemars(with = "BTreeMap<String, f64>")]
    pub correction_urad: ByAxis,
    /// The correction of each linear axis that was sent last without a failure, µm; empty where none was since the start.
    #[serde(default)]
    #[schemars(with = "BTreeMap<String, f64>")]
    pub sent_um: ByAxis,
    /// The correction of each rotary axis that was sent last without a failure, µrad.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    #[schemars(with = "BTreeMap<String, f64>")]
    pub sent_urad: ByAxis,
    /// What the last test shift showed of the reported position of each axis that is corrected.
    #[serde(default)]
    #[schemars(with = "BTreeMap<String, ProvenName>")]
    pub proven: BTreeMap<AxisName, ProvenName>,
    /// The correction of each linear axis that the model asks for, before limits and ramps, µm.
    #[schemars(with = "BTreeMap<String, f64>")]
    pub wanted_um: ByAxis,
    /// The correction of each rotary axis that the model asks for, before limits and ramps, µrad.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    #[schemars(with = "BTreeMap<String, f64>")]
    pub wanted_urad: ByAxis,
    /// The position error of the tool tip without correction by the model, µm in workpiece axes; null while
    /// positions are not known.
    pub error_um: Option<[f64; 3]>,
    /// The rotation error of the tool without correction by the model, µrad about the workpiece axes.
    pub error_urad: Option<[f64; 3]>,
    /// The direction error of the tool axis without correction by the model, µrad in workpiece axes; only on
    /// machines with rotary axes.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub error_axis_urad: Option<[f64; 3]>,
    /// The position error that the model leaves with the applied correction, axes that are not written holding none, µm in
    /// workpiece axes; null while the applied correction is not known.
    pub residual_um: Option<[f64; 3]>,
    /// The direction error of the tool axis that the model leaves with the applied correction, µrad in workpiece
    /// axes; only on machines with rotary axes.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub residual_axis_urad: Option<[f64; 3]>,
    /// The true error of the simulated machine without correction, µm; only in the simulation.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub true_error_um: Option<[f64; 3]>,
    /// The true error of the simulated machine with the applied correction, µm; only in the simulation.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub true_residual_um: Option<[f64; 3]>,
    /// The temperatures in the order of the configuration.
    pub temperatures: Vec<SensorState>,
    /// Cycles so far in which slew or acceleration limits held the correction back.
    pub held_back: u64,
    /// Exchanges with controllers so far that failed.
    pub faults: u64,
    /// Time from the start of the control thread to the reported cycle, s.
    pub uptime_s: f64,
    /// Age of the state, ms.
    pub age_ms: f64,
    /// How long cycles took.
    pub cycle: CycleTimes,
    /// How it stands with the centre of the fleet; only where `[fleet]` is configured.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub fleet: Option<FleetState>,
}

/// How it stands with the centre of the fleet.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct FleetState {
    /// The site.
    pub site: String,
    /// The name of the machine in the fleet.
    pub machine: String,
    /// Whether the server is connected now.
    pub connected: bool,
    /// The version of the manifest whose machine file corrects; 0: the configured machine file does.
    pub version: u64,
    /// The version of the highest manifest that was accepted; 0: none was.
    pub accepted: u64,
    /// Whether the centre allows correcting.
    pub enabled: bool,
    /// What became of the highest manifest; null while that is not known.
    pub outcome: Option<String>,
    /// Why the highest manifest is not active yet, or what was damaged at the start; it is retried.
    pub trouble: Option<String>,
    /// Why the last value of the machine's key was not accepted, which changed nothing; null where none was refused since the
    /// last that was accepted.
    #[serde(default)]
    pub refused: Option<String>,
    /// Why messages to the centre wait; null while they are sent.
    pub waiting: Option<String>,
    /// Messages dropped since the start for lack of space.
    pub dropped: u64,
}

/// The machine whose model corrects.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct MachineState {
    /// Its name in the machine file.
    pub name: String,
    /// The checksum of the machine file's content.
    pub hash: String,
    /// The structure code, such as `w X' b Y Z t`: the order of its axes from the workpiece to the tool.
    #[serde(default)]
    pub structure: String,
    /// The letters of its axes in the order X Y Z A B C U V W.
    #[schemars(with = "Vec<String>")]
    pub axes: Vec<AxisName>,
}

/// The controller that corrects.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct ControllerState {
    /// The URL of the device.
    pub device: String,
    /// The name of the channel by which its corrections reach the axes.
    pub channel: String,
    /// Its place among the configured controllers, from 0; texts count from 1 (path 1).
    pub number: usize,
}

/// How one of the configured controllers is.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct PathState {
    /// The URL of the device.
    pub device: String,
    /// Its place among the configured controllers, from 0; texts count from 1 (path 1).
    pub number: usize,
    /// Whether it is the one that corrects.
    pub active: bool,
    /// How its correction is confirmed.
    pub scheme: SchemeName,
    /// How long ago it answered last, ms; null: never.
    pub answered_ms: Option<f64>,
    /// Age of its positions, ms; null: none received.
    pub positions_ms: Option<f64>,
    /// How long ago the correction that it applies was confirmed last, ms; null: never.
    pub confirmed_ms: Option<f64>,
    /// Whether the correction that it applies is other than zero; null: not known, since nothing confirmed it in the last
    /// two seconds.
    pub holds_correction: Option<bool>,
    /// What else is to be known of it.
    pub reasons: Vec<String>,
}

/// How the correction of a controller is confirmed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum SchemeName {
    /// A barrier in the control accepts frames and reports the applied correction.
    Barrier,
    /// Plain values that can be read back: no barrier.
    Plain,
    /// Plain values that cannot be read back: no barrier.
    NoReadBack,
}

impl From<volcomp_guard::Scheme> for SchemeName {
    fn from(scheme: volcomp_guard::Scheme) -> Self {
        use volcomp_guard::Scheme;
        match scheme {
            Scheme::Barrier => Self::Barrier,
            Scheme::Plain => Self::Plain,
            Scheme::NoReadBack => Self::NoReadBack,
        }
    }
}

/// What the test shift showed of the reported position of an axis.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum ProvenName {
    /// It contains the correction.
    Contained,
    /// It does not contain the correction.
    NotContained,
    /// Neither was shown.
    NotProven,
}

impl From<volcomp_guard::AxisProof> for ProvenName {
    fn from(proven: volcomp_guard::AxisProof) -> Self {
        use volcomp_guard::AxisProof;
        match proven {
            AxisProof::Contained => Self::Contained,
            AxisProof::NotContained => Self::NotContained,
            AxisProof::NotProven => Self::NotProven,
        }
    }
}

/// One temperature as it is used.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct SensorState {
    /// The name of the sensor.
    pub name: String,
    /// °C; null when it is not used.
    pub degc: Option<f64>,
    /// `good` or `uncertain` when it is used, else `bad`.
    pub quality: String,
    /// Why it is not used.
    pub reason: Option<String>,
}

/// How long cycles took, whole cycles and their parts, over the last some thousand cycles.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct CycleTimes {
    /// The number of cycles so far.
    pub count: u64,
    /// The configured time of a cycle, µs.
    pub period_us: f64,
    /// Half of the cycles took no longer than this, µs.
    pub p50_us: f64,
    /// 99 % of the cycles took no longer than this, µs.
    pub p99_us: f64,
    /// The longest cycle, µs.
    pub max_us: f64,
    /// Periods that were missed so far.
    pub overruns: u64,
    /// Compute time of the gateway in a cycle by the CPU clock of its thread, without exchanges.
    pub own: StretchTimes,
    /// A fixed computation by the same clock, the polynomial of degree 511 of `[realtime] reference`; only where it is made.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub reference: Option<StretchTimes>,
    /// From the deadline to the first instruction of a cycle.
    pub wake: StretchTimes,
    /// The exchanges with controllers in a cycle.
    pub exchange: StretchTimes,
    /// Histogram of cycle times: upper edge (µs) and count of each bin, edges doubling.
    pub histogram_us: Vec<(f64, u64)>,
}

/// Quantiles of one part of the cycle, µs.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct StretchTimes {
    /// Half of the cycles took no longer than this, µs.
    pub p50_us: f64,
    /// 99 % of the cycles took no longer than this, µs.
    pub p99_us: f64,
    /// The longest of all, µs.
    pub max_us: f64,
}

/// Rounds to three decimals, the precision of all documents.
pub fn round(value: f64) -> f64 {
    let rounded = (value * 1e3).round() / 1e3;
    // Adding zero turns −0 into 0.
    rounded + 0.0
}

/// The answer to `GET /api/map`: the error over the travels of two linear axes, the others where they stand. Empty for
/// a machine with fewer than two linear axes.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ErrorMap {
    /// The axis of the columns, then that of the rows.
    pub axes: Vec<MapAxis>,
    /// The length of the position error, µm: rows over the second axis, values in a row over the first, from the lower
    /// to the upper end of the travel.
    pub error_um: Vec<Vec<f64>>,
}

/// One axis of the map.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct MapAxis {
    /// The letter of the axis.
    #[schemars(with = "String")]
    pub name: AxisName,
    /// The ends of its travel, mm.
    pub travel: [f64; 2],
}

/// The answer to `GET /api/history`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct History {
    /// Maximum length of the history, s.
    pub span_s: f64,
    /// The points, oldest first.
    pub points: Vec<HistoryPoint>,
}

/// The length of the error at one time. Of the simulated machine it is the true error, else the model's.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct HistoryPoint {
    /// Time since the start of the control thread, s.
    pub at_s: f64,
    /// Length of the position error of the tool tip without correction, µm; null while it was not known.
    pub error_um: Option<f64>,
    /// Length of the position error with the applied correction, µm.
    pub residual_um: Option<f64>,
    /// Length of the direction error of the tool axis without correction, µrad; only with rotary axes.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub error_axis_urad: Option<f64>,
    /// Length of the direction error of the tool axis with the applied correction, µrad; only with rotary axes.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub residual_axis_urad: Option<f64>,
}
