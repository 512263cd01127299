//! The configuration of a gateway: TOML, read by serde. Every mistake is reported, with file, line and key.

use std::{
    ops::Range,
    path::{Path, PathBuf},
    time::Duration,
};

use serde::{Deserialize, Serialize};
use volcomp_document::{Document, FileKind, InputError, InputErrors, Places};
use volcomp_port::DeviceError;
use volcomp_runtime::{GuardSettings, PlanError, Realtime};

use crate::{documents::ModelSource, error::GatewayError, models::store::Store};

mod effective;
mod guard;
mod map_sender;
pub(crate) mod tables;
mod validate;

pub use guard::GuardTable;
pub use map_sender::MapSender;
use tables::RealtimeKeys;
pub use tables::{DashboardConfig, FleetConfig, OpcUaConfig, ShdrConfig};
use volcomp_devices::config::{join, of_ms};
pub use volcomp_devices::{
    config::{BarrierConfig, ControllerConfig, ThermometerConfig},
    map::AuditConfig,
};

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

/// What replaced a key that old configurations have.
fn replaced(key: &str) -> Option<&'static str> {
    match key {
        "several" => Some(
            "found several machines in one gateway, which is gone, expected the path of one machine file: run one gateway for each machine (volcomp-gateway@.service)",
        ),
        "machine" => Some(
            "expected the path of one machine file in quotes; several machines in one gateway are gone: run one gateway for each machine (volcomp-gateway@.service)",
        ),
        "sparkplug" => Some(
            "found [sparkplug], which is gone, expected [opc_ua] or [shdr], which bridges to MQTT read",
        ),
        _ => None,
    }
}

/// Everything that a configuration says. Paths are relative to its folder. The fields are the keys of the file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Config {
    /// The name of the configuration file as messages have it.
    #[serde(skip)]
    pub file: String,
    /// Where the file states its keys.
    #[serde(skip)]
    pub source: Source,
    /// The path of the machine file that is active: that of the centre or of the operator, else the configured one.
    #[serde(skip)]
    pub machine: PathBuf,
    /// The path of the machine file that the configuration names.
    #[serde(rename = "machine")]
    pub configured_machine: PathBuf,
    /// The time of a cycle.
    pub cycle_ms: f64,
    /// Whether it arms itself as soon as nothing stands against it.
    pub auto_arm: bool,
    /// The limits of the axes; without them the gateway does not arm.
    pub guard: Option<GuardTable>,
    /// The controllers in the order of preference; none: the built-in simulation.
    #[serde(rename = "controller")]
    pub controllers: Vec<ControllerConfig>,
    /// The thermometers, in order.
    #[serde(rename = "thermometer")]
    pub thermometers: Vec<ThermometerConfig>,
    /// The dashboard and its protection.
    pub dashboard: DashboardConfig,
    /// Where the audit log is kept.
    pub audit: AuditConfig,
    /// How the control thread is scheduled.
    #[serde(with = "RealtimeKeys")]
    pub realtime: Realtime,
    /// The centre of the fleet; `None`: the gateway has none.
    pub fleet: Option<FleetConfig>,
    /// The adapter of MTConnect; `None`: there is none.
    pub shdr: Option<ShdrConfig>,
    /// The OPC UA server; `None`: there is none.
    pub opc_ua: Option<OpcUaConfig>,
}

impl Default for Config {
    fn default() -> Self {
        Self {
            file: String::new(),
            source: Source::default(),
            machine: PathBuf::new(),
            configured_machine: PathBuf::new(),
            cycle_ms: 4.0,
            auto_arm: false,
            guard: None,
            controllers: Vec::new(),
            thermometers: Vec::new(),
            dashboard: DashboardConfig::default(),
            audit: AuditConfig::default(),
            realtime: tables::realtime(),
            fleet: None,
            shdr: None,
            opc_ua: None,
        }
    }
}

/// The text of a configuration, and where it states its keys. All are equal: comments and order are no part of what a
/// configuration says.
#[derive(Clone, Debug, Default)]
pub struct Source {
    document: Option<Document>,
    places: Places,
}

impl PartialEq for Source {
    fn eq(&self, _: &Self) -> bool {
        true
    }
}

impl Source {
    /// Whether the file states a key, such as `controller[0].url`.
    pub fn states(&self, key: &str) -> bool {
        self.places.contains_key(key)
    }

    /// An error at a key; where the file does not state it, at the table above.
    pub fn error(&self, file: &str, key: &str, message: String) -> InputError {
        match &self.document {
            Some(document) => document.error_at(&self.places, key, message),
            // The configuration was put together by a program.
            None => InputError {
                file: file.to_owned(),
                line: 1,
                key: key.to_owned(),
                message,
                span: Range::default(),
                text: "".into(),
            },
        }
    }

    /// The line of a key; `None`: the file does not state it.
    pub fn line(&self, key: &str) -> Option<usize> {
        let stated = self.states(key).then_some(self.document.as_ref()?);
        stated.map(|document| document.error_at(&self.places, key, "").line)
    }
}

