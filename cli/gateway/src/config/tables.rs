//! The tables of a configuration, key by key: the field names are the keys.
#![expect(missing_docs, reason = "the manual describes the keys")]

use std::{net::SocketAddr, path::PathBuf};

use serde::{Deserialize, Serialize};
use volcomp_fleet::{Identity, UnknownId, VerifyingKey, trusted_key};
use volcomp_runtime::Realtime;

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
