//! Why a gateway does not start, or does not do what it is asked.

use std::{
    fmt, io,
    net::SocketAddr,
    path::{Path, PathBuf},
};

use volcomp_document::{InputError, InputErrors, PrivateError, ReadError};
use volcomp_model::ModelError;
use volcomp_port::DeviceError;
use volcomp_runtime::{PlanError, StartError};
use volcomp_vocabulary::AxisName;
use volcomp_web::TlsError;

/// Why a gateway does not start, or does not do what it is asked.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum GatewayError {
    /// A place in the configuration or the machine file.
    #[error(transparent)]
    Place(#[from] InputError),
    /// Everything that is wrong in a configuration.
    #[error(transparent)]
    Configuration(#[from] InputErrors),
    /// A machine file that does not make a machine.
    #[error(transparent)]
    Model(ModelError),
    /// The configuration that says where the gateway is to be asked for its state cannot be read.
    #[error(
        "{source}; a running gateway tells its state without this file, too: volcomp-gateway status --listen ADDRESS, its address and port"
    )]
    NoAddress {
        /// What is wrong with the file.
        source: Box<GatewayError>,
    },
    /// The configuration cannot be read as text.
    #[error(transparent)]
    Unreadable(#[from] ReadError),
    /// The machine file cannot be read as text.
    #[error("{file}: machine: {source}")]
    MachineFile {
        /// The path of the configuration file.
        file: String,
        /// Why it cannot be.
        source: ReadError,
    },
    /// Controllers, machine and limits do not fit together.
    #[error("{file}: {source}")]
    Plan {
        /// The path of the configuration file.
        file: String,
        /// The reason why the settings do not fit the machine or the controller.
        source: PlanError,
    },
    /// The configuration of a device makes no sense; found without opening it.
    #[error("{file}: {source}")]
    DeviceConfig {
        /// The path of the configuration file.
        file: String,
        /// The reason why the configuration of the device is refused.
        source: DeviceError,
    },
    /// Two controllers, or two thermometers, are the same device.
    #[error("{file}: {url} stands in two [[{table}]], expected one for each device")]
    DeviceTwice {
        /// The path of the configuration file.
        file: String,
        /// The name of the tables, `controller` or `thermometer`.
        table: &'static str,
        /// The URL of the device.
        url: String,
    },
    /// A device does not show a state of the control, and the configuration does not accept that.
    #[error(
        "{file}: {url}: this device does not show {state}, so nothing holds the correction by it: let the control show it, or accept that with {state:?} in unseen"
    )]
    StateUnseen {
        /// The path of the configuration file.
        file: String,
        /// The URL of the device.
        url: String,
        /// The name of the state, as the key has it.
        state: &'static str,
    },
    /// The configuration accepts that a state is not shown, and the device shows it.
    #[error(
        "{file}: {url}: unseen: found {state:?}, expected only states that this device does not show"
    )]
    StateSeen {
        /// The path of the configuration file.
        file: String,
        /// The URL of the device.
        url: String,
        /// The name of the state, as the key has it.
        state: &'static str,
    },
    /// Two sensors have one name, so that it is not known which of them a machine file or a person means.
    #[error(
        "{file}: {url}: names: found {name:?}, which is a sensor of another [[thermometer]] already, expected another name for each sensor of the machine"
    )]
    SensorTwice {
        /// The path of the configuration file.
        file: String,
        /// The URL of the second device.
        url: String,
        /// The name of both sensors.
        name: String,
    },
    /// A name of a sensor that nobody can read or write.
    #[error(
        "{file}: {url}: names: found {name:?}, expected a name of visible characters for each sensor"
    )]
    SensorBlank {
        /// The path of the configuration file.
        file: String,
        /// The URL of the device.
        url: String,
        /// The name.
        name: String,
    },
    /// Other computers can reach the dashboard, and it has no TLS.
    #[error(
        "[dashboard] listen = {listen}: others can reach this address, so tls_certificate and tls_key are needed (volcomp-gateway tls-init makes a pair)"
    )]
    NoTls {
        /// The address and port.
        listen: SocketAddr,
    },
    /// Other computers can reach the dashboard, and nobody has a token.
    #[error(
        "[dashboard] listen = {listen}: others can reach this address, so reading needs a token: token_file is missing or empty"
    )]
    NoToken {
        /// The address and port.
        listen: SocketAddr,
    },
    /// A certificate that cannot be used or made.
    #[error(transparent)]
    Tls(#[from] TlsError),
    /// A line of the token file.
    #[error("{}:{line}: {source}", file.display())]
    Token {
        /// The path of the file.
        file: PathBuf,
        /// The line, from 1.
        line: usize,
        /// The reason why the line is refused; never the token itself.
        source: TokenError,
    },
    /// A file with a secret that cannot be read, or that others may read.
    #[error(transparent)]
    Private(#[from] PrivateError),
    /// The folder of the audit log is no folder, or cannot be made because something above it is none.
    #[error("[audit] dir = {}: {}", dir.display(), audit_dir(dir, found))]
    AuditDir {
        /// The folder as it is configured.
        dir: PathBuf,
        /// The path in it that is something else than it has to be.
        found: PathBuf,
    },
    /// The folder of the audit log cannot be made or written.
    #[error("[audit] dir = {dir:?}: {found:?} cannot be used: {source}")]
    AuditAccess {
        /// The folder as it is configured.
        dir: PathBuf,
        /// The path in it that was tried.
        found: PathBuf,
        /// The answer of the operating system.
        source: io::Error,
    },
    /// A controller that is only read before one that writes, or without one.
    #[error(
        "{file}: {url}: found axes = [], a controller that is only read, expected it after a [[controller]] that writes and after all of those"
    )]
    ReaderFirst {
        /// The path of the configuration file.
        file: String,
        /// The URL of the controller that is only read.
        url: String,
    },
    /// The correction depends on the positions of axes that nobody tells.
    #[error("{file}: {url}: {}", unknown_positions(axes, machine))]
    PositionUnknown {
        /// The path of the configuration file.
        file: String,
        /// The URL of the controller whose correction depends on them.
        url: String,
        /// The axes of the machine, at least one.
        axes: Vec<AxisName>,
        /// The path of the machine file.
        machine: PathBuf,
    },
    /// A reload that cannot be done while the gateway runs.
    #[error(transparent)]
    Reload(#[from] ReloadError),
    /// A file that cannot be read.
    #[error("{file}: cannot be read: {source}")]
    Read {
        /// The path of the file.
        file: String,
        /// Why it cannot be.
        source: io::Error,
    },
    /// A device that cannot be opened.
    #[error(transparent)]
    Device(DeviceError),
    /// Another gateway on this computer uses the same device.
    #[error("{url}: another gateway on this computer uses it")]
    Locked {
        /// The URL of the device.
        url: String,
    },
    /// Another gateway on this computer uses the same folder.
    #[error("[audit] dir: another gateway on this computer uses the folder {}, expected one of its own", .folder.display())]
    FolderLocked {
        /// The folder.
        folder: PathBuf,
    },
    /// A map that is not sent.
    #[error("{file}: {what}")]
    Map {
        /// The file of the map.
        file: String,
        /// What is wrong with it.
        what: String,
    },
    /// A map is not sent or kept any more.
    #[error("{url}: {what}")]
    MapEnded {
        /// The URL of the control.
        url: String,
        /// Why it is not sent or kept, a sentence without its full stop.
        what: String,
    },
    /// The control thread does not start.
    #[error(transparent)]
    Start(#[from] StartError),
    /// A running gateway refuses to answer, or answers with no state.
    #[error("gateway at {address}: {what}")]
    Answer {
        /// The address and port of the gateway.
        address: SocketAddr,
        /// The reason why the answer cannot be used.
        what: String,
    },
    /// The settings of the barrier in the control of the built-in machine.
    #[error("built-in barrier: {source}")]
    BuiltInBarrier {
        /// The setting that makes no sense.
        source: volcomp_guard::barrier::SettingsError,
    },
    /// A fault that is not in the catalogue of a rehearsal.
    #[error("--fault: found {found:?}, expected one of {expected}")]
    NoSuchFault {
        /// The name that was found.
        found: String,
        /// The names that there are.
        expected: String,
    },
    /// A rehearsal of a configuration without limits.
    #[error("{file}: [guard] is missing, expected it: without limits nothing is corrected")]
    NoLimits {
        /// The path of the configuration file.
        file: String,
    },
    /// A barrier that cannot be set to the configured limits.
    #[error("{device}: a barrier cannot be set to these limits: {source}")]
    Barrier {
        /// The URL of the controller.
        device: String,
        /// The setting that makes no sense.
        source: volcomp_guard::barrier::SettingsError,
    },
    /// A table that the program was built without.
    #[error(
        "{file}: [{table}]: this program was built without it: build it with the feature {feature}"
    )]
    NotBuilt {
        /// The path of the configuration file.
        file: String,
        /// The table.
        table: &'static str,
        /// The feature of the crate that it needs.
        feature: &'static str,
    },
    /// A rehearsal in which a rule was broken.
    #[error("rehearsal: {broken} of {count} faults broke a rule")]
    Rehearsal {
        /// How many broke a rule, each phase counted.
        broken: usize,
        /// How many were rehearsed.
        count: usize,
    },
    /// The machine did not start, or ended by a fault of the program.
    #[error("{what}")]
    Failed {
        /// Why it did not start, or ended.
        what: String,
        /// The exit status of the program.
        status: u8,
    },
    /// A configuration with a centre for a build that knows none.
    #[error(
        "{file}: [fleet]: this build of volcomp-gateway has no fleet, expected one that was built with the feature `fleet` (cargo build -p volcomp-gateway --features fleet), or a configuration without this table"
    )]
    NoFleet {
        /// The path of the configuration file.
        file: String,
    },
    /// The file of an nkey that holds none.
    #[error("{}: expected the seed of an nkey of a user: SU and 56 capital letters and digits", file.display())]
    Nkey {
        /// The path of the file.
        file: PathBuf,
    },
    /// The certificates of the fleet's servers cannot be used.
    #[error("{}: expected certificates as PEM", file.display())]
    FleetCa {
        /// The path of the file.
        file: PathBuf,
    },
    /// Another gateway on this computer keeps what its centre sent in the same folder.
    #[error("[fleet] dir: another gateway on this computer uses the folder {}, expected one of its own", .folder.display())]
    FleetFolderLocked {
        /// The folder.
        folder: PathBuf,
    },
    /// Something of the operating system.
    #[error("{what}: {source}")]
    System {
        /// The file, device, address or other object that the operation concerned.
        what: String,
        /// Why the operating system refused it.
        source: io::Error,
    },
}

