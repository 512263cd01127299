//! The tables of a configuration, key by key: the field names are the keys.
#![expect(missing_docs, reason = "the manual describes the keys")]

use std::{
    collections::{BTreeMap, BTreeSet},
    fmt,
    net::SocketAddr,
    path::{Path, PathBuf},
    time::Duration,
};

use serde::{
    Deserialize, Deserializer, Serialize,
    de::{MapAccess, Visitor, value::MapAccessDeserializer},
};
use volcomp_devices::Address;
use volcomp_digital_io::{
    Coherence, CorrectionCode, CorrectionWord, DigitalAxis, PositionCode, PositionWord,
};
use volcomp_fleet::{Identity, UnknownId, VerifyingKey, trusted_key};
use volcomp_focas::{PmcAddress, PmcArea};
use volcomp_port::ShownStates;
use volcomp_runtime::Realtime;
use volcomp_sinumerik::{Nodes, Security, Server, Sign};
use volcomp_vocabulary::{AxisKind, AxisName, Deg, Displacement};

use super::ControllerKind;

/// One table `[[controller]]`: a path to the machine.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ControllerConfig {
    pub url: String,
    /// The name of the channel by which its corrections reach the axes; `None`: the driver's own.
    pub channel: Option<String>,
    pub axes: Vec<AxisName>,
    pub reads: Vec<AxisName>,
    pub fixed: BTreeMap<AxisName, f64>,
    pub not_driven: Vec<AxisName>,
    pub includes_correction: bool,
    /// The terms that it carries; `["thermal"]`, `None`: all.
    pub terms: Option<Vec<String>>,
    /// Older positions are held on this path; `None`: `hold_ms` of `[guard]`.
    pub hold_ms: Option<f64>,
    /// Whether the test shift at arming is made; `None`: not on digital lines.
    pub test_shift: Option<bool>,
    pub unwatched: bool,
    pub unseen: Vec<StateKey>,
    /// The smallest step of a correction of a linear axis; `None`: the driver's own.
    pub resolution_um: Option<f64>,
    /// The smallest step of a correction of a rotary axis; `None`: the driver's own.
    pub resolution_urad: Option<f64>,
    /// FOCAS: the words of the shifts in the PMC; `None`: the driver's own place.
    pub area: Option<AreaConfig>,
    pub heartbeat: Option<PmcByte>,
    /// FOCAS: the byte whose bits say which axes are referenced; `None`: the driver's own.
    pub referenced: Option<Referenced>,
    /// The barrier in the control that receives frames; `None`: corrections are written as plain values.
    pub barrier: Option<BarrierConfig>,
    /// The words on digital lines; `None`: another device.
    pub digital: Option<DigitalConfig>,
    /// SINUMERIK: how the server is reached, and its nodes; `None`: another device.
    pub sinumerik: Option<SinumerikTable>,
    pub linuxcnc: Option<LinuxCncTable>,
}

/// A state of the control, by its key.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum StateKey {
    Referenced,
    Alarm,
    EmergencyStop,
}

/// The areas of the PMC that a configuration can name.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum PmcLetter {
    G,
    F,
    #[default]
    R,
    D,
}

/// A byte of the PMC, `{ pmc = "R", at = 120 }`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PmcByte {
    pub pmc: PmcLetter,
    pub at: u16,
}

/// FOCAS: the words of the shifts in the PMC, `{ pmc = "R", first = 100, width = 2 }`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AreaConfig {
    pub pmc: PmcLetter,
    pub first: u16,
    #[serde(default = "word")]
    pub width: u16,
    #[serde(default)]
    pub copied: bool,
}

fn word() -> u16 {
    2
}

/// `false`, or the byte of the PMC whose bits say which axes are referenced.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(untagged)]
pub enum Referenced {
    Not(bool),
    Byte(PmcByte),
}

impl<'de> Deserialize<'de> for Referenced {
    // What serde derives for `untagged` loses the place of a mistake in the byte.
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Either;
        impl<'de> Visitor<'de> for Either {
            type Value = Referenced;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("false or a byte such as { pmc = \"F\", at = 94 }")
            }

            fn visit_bool<E>(self, value: bool) -> Result<Referenced, E> {
                Ok(Referenced::Not(value))
            }

