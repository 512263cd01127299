//! The configuration of a gateway: TOML, parsed with serde. All errors are reported, with file, line and key.

use std::{
    net::SocketAddr,
    ops::Range,
    path::{Path, PathBuf},
    time::Duration,
};

use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};
use volcomp_devices::config::{CONTROLLER_ONLY, join, of_ms, uses};
use volcomp_document::{Document, FileKind, InputError, InputErrors, Places};
use volcomp_fleet::{IdError, Identity, VerifyingKey, trusted_key};
use volcomp_port::DeviceError;
use volcomp_runtime::{GuardSettings, PlanError, Realtime};

use crate::{documents::ModelSource, error::GatewayError, models::store::Store, toml_text};

mod guard;
mod map_sender;
mod validate;

pub use guard::GuardTable;
pub use map_sender::MapSender;
pub use volcomp_devices::{
    config::{BarrierConfig, ControllerConfig, ThermometerConfig},
    map::AuditConfig,
};

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

/// Message about a key of earlier versions, with its replacement. `None` for other keys.
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

/// The configuration of a gateway. Paths are resolved against the folder of the file. The fields are the keys of the
/// file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Config {
    /// File name used in messages.
    #[serde(skip)]
    pub file: String,
    /// Position of each key in the file.
    #[serde(skip)]
    pub source: Source,
    /// Path of the active machine file: from the centre, else activated by the operator, else the configured one.
    #[serde(skip)]
    pub machine: PathBuf,
    /// Path of the machine file named in the configuration.
    #[serde(rename = "machine")]
    pub configured_machine: PathBuf,
    /// Cycle time, ms.
    pub cycle_ms: f64,
    /// True if the gateway arms automatically as soon as no condition prevents it.
    pub auto_arm: bool,
    /// Limits of the axes; `None`: the gateway does not arm.
    pub guard: Option<GuardTable>,
    /// Controllers in order of preference; empty: the built-in simulation.
    #[serde(rename = "controller")]
    pub controllers: Vec<ControllerConfig>,
    /// Thermometers in the order of the file.
    #[serde(rename = "thermometer")]
    pub thermometers: Vec<ThermometerConfig>,
    /// The dashboard and its access control.
    pub dashboard: DashboardConfig,
    /// Location of the audit log.
    pub audit: AuditConfig,
    /// Scheduling of the control thread.
    #[serde(with = "RealtimeKeys")]
    pub realtime: Realtime,
    /// The centre of the fleet; `None`: not part of a fleet.
    pub fleet: Option<FleetConfig>,
    /// The MTConnect adapter; `None`: disabled.
    pub shdr: Option<ShdrConfig>,
    /// The OPC UA server; `None`: disabled.
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
            realtime: realtime(),
            fleet: None,
            shdr: None,
            opc_ua: None,
        }
    }
}

/// The text of a configuration and the position of each key. All values compare equal, so that comments and the order
/// of keys do not affect the comparison of configurations.
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
    /// True if the file states a key, such as `controller[0].url`.
    pub fn states(&self, key: &str) -> bool {
        self.places.contains_key(key)
    }

    /// Creates an error at a key, or at the table that contains the key if the file does not state it.
    pub fn error(&self, file: &str, key: &str, message: String) -> InputError {
        match &self.document {
            Some(document) => document.error_at(&self.places, key, message),
            // The configuration was created in code, without a file.
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

    /// Line of a key, from 1; `None` if the file does not state the key.
    pub fn line(&self, key: &str) -> Option<usize> {
        let stated = self.states(key).then_some(self.document.as_ref()?);
        stated.map(|document| document.error_at(&self.places, key, "").line)
    }
}

impl DashboardConfig {
    /// Reads only the table `[dashboard]` of a configuration file, so that the state of a running gateway can be
    /// requested while the rest of the file is being edited.
    ///
    /// # Errors
    /// The file cannot be read, or the table is invalid: every error with file, line and key.
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
        let files = [&mut self.token_file, &mut self.tls_certificate, &mut self.tls_key];
        join(folder, files.into_iter().flatten());
    }
}

/// True if a name has no visible character or contains a control character.
pub(crate) fn is_blank(name: &str) -> bool {
    name.trim().is_empty() || name.contains(char::is_control)
}

