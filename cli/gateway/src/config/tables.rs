//! The tables of a configuration, key by key: the field names are the keys.
#![expect(missing_docs, reason = "the manual describes the keys")]

use std::{net::SocketAddr, path::PathBuf};

use serde::{Deserialize, Serialize};
use volcomp_fleet::{IdError, Identity, VerifyingKey, trusted_key};
use volcomp_runtime::Realtime;

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

/// The table `[realtime]`.
#[derive(Serialize, Deserialize)]
#[serde(remote = "Realtime", deny_unknown_fields, default = "realtime")]
pub(super) struct RealtimeKeys {
    priority: u8,
    cpu: Option<usize>,
    reference: bool,
}

/// Default scheduling of the control thread.
pub(crate) fn realtime() -> Realtime {
    Realtime {
        priority: 60,
        cpu: None,
        reference: false,
    }
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
        Self {
            listen: SocketAddr::from(([127, 0, 0, 1], 4840)),
            anyone_may_read: false,
        }
    }
}

impl DashboardConfig {
    /// Whether reading requires a token; on the loopback interface it does not.
    pub(crate) fn reading_needs_token(&self) -> bool {
        !self.listen.ip().is_loopback()
    }
}

impl FleetConfig {
    /// Site and machine name in the fleet.
    ///
    /// # Errors
    /// A name is not valid in a message subject; this cannot occur in a configuration that was read from a file.
    pub fn identity(&self) -> Result<Identity, IdError> {
        Ok(Identity {
            site: self.site.parse()?,
            machine: self.machine.parse()?,
        })
    }

    /// The public keys whose manifests are accepted.
    pub fn trusted(&self) -> Vec<VerifyingKey> {
        let keys = self.trusted_keys.iter();
        keys.filter_map(|key| trusted_key(key).ok()).collect()
    }
}
