//! The plan that a configuration makes: the document of `check --json`.

use std::collections::BTreeMap;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use volcomp_vocabulary::{AxisKind, AxisName};

use super::ByAxis;

/// Where a value comes from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Source {
    /// The configuration file states it.
    Configuration,
    /// The configuration does not state it; this is the gateway's default.
    Default,
    /// The device states it: its signals, its profile, its driver.
    Device,
}

/// A value that holds, and where it comes from.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Stated<T> {
    /// The value that holds, in the unit of its key.
    pub value: T,
    /// Where it comes from.
    pub source: Source,
    /// The value that the source asks for, where another one holds; the notes say why.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub asked: Option<T>,
}

impl<T> Stated<T> {
    /// A value that holds as its source states it.
    pub fn by(source: Source, value: T) -> Self {
        Self {
            value,
            source,
            asked: None,
        }
    }
}

impl<T: PartialEq> Stated<T> {
    /// The same, where the source asked for another value.
    #[must_use]
    pub fn instead_of(mut self, asked: T) -> Self {
        self.asked = (asked != self.value).then_some(asked);
        self
    }
}

/// The plan that a configuration makes: every device, limit and path, and where each value comes from.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct PlanDocument {
    /// Notes in words, to be read before the first start; none of them forbids it.
    pub notes: Vec<String>,
    /// The machine that is corrected.
    pub machine: MachinePlan,
    /// The time of a cycle, ms.
    pub cycle_ms: Stated<f64>,
    /// Whether it arms itself after the start.
    pub auto_arm: Stated<bool>,
    /// The limits of the guard for every controller; null without `[guard]`: the gateway does not arm then.
    pub guard: Option<GuardPlan>,
    /// The controllers in the order of preference.
    pub controllers: Vec<ControllerPlan>,
    /// The thermometers in the order of the configuration.
    pub thermometers: Vec<ThermometerPlan>,
    /// The sensors that thermal terms of the machine name.
    pub sensors: Vec<SensorPlan>,
    /// The dashboard and who may use it.
    pub dashboard: DashboardPlan,
    /// Where the audit log is kept.
    pub audit: AuditPlan,
    /// The centre of the fleet; missing where there is none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub fleet: Option<FleetPlan>,
    /// Over which ways other systems read the gateway; missing where there are none.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub interop: Vec<InteropPlan>,
    /// What the controls told when they were asked (`--online`), in the order of the configuration; only those are listed
    /// whose bus has something to compare. Missing where nobody asked.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub online: Option<Vec<OnlinePlan>>,
}

/// The centre of the fleet, and what it has put in force.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct FleetPlan {
    /// The addresses of the servers, separated by commas.
    pub url: String,
    /// The site.
    pub site: String,
    /// The name of the machine in the fleet.
    pub machine: String,
    /// The serial number of the machine tool.
    pub serial: String,
    /// The public nkey by which the server knows the machine.
    pub nkey: String,
    /// The public keys whose manifests count, base64.
    pub trusted_keys: Vec<String>,
    /// The folder of what was accepted and of what waits to be sent.
    pub dir: Stated<String>,
    /// The file with certificates that are trusted besides those of the system.
    pub ca: Option<String>,
    /// The version of the manifest whose machine file corrects; 0: the configured machine file does.
    pub version: u64,
    /// The version of the highest manifest that was accepted; 0: none was.
    pub accepted: u64,
    /// Whether the centre allows correcting.
    pub enabled: bool,
}

/// What a control told about itself when it was asked.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct OnlinePlan {
    /// The URL of the control.
    pub url: String,
    /// The letters of the control's axes.
    pub axes: Vec<String>,
    /// SINUMERIK: how fast each axis takes a changed correction at the most (MD32760 times MD32000), mm/min or rev/min;
    /// missing for others, and axes for which the control does not tell.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub fastest_per_min: Option<BTreeMap<String, f64>>,
    /// Whether the extended external machine zero point shift is in use (parameter 1203#0); null: the control does not
    /// tell.
    pub shift_in_use: Option<bool>,
    /// The first R address of the words from which the control takes the shifts of its axes (parameter 1280); null: the
    /// control does not tell.
    pub shift_words: Option<u32>,
    /// LinuxCNC: the version of the protocol that the bridge speaks; missing for others.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub protocol: Option<u8>,
    /// LinuxCNC: what the control is doing, in words; missing for others.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub state: Option<String>,
    /// The barrier as its report tells it; missing where the configuration has none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub barrier: Option<OnlineBarrier>,
    /// What deserves to be known and forbids nothing, in words.
    pub notes: Vec<String>,
}

/// The barrier of a control as its report tells it. Times are scans of the control with the configured `scan_ms`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct OnlineBarrier {
    /// The number of the machine.
    pub machine: u16,
    /// The number of its axes in their order, as `layout` of the barrier.
    pub layout: u32,
    /// The gateway whose frames it takes now; 0: nobody's, the next that sends.
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