/// The reason why a line of a token file is refused.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum TokenError {
    /// A line that has not three words.
    #[error("found {0} words, expected NAME ROLE TOKEN")]
    Words(usize),
    /// A role that is not known.
    #[error("found another role, expected view, operate or engineer")]
    Role,
    /// A token that can be guessed.
    #[error(
        "expected a token of at least 128 bits: 32 hexadecimal digits or 22 other letters and digits"
    )]
    Short,
    /// A second token of one name.
    #[error("this name stands twice")]
    Twice,
}

/// Why a configuration cannot be taken while the gateway runs.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum ReloadError {
    /// The simulation has no file to read again.
    #[error("the built-in configuration cannot be read again")]
    BuiltIn,
    /// Without limits nothing may be corrected.
    #[error(
        "{file}: [guard] is missing, expected it: without limits nothing may be corrected; nothing was changed"
    )]
    NoGuard {
        /// The path of the configuration file.
        file: String,
    },
    /// A key that is fixed while the gateway runs.
    #[error("{file}: {key} changed: restart the gateway for that")]
    Changed {
        /// The path of the configuration file.
        file: String,
        /// The key or table.
        key: FixedKey,
    },
    /// A file that a controller is described by, such as a DBC file, says something else than when it was opened.
    #[error(
        "{file}: {device}: axes, steps or signals are not those with which it was opened: restart the gateway for that"
    )]
    OtherController {
        /// The path of the configuration file.
        file: String,
        /// The device as its driver names it.
        device: String,
    },
    /// The machine file has other axes.
    #[error("{}: other axes than before: restart the gateway for that", machine.display())]
    OtherAxes {
        /// The path of the machine file.
        machine: PathBuf,
    },
}

