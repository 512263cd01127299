//! The state of the gateway, as served by `GET /api/state`, exported as metrics and printed by `status`.

use std::collections::BTreeMap;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use volcomp_vocabulary::AxisName;

/// One value per axis, in the order X Y Z A B C U V W.
pub type ByAxis = BTreeMap<AxisName, f64>;

/// State of the correction.
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
    /// The control thread has stopped reporting: the applied correction is unknown.
    Unknown,
}

impl StateName {
    /// All states in the order of the metrics.
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

/// State of the gateway after one control cycle.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[expect(clippy::struct_excessive_bools, reason = "each is a key of the document")]
pub struct Status {
    /// State of the guard; `unknown` after a timeout without a report of the control thread.
    pub state: StateName,
    /// Reasons for the state, and warnings.
    pub reasons: Vec<String>,
    /// Whether the gateway corrects or will resume automatically.
    pub armed: bool,
    /// Whether the gateway arms automatically after the start.
    pub auto_arm: bool,
    /// Whether the machine is the built-in simulation.
    pub simulated: bool,
    /// The machine of the active model.
    pub machine: MachineState,
    /// Whether a token with the role of an operator is configured. Without one, the only request
    /// accepted over HTTP is to disarm, from the same computer.
    #[serde(default)]
    pub operable: bool,
    /// The active controller.
    pub controller: Option<ControllerState>,
    /// Condition of every configured controller, active or on stand-by, in order of preference.
    #[serde(default)]
    pub controllers: Vec<PathState>,
    /// Positions of the linear axes without the correction, mm. Axes with an unknown position are
    /// missing.
    #[schemars(with = "BTreeMap<String, f64>")]
    pub positions_mm: ByAxis,
    /// Positions of the rotary axes without the correction, deg.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    #[schemars(with = "BTreeMap<String, f64>")]
    pub positions_deg: ByAxis,
    /// Whether the applied correction was confirmed within `hold_ms`. Otherwise it is unknown, and
    /// `correction_um` and `correction_urad` are the last confirmed values.
    #[serde(default)]
    pub correction_known: bool,
    /// Last confirmed correction of each linear axis written by the active controller, µm; empty if
    /// none was ever confirmed.
    #[schemars(with = "BTreeMap<String, f64>")]
    pub correction_um: ByAxis,
    /// Last confirmed correction of each rotary axis written by the active controller, µrad.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    #[schemars(with = "BTreeMap<String, f64>")]
    pub correction_urad: ByAxis,
    /// Last correction of each linear axis that was sent successfully, µm; empty if none was since
    /// the start.
    #[serde(default)]
    #[schemars(with = "BTreeMap<String, f64>")]
    pub sent_um: ByAxis,
    /// Last correction of each rotary axis that was sent successfully, µrad.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    #[schemars(with = "BTreeMap<String, f64>")]
    pub sent_urad: ByAxis,
    /// Result of the last test shift for each corrected axis, which tests whether the reported
    /// position contains the correction.
    #[serde(default)]
    #[schemars(with = "BTreeMap<String, ProvenName>")]
    pub proven: BTreeMap<AxisName, ProvenName>,
    /// Correction of each linear axis by the model, before limits and ramps, µm; empty while a position is unknown or rejected.
    #[schemars(with = "BTreeMap<String, f64>")]
    pub wanted_um: ByAxis,
    /// Correction of each rotary axis by the model, before limits and ramps, µrad; empty while a position is unknown or rejected.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    #[schemars(with = "BTreeMap<String, f64>")]
    pub wanted_urad: ByAxis,
    /// Predicted position error of the tool tip without correction, µm in workpiece axes; null if
    /// positions are unknown.
    pub error_um: Option<[f64; 3]>,
    /// Predicted rotation error of the tool without correction, µrad about the workpiece axes.
    pub error_urad: Option<[f64; 3]>,
    /// Predicted direction error of the tool axis without correction, µrad in workpiece axes; only
    /// on machines with rotary axes.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub error_axis_urad: Option<[f64; 3]>,
    /// Predicted position error with the applied correction, which is zero for axes that are not
    /// written, µm in workpiece axes; null if the applied correction is unknown.
    pub residual_um: Option<[f64; 3]>,
    /// Predicted direction error of the tool axis with the applied correction, µrad in workpiece
    /// axes; only on machines with rotary axes.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub residual_axis_urad: Option<[f64; 3]>,
    /// The true error of the simulated machine without correction, µm; only in the simulation.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub true_error_um: Option<[f64; 3]>,
    /// The true error of the simulated machine with the applied correction, µm; only in the simulation.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub true_residual_um: Option<[f64; 3]>,
    /// Temperatures of the sensors, in the order of the configuration.
    pub temperatures: Vec<SensorState>,
    /// Limits and warning thresholds of the correction on the active path; missing without `[guard]`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub limits: Option<CorrectionLimits>,
    /// What a user can do to the built-in simulation; missing on a configured machine.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub demo: Option<DemoState>,
    /// Number of cycles since the start in which a rate or acceleration limit made the correction
    /// lag behind the model.
    pub held_back: u64,
    /// Number of failed exchanges with controllers since the start.
    pub faults: u64,
    /// Time from the start of the control thread to the reported cycle, s.
    pub uptime_s: f64,
    /// Age of the state, ms.
    pub age_ms: f64,
    /// Quantiles of the cycle time.
    pub cycle: CycleTimes,
    /// State of the connection to the centre; only if `[fleet]` is configured.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub fleet: Option<FleetState>,
}

/// Limits and warning thresholds of the correction; null: none.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct CorrectionLimits {
    /// Limit of a linear axis, µm.
    pub limit_um: f64,
    /// Threshold of the warning of a linear axis, µm.
    pub warn_um: Option<f64>,
    /// Limit of a rotary axis, µrad.
    pub limit_urad: Option<f64>,
    /// Threshold of the warning of a rotary axis, µrad.
    pub warn_urad: Option<f64>,
    /// Lowest and highest valid temperature, °C.
    pub range_degc: Option<[f64; 2]>,
}

