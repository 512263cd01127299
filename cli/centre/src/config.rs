//! The configuration of the centre: `centre.toml`. The manual describes the keys.

use std::{
    net::SocketAddr,
    path::{Path, PathBuf},
    time::Duration,
};

use serde::Deserialize;
use volcomp_document::{Document, Mistakes};
use volcomp_fleet::{ADDRESSES, ServerTls, StreamRetention, first_port, wrong_address};

use crate::{Error, rollout::Rules, store::Retention};

#[derive(Clone, Debug, Deserialize, PartialEq)]
#[serde(default, deny_unknown_fields)]
pub struct StoreConfig {
    pub file: PathBuf,
}

impl Default for StoreConfig {
    fn default() -> Self {
        Self { file: "centre.db".into() }
    }
}

#[derive(Clone, Debug, Deserialize, PartialEq)]
#[serde(default, deny_unknown_fields)]
pub struct NatsConfig {
    /// Server addresses, separated by commas.
    pub url: String,
    pub nkey_file: PathBuf,
    pub ca: Option<PathBuf>,
    replicas: usize,
    telemetry_d: f64,
    telemetry_gib: i64,
    audit_d: f64,
}

impl Default for NatsConfig {
    fn default() -> Self {
        let stream_retention = StreamRetention::default();
        let days = |duration: Duration| duration.as_secs_f64() / 86_400.0;
        Self {
            url: String::new(),
            nkey_file: "centre.nkey".into(),
            ca: None,
            replicas: stream_retention.replicas,
            telemetry_d: days(stream_retention.telemetry),
            telemetry_gib: stream_retention.site_bytes >> 30,
            audit_d: days(stream_retention.audit),
        }
    }
}

impl NatsConfig {
    pub fn stream_retention(&self) -> StreamRetention {
        let days = |days: f64| Duration::from_secs_f64(days * 86_400.0);
        StreamRetention {
            replicas: self.replicas,
            telemetry: days(self.telemetry_d),
            site_bytes: self.telemetry_gib << 30,
            audit: days(self.audit_d),
        }
    }
}

#[derive(Clone, Debug, Deserialize, PartialEq)]
#[serde(default, deny_unknown_fields)]
pub struct KeysConfig {
    pub folder: PathBuf,
    pub sign_with: String,
}

impl Default for KeysConfig {
    fn default() -> Self {
        Self { folder: "keys".into(), sign_with: "main".to_owned() }
    }
}

/// The table `[server]`: settings that `nats-config` writes in addition to the users.
#[derive(Clone, Debug, Deserialize, PartialEq)]
#[serde(default, deny_unknown_fields)]
pub struct ServerConfig {
    pub name: String,
    /// Address for clients. Default: the port of `nats.url` on the loopback interface.
    listen: Option<String>,
    pub store: PathBuf,
    certificate: Option<PathBuf>,
    key: Option<PathBuf>,
    pub cluster: Option<String>,
    pub cluster_listen: String,
    pub routes: Vec<String>,
}

impl Default for ServerConfig {
    fn default() -> Self {
        Self {
            name: "centre".to_owned(),
            listen: None,
            store: "streams".into(),
            certificate: None,
            key: None,
            cluster: None,
            cluster_listen: String::new(),
            routes: Vec::new(),
        }
    }
}

impl ServerConfig {
    /// TLS for clients and between the servers of a cluster.
    pub fn tls(&self) -> Option<ServerTls> {
        let (certificate, key) = self.certificate.clone().zip(self.key.clone())?;
        Some(ServerTls { certificate, key })
    }
}

#[derive(Clone, Debug, Deserialize, PartialEq)]
#[serde(deny_unknown_fields)]
pub struct PageConfig {
    pub listen: SocketAddr,
    tls_certificate: Option<PathBuf>,
    tls_key: Option<PathBuf>,
    /// Host names accepted in requests, in addition to addresses.
    #[serde(default)]
    pub hosts: Vec<String>,
}

impl PageConfig {
    /// Paths of the certificate and the key, PEM.
    pub fn tls(&self) -> Option<(&Path, &Path)> {
        self.tls_certificate.as_deref().zip(self.tls_key.as_deref())
    }
}

