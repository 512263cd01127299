//! The table `[server]` of the configuration: what `nats-config` writes beside the users.

use std::path::{Path, PathBuf};

use volcomp_document::{InputError, Section};
use volcomp_fleet::ServerTls;

use crate::config::path;

/// A server among the others of its cluster, as the configuration has it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ClusterConfig {
    /// The name of the cluster.
    pub name: String,
    /// The address on which the other servers reach this one.
    pub listen: String,
    /// The addresses of the servers of the cluster, `nats://HOST:PORT`.
    pub routes: Vec<String>,
}

/// The table `[server]`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ServerConfig {
    /// The name of the server.
    pub name: String,
    /// The address on which clients reach it.
    pub listen: String,
    /// The folder of its streams.
    pub store: PathBuf,
    /// TLS towards clients, and between the servers of a cluster.
    pub tls: Option<ServerTls>,
    /// The cluster.
    pub cluster: Option<ClusterConfig>,
}

impl ServerConfig {
    /// The server of a configuration without the table.
    pub(crate) fn alone(folder: &Path) -> Self {
        Self {
            name: "centre".to_owned(),
            listen: "127.0.0.1:4222".to_owned(),
            store: folder.join("streams"),
            tls: None,
            cluster: None,
        }
    }

    pub(crate) fn decode(section: &Section<'_>, folder: &Path) -> Result<Self, InputError> {
        section.allow(&[
            "name",
            "listen",
            "store",
            "certificate",
            "key",
            "cluster",
            "cluster_listen",
            "routes",
        ])?;
        let default = Self::alone(folder);
        let text = |key: &str, default: String| match section.get(key) {
            Some(value) => value.text().map(str::to_owned),
            None => Ok(default),
        };
        let tls = match (section.get("certificate"), section.get("key")) {
            (Some(certificate), Some(key)) => Some(ServerTls {
                certificate: path(&certificate, folder)?,
                key: path(&key, folder)?,
            }),
            (None, None) => None,
            _ => {
                return Err(
                    section.error("found one of certificate and key, expected both or neither")
                );
            }
        };
        let cluster = match section.get("cluster") {
            None => None,
            Some(name) => Some(ClusterConfig {
                name: name.text()?.to_owned(),
                listen: section.require("cluster_listen")?.text()?.to_owned(),
                routes: (section.require("routes")?.texts()?.into_iter())
                    .map(str::to_owned)
                    .collect(),
            }),
        };
        Ok(Self {
            name: text("name", default.name)?,
            listen: text("listen", default.listen)?,
            store: match section.get("store") {
                Some(value) => path(&value, folder)?,
                None => default.store,
            },
            tls,
            cluster,
        })
    }
}
