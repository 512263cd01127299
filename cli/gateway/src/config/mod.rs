//! The configuration of a gateway and of a map sender: TOML, parsed with serde.
//!
//! Every rule is checked, and all errors are reported at once, with file, line and key.

use std::{
    net::SocketAddr,
    ops::Range,
    path::{Path, PathBuf},
    time::Duration,
};

use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};
use volcomp_devices::{
    Rules,
    config::{self, CONTROLLER_ONLY, both, check_keys, has_axis, join, ms, of_ms, path, uses},
    map::MapKeys,
};
use volcomp_document::{
    Document, FileKind, InputError, InputErrors, LARGEST_NUMBER, Mistakes, Places,
};
use volcomp_fleet::{
    ADDRESSES, IdError, Identity, MachineId, SiteId, VerifyingKey, trusted_key, wrong_address,
};
use volcomp_guard::{barrier::LARGEST_MACHINE, ceiling};
use volcomp_port::DeviceError;
use volcomp_runtime::{GuardSettings, PlanError, Realtime};
use volcomp_tables::{
    HEADER_WORDS, MAX_WORDS, SenderLimits,
    control::{FRAME_WORDS, REPORT_WORDS},
};
use volcomp_vocabulary::{AxisKind, AxisName, MAX_AXES};

use crate::{documents::ModelSource, error::GatewayError, models::store::Store, toml_text};

mod guard;

pub use guard::GuardTable;
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
        dashboard(&table.dashboard, &mut found);
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
        validate(&config, &mut found);
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

fn validate(config: &Config, found: &mut Mistakes<'_>) {
    found.require("", "machine");
    let [shortest, longest] = [ceiling::SHORTEST_CYCLE, ceiling::LONGEST_CYCLE].map(ms);
    found.range("cycle_ms", config.cycle_ms, shortest..=longest);
    if let Some(guard) = &config.guard {
        guard.validate(config.cycle_ms, found);
    }
    let count = config.controllers.len();
    if count == 0 {
        found.add("", "found no [[controller]], expected at least one");
    }
    if count > volcomp_guard::MAX_PATHS {
        let most = volcomp_guard::MAX_PATHS;
        found.add("controller", format!("found {count} controllers, expected at most {most}"));
    }
    let has_barrier = config.controllers.iter().any(|own| own.barrier.is_some());
    for (index, own) in config.controllers.iter().enumerate() {
        let rules = Rules {
            at: &format!("controller[{index}]"),
            longest_hold: ceiling::HOLD_THERMAL,
            has_barrier,
        };
        controller(own, config.cycle_ms, &rules, found);
    }
    for (index, own) in config.thermometers.iter().enumerate() {
        own.validate(&format!("thermometer[{index}]"), found);
    }
    dashboard(&config.dashboard, found);
    path("audit.dir", &config.audit.dir, found);
    found.whole("realtime.priority", config.realtime.priority, 0..=99);
    if let Some(cpu) = config.realtime.cpu {
        found.whole("realtime.cpu", cpu, 0..=1023);
    }
    if let Some(own) = &config.fleet {
        fleet(own, found);
    }
    if let Some(own) = &config.shdr {
        open_address("shdr.listen", own.listen, own.anyone_may_read, found);
        if let Some(name) = own.device.as_deref().filter(|name| is_blank(name)) {
            found.add("shdr.device", format!("found `{name}`, expected a name"));
        }
    }
    if let Some(own) = &config.opc_ua {
        open_address("opc_ua.listen", own.listen, own.anyone_may_read, found);
    }
}

fn dashboard(own: &DashboardConfig, found: &mut Mistakes<'_>) {
    let stated = [own.tls_certificate.is_some(), own.tls_key.is_some()];
    both(found, "dashboard", ["tls_certificate", "tls_key"], stated, "");
}

/// Requires that a server without authentication listens on loopback, or that its key `anyone`
/// permits other addresses.
fn open_address(key: &str, listen: SocketAddr, anyone: bool, found: &mut Mistakes<'_>) {
    if !anyone && !listen.ip().is_loopback() {
        found.add(
            key,
            format!(
                "found `{listen}`, which other computers reach, without a password and without encryption: expected an address such as 127.0.0.1:{}, or anyone_may_read = true",
                listen.port()
            ),
        );
    }
}

fn letters(key: &str, axes: &[AxisName], found: &mut Mistakes<'_>) {
    for (index, name) in axes.iter().enumerate() {
        if axes[..index].contains(name) {
            found.add(key, format!("duplicate axis {name}"));
        }
    }
}

