//! Configuration keys: the tables `[[controller]]` and `[[thermometer]]` of a gateway, and the file of a map sender.
//! Field names are keys. The keys of a bus exist only if its feature is enabled.

#[cfg(feature = "focas")]
use std::fmt;
use std::{
    collections::BTreeMap,
    path::{Path, PathBuf},
    time::Duration,
};

use serde::{Deserialize, Serialize};
#[cfg(feature = "focas")]
use serde::{
    Deserializer,
    de::{MapAccess, Visitor, value::MapAccessDeserializer},
};
#[cfg(any(feature = "gpio", feature = "modbus"))]
use volcomp_digital_io::{Coherence, CorrectionCode, PositionCode};
use volcomp_document::Mistakes;
use volcomp_port::{DeviceError, ShownStates};
#[cfg(feature = "sinumerik")]
use volcomp_sinumerik::{Nodes, Security, Server, Sign};
use volcomp_vocabulary::{AxisKind, AxisName, Displacement};

use crate::address::Address;

/// Table `[[controller]]`: a control that reports positions and may receive corrections.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ControllerConfig {
    pub url: String,
    /// Name of the channel through which corrections reach the axes; `None`: the driver's default.
    pub channel: Option<String>,
    pub axes: Vec<AxisName>,
    pub reads: Vec<AxisName>,
    pub fixed: BTreeMap<AxisName, f64>,
    pub not_driven: Vec<AxisName>,
    pub includes_correction: bool,
    /// Terms of the correction that are sent to this controller: `["thermal"]`; `None`: all terms.
    pub terms: Option<Vec<String>>,
    /// Maximum age of this controller's positions, ms; the correction is held when they are older. `None`: `hold_ms` of
    /// `[guard]`.
    pub hold_ms: Option<f64>,
    /// Whether a test shift is made at arming; `None`: only if the positions are fine enough.
    pub test_shift: Option<bool>,
    pub unwatched: bool,
    pub unseen: Vec<StateKey>,
    /// Smallest step of a correction of a linear axis, µm; `None`: the driver's default.
    pub resolution_um: Option<f64>,
    /// Smallest step of a correction of a rotary axis, µrad; `None`: the driver's default.
    pub resolution_urad: Option<f64>,
    /// PMC address of the shift words; `None`: the driver's default.
    #[cfg(feature = "focas")]
    pub area: Option<AreaConfig>,
    #[cfg(feature = "focas")]
    pub heartbeat: Option<PmcByte>,
    /// PMC address of the byte with the reference bits of the axes; `None`: the driver's default.
    #[cfg(feature = "focas")]
    pub referenced: Option<Referenced>,
    /// Barrier in the control; `None`: corrections are written as plain values.
    pub barrier: Option<BarrierConfig>,
    /// Settings of the words on digital lines; `None` for other devices.
    #[cfg(any(feature = "gpio", feature = "modbus"))]
    pub digital: Option<DigitalConfig>,
    /// Connection settings of the OPC UA server, and its nodes; `None` for other devices.
    #[cfg(feature = "sinumerik")]
    pub sinumerik: Option<SinumerikTable>,
    #[cfg(feature = "linuxcnc")]
    pub linuxcnc: Option<LinuxCncTable>,
}