            fn visit_map<A: MapAccess<'de>>(self, map: A) -> Result<Referenced, A::Error> {
                PmcByte::deserialize(MapAccessDeserializer::new(map)).map(Referenced::Byte)
            }
        }
        deserializer.deserialize_any(Either)
    }
}

/// The table `[controller.barrier]`: the barrier in the control, as its program is set.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct BarrierConfig {
    pub machine: u16,
    pub scan_ms: f64,
    pub frame: Option<PmcByte>,
    pub report: Option<PmcByte>,
}

/// The table `linuxcnc` of a `[[controller]]`.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct LinuxCncTable {
    pub key_file: Option<PathBuf>,
    pub ini: Option<PathBuf>,
}

/// The table `[controller.digital]`: the words on digital lines.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct DigitalConfig {
    pub position_bits: u32,
    pub position_mm_per_count: Option<f64>,
    pub position_deg_per_count: Option<f64>,
    pub position_zero_mm: Option<f64>,
    pub position_zero_deg: Option<f64>,
    #[serde(with = "PositionCodeKey")]
    pub position_code: PositionCode,
    pub correction_bits: u32,
    #[serde(with = "CorrectionCodeKey")]
    pub correction_code: CorrectionCode,
    /// The line that changes its level when the correction word has settled, from 0; `None`: there is none.
    pub latch: Option<u32>,
    /// The time without an edge of the latch after which the control takes the correction to zero; `None`: never.
    pub time_out_ms: Option<f64>,
    #[serde(with = "CoherenceKey")]
    pub coherence: Coherence,
}

#[derive(Serialize, Deserialize)]
#[serde(remote = "PositionCode", rename_all = "kebab-case")]
enum PositionCodeKey {
    Binary,
    Gray,
}

#[derive(Serialize, Deserialize)]
#[serde(remote = "CorrectionCode", rename_all = "kebab-case")]
enum CorrectionCodeKey {
    TwosComplement,
    SignMagnitude,
}

#[derive(Serialize, Deserialize)]
#[serde(remote = "Coherence", rename_all = "kebab-case")]
enum CoherenceKey {
    TwoAgree,
    #[serde(skip)]
    Strobe,
    Latched,
}

impl Default for DigitalConfig {
    /// The published scheme: 15 lines of 1/32 mm, 8 lines of correction.
    fn default() -> Self {
        Self {
            position_bits: 15,
            position_mm_per_count: None,
            position_deg_per_count: None,
            position_zero_mm: None,
            position_zero_deg: None,
            position_code: PositionCode::Binary,
            correction_bits: 8,
            correction_code: CorrectionCode::TwosComplement,
            latch: None,
            time_out_ms: None,
            coherence: Coherence::TwoAgree,
        }
    }
}

/// The tables `sinumerik`: how the OPC UA server of a control is reached, and the nodes of a controller.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SinumerikTable {
    pub namespace: String,
    /// The user name; `None`: anonymous.
    pub user: Option<String>,
    pub password_file: Option<PathBuf>,
    #[serde(with = "SecurityKey")]
    pub security: Security,
    pub certificates: Option<PathBuf>,
    pub period_ms: f64,
    pub time_out_ms: f64,
    pub source_timestamps: bool,
    pub numbers: Vec<u16>,
    #[serde(with = "SignKey")]
    pub sign: Sign,
    #[serde(with = "NodesKeys")]
    pub nodes: Nodes,
}

#[derive(Serialize, Deserialize)]
#[serde(remote = "Security", rename_all = "kebab-case")]
enum SecurityKey {
    None,
    Sign,
    SignAndEncrypt,
}

#[derive(Serialize, Deserialize)]
#[serde(remote = "Sign", rename_all = "kebab-case")]
enum SignKey {
    Adds,
    Subtracts,
}

#[derive(Serialize, Deserialize)]
#[serde(remote = "Nodes", deny_unknown_fields, default = "Nodes::default")]
struct NodesKeys {
    position: String,
    name: String,
    setting: String,
    kind: String,
    share: String,
    speed: String,
    emergency_stop: Option<String>,
    alarm: Option<String>,
    referenced: Option<String>,
}

impl Default for SinumerikTable {
    fn default() -> Self {
        let server = Server::new("");
        Self {
            namespace: server.namespace,
            user: None,
            password_file: None,
            security: server.security,
            certificates: None,
            period_ms: ms(server.period),
            time_out_ms: ms(server.time_out),
            source_timestamps: server.source_timestamps,
            numbers: Vec::new(),
            sign: Sign::Adds,
            nodes: Nodes::default(),
        }
    }
}

