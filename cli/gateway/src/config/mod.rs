//! The configuration of a gateway: TOML, every mistake named with file, line and key.

use std::{
    collections::BTreeMap,
    net::SocketAddr,
    path::{Path, PathBuf},
    time::Duration,
};

use volcomp_digital_io::{Coherence, CorrectionCode, PositionCode};
use volcomp_document::{Document, InputError, Section};
use volcomp_focas::{PmcAddress, Width};
use volcomp_model::Fading;
use volcomp_vocabulary::AxisName;

use crate::error::GatewayError;

mod controller;
mod dashboard;
mod guard;

use controller::{controller, thermometer};
use dashboard::{dashboard, realtime};
use guard::guard;

/// Everything a gateway is told.
#[derive(Clone, Debug, PartialEq)]
pub struct Config {
    /// The machine file; relative to the configuration.
    pub machine: PathBuf,
    /// Time of a cycle.
    pub cycle: Duration,
    /// Arm as soon as it can be.
    pub auto_arm: bool,
    /// Limits; without them it does not arm.
    pub guard: Option<GuardConfig>,
    /// Controllers in the order of preference.
    pub controllers: Vec<ControllerConfig>,
    /// Thermometers.
    pub thermometers: Vec<ThermometerConfig>,
    /// The dashboard.
    pub dashboard: DashboardConfig,
    /// Folder of the audit log.
    pub audit_dir: PathBuf,
    /// The control thread.
    pub realtime: RealtimeConfig,
}

/// `[guard]`: um, urad, s.
#[derive(Clone, Debug, PartialEq)]
pub struct GuardConfig {
    /// Of linear axes.
    pub linear: AxisGuard,
    /// Of rotary axes; a machine with some needs it.
    pub rotary: Option<AxisGuard>,
    /// Positions older than this: held.
    pub hold: Duration,
    /// Older than this: ramped to zero.
    pub zero_after: Duration,
    /// Time of a ramp.
    pub ramp: Duration,
    /// So long a stop may ramp out.
    pub stop: Duration,
    /// So long a better controller must be usable before it takes over again.
    pub hand_back: Duration,
    /// The fastest change of a temperature, K in a minute.
    pub max_degc_per_min: f64,
    /// What a temperature may be, degC.
    pub range_degc: [f64; 2],
    /// A temperature older than this is stale.
    pub temperature_stale: Duration,
    /// What becomes of terms without a sensor.
    pub fading: Fading,
}

/// Limits of one kind of axis: um or urad.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AxisGuard {
    /// The largest correction.
    pub limit: f64,
    /// From here on it is reported.
    pub warn: f64,
    /// In a second.
    pub slew_per_s: f64,
    /// In a second, in a second.
    pub accel_per_s2: f64,
    /// A change of model that moves a corner further needs a confirmation.
    pub confirm: f64,
    /// The shift that proves at arming whether positions contain it.
    pub test_shift: f64,
}

/// `[[controller]]`.
#[derive(Clone, Debug, PartialEq)]
pub struct ControllerConfig {
    /// Its device URL.
    pub url: String,
    /// Its channel.
    pub channel: Option<String>,
    /// The axes it corrects.
    pub axes: Vec<AxisName>,
    /// Machine axes that stand where they are told: mm, deg.
    pub fixed: BTreeMap<AxisName, f64>,
    /// Smallest step, um.
    pub resolution_um: Option<f64>,
    /// Smallest step of rotary axes, urad.
    pub resolution_urad: Option<f64>,
    /// Whether positions contain the correction.
    pub includes_correction: bool,
    /// Nobody watches it, and that is known.
    pub unwatched: bool,
    /// Whether the test shift is made.
    pub proves: Option<bool>,
    /// First byte of the shifts and bytes of each (FOCAS).
    pub area: Option<(PmcAddress, Width)>,
    /// Byte that every correction moves on (FOCAS).
    pub heartbeat: Option<PmcAddress>,
    /// Byte with the referenced axes (FOCAS); `None`: as the driver has it, `Some(None)`: not asked.
    pub referenced: Option<Option<PmcAddress>>,
    /// Digital lines.
    pub digital: DigitalConfig,
}