fn controller(own: &ControllerConfig, cycle_ms: f64, rules: &Rules<'_>, found: &mut Mistakes<'_>) {
    let at = rules.at;
    let key = |name: &str| format!("{at}.{name}");
    let is_reader = found.is_read(&key("axes")) && own.axes.is_empty();
    let driver = check_keys(own, at, is_reader, found);
    axes(own, at, found);
    if let Some(name) = own.channel.as_deref().filter(|name| is_blank(name)) {
        found
            .add(&key("channel"), format!("found {name:?}, expected a name of visible characters"));
    }
    for (name, position) in &own.fixed {
        let key = key(&format!("fixed.{name}"));
        found.range(&key, *position, -LARGEST_NUMBER..=LARGEST_NUMBER);
    }
    letters(&key("not_driven"), &own.not_driven, found);
    for (index, state) in own.unseen.iter().enumerate() {
        if own.unseen[..index].contains(state) {
            let name = serde_json::to_string(state).unwrap_or_default();
            found.add(&key("unseen"), format!("duplicate {}", name.trim_matches('"')));
        }
    }
    for (name, step, kind, most) in [
        ("resolution_um", own.resolution_um, AxisKind::Linear, 1000.0),
        ("resolution_urad", own.resolution_urad, AxisKind::Rotary, 1e5),
    ] {
        if let Some(step) = step {
            has_axis(&key(name), kind, &own.axes, found);
            found.range(&key(name), step, 1e-4..=most);
        }
    }
    if own.terms.as_ref().is_some_and(|terms| *terms != ["thermal"]) {
        found.add(&key("terms"), "expected [\"thermal\"], or no such key: all terms");
    }
    let longest = if own.terms.is_some() { ceiling::HOLD_THERMAL } else { ceiling::HOLD };
    if let Some(hold_ms) = own.hold_ms {
        found.range(&key("hold_ms"), hold_ms, cycle_ms..=ms(longest));
    }
    barrier(own, at, found);
    if let Some(driver) = driver {
        (driver.validate)(own, rules, found);
    }
}

fn axes(own: &ControllerConfig, at: &str, found: &mut Mistakes<'_>) {
    found.require(at, "axes");
    let (axes, reads) = (format!("{at}.axes"), format!("{at}.reads"));
    letters(&axes, &own.axes, found);
    letters(&reads, &own.reads, found);
    if found.states(&reads) && own.reads.is_empty() {
        found.add(&reads, "found no axis, expected the letters of axes that are only read");
    }
    if let Some(name) = own.reads.iter().find(|name| own.axes.contains(name)) {
        let message = format!("axis {name} is also in axes: written axes are read anyway");
        found.add(&reads, message);
    }
    let count = own.axes.len() + own.reads.len();
    if found.states(&axes) && !(1..=MAX_AXES).contains(&count) {
        found.add(&axes, format!("found {count} axes, expected 1 to {MAX_AXES}"));
    }
}

/// Checks the table `barrier` of a controller, which excludes the keys of the plain scheme.
fn barrier(own: &ControllerConfig, at: &str, found: &mut Mistakes<'_>) {
    let Some(barrier) = &own.barrier else {
        return;
    };
    for key in ["area", "heartbeat", "unwatched"] {
        let key = format!("{at}.{key}");
        if found.states(&key) {
            found.add(
                &key,
                "found this key together with barrier, expected it only where corrections are written as plain values",
            );
        }
    }
    let table = format!("{at}.barrier");
    for key in ["machine", "scan_ms"] {
        found.require(&table, key);
    }
    found.whole(&format!("{table}.machine"), barrier.machine, 0..=LARGEST_MACHINE);
    found.range(&format!("{table}.scan_ms"), barrier.scan_ms, 0.1..=100.0);
}