impl Config {
    /// Reads a configuration file. A model activated by the centre or the operator replaces the configured machine
    /// file.
    ///
    /// # Errors
    /// The file cannot be read, or is invalid: every error with file, line and key.
    pub fn read(path: &Path) -> Result<Self, GatewayError> {
        let folder = path.parent().unwrap_or(Path::new(""));
        let document = Document::read(path)?;
        let config = Self::decode(document, &path.display().to_string(), folder)?;
        Ok(config.with_machine_in_force())
    }

    /// Parses the text of a configuration; relative paths are resolved against `folder`.
    ///
    /// # Errors
    /// Every error, with file, line and key.
    pub fn parse(text: &str, file: &str, folder: &Path) -> Result<Self, InputErrors> {
        Self::decode(Document::new(file, text), file, folder)
    }

    fn decode(document: Document, file: &str, folder: &Path) -> Result<Self, InputErrors> {
        document.decode(|root| match root.other_kind(FileKind::Gateway, &ROOT_KEYS) {
            Some(error) => Err(error),
            None => Ok(()),
        })?;
        let (config, mut found) = document.structure::<Self>(replaced)?;
        validate::validate(&config, &mut found);
        let places = found.places().clone();
        let mut config = found.none_or(config)?;
        config.join(folder);
        config.complete(folder);
        file.clone_into(&mut config.file);
        config.machine.clone_from(&config.configured_machine);
        config.source = Source { document: Some(document), places };
        Ok(config)
    }

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

    /// Completes the defaults that follow from other keys, and the defaults of the drivers.
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

    /// Period of the control cycle (`cycle_ms`).
    pub fn cycle(&self) -> Duration {
        of_ms(self.cycle_ms)
    }

    /// Settings of the guard; `None` if the file has no table `[guard]`.
    pub fn guard_settings(&self) -> Option<GuardSettings> {
        self.guard.as_ref().map(GuardTable::settings)
    }

    pub(crate) fn device_error(&self, source: DeviceError) -> GatewayError {
        let file = self.file.clone();
        GatewayError::DeviceConfig { file, source }
    }

    /// Adds the file name to an error of the plan (controllers, machine and limits do not match).
    pub(crate) fn plan_error(&self, source: PlanError) -> GatewayError {
        let file = self.file.clone();
        GatewayError::Plan { file, source }
    }

    pub fn audit_dir(&self) -> &Path {
        &self.audit.dir
    }

    /// Sets the active machine file: the one activated by the centre, else by an operator, else the configured one. A
    /// damaged file is logged and skipped.
    pub(crate) fn with_machine_in_force(mut self) -> Self {
        self.machine.clone_from(&self.configured_machine);
        // The built-in simulation has its own machine file.
        if self.controllers.is_empty() {
            return self;
        }
        match Store::new(self.audit_dir()).in_force() {
            Ok(Some(machine)) => self.machine = machine,
            Ok(None) => {}
            Err(what) => tracing::error!("{what}: the configured machine file is active"),
        }
        #[cfg(feature = "fleet")]
        if let Some(machine) = self.fleet.as_ref().and_then(crate::fleet::machine_in_force) {
            self.machine = machine;
        }
        self
    }

    pub(crate) fn machine_from(&self) -> ModelSource {
        if self.is_machine_of_centre() {
            ModelSource::Centre
        } else if Store::new(self.audit_dir()).holds(&self.machine) {
            ModelSource::Upload
        } else {
            ModelSource::File
        }
    }

    pub(crate) fn is_machine_of_centre(&self) -> bool {
        let fleet = self.fleet.as_ref();
        let is_of_person = Store::new(self.audit_dir()).holds(&self.machine);
        !is_of_person && fleet.is_some_and(|fleet| self.machine.starts_with(&fleet.dir))
    }
}

/// The table `[dashboard]`: its address and access control.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct DashboardConfig {
    pub listen: SocketAddr,
    pub token_file: Option<PathBuf>,
    /// TLS certificate, PEM; `None`: without TLS.
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

#[derive(Serialize, Deserialize)]
#[serde(remote = "Realtime", deny_unknown_fields, default = "realtime")]
struct RealtimeKeys {
    priority: u8,
    cpu: Option<usize>,
    reference: bool,
}