/// The settings of one axis of a barrier, in µm for linear and µrad for rotary axes.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct OnlineBarrierAxis {
    /// The letter of the axis.
    #[schemars(with = "String")]
    pub name: AxisName,
    /// The largest correction that it lets through.
    pub limit: f64,
    /// How far it moves the correction in a second at the most.
    pub rate_per_s: f64,
}

/// The machine of a plan.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
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

/// The limits of the guard that hold for every controller.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct GuardPlan {
    /// Positions that are older are held, ms.
    pub hold_ms: Stated<f64>,
    /// Positions that are older ramp the correction to zero, ms.
    pub zero_after_ms: Stated<f64>,
    /// The time that a ramp takes, s: what is asked for, or 20 cycles if that is longer.
    pub ramp_s: Stated<f64>,
    /// The longest time that a stop may ramp out, s.
    pub stop_s: Stated<f64>,
    /// A rotary axis is corrected where half its step moves the tool tip by this at the most, µm.
    pub rotary_step_um: Stated<f64>,
    /// How long a better controller must be usable before it takes over again, s.
    pub hand_back_s: Stated<f64>,
    /// Positions that say that a linear axis moves faster are not believed, m/min.
    pub rapid_m_per_min: Stated<f64>,
    /// Positions that say that a rotary axis moves faster are not believed, 1/min.
    pub rapid_rpm: Stated<f64>,
    /// The fastest change of a temperature, K in a minute.
    pub max_degc_per_min: Stated<f64>,
    /// The lowest and the highest temperature that is believed, °C.
    pub range_degc: Stated<[f64; 2]>,
    /// A temperature that is older is stale, s.
    pub temperature_stale_s: Stated<f64>,
    /// A temperature with the same digits for this long is told to be stuck, s; 0: never.
    pub temperature_stuck_s: Stated<f64>,
    /// A temperature farther than this from the median of the others is told to disagree, K; null: not compared.
    pub temperature_neighbours_k: Stated<Option<f64>>,
    /// Thermal terms whose sensor is missing keep their last value for so long, s.
    pub temperature_hold_s: Stated<f64>,
    /// Thermal terms whose sensor is missing then fade to zero over so long, s.
    pub temperature_fade_s: Stated<f64>,
}

/// One controller of a plan.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ControllerPlan {
    /// The URL of the device.
    pub url: String,
    /// The name of the channel by which its corrections reach the axes.
    pub channel: Stated<String>,
    /// Whether the control's side notices when the gateway stops, and `unwatched` does not state otherwise.
    pub watched: bool,
    /// Whether a second gateway on this controller is noticed.
    pub sees_other_gateways: bool,
    /// The shortest cycle that it keeps up with, ms.
    pub shortest_cycle_ms: f64,
    /// Whether it carries the correction of thermal terms alone.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub only_thermal: bool,
    /// Positions that are older are held on this path, ms; null: those of the guard.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub hold_ms: Option<f64>,
    /// The barrier in the control, as the configuration states it; missing where it states none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub barrier: Option<BarrierPlan>,
    /// FANUC controls: the addresses in the PMC that are written and read.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub pmc: Option<PmcPlan>,
    /// SINUMERIK controls: how the server is asked, and its nodes.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub opc_ua: Option<OpcUaPlan>,
    /// Its axes that correct, in the order X Y Z A B C U V W.
    pub axes: Vec<AxisPlan>,
    /// The largest correction of each of them that the machine file asks for over a grid of the travels, without what
    /// temperatures add: µm, µrad. More than the limit is not corrected.
    #[serde(default)]
    #[schemars(with = "BTreeMap<String, f64>")]
    pub needs: ByAxis,
    /// How much temperatures may change the correction of each of them with each kelvin of the sensors, at the most: µm, µrad.
    /// Not there for axes that no thermal term moves.
    #[serde(default)]
    #[schemars(with = "BTreeMap<String, f64>")]
    pub needs_per_k: ByAxis,
    /// Its axes that do not correct, in the same order: they are held, and nothing but zero is written to them.
    #[schemars(with = "Vec<String>")]
    pub held: Vec<AxisName>,
    /// Axes that it shows and never writes, in the same order: where they stand makes the correction of the others.
    #[serde(default)]
    #[schemars(with = "Vec<String>")]
    pub reads: Vec<AxisName>,
    /// Machine axes that it does not show and that stand at this position: mm, deg.
    #[schemars(with = "BTreeMap<String, f64>")]
    pub fixed: ByAxis,
}

/// The barrier in a control, as the configuration states it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
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