impl DashboardConfig {
    /// Reads the table `[dashboard]` of a configuration file and nothing else of it: a running gateway can be asked for its
    /// state while the rest of the file is being changed.
    ///
    /// # Errors
    /// A file that cannot be read, or with file, line and key what is wrong in the table.
    pub fn read(path: &Path) -> Result<Self, GatewayError> {
        #[derive(Default, Deserialize)]
        #[serde(default)]
        struct Table {
            dashboard: DashboardConfig,
        }
        let document = Document::read(path)?;
        let (table, mut found) = document.structure::<Table>(|_| None)?;
        validate::dashboard(&table.dashboard, &mut found);
        let mut dashboard = found.none_or(table.dashboard)?;
        dashboard.join(path.parent().unwrap_or(Path::new("")));
        Ok(dashboard)
    }

    fn join(&mut self, folder: &Path) {
        let files = [
            &mut self.token_file,
            &mut self.tls_certificate,
            &mut self.tls_key,
        ];
        join(folder, files.into_iter().flatten());
    }
}

/// Whether a name has nothing in it that can be read, or something that cannot.
pub(crate) fn is_blank(name: &str) -> bool {
    name.trim().is_empty() || name.contains(char::is_control)
}

impl Config {
    /// Reads a configuration file. Where the operator or the centre has activated a model, that one takes the place of the
    /// configured machine file.
    ///
    /// # Errors
    /// A file that cannot be read, or with file, line and key everything that is wrong in it.
    pub fn read(path: &Path) -> Result<Self, GatewayError> {
        let folder = path.parent().unwrap_or(Path::new(""));
        let document = Document::read(path)?;
        let config = Self::decode(document, &path.display().to_string(), folder)?;
        Ok(config.with_machine_in_force())
    }

    /// Takes the text of a configuration; paths in it are relative to `folder`.
    ///
    /// # Errors
    /// With file, line and key everything that is wrong.
    pub fn parse(text: &str, file: &str, folder: &Path) -> Result<Self, InputErrors> {
        Self::decode(Document::new(file, text), file, folder)
    }

    fn decode(document: Document, file: &str, folder: &Path) -> Result<Self, InputErrors> {
        document.decode(
            |root| match root.other_kind(FileKind::Gateway, &ROOT_KEYS) {
                Some(error) => Err(error),
                None => Ok(()),
            },
        )?;
        let (config, mut found) = document.structure::<Self>(replaced)?;
        validate::validate(&config, &mut found);
        let places = found.places().clone();
        let mut config = found.none_or(config)?;
        config.join(folder);
        config.complete(folder);
        file.clone_into(&mut config.file);
        config.machine.clone_from(&config.configured_machine);
        config.source = Source {
            document: Some(document),
            places,
        };
        Ok(config)
    }

    /// Makes every path relative to the folder of the file.
    fn join(&mut self, folder: &Path) {
        let paths = [&mut self.configured_machine, &mut self.audit.dir];
        let of_fleet = self.fleet.iter_mut();
        let of_fleet = of_fleet.flat_map(|fleet| {
            let paths = [&mut fleet.nkey_file, &mut fleet.dir];
            paths.into_iter().chain(&mut fleet.ca)
        });
        join(folder, paths.into_iter().chain(of_fleet));
        for own in &mut self.thermometers {
            own.join(folder);
        }
        self.dashboard.join(folder);
    }

    /// Fills in the defaults that follow from other keys, and what the drivers add to their own.
    fn complete(&mut self, folder: &Path) {
        if let Some(guard) = &mut self.guard {
            guard.complete();
        }
        for own in &mut self.controllers {
            if let Some(driver) = own.driver() {
                (driver.complete)(own, folder);
            }
        }
    }

    /// The time of a cycle.
    pub fn cycle(&self) -> Duration {
        of_ms(self.cycle_ms)
    }

    /// The settings of the guard; `None` without `[guard]`.
    pub fn guard_settings(&self) -> Option<GuardSettings> {
        self.guard.as_ref().map(GuardTable::settings)
    }

    /// The configuration of a device is invalid.
    pub(crate) fn device_error(&self, source: DeviceError) -> GatewayError {
        let file = self.file.clone();
        GatewayError::DeviceConfig { file, source }
    }

    /// Controllers, machine and limits do not fit together.
    pub(crate) fn plan_error(&self, source: PlanError) -> GatewayError {
        let file = self.file.clone();
        GatewayError::Plan { file, source }
    }

    /// The folder of the audit log.
    pub fn audit_dir(&self) -> &Path {
        &self.audit.dir
    }

    /// The configuration with the machine file that is in force: that of the centre, else that of a person, else the configured
    /// one. What is damaged is not used, and told.
    pub(crate) fn with_machine_in_force(mut self) -> Self {
        self.machine.clone_from(&self.configured_machine);
        // The built-in simulation has its own machine file.
        if self.controllers.is_empty() {
            return self;
        }
        match Store::new(self.audit_dir()).in_force() {
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
        } else if Store::new(self.audit_dir()).holds(&self.machine) {
            ModelSource::Upload
        } else {
            ModelSource::File
        }
    }

    /// Whether the machine file is one that the centre has put in force.
    pub(crate) fn is_machine_of_centre(&self) -> bool {
        let fleet = self.fleet.as_ref();
        let is_of_person = Store::new(self.audit_dir()).holds(&self.machine);
        !is_of_person && fleet.is_some_and(|fleet| self.machine.starts_with(&fleet.dir))
    }
}