pub(crate) fn realtime() -> Realtime {
    Realtime { priority: 60, cpu: None, reference: false }
}

/// The table `[fleet]`: the centre that provides the machine file and receives the condition of the machine.
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

/// The table `[shdr]`: an adapter for MTConnect agents.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ShdrConfig {
    pub listen: SocketAddr,
    pub anyone_may_read: bool,
    /// Device name shown by an agent; `None`: the name of the machine.
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

/// The table `[opc_ua]`: a read-only OPC UA server.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct OpcUaConfig {
    pub listen: SocketAddr,
    pub anyone_may_read: bool,
}

impl Default for OpcUaConfig {
    fn default() -> Self {
        Self { listen: SocketAddr::from(([127, 0, 0, 1], 4840)), anyone_may_read: false }
    }
}

impl DashboardConfig {
    /// True if reading requires a token: on every interface but loopback.
    pub(crate) fn reading_needs_token(&self) -> bool {
        !self.listen.ip().is_loopback()
    }
}

impl FleetConfig {
    /// Site and machine name in the fleet.
    ///
    /// # Errors
    /// A name is invalid in a message subject. This cannot occur in a configuration that was read from a file.
    pub fn identity(&self) -> Result<Identity, IdError> {
        Ok(Identity { site: self.site.parse()?, machine: self.machine.parse()? })
    }

    /// The public keys whose manifests are accepted.
    pub fn trusted(&self) -> Vec<VerifyingKey> {
        let keys = self.trusted_keys.iter();
        keys.filter_map(|key| trusted_key(key).ok()).collect()
    }
}

impl Config {
    /// Every key that has an effect, with its value, in the order of the manual.
    pub fn effective(&self) -> Map<String, Value> {
        // Decode the file again so that paths stay relative to its folder.
        let stated = self.source.document.clone();
        let stated = stated.and_then(|file| Self::decode(file, &self.file, Path::new("")).ok());
        let Ok(Value::Object(mut keys)) = serde_json::to_value(stated.as_ref().unwrap_or(self))
        else {
            return Map::new();
        };
        let controllers = keys.get_mut("controller").and_then(Value::as_array_mut);
        for (value, own) in controllers.into_iter().flatten().zip(&self.controllers) {
            if let (Some(table), Some(driver)) = (value.as_object_mut(), own.driver()) {
                let is_reader = own.axes.is_empty();
                let has_barrier = own.barrier.is_some();
                table.retain(|key, _| {
                    uses(driver, is_reader, key) && !(has_barrier && key == "unwatched")
                });
            }
        }
        let thermometers = keys.get_mut("thermometer").and_then(Value::as_array_mut);
        let thermometers = thermometers.into_iter().flatten();
        for own in thermometers.filter_map(Value::as_object_mut) {
            for table in own.values_mut().filter_map(Value::as_object_mut) {
                table.retain(|key, _| !CONTROLLER_ONLY.contains(&key.as_str()));
            }
        }
        if let Some(guard) = keys.get_mut("guard").and_then(Value::as_object_mut)
            && guard.get("limit_urad").is_some_and(Value::is_null)
        {
            guard.retain(|key, _| !key.ends_with("_urad"));
        }
        toml_text::without_empty(&mut keys);
        keys
    }

    /// Full names of the effective keys that the file does not state.
    pub fn defaults(&self) -> Vec<String> {
        let mut defaults = Vec::new();
        self.collect(&self.effective(), "", &mut defaults);
        defaults
    }

    fn collect(&self, table: &Map<String, Value>, above: &str, defaults: &mut Vec<String>) {
        for (key, value) in table {
            let key = format!("{above}{key}");
            match value {
                Value::Object(table) => self.collect(table, &format!("{key}."), defaults),
                Value::Array(items) if items.iter().any(Value::is_object) => {
                    for (index, item) in items.iter().enumerate() {
                        if let Value::Object(table) = item {
                            self.collect(table, &format!("{key}[{index}]."), defaults);
                        }
                    }
                }
                _ if self.source.states(&key) => {}
                _ => defaults.push(key),
            }
        }
    }

    /// The effective configuration as TOML; defaults are marked.
    pub fn effective_toml(&self) -> String {
        toml_text::marked(&self.effective(), &|key| !self.source.states(key))
    }
}