#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ThermometerConfig {
    pub url: String,
    pub names: Vec<String>,
    #[cfg(feature = "sinumerik")]
    pub nodes: Vec<String>,
    /// Connection settings of the OPC UA server; `None` for other devices.
    #[cfg(feature = "sinumerik")]
    pub sinumerik: Option<SinumerikTable>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum StateKey {
    Referenced,
    Alarm,
    EmergencyStop,
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct BarrierConfig {
    pub machine: u16,
    pub scan_ms: f64,
    #[cfg(feature = "focas")]
    pub frame: Option<PmcByte>,
    #[cfg(feature = "focas")]
    pub report: Option<PmcByte>,
}

/// Keys that are valid only if corrections are written as plain values, without a barrier.
pub(crate) const PLAIN_KEYS: &[&str] =
    &["includes_correction", "unwatched", "resolution_um", "resolution_urad"];

/// Keys that are valid in a table of `[[controller]]`, but not in the table of the same name in `[[thermometer]]` or in
/// a map sender's file.
pub const CONTROLLER_ONLY: [&str; 3] = ["numbers", "sign", "nodes"];

/// Reports an error if `key` applies to a kind of axis that `axes` lacks.
pub fn has_axis(key: &str, kind: AxisKind, axes: &[AxisName], found: &mut Mistakes<'_>) {
    // Another check reports missing axes.
    if !axes.is_empty() && !axes.iter().any(|name| name.kind() == kind) {
        let names: Vec<String> = axes.iter().map(ToString::to_string).collect();
        found.add(
            key,
            format!(
                "found this key for the axes {}, expected it only where an axis is {kind}",
                names.join(" ")
            ),
        );
    }
}

/// Reports an error if exactly one of two keys is present. `stated` is true for each key that is present, and `why` is
/// appended to the message.
pub fn both(found: &mut Mistakes<'_>, at: &str, keys: [&str; 2], stated: [bool; 2], why: &str) {
    let [one, other] = keys;
    if let [true, false] | [false, true] = stated {
        let key = if stated[0] { one } else { other };
        found.add(
            &format!("{at}.{key}"),
            format!("found one of {one} and {other}, expected both or neither{why}"),
        );
    }
}

/// Reports an error if a path is empty.
pub fn path(key: &str, path: &Path, found: &mut Mistakes<'_>) {
    if path.as_os_str().is_empty() {
        found.add(key, "found an empty text, expected a path");
    }
}

/// Makes relative paths start from this folder.
pub fn join<'a>(folder: &Path, paths: impl IntoIterator<Item = &'a mut PathBuf>) {
    for path in paths {
        *path = folder.join(&*path);
    }
}

/// Converts to milliseconds, rounded to the nanosecond.
pub fn ms(time: Duration) -> f64 {
    (time.as_secs_f64() * 1e9).round() / 1e6
}

/// Converts milliseconds to a duration; 0 if the number is invalid.
pub fn of_ms(ms: f64) -> Duration {
    Duration::try_from_secs_f64(ms * 1e-3).unwrap_or_default()
}

impl BarrierConfig {
    /// Scan period of the control's program.
    pub fn scan(&self) -> Duration {
        of_ms(self.scan_ms)
    }
}

impl ThermometerConfig {
    /// Makes relative paths start from the folder of the file.
    pub fn join(&mut self, folder: &Path) {
        #[cfg(feature = "sinumerik")]
        if let Some(table) = &mut self.sinumerik {
            table.join(folder);
        }
        #[cfg(not(feature = "sinumerik"))]
        let _ = folder;
    }
}

impl ControllerConfig {
    /// States that the control need not report, because the configuration accepts their absence (`unseen`).
    pub fn unseen(&self) -> ShownStates {
        let has = |state| self.unseen.contains(&state);
        ShownStates {
            referenced: has(StateKey::Referenced),
            alarm: has(StateKey::Alarm),
            emergency_stop: has(StateKey::EmergencyStop),
        }
    }

    /// Configured smallest step of a correction for this kind of axis; `None`: the driver's default.
    pub fn resolution(&self, kind: AxisKind) -> Option<Displacement> {
        let micro = match kind {
            AxisKind::Linear => self.resolution_um,
            AxisKind::Rotary => self.resolution_urad,
        };
        micro.map(|micro| Displacement::from_micro(kind, micro))
    }

    pub(crate) fn shown(&self) -> impl Iterator<Item = AxisName> {
        self.axes.iter().chain(&self.reads).copied()
    }

    /// Returns an error if another channel than `only`, the only channel of the control, is configured.
    pub(crate) fn only_channel(
        &self,
        address: &Address,
        only: &str,
        control: &str,
    ) -> Result<(), DeviceError> {
        match &self.channel {
            Some(channel) if channel != only => Err(address.wrong(
                format!("channel: found {channel:?}"),
                format!("expected {only:?}, the only channel of {control}"),
            )),
            _ => Ok(()),
        }
    }

    /// Configured channel name, or `default`.
    pub(crate) fn channel_or(&self, default: &str) -> String {
        self.channel.as_deref().unwrap_or(default).to_owned()
    }
}

/// Keys of a map sender's file. The tables of a bus exist only if its feature is enabled.
#[derive(Clone, Debug, Default, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct MapKeys {
    pub map: PathBuf,
    pub url: String,
    pub number: u16,
    pub capacity: usize,
    pub scan_ms: f64,
    pub limit_um: f64,
    pub slew_um_per_s: f64,
    pub zero_after_ms: f64,
    #[cfg(feature = "sinumerik")]
    pub sinumerik: SinumerikTable,
    #[cfg(feature = "sinumerik")]
    pub nodes: volcomp_sinumerik::MapNodes,
    #[cfg(feature = "focas")]
    pub pmc: PmcTable,
    pub audit: AuditConfig,
}