/// The words on digital lines.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DigitalConfig {
    /// Bits of the position.
    pub position_bits: u32,
    /// mm of one count.
    pub position_mm_per_count: f64,
    /// Position at count 0, mm.
    pub position_zero_mm: f64,
    /// Code of the position.
    pub position_code: PositionCode,
    /// Bits of the correction.
    pub correction_bits: u32,
    /// Code of the correction.
    pub correction_code: CorrectionCode,
    /// How a word is known to be whole.
    pub coherence: Coherence,
}

impl Default for DigitalConfig {
    /// The published scheme.
    fn default() -> Self {
        Self {
            position_bits: 15,
            position_mm_per_count: 1.0 / 32.0,
            position_zero_mm: 0.0,
            position_code: PositionCode::Binary,
            correction_bits: 8,
            correction_code: CorrectionCode::TwosComplement,
            coherence: Coherence::TwoAgree,
        }
    }
}

/// `[[thermometer]]`.
#[derive(Clone, Debug, PartialEq)]
pub struct ThermometerConfig {
    /// Its device URL.
    pub url: String,
    /// Names of its sensors.
    pub names: Vec<String>,
}

/// `[dashboard]`.
#[derive(Clone, Debug, PartialEq)]
pub struct DashboardConfig {
    /// Where it listens.
    pub listen: SocketAddr,
    /// Named tokens, mode 0600.
    pub token_file: Option<PathBuf>,
    /// Certificate and key, PEM.
    pub tls: Option<(PathBuf, PathBuf)>,
    /// Names besides addresses under which browsers may ask for it.
    pub hosts: Vec<String>,
}

/// `[realtime]`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct RealtimeConfig {
    /// SCHED_FIFO priority, 1 to 99; 0: none is asked for.
    pub priority: u8,
    /// The processor it stays on.
    pub cpu: Option<usize>,
}

impl Default for DashboardConfig {
    fn default() -> Self {
        Self {
            listen: SocketAddr::from(([127, 0, 0, 1], 8080)),
            token_file: None,
            tls: None,
            hosts: Vec::new(),
        }
    }
}

impl Config {
    /// Reads a configuration file.
    ///
    /// # Errors
    /// A file that cannot be read, or with file, line and key what is wrong in it.
    pub fn read(path: &Path) -> Result<Self, GatewayError> {
        let folder = path.parent().unwrap_or(Path::new(""));
        Ok(Document::read(path)?.decode(|root| Self::decode(&root, folder))?)
    }

    /// Takes the text of a configuration; paths in it are relative to `folder`.
    ///
    /// # Errors
    /// With file, line and key what is wrong.
    pub fn parse(text: &str, file: &str, folder: &Path) -> Result<Self, InputError> {
        Document::new(file, text).decode(|root| Self::decode(&root, folder))
    }

    fn decode(root: &Section<'_>, folder: &Path) -> Result<Self, InputError> {
        root.allow(&[
            "machine",
            "cycle_ms",
            "auto_arm",
            "guard",
            "controller",
            "thermometer",
            "dashboard",
            "audit",
            "realtime",
        ])?;
        let controllers = root.tables("controller", controller)?;
        if controllers.is_empty() {
            return Err(root.error("found no [[controller]], expected at least one"));
        }
        if controllers.len() > volcomp_guard::MAX_PATHS {
            return Err(root.error(format!(
                "found {} controllers, expected {} at the most",
                controllers.len(),
                volcomp_guard::MAX_PATHS
            )));
        }
        let cycle_ms = root.number_or("cycle_ms", 0.1..=1000.0, 4.0)?;
        let audit = root.section("audit")?;
        let audit_dir = match &audit {
            Some(audit) => {
                audit.allow(&["dir"])?;
                folder.join(audit.require("dir")?.text()?)
            }
            None => folder.join("audit"),
        };
        Ok(Self {
            machine: folder.join(root.require("machine")?.text()?),
            cycle: Duration::from_secs_f64(cycle_ms * 1e-3),
            auto_arm: root.truth_or("auto_arm", false)?,
            guard: root
                .section("guard")?
                .map(|section| guard(&section, cycle_ms))
                .transpose()?,
            controllers,
            thermometers: root.tables("thermometer", thermometer)?,
            dashboard: root
                .section("dashboard")?
                .map(|section| dashboard(&section, folder))
                .transpose()?
                .unwrap_or_default(),
            audit_dir,
            realtime: root
                .section("realtime")?
                .map(|section| realtime(&section))
                .transpose()?
                .unwrap_or(RealtimeConfig {
                    priority: 60,
                    cpu: None,
                }),
        })
    }
}