/// What a user can do to the built-in simulation.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct DemoState {
    /// Token that may operate, from the same computer; null if tokens are configured.
    pub token: Option<String>,
    /// The disturbances that are on.
    pub disturbances: Vec<Disturbance>,
}

/// A disturbance of the built-in simulation.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Disturbance {
    /// The cable to the control is pulled.
    Cable,
    /// The control reports the same position again and again while the machine moves on.
    Freeze,
    /// One sensor reads 15 K too much.
    Heat,
}

/// The body of `POST /api/disturb`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct DisturbRequest {
    /// The disturbance.
    pub what: Disturbance,
    /// `true`: the disturbance begins; `false`: it ends.
    pub on: bool,
}

/// State of the connection to the centre of the fleet.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct FleetState {
    /// Name of the site to which the centre assigns the machine.
    pub site: String,
    /// Name of the machine at the centre.
    pub machine: String,
    /// Whether the gateway is connected to the NATS server.
    pub connected: bool,
    /// Version of the manifest whose machine file is active; 0: the configured machine file is
    /// active.
    pub version: u64,
    /// Highest accepted version of a manifest; 0: none.
    pub accepted: u64,
    /// Whether the centre permits correction.
    pub enabled: bool,
    /// Outcome of the accepted manifest with the highest version; null if not known yet.
    pub outcome: Option<String>,
    /// Why the accepted manifest is not active yet, or which damage was found at start-up.
    /// Activation is retried.
    pub trouble: Option<String>,
    /// Why the last manifest sent to this machine was rejected. A rejected manifest changes
    /// nothing. Null if a later one was accepted.
    #[serde(default)]
    pub refused: Option<String>,
    /// Why messages to the centre are queued; null while they are sent.
    pub waiting: Option<String>,
    /// Number of messages dropped since the start because the queue was full.
    pub dropped: u64,
}

/// The machine of the active model.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct MachineState {
    /// Name in the machine file.
    pub name: String,
    /// Checksum of the machine file.
    pub hash: String,
    /// Structure code: the order of the axes from workpiece to tool, such as `w X' b Y Z t`.
    #[serde(default)]
    pub structure: String,
    /// The letters of its axes in the order X Y Z A B C U V W.
    #[schemars(with = "Vec<String>")]
    pub axes: Vec<AxisName>,
}

/// The active controller.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct ControllerState {
    /// The URL of the device.
    pub device: String,
    /// Name of the channel through which corrections reach the axes.
    pub channel: String,
    /// Index among the configured controllers, from 0. Messages count from 1 (path 1).
    pub number: usize,
}

/// Condition of one of the configured controllers.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct PathState {
    /// URL of the controller's device.
    pub device: String,
    /// Index among the configured controllers, from 0. Messages count from 1 (path 1).
    pub number: usize,
    /// Whether this controller is active.
    pub active: bool,
    /// How the correction of this controller is confirmed.
    pub scheme: SchemeName,
    /// Time since the last response, ms; null: never.
    pub answered_ms: Option<f64>,
    /// Age of the positions that this controller reported, ms; null: none received.
    pub positions_ms: Option<f64>,
    /// Time since the last confirmation of the applied correction, ms; null: never.
    pub confirmed_ms: Option<f64>,
    /// Whether the applied correction is not zero; null: unknown, because nothing confirmed it in
    /// the last two seconds.
    pub holds_correction: Option<bool>,
    /// Warnings about this controller.
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

/// Result of the test shift of an axis.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum ProvenName {
    /// The reported position contains the correction.
    Contained,
    /// The reported position does not contain the correction.
    NotContained,
    /// No conclusive test shift was made.
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

/// One temperature as used by the model.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct SensorState {
    /// Name of the sensor, as in the configuration.
    pub name: String,
    /// Temperature, °C; null if it is not used.
    pub degc: Option<f64>,
    /// `good` or `uncertain` if the temperature is used, else `bad`.
    pub quality: String,
    /// Why the temperature is not used; null if it is used.
    pub reason: Option<String>,
}