/// The addresses in the PMC of a FANUC control, as ladders name them, such as `R100`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct PmcPlan {
    /// The first byte of the words into which shifts are written; null with a barrier, where the ladder writes them.
    pub shift_words: Option<String>,
    /// How many bytes the shift of an axis has; null with a barrier.
    pub shift_bytes: Option<u16>,
    /// Whether a ladder copies the shifts on to the words from which the control takes them.
    pub copied: bool,
    /// The first byte of the frame that goes to the barrier; null without a barrier.
    pub frame: Option<String>,
    /// The first byte of the report of the barrier; null without a barrier.
    pub report: Option<String>,
    /// The byte that every correction moves on, for the ladder to watch; null: none, or a barrier watches.
    pub heartbeat: Option<String>,
    /// The byte whose bits say which axes are referenced; null: not asked, the axes are taken to be referenced.
    pub referenced: Option<String>,
}

/// How the OPC UA server of a SINUMERIK control is asked. Node ids are patterns: `{axis}` is the number of an axis in the
/// control, `{db}` 30 more.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct OpcUaPlan {
    /// The namespace of the nodes.
    pub namespace: String,
    /// Who logs in; null: nobody, anonymous.
    pub user: Option<String>,
    /// How messages are protected: `none`, `sign` or `sign-and-encrypt`.
    pub security: String,
    /// The time from one reading to the next, ms.
    pub period_ms: f64,
    /// How long a request may take, ms.
    pub time_out_ms: f64,
    /// Whether the server's source timestamps make positions older.
    pub source_timestamps: bool,
    /// The nodes of positions.
    pub positions: String,
    /// The nodes of SD43900, the correction.
    pub settings: String,
    /// Whether a positive SD43900 moves an axis in its positive direction (`adds`) or not (`subtracts`).
    pub sign: String,
}

/// The limits and properties of one axis of a controller, in µm for linear and µrad for rotary axes.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct AxisPlan {
    /// The letter of the axis.
    #[schemars(with = "String")]
    pub name: AxisName,
    /// The kind of the axis: `linear` or `rotary`.
    pub kind: String,
    /// The unit of the numbers below: `µm` or `µrad`.
    pub unit: String,
    /// The largest correction that is written, in either direction: whole steps within the limit that is asked for.
    pub limit: Stated<f64>,
    /// Corrections above are reported.
    pub warn: Stated<f64>,
    /// The largest change of the correction in a second.
    pub slew_per_s: Stated<f64>,
    /// The largest change of the slew in a second; null: not limited.
    pub accel_per_s2: Stated<Option<f64>>,
    /// A change of model that moves a corner further needs a confirmation.
    pub confirm: Stated<f64>,
    /// The smallest step of a correction.
    pub resolution: Stated<f64>,
    /// The shift at arming that shows whether positions contain the correction; 0: not made.
    pub test_shift: f64,
    /// Whether reported positions contain the correction.
    pub includes_correction: Stated<bool>,
}

impl AxisPlan {
    /// The unit of corrections of this kind of axis, as people read it.
    pub fn unit_of(kind: AxisKind) -> &'static str {
        match kind {
            AxisKind::Linear => "µm",
            AxisKind::Rotary => "µrad",
        }
    }
}

/// One thermometer of a plan.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct ThermometerPlan {
    /// The URL of the device.
    pub url: String,
    /// The names of its sensors.
    pub sensors: Vec<String>,
}

/// A sensor that thermal terms name.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct SensorPlan {
    /// The name as the file states it.
    pub name: String,
    /// The thermal terms that it feeds, such as `expansion EXX`.
    pub feeds: Vec<String>,
    /// The thermometer that measures it; null: none, and its terms are left out.
    pub thermometer: Option<String>,
}

/// The dashboard of a plan.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct DashboardPlan {
    /// The address and port on which it listens.
    pub listen: Stated<String>,
    /// Whether it speaks TLS.
    pub tls: bool,
    /// Whether reading needs a token.
    pub reading_needs_token: bool,
    /// The tokens that are known, without the secret.
    pub tokens: Vec<TokenPlan>,
}

/// A token of a plan.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct TokenPlan {
    /// The name of its holder.
    pub name: String,
    /// The role of its holder: `view` (read only), `operate` or `engineer`.
    pub role: String,
}

/// A way over which other systems read the gateway.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct InteropPlan {
    /// Its table in the configuration, such as `shdr`.
    pub table: String,
    /// The address and port on which it listens, or the URL with which it connects.
    pub address: String,
    /// The name under which others see the gateway.
    pub name: String,
}

/// The audit log of a plan.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct AuditPlan {
    /// The folder of the log.
    pub dir: Stated<String>,
}

/// The document on standard error when a call with `--json` fails.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct CheckFailure {
    /// The message in words.
    pub error: String,
    /// The exit status: 1 the work failed, 2 the configuration or the call is wrong.
    pub status: u8,
}