/// A part of the configuration that is fixed while the gateway runs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FixedKey {
    /// The tables `[[controller]]` of the controllers.
    Controller,
    /// The tables `[[thermometer]]` of the thermometers.
    Thermometer,
    /// The time of a cycle.
    CycleMs,
    /// The table `[dashboard]`: address, tokens, certificate.
    Dashboard,
    /// The folder of the audit log.
    Audit,
    /// The scheduling of the control thread.
    Realtime,
    /// The table `[fleet]`: the centre, and who this machine is.
    Fleet,
    /// The keys of `[guard]` that are not limits of the correction.
    GuardTimes,
    /// The tables of other systems that read the gateway.
    Interop,
}

impl fmt::Display for FixedKey {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Controller => "[[controller]]",
            Self::Thermometer => "[[thermometer]]",
            Self::CycleMs => "cycle_ms",
            Self::Dashboard => "[dashboard]",
            Self::Audit => "[audit]",
            Self::Realtime => "[realtime]",
            Self::Fleet => "[fleet]",
            Self::GuardTimes => "[guard] hand_back_s, rotary_step_um, rapid_m_per_min, rapid_rpm or a key of temperatures",
            Self::Interop => "a table of other systems ([shdr], [opc_ua])",
        })
    }
}

impl GatewayError {
    /// A failure of the operating system.
    pub fn system(what: impl Into<String>, source: io::Error) -> Self {
        Self::System {
            what: what.into(),
            source,
        }
    }