/// Quantiles of the durations of complete cycles and of their parts, over the last several thousand
/// cycles.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct CycleTimes {
    /// Number of cycles since the start.
    pub count: u64,
    /// Configured cycle time, µs.
    pub period_us: f64,
    /// Median (p50), µs.
    pub p50_us: f64,
    /// 99th percentile, µs.
    pub p99_us: f64,
    /// Maximum over the last several thousand cycles, µs.
    pub max_us: f64,
    /// Number of missed periods since the start.
    pub overruns: u64,
    /// Compute time of the gateway in a cycle by the CPU clock of its thread, without exchanges.
    pub own: StretchTimes,
    /// Time of a reference computation by the same clock: the polynomial of degree 511 of
    /// `[realtime] reference`. Missing if it is disabled.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub reference: Option<StretchTimes>,
    /// Wake-up latency: from the deadline to the first instruction of the cycle.
    pub wake: StretchTimes,
    /// Time of the exchanges with controllers.
    pub exchange: StretchTimes,
    /// Histogram of cycle times: upper edge (µs) and count of each bin, edges doubling.
    pub histogram_us: Vec<(f64, u64)>,
}

/// Quantiles of one part of the cycle, µs.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct StretchTimes {
    /// Median (p50), µs.
    pub p50_us: f64,
    /// 99th percentile, µs.
    pub p99_us: f64,
    /// Maximum over the last several thousand cycles, µs.
    pub max_us: f64,
}

/// Rounds to three decimals, the precision of all documents.
pub fn round(value: f64) -> f64 {
    let rounded = (value * 1e3).round() / 1e3;
    // Adding zero turns −0 into 0.
    rounded + 0.0
}

/// The response to `GET /api/map`: the error over the travels of two linear axes, with the other
/// axes at their current positions. Empty for a machine with fewer than two linear axes.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ErrorMap {
    /// The horizontal axis of the map, then the vertical axis.
    pub axes: Vec<MapAxis>,
    /// Length of the position error, µm. Rows run along the second axis, values in a row along the
    /// first, from the lower to the upper end of the travel.
    pub error_um: Vec<Vec<f64>>,
}

/// An axis of the map, with its travel.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct MapAxis {
    /// The letter of the axis.
    #[schemars(with = "String")]
    pub name: AxisName,
    /// Ends of the travel, mm.
    pub travel: [f64; 2],
}

/// The answer to `GET /api/history`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct History {
    /// Maximum length of the history, s.
    pub span_s: f64,
    /// Time of the start of the control thread, s since 1970 by the clock of the gateway's computer; only with `span_s` in the request.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub start_s: Option<f64>,
    /// Period that each point covers from its time on, s; only with `span_s` in the request; 0: the points are single states.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub step_s: Option<f64>,
    /// The points, oldest first.
    pub points: Vec<HistoryPoint>,
}

/// Length of the error at one time. For the simulated machine it is the true error, otherwise the
/// prediction of the model. State, maxima, corrections and temperatures only with `span_s` in the request; a point that covers a period has
/// means.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct HistoryPoint {
    /// Time since the start of the control thread, s; negative before it.
    pub at_s: f64,
    /// Length of the position error of the tool tip without correction, µm; null while it was not known.
    pub error_um: Option<f64>,
    /// Length of the position error with the applied correction, µm; with `span_s` in the request null while none was applied.
    pub residual_um: Option<f64>,
    /// Length of the direction error of the tool axis without correction, µrad; only with rotary axes.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub error_axis_urad: Option<f64>,
    /// Length of the direction error of the tool axis with the applied correction, µrad; only with rotary axes.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub residual_axis_urad: Option<f64>,
    /// State of the guard for most of the period; `faulted` and `unknown` however short they were.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub state: Option<StateName>,
    /// Maximum of `error_um` in the period.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub error_max_um: Option<f64>,
    /// Maximum of `residual_um` in the period.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub residual_max_um: Option<f64>,
    /// Maximum of `error_axis_urad` in the period.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub error_axis_max_urad: Option<f64>,
    /// Maximum of `residual_axis_urad` in the period.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub residual_axis_max_urad: Option<f64>,
    /// Applied correction of each linear axis, µm; empty while it was not known.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    #[schemars(with = "BTreeMap<String, f64>")]
    pub correction_um: ByAxis,
    /// Minimum and maximum of `correction_um` in the period.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    #[schemars(with = "BTreeMap<String, [f64; 2]>")]
    pub correction_range_um: BTreeMap<AxisName, [f64; 2]>,
    /// Applied correction of each rotary axis, µrad; empty while it was not known.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    #[schemars(with = "BTreeMap<String, f64>")]
    pub correction_urad: ByAxis,
    /// Minimum and maximum of `correction_urad` in the period.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    #[schemars(with = "BTreeMap<String, [f64; 2]>")]
    pub correction_range_urad: BTreeMap<AxisName, [f64; 2]>,
    /// Temperature of each sensor that the model used, °C.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub temperatures_degc: BTreeMap<String, f64>,
}