#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct AuditConfig {
    pub dir: PathBuf,
}

impl Default for AuditConfig {
    fn default() -> Self {
        Self { dir: PathBuf::from("audit") }
    }
}

impl MapKeys {
    /// Makes relative paths start from the folder of the file.
    pub fn join(&mut self, folder: &Path) {
        #[cfg(feature = "sinumerik")]
        self.sinumerik.join(folder);
        join(folder, [&mut self.map, &mut self.audit.dir]);
    }
}

/// PMC areas that a configuration can name.
#[cfg(feature = "focas")]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum PmcLetter {
    G,
    F,
    #[default]
    R,
    D,
}

/// Byte of the PMC: `{ pmc = "R", at = 120 }`.
#[cfg(feature = "focas")]
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PmcByte {
    pub pmc: PmcLetter,
    pub at: u16,
}

/// Words of the shifts in the PMC: `{ pmc = "R", first = 100, width = 2 }`.
#[cfg(feature = "focas")]
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

#[cfg(feature = "focas")]
fn word() -> u16 {
    2
}

/// Value of the key `referenced`: the PMC byte with the reference bits of the axes, or `false` if no bits are read.
#[cfg(feature = "focas")]
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(untagged)]
pub enum Referenced {
    Not(bool),
    Byte(PmcByte),
}

#[cfg(feature = "focas")]
impl<'de> Deserialize<'de> for Referenced {
    // The derived implementation of `untagged` would lose the location of an error in the byte.
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

/// Table `pmc` of a map sender's file: the PMC addresses of its words.
#[cfg(feature = "focas")]
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct PmcTable {
    pub time_out_ms: f64,
    pub mailbox: PmcByte,
    pub report: PmcByte,
    pub buffers: PmcByte,
}

#[cfg(feature = "focas")]
impl Default for PmcTable {
    fn default() -> Self {
        let byte = |at| PmcByte { pmc: PmcLetter::D, at };
        Self { time_out_ms: 500.0, mailbox: byte(0), report: byte(144), buffers: byte(200) }
    }
}

/// Table `[controller.digital]`: the words on digital lines.
#[cfg(any(feature = "gpio", feature = "modbus"))]
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct DigitalConfig {
    pub position_bits: u32,
    pub position_mm_per_count: Option<f64>,
    pub position_deg_per_count: Option<f64>,
    pub position_zero_mm: Option<f64>,
    pub position_zero_deg: Option<f64>,
    pub position_code: PositionCode,
    pub correction_bits: u32,
    pub correction_code: CorrectionCode,
    /// Line that toggles when the correction word has settled, counted from 0; `None` without a latch.
    pub latch: Option<u32>,
    /// Time without an edge of the latch after which the control ramps the correction to zero, ms; `None`: the control
    /// never does so.
    pub time_out_ms: Option<f64>,
    #[serde(with = "CoherenceKey")]
    pub coherence: Coherence,
}

#[cfg(any(feature = "gpio", feature = "modbus"))]
#[derive(Serialize, Deserialize)]
#[serde(remote = "Coherence", rename_all = "kebab-case")]
enum CoherenceKey {
    TwoAgree,
    #[serde(skip)]
    Strobe,
    Latched,
}

#[cfg(any(feature = "gpio", feature = "modbus"))]
impl Default for DigitalConfig {
    /// The default word layout: a position of 15 bits of 1/32 mm, a correction of 8 bits.
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

/// Table `linuxcnc` of a `[[controller]]`.
#[cfg(feature = "linuxcnc")]
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct LinuxCncTable {
    pub key_file: Option<PathBuf>,
    pub ini: Option<PathBuf>,
}

/// Table `sinumerik`: connection settings of a control's OPC UA server, and the nodes of a controller.
#[cfg(feature = "sinumerik")]
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SinumerikTable {
    pub namespace: String,
    /// User name; `None`: anonymous.
    pub user: Option<String>,
    pub password_file: Option<PathBuf>,
    pub security: Security,
    pub certificates: Option<PathBuf>,
    pub period_ms: f64,
    pub time_out_ms: f64,
    pub source_timestamps: bool,
    pub numbers: Vec<u16>,
    pub sign: Sign,
    pub nodes: Nodes,
}

#[cfg(feature = "sinumerik")]
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

#[cfg(feature = "sinumerik")]
impl SinumerikTable {
    /// Makes relative paths start from the folder of the file.
    pub(crate) fn join(&mut self, folder: &Path) {
        let paths = [&mut self.password_file, &mut self.certificates];
        join(folder, paths.into_iter().flatten());
    }
}
