//! The configuration of a gateway: TOML. Mistakes are named with file, line and key.

use std::{
    collections::{BTreeMap, BTreeSet},
    net::SocketAddr,
    path::{Path, PathBuf},
    time::Duration,
};

use volcomp_digital_io::{Coherence, CorrectionCode, PositionCode};
use volcomp_document::{Document, FileKind, InputError, Section};
use volcomp_focas::{PmcAddress, Width};
use volcomp_port::ShownStates;
use volcomp_runtime::{GuardSettings, Realtime, guard::ceiling};
use volcomp_vocabulary::{AxisName, Displacement};

use crate::{documents::ModelSource, error::GatewayError, models::store::Store};

mod controller;
mod dashboard;
mod fleet;
mod guard;
mod interop;
mod kinds;
mod map_sender;
mod sinumerik;
mod stated;

pub use controller::MissingKey;
use controller::{check_latches, controller, thermometer};
use dashboard::{dashboard, realtime};
pub use fleet::FleetConfig;
use fleet::fleet;
use guard::guard;
pub use interop::{InteropConfig, OpcUaConfig, ShdrConfig};
pub use kinds::{CONTROLLER_KEYS, ControllerKind};
pub use map_sender::{MapControl, MapSender};
pub use sinumerik::{ServerConfig, SinumerikTable};
pub use stated::StatedKeys;

/// The keys of the root of a configuration.
const ROOT_KEYS: [&str; 12] = [
    "machine",
    "cycle_ms",
    "auto_arm",
    "guard",
    "controller",
    "thermometer",
    "dashboard",
    "audit",
    "realtime",
    "fleet",
    "shdr",
    "opc_ua",
];

/// Everything that a configuration says. Paths are relative to its folder.
#[derive(Clone, Debug, PartialEq)]
pub struct Config {
    /// The name of the configuration file as messages have it.
    pub file: String,
    /// The keys that the file states, and where; the others have their defaults.
    pub stated: StatedKeys,
    /// The path of the machine file that is used: where a person or the centre has put a model in force, that one.
    pub machine: PathBuf,
    /// The path of the machine file that the configuration names.
    pub configured_machine: PathBuf,
    /// The time of a cycle.
    pub cycle: Duration,
    /// Whether it arms itself as soon as nothing stands against it.
    pub auto_arm: bool,
    /// The limits of the axes; without them the gateway does not arm.
    pub guard: Option<GuardSettings>,
    /// The controllers in the order of preference; none: the built-in simulation.
    pub controllers: Vec<ControllerConfig>,
    /// The thermometers, in order.
    pub thermometers: Vec<ThermometerConfig>,
    /// The dashboard and its protection.
    pub dashboard: DashboardConfig,
    /// The folder of the audit log.
    pub audit_dir: PathBuf,
    /// How the control thread is scheduled.
    pub realtime: Realtime,
    /// The centre of the fleet; `None`: the gateway has none.
    pub fleet: Option<FleetConfig>,
    /// Over which ways other systems read it.
    pub interop: InteropConfig,
}

/// FOCAS: the words of the shifts in the PMC, `area`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct AreaConfig {
    /// The first byte.
    pub first: PmcAddress,
    /// The bytes of each word.
    pub width: Width,
    /// Whether a ladder copies the words on to those from which the control takes the shifts.
    pub copied: bool,
}

/// One table `[[controller]]`: a path to the machine.
#[derive(Clone, Debug, PartialEq)]
pub struct ControllerConfig {
    /// The URL of the device.
    pub url: String,
    /// The name of the channel by which its corrections reach the axes; `None`: the driver's own.
    pub channel: Option<String>,
    /// The axes that it shows and corrects, in the order of the control; none where it is only read.
    pub axes: Vec<AxisName>,
    /// Further axes that it shows, and that it does not write.
    pub reads: Vec<AxisName>,
    /// Machine axes that it does not show, and where they stand: mm, deg.
    pub fixed: BTreeMap<AxisName, f64>,
    /// Rotary axes of `fixed`: no drive turns them.
    pub not_driven: BTreeSet<AxisName>,
    /// The smallest step of a correction of a linear axis, µm; `None`: the driver's own.
    pub resolution_um: Option<f64>,
    /// The smallest step of a correction of a rotary axis, µrad; `None`: the driver's own.
    pub resolution_urad: Option<f64>,
    /// Whether reported positions contain the correction.
    pub includes_correction: bool,
    /// Whether it is accepted that nothing at the control notices when the gateway stops.
    pub unwatched: bool,
    /// The states of the control that the device does not show, and that the machine may be corrected without.
    pub unseen: ShownStates,
    /// Whether it carries the correction of thermal terms alone (`terms = ["thermal"]`).
    pub only_thermal: bool,
    /// Positions that are older are held on this path; `None`: `hold_ms` of `[guard]`.
    pub hold: Option<Duration>,
    /// Whether the test shift at arming is made; `None`: not on digital lines.
    pub proves: Option<bool>,
    /// FOCAS: where the words of the shifts stand in the PMC; `None`: the driver's own place.
    pub area: Option<AreaConfig>,
    /// FOCAS: the byte that every correction counts up, for the ladder to watch.
    pub heartbeat: Option<PmcAddress>,
    /// The barrier in the control that frames go to; `None`: corrections are written as plain values.
    pub barrier: Option<BarrierConfig>,
    /// FOCAS: the byte whose bits say which axes are referenced; `None`: the driver's own, `Some(None)`: not asked.
    pub referenced: Option<Option<PmcAddress>>,
    /// The words on digital lines.
    pub digital: DigitalConfig,
    /// SINUMERIK: how the server is reached, and its nodes.
    pub sinumerik: SinumerikTable,
    /// LinuxCNC: the files that gateway and control share.
    pub linuxcnc: LinuxCncTable,
}