    /// A configuration that does not say where a running gateway is to be asked.
    pub fn status_without(source: Self) -> Self {
        let source = Box::new(source);
        Self::NoAddress { source }
    }

    /// The exit status of the program: 2 when the call or a file is wrong, 1 when the work failed.
    pub fn status(&self) -> u8 {
        match self {
            Self::Failed { status, .. } => *status,
            Self::Device(_)
            | Self::Locked { .. }
            | Self::FolderLocked { .. }
            | Self::FleetFolderLocked { .. }
            | Self::Start(_)
            | Self::MapEnded { .. }
            | Self::Answer { .. }
            | Self::Rehearsal { .. }
            | Self::Tls(TlsError::Write { .. })
            | Self::System { .. } => 1,
            Self::Place(_)
            | Self::Configuration(_)
            | Self::Map { .. }
            | Self::Model(_)
            | Self::Unreadable(_)
            | Self::MachineFile { .. }
            | Self::NoAddress { .. }
            | Self::Plan { .. }
            | Self::DeviceConfig { .. }
            | Self::DeviceTwice { .. }
            | Self::StateUnseen { .. }
            | Self::StateSeen { .. }
            | Self::SensorTwice { .. }
            | Self::SensorBlank { .. }
            | Self::NoTls { .. }
            | Self::NoToken { .. }
            | Self::Tls(_)
            | Self::Token { .. }
            | Self::Private(_)
            | Self::AuditDir { .. }
            | Self::AuditAccess { .. }
            | Self::ReaderFirst { .. }
            | Self::PositionUnknown { .. }
            | Self::Reload(_)
            | Self::Read { .. }
            | Self::NoSuchFault { .. }
            | Self::NoLimits { .. }
            | Self::NoFleet { .. }
            | Self::Nkey { .. }
            | Self::FleetCa { .. }
            | Self::Barrier { .. }
            | Self::NotBuilt { .. }
            | Self::BuiltInBarrier { .. } => 2,
        }
    }
}

/// The message about the folder of the audit log: which part of it is not a folder, or cannot be made.
fn audit_dir(dir: &Path, found: &Path) -> String {
    if found.starts_with(dir) && found != dir {
        format!("{} is a folder, expected a file", found.display())
    } else {
        format!("{} is no folder", found.display())
    }
}

/// The message about axes whose positions nobody tells: what to state for each kind.
fn unknown_positions(axes: &[AxisName], machine: &Path) -> String {
    let list = |axes: &[AxisName], with: &str, between: &str| {
        let words: Vec<String> = axes
            .iter()
            .map(|axis| format!("{with}{axis}{with}"))
            .collect();
        words.join(between)
    };
    let linear: Vec<AxisName> = axes.iter().copied().filter(|a| !a.is_rotary()).collect();
    let (axis, they, them, they_are) = match axes {
        [_] => ("axis", "it stands", "it", "it is"),
        _ => ("axes", "they stand", "them", "they are"),
    };
    let or_fixed = if linear.is_empty() {
        String::new()
    } else {
        let each: Vec<String> = linear.iter().map(|axis| format!("{axis} = …")).collect();
        format!(", or state fixed = {{ {} }}", each.join(", "))
    };
    let not_fixed = if linear.len() == axes.len() {
        " and `fixed` does not state it"
    } else {
        ""
    };
    format!(
        "{axis} {} of {}: the correction depends on where {they}, but no [[controller]] shows {them}{not_fixed}: name {} in axes where {they_are} corrected, in reads = [{}] where {they_are} not{or_fixed}",
        list(axes, "", ", "),
        machine.display(),
        list(axes, "", ", "),
        list(axes, "\"", ", "),
    )
}

impl From<ModelError> for GatewayError {
    fn from(error: ModelError) -> Self {
        match error {
            ModelError::Input(place) => Self::Place(place),
            other => Self::Model(other),
        }
    }
}