/// One table `[[thermometer]]`: a device with temperatures.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ThermometerConfig {
    pub url: String,
    pub names: Vec<String>,
    pub nodes: Vec<String>,
    /// SINUMERIK: how the server is reached; `None`: another device.
    pub sinumerik: Option<SinumerikTable>,
}

/// The table `[dashboard]`: where it listens, and who may use it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct DashboardConfig {
    pub listen: SocketAddr,
    pub token_file: Option<PathBuf>,
    /// The certificate, PEM; `None`: without TLS.
    pub tls_certificate: Option<PathBuf>,
    pub tls_key: Option<PathBuf>,
    pub hosts: Vec<String>,
}

impl Default for DashboardConfig {
    fn default() -> Self {
        Self {
            listen: SocketAddr::from(([127, 0, 0, 1], 8080)),
            token_file: None,
            tls_certificate: None,
            tls_key: None,
            hosts: Vec::new(),
        }
    }
}

/// The table `[audit]`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct AuditConfig {
    pub dir: PathBuf,
}

impl Default for AuditConfig {
    fn default() -> Self {
        Self {
            dir: PathBuf::from("audit"),
        }
    }
}

/// The table `[realtime]`.
#[derive(Serialize, Deserialize)]
#[serde(remote = "Realtime", deny_unknown_fields, default = "realtime")]
pub(super) struct RealtimeKeys {
    priority: u8,
    cpu: Option<usize>,
    reference: bool,
}

/// How the control thread is scheduled where nothing else is stated.
pub(crate) fn realtime() -> Realtime {
    Realtime {
        priority: 60,
        cpu: None,
        reference: false,
    }
}

/// The table `[fleet]`: the centre that sends the machine file and receives the condition of the machine.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct FleetConfig {
    pub url: String,
    pub site: String,
    pub machine: String,
    pub serial: String,
    pub nkey_file: PathBuf,
    pub trusted_keys: Vec<String>,
    #[serde(default = "fleet_dir")]
    pub dir: PathBuf,
    pub ca: Option<PathBuf>,
}

fn fleet_dir() -> PathBuf {
    PathBuf::from("fleet")
}

/// The table `[shdr]`: an adapter for agents of MTConnect.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ShdrConfig {
    pub listen: SocketAddr,
    pub anyone_may_read: bool,
    /// The name of the device that an agent shows; `None`: that of the machine.
    pub device: Option<String>,
}

impl Default for ShdrConfig {
    fn default() -> Self {
        Self {
            listen: SocketAddr::from(([127, 0, 0, 1], 7878)),
            anyone_may_read: false,
            device: None,
        }
    }
}

/// The table `[opc_ua]`: a server that clients read.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct OpcUaConfig {
    pub listen: SocketAddr,
    pub anyone_may_read: bool,
}

impl Default for OpcUaConfig {
    fn default() -> Self {
        Self {
            listen: SocketAddr::from(([127, 0, 0, 1], 4840)),
            anyone_may_read: false,
        }
    }
}

/// Milliseconds to the nanosecond, as they are written by hand.
pub(crate) fn ms(time: Duration) -> f64 {
    (time.as_secs_f64() * 1e9).round() / 1e6
}

/// A time that was checked to be positive.
pub(crate) fn of_ms(ms: f64) -> Duration {
    Duration::try_from_secs_f64(ms * 1e-3).unwrap_or_default()
}

impl From<PmcByte> for PmcAddress {
    fn from(PmcByte { pmc, at }: PmcByte) -> Self {
        let area = match pmc {
            PmcLetter::G => PmcArea::G,
            PmcLetter::F => PmcArea::F,
            PmcLetter::R => PmcArea::R,
            PmcLetter::D => PmcArea::D,
        };
        Self { area, at }
    }
}

impl BarrierConfig {
    /// The time from one scan of the control's program to the next.
    pub fn scan(&self) -> Duration {
        of_ms(self.scan_ms)
    }
}

impl SinumerikTable {
    /// Makes every path relative to the folder of the file.
    pub(super) fn join(&mut self, folder: &Path) {
        let paths = [&mut self.password_file, &mut self.certificates];
        for path in paths.into_iter().flatten() {
            *path = folder.join(&*path);
        }
    }
}