#[derive(Clone, Debug, Default, Deserialize, PartialEq)]
#[serde(default, deny_unknown_fields)]
pub struct Config {
    pub store: StoreConfig,
    pub keep: Retention,
    pub nats: NatsConfig,
    pub keys: KeysConfig,
    pub rollout: Rules,
    pub server: ServerConfig,
    pub page: Option<PageConfig>,
}

impl Config {
    /// Reads a configuration file. Paths in it are relative to its folder.
    pub fn read(path: &Path) -> Result<Self, Error> {
        let document = Document::read(path)?;
        let (mut config, mut mistakes) = document.structure::<Self>(|key| {
            (key == "store.postgres")
                .then_some("PostgreSQL is not supported any more, expected `file`, a SQLite file")
        })?;
        config.check(&mut mistakes);
        // The server reads the file written by `nats-config` in a different working directory, so its paths must be
        // absolute.
        let whole = std::path::absolute(path).unwrap_or_else(|_| path.to_owned());
        let folder = whole.parent().unwrap_or(Path::new("."));
        for path in config.paths() {
            *path = folder.join(&*path);
        }
        Ok(mistakes.none_or(config)?)
    }

    pub fn server_listen(&self) -> String {
        self.server.listen.clone().unwrap_or_else(|| {
            let port = first_port(&self.nats.url).unwrap_or_default();
            format!("127.0.0.1:{port}")
        })
    }

    fn paths(&mut self) -> impl Iterator<Item = &mut PathBuf> {
        let Self { store, nats, keys, server, page, .. } = self;
        let page = (page.iter_mut())
            .flat_map(|page| [page.tls_certificate.as_mut(), page.tls_key.as_mut()]);
        let stated = [nats.ca.as_mut(), server.certificate.as_mut(), server.key.as_mut()];
        [&mut store.file, &mut nats.nkey_file, &mut keys.folder, &mut server.store]
            .into_iter()
            .chain(stated.into_iter().chain(page).flatten())
    }

    fn check(&self, mistakes: &mut Mistakes<'_>) {
        let (keep, nats, server) = (&self.keep, &self.nats, &self.server);
        if mistakes.states("nats") {
            mistakes.require("nats", "url");
        } else {
            mistakes.add("nats", "found no table [nats], expected it with the key url");
        }
        if let Some(found) = wrong_address(&nats.url).filter(|_| mistakes.states("nats.url")) {
            mistakes.add("nats.url", format!("found {found:?}, expected {ADDRESSES}"));
        }
        if !matches!(nats.replicas, 1 | 3 | 5) {
            let found = format!("found {}, expected 1, 3 or 5", nats.replicas);
            mistakes.add("nats.replicas", found);
        }
        mistakes.range("nats.telemetry_d", nats.telemetry_d, 0.01..=3660.0);
        mistakes.range("nats.audit_d", nats.audit_d, 0.01..=3660.0);
        mistakes.whole("nats.telemetry_gib", nats.telemetry_gib, 1..=65_536);
        for (key, hours) in [("keep.raw_h", keep.raw_h), ("keep.telemetry_h", keep.telemetry_h)] {
            mistakes.range(key, hours, 1.0..=8784.0);
        }
        for (key, days) in [
            ("keep.minutes_d", keep.minutes_d),
            ("keep.telemetry_hourly_d", keep.telemetry_hourly_d),
        ] {
            mistakes.range(key, days, 1.0..=36_600.0);
        }
        if let Err((key, why)) = self.rollout.check() {
            mistakes.add(&format!("rollout.{key}"), why);
        }
        if server.certificate.is_some() != server.key.is_some() {
            mistakes.add("server", "found one of certificate and key, expected both or neither");
        }
        if server.cluster.is_some() {
            mistakes.require("server", "cluster_listen");
            mistakes.require("server", "routes");
        }
        let Some(page) = &self.page else { return };
        if page.tls_certificate.is_some() != page.tls_key.is_some() {
            mistakes
                .add("page", "found one of tls_certificate and tls_key, expected both or neither");
        } else if page.tls_key.is_none() && !page.listen.ip().is_loopback() {
            mistakes.add(
                "page.listen",
                "this address is reachable from other computers, expected tls_certificate and tls_key (create them with volcomp-centre tls-init)",
            );
        }
    }
}