/// The table `linuxcnc` of a `[[controller]]`.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct LinuxCncTable {
    /// The file with the key that the bridge has, too.
    pub key_file: Option<PathBuf>,
    /// The INI file of the control, which `check` reads.
    pub ini: Option<PathBuf>,
}

/// The table `[controller.barrier]`: the barrier in the control, as its program is set.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct BarrierConfig {
    /// The number of the machine, which starts the checksums.
    pub machine: u16,
    /// The time from one scan of the control's program to the next.
    pub scan: Duration,
    /// FOCAS: the first byte of the frame in the PMC.
    pub frame: Option<PmcAddress>,
    /// FOCAS: the first byte of the report in the PMC.
    pub report: Option<PmcAddress>,
}

/// The table `[controller.digital]`: the words on digital lines.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DigitalConfig {
    /// How many lines carry the position.
    pub position_bits: u32,
    /// The travel of the axis for one count of the position; `None`: 1/32 mm as published.
    pub position_step: Option<Displacement>,
    /// The position at count 0; `None`: zero.
    pub position_zero: Option<Displacement>,
    /// The code of the position word.
    pub position_code: PositionCode,
    /// How many lines carry the correction.
    pub correction_bits: u32,
    /// The code of the correction word.
    pub correction_code: CorrectionCode,
    /// The line that changes its level when the correction word has settled, from 0; `None`: there is none.
    pub latch: Option<u32>,
    /// The time without an edge of the latch after which the control takes the correction to zero by itself; `None`: it
    /// does not.
    pub time_out: Option<Duration>,
    /// How it is known that a word was not read in the middle of a change.
    pub coherence: Coherence,
}

impl Default for DigitalConfig {
    /// The published scheme: 15 lines of 1/32 mm, 8 lines of correction.
    fn default() -> Self {
        Self {
            position_bits: 15,
            position_step: None,
            position_zero: None,
            position_code: PositionCode::Binary,
            correction_bits: 8,
            correction_code: CorrectionCode::TwosComplement,
            latch: None,
            time_out: None,
            coherence: Coherence::TwoAgree,
        }
    }
}

/// One table `[[thermometer]]`: a device with temperatures.
#[derive(Clone, Debug, PartialEq)]
pub struct ThermometerConfig {
    /// The URL of the device.
    pub url: String,
    /// The names of its sensors: on Modbus in the order of its channels, on CAN a choice among those of the DBC file; none:
    /// all of them.
    pub names: Vec<String>,
    /// SINUMERIK: the node of each of them.
    pub nodes: Vec<String>,
    /// SINUMERIK: how the server is reached.
    pub sinumerik: ServerConfig,
}

/// The table `[dashboard]`: where it listens, and who may use it.
#[derive(Clone, Debug, PartialEq)]
pub struct DashboardConfig {
    /// The address and port on which it listens.
    pub listen: SocketAddr,
    /// The file with named tokens, mode 0600.
    pub token_file: Option<PathBuf>,
    /// The files with certificate and key, PEM; `None`: without TLS.
    pub tls: Option<(PathBuf, PathBuf)>,
    /// Host names, besides addresses, under which browsers may ask for it.
    pub hosts: Vec<String>,
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

impl DashboardConfig {
    /// Whether reading needs a token: it is open to programs on this computer alone.
    pub(crate) fn reading_needs_token(&self) -> bool {
        !self.listen.ip().is_loopback()
    }