impl DashboardConfig {
    /// Whether reading needs a token: it is open to programs on this computer alone.
    pub(crate) fn reading_needs_token(&self) -> bool {
        !self.listen.ip().is_loopback()
    }
}

impl FleetConfig {
    /// The site and the name of the machine in the fleet.
    ///
    /// # Errors
    /// A name that cannot stand in a subject; a configuration that was read has none.
    pub fn identity(&self) -> Result<Identity, UnknownId> {
        Ok(Identity {
            site: self.site.parse()?,
            machine: self.machine.parse()?,
        })
    }

    /// The keys whose manifests count.
    pub fn trusted(&self) -> Vec<VerifyingKey> {
        let keys = self.trusted_keys.iter();
        keys.filter_map(|key| trusted_key(key).ok()).collect()
    }
}

impl ControllerConfig {
    /// The kind of the controller; `None`: its URL is none.
    pub fn kind(&self) -> Option<ControllerKind> {
        let address = Address::parse(&self.url).ok()?;
        Some(ControllerKind::of(address.scheme))
    }

    /// Whether it carries the correction of thermal terms alone.
    pub fn only_thermal(&self) -> bool {
        self.terms.is_some()
    }

    /// Older positions are held on this path; `None`: the hold of the guard.
    pub fn hold(&self) -> Option<Duration> {
        self.hold_ms.map(of_ms)
    }

    /// Digital lines: the time without an edge after which the control takes the correction to zero.
    pub fn time_out(&self) -> Option<Duration> {
        self.digital?.time_out_ms.map(of_ms)
    }

    /// Rotary axes of `fixed` without a drive.
    pub fn not_driven(&self) -> BTreeSet<AxisName> {
        self.not_driven.iter().copied().collect()
    }

    /// The states that are accepted as missing.
    pub fn unseen(&self) -> ShownStates {
        let has = |state| self.unseen.contains(&state);
        ShownStates {
            referenced: has(StateKey::Referenced),
            alarm: has(StateKey::Alarm),
            emergency_stop: has(StateKey::EmergencyStop),
        }
    }

    /// The smallest step of a correction that the configuration states for this kind of axis.
    pub fn resolution(&self, kind: AxisKind) -> Option<Displacement> {
        let micro = match kind {
            AxisKind::Linear => self.resolution_um,
            AxisKind::Rotary => self.resolution_urad,
        };
        micro.map(|micro| Displacement::from_micro(kind, micro))
    }

    /// The words of one axis on digital lines. No position is published for a rotary axis, so its step must be stated.
    ///
    /// # Errors
    /// The key that is missing.
    pub fn digital_axis(&self, name: AxisName) -> Result<DigitalAxis, MissingKey> {
        let (kind, digital) = (name.kind(), self.digital.unwrap_or_default());
        let (step, zero) = match kind {
            AxisKind::Linear => (digital.position_mm_per_count, digital.position_zero_mm),
            AxisKind::Rotary => (digital.position_deg_per_count, digital.position_zero_deg),
        };
        let stated = step.map(|step| Displacement::from_coordinate(kind, step));
        let published = Some(PositionWord::PUBLISHED.step).filter(|step| step.kind() == kind);
        let step = stated.or(published).ok_or(MissingKey {
            axis: name,
            key: "digital.position_deg_per_count",
        })?;
        let correction_step = self.resolution(kind).unwrap_or(match kind {
            AxisKind::Linear => CorrectionWord::PUBLISHED.step,
            AxisKind::Rotary => Displacement::Angle(LINE_STEP.to_rad()),
        });
        Ok(DigitalAxis {
            position: PositionWord {
                bits: digital.position_bits,
                code: digital.position_code,
                step,
                zero: Displacement::from_coordinate(kind, zero.unwrap_or(0.0)),
            },
            correction: CorrectionWord {
                bits: digital.correction_bits,
                code: digital.correction_code,
                step: correction_step,
            },
            includes_correction: self.includes_correction,
            ..DigitalAxis::published(name)
        })
    }
}

/// The step of a correction of a rotary axis on digital lines where the configuration states none.
const LINE_STEP: Deg = Deg(1e-3);

/// A key that a rotary axis on digital lines needs.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("[[controller]]: {key}: missing, expected a number, since axis {axis} is rotary")]
pub struct MissingKey {
    pub axis: AxisName,
    pub key: &'static str,
}