fn fleet(own: &FleetConfig, found: &mut Mistakes<'_>) {
    for key in ["url", "site", "machine", "serial", "nkey_file", "trusted_keys"] {
        found.require("fleet", key);
    }
    let stated = |key: &str, found: &Mistakes<'_>| found.states(&format!("fleet.{key}"));
    if stated("url", found)
        && let Some(wrong) = wrong_address(&own.url)
    {
        found.add("fleet.url", format!("found {wrong:?}, expected {ADDRESSES}"));
    }
    if stated("site", found)
        && let Err(error) = own.site.parse::<SiteId>()
    {
        found.add("fleet.site", error.to_string());
    }
    if stated("machine", found)
        && let Err(error) = own.machine.parse::<MachineId>()
    {
        found.add("fleet.machine", error.to_string());
    }
    if stated("serial", found) && is_blank(&own.serial) {
        let message =
            format!("found {:?}, expected the serial number of the machine tool", own.serial);
        found.add("fleet.serial", message);
    }
    if stated("nkey_file", found) {
        path("fleet.nkey_file", &own.nkey_file, found);
    }
    path("fleet.dir", &own.dir, found);
    if let Some(ca) = &own.ca {
        path("fleet.ca", ca, found);
        if !own.url.contains("tls://") {
            found.add("fleet.ca", "found this key without a tls:// in url, expected it only there");
        }
    }
    if stated("trusted_keys", found) && own.trusted_keys.is_empty() {
        found.add("fleet.trusted_keys", "found no key, expected at least one public key");
    }
    for (index, text) in own.trusted_keys.iter().enumerate() {
        if let Err(error) = trusted_key(text) {
            found.add("fleet.trusted_keys", format!("found {text:?}: {error}"));
        } else if own.trusted_keys[..index].contains(text) {
            found.add("fleet.trusted_keys", format!("duplicate key {text}"));
        }
    }
}

/// Maximum time after the last frame until a control ramps to zero, s.
const LONGEST_SILENCE_S: f64 = 60.0;

#[derive(Clone, Debug, PartialEq)]
pub struct MapSender {
    /// File name used in messages.
    pub file: String,
    /// The keys; relative paths are resolved against the folder of the file.
    pub keys: MapKeys,
    /// Upper bounds for the settings of the control: correction, rate and timeout.
    pub allowed: SenderLimits,
}

impl MapSender {
    /// Reads the configuration file.
    ///
    /// # Errors
    /// The file cannot be read, or it is invalid: every error with file, line and key.
    pub fn read(path: &Path) -> Result<Self, GatewayError> {
        let folder = path.parent().unwrap_or(Path::new(""));
        let document = Document::read(path)?;
        Ok(Self::decode(&document, &path.display().to_string(), folder)?)
    }

    /// Parses the text of a configuration; relative paths are resolved against `folder`.
    ///
    /// # Errors
    /// Every error, with file, line and key.
    pub fn parse(text: &str, file: &str, folder: &Path) -> Result<Self, InputErrors> {
        Self::decode(&Document::new(file, text), file, folder)
    }

    fn decode(document: &Document, file: &str, folder: &Path) -> Result<Self, InputErrors> {
        let (mut keys, mut found) = document.structure::<MapKeys>(|_| None)?;
        validate_sender(&keys, &mut found);
        keys.join(folder);
        let sender = Self {
            file: file.to_owned(),
            allowed: SenderLimits {
                limit_mm: keys.limit_um * 1e-3,
                slew_mm_per_s: keys.slew_um_per_s * 1e-3,
                zero_after_s: keys.zero_after_ms * 1e-3,
                scan_s: keys.scan_ms * 1e-3,
                capacity: keys.capacity,
            },
            keys,
        };
        found.none_or(sender)
    }
}

fn validate_sender(keys: &MapKeys, found: &mut Mistakes<'_>) {
    for key in [
        "map",
        "url",
        "number",
        "capacity",
        "scan_ms",
        "limit_um",
        "slew_um_per_s",
        "zero_after_ms",
    ] {
        found.require("", key);
    }
    if found.states("map") {
        config::path("map", &keys.map, found);
    }
    config::path("audit.dir", &keys.audit.dir, found);
    found.whole("number", keys.number, 0..=LARGEST_MACHINE);
    // Room for the header and at least one value.
    found.whole("capacity", keys.capacity, HEADER_WORDS + 1..=MAX_WORDS);
    let most_um = ceiling::LIMIT.0 * 1e3;
    let fastest_um = ceiling::SLEW_PER_S.0 * 1e3;
    found.range("limit_um", keys.limit_um, 0.001..=most_um);
    found.range("slew_um_per_s", keys.slew_um_per_s, 0.001..=fastest_um);
    let longest = LONGEST_SILENCE_S * 1e3;
    found.range("zero_after_ms", keys.zero_after_ms, 100.0..=longest);
    found.range("scan_ms", keys.scan_ms, 0.1..=1000.0);
    keys.validate_control([FRAME_WORDS, REPORT_WORDS], found);
}