    /// Reads the table `[dashboard]` of a configuration file and nothing else of it: a gateway that runs can be asked while
    /// the rest of the file is being changed.
    ///
    /// # Errors
    /// A file that cannot be read, or with file, line and key what is wrong in the table.
    pub fn read(path: &Path) -> Result<Self, GatewayError> {
        let folder = path.parent().unwrap_or(Path::new(""));
        let table = Document::read(path)?.decode(|root| {
            let section = root.section("dashboard")?;
            section
                .map(|section| dashboard(&section, folder))
                .transpose()
        })?;
        Ok(table.unwrap_or_default())
    }
}

/// Whether a name has nothing in it that can be read, or something that cannot.
pub(crate) fn is_blank(name: &str) -> bool {
    name.trim().is_empty() || name.contains(char::is_control)
}

impl Config {
    /// Reads a configuration file. Where a person or the centre has put a model in force, that one takes the place of the
    /// configured machine file.
    ///
    /// # Errors
    /// A file that cannot be read, or with file, line and key what is wrong in it.
    pub fn read(path: &Path) -> Result<Self, GatewayError> {
        let folder = path.parent().unwrap_or(Path::new(""));
        let file = path.display().to_string();
        let config = Document::read(path)?.decode(|root| Self::decode(&root, &file, folder))?;
        Ok(config.with_machine_in_force())
    }

    /// The configuration with the machine file that is in force: that of the centre, else that of a person, else the configured
    /// one. What is damaged is not used, and told.
    pub(crate) fn with_machine_in_force(mut self) -> Self {
        self.machine.clone_from(&self.configured_machine);
        // The built-in simulation has its own machine file.
        if self.controllers.is_empty() {
            return self;
        }
        match Store::new(&self.audit_dir).in_force() {
            Ok(Some(machine)) => self.machine = machine,
            Ok(None) => {}
            Err(what) => tracing::error!("{what}: the configured machine file holds"),
        }
        #[cfg(feature = "fleet")]
        if let Some(machine) = self.fleet.as_ref().and_then(crate::fleet::machine_in_force) {
            self.machine = machine;
        }
        self
    }

    /// Where the machine file comes from.
    pub(crate) fn machine_from(&self) -> ModelSource {
        if self.is_machine_of_centre() {
            ModelSource::Centre
        } else if Store::new(&self.audit_dir).holds(&self.machine) {
            ModelSource::Upload
        } else {
            ModelSource::File
        }
    }

    /// Whether the machine file is one that the centre has put in force.
    pub(crate) fn is_machine_of_centre(&self) -> bool {
        let fleet = self.fleet.as_ref();
        let is_of_person = Store::new(&self.audit_dir).holds(&self.machine);
        !is_of_person && fleet.is_some_and(|fleet| self.machine.starts_with(&fleet.dir))
    }

    /// Takes the text of a configuration; paths in it are relative to `folder`.
    ///
    /// # Errors
    /// With file, line and key what is wrong.
    pub fn parse(text: &str, file: &str, folder: &Path) -> Result<Self, InputError> {
        Document::new(file, text).decode(|root| Self::decode(&root, file, folder))
    }

    /// Whether the file states a key; inside arrays of tables `controller.0.url`.
    pub fn states(&self, key: &str) -> bool {
        self.stated.contains(key)
    }

    fn decode(root: &Section<'_>, file: &str, folder: &Path) -> Result<Self, InputError> {
        if let Some(machines) = root.get("machine").filter(|value| value.items().is_ok()) {
            return Err(machines.error(
                "found [[machine]], several machines in one gateway, which is gone, expected the path of one machine file: run one gateway for each machine (volcomp-gateway@.service)",
            ));
        }
        if let Some(sparkplug) = root.get("sparkplug") {
            return Err(sparkplug.error(
                "found [sparkplug], which is gone, expected [opc_ua] or [shdr], which bridges to MQTT read",
            ));
        }
        root.allow_in(FileKind::Gateway, &ROOT_KEYS)?;
        let [shortest_ms, longest_ms] = [ceiling::SHORTEST_CYCLE, ceiling::LONGEST_CYCLE]
            .map(|cycle| cycle.as_secs_f64() * 1e3);
        let cycle_ms = root.number_or("cycle_ms", shortest_ms..=longest_ms, 4.0)?;
        let controllers = root.tables("controller", |table| controller(table, cycle_ms, folder))?;
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
        check_latches(root, &controllers)?;
        let audit = root.section("audit")?;
        let audit_dir = match &audit {
            Some(audit) => {
                audit.allow(&["dir"])?;
                let dir = audit.require("dir")?;
                match dir.text()? {
                    "" => return Err(dir.error("found an empty text, expected a folder")),
                    text => folder.join(text),
                }
            }
            None => folder.join("audit"),
        };
        let machine = folder.join(root.require("machine")?.text()?);
        Ok(Self {
            file: file.to_owned(),
            stated: StatedKeys::of(root),
            configured_machine: machine.clone(),
            machine,
            cycle: Duration::from_secs_f64(cycle_ms * 1e-3),
            auto_arm: root.truth_or("auto_arm", false)?,
            guard: root
                .section("guard")?
                .map(|section| guard(&section, cycle_ms))
                .transpose()?,
            controllers,
            thermometers: root.tables("thermometer", |table| thermometer(table, folder))?,
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
                .unwrap_or(Realtime {
                    priority: 60,
                    cpu: None,
                    reference: false,
                }),
            fleet: root
                .section("fleet")?
                .map(|section| fleet(&section, folder))
                .transpose()?,
            interop: interop::interop(root)?,
        })
    }
}
