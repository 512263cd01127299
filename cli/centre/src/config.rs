//! The configuration of the centre: `centre.toml`.

use std::{
    net::SocketAddr,
    path::{Path, PathBuf},
    time::Duration,
};

use volcomp_document::{Document, InputError, ReadError, Section, Value};
use volcomp_fleet::{ADDRESSES, Keeping, ServerTls, wrong_address};

use crate::{rollout::Rules, store::Keep};

/// A day, s.
const DAY_S: f64 = 86_400.0;

/// Why there is no configuration.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ConfigError {
    /// A place in the file.
    #[error(transparent)]
    Input(#[from] InputError),
    /// The file cannot be read.
    #[error(transparent)]
    Read(#[from] ReadError),
}

/// The table `[nats]`: the server as a client sees it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct NatsConfig {
    /// The addresses, separated by commas.
    pub url: String,
    /// The file with the seed of the nkey of the centre, mode 0600.
    pub nkey_file: PathBuf,
    /// Certificates that are trusted besides those of the system, PEM.
    pub ca: Option<PathBuf>,
    /// How long and how much the server keeps.
    pub keeping: Keeping,
}

/// The table `[keys]`: the keys that sign.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct KeysConfig {
    /// The folder of the key files.
    pub folder: PathBuf,
    /// The name of the key that signs.
    pub sign_with: String,
}

/// The configuration.
#[derive(Clone, Debug, PartialEq)]
pub struct Config {
    /// The file that it was read from.
    pub file: PathBuf,
    /// Where the centre remembers.
    pub store: PathBuf,
    /// How long it remembers.
    pub keep: Keep,
    /// The server.
    pub nats: NatsConfig,
    pub keys: KeysConfig,
    /// The rules of roll-outs that state none.
    pub rollout: Rules,
    /// What `nats-config` writes.
    pub server: ServerConfig,
    /// The page; `None`: there is none.
    pub page: Option<PageConfig>,
}

impl Config {
    /// Reads a configuration file. Paths in it are relative to its folder.
    ///
    /// # Errors
    /// What is wrong, with file, line and key.
    pub fn read(path: &Path) -> Result<Self, ConfigError> {
        let document = Document::read(path)?;
        // The server reads what `nats-config` prints in a folder of its own: its paths begin at the root.
        let whole = std::path::absolute(path).unwrap_or_else(|_| path.to_owned());
        let folder = whole.parent().unwrap_or(Path::new("."));
        let mut config = document.decode(|root| decode(&root, folder))?;
        path.clone_into(&mut config.file);
        Ok(config)
    }
}

fn decode(root: &Section<'_>, folder: &Path) -> Result<Config, InputError> {
    root.allow(&["store", "keep", "nats", "keys", "rollout", "server", "page"])?;
    let of = |key: &str| root.section(key);
    let store = match of("store")? {
        Some(section) => store(&section, folder)?,
        None => folder.join("centre.db"),
    };
    let nats = match of("nats")? {
        Some(section) => nats(&section, folder)?,
        None => return Err(root.error("found no [nats], expected the table with its url")),
    };
    Ok(Config {
        file: PathBuf::new(),
        store,
        keep: (of("keep")?.map(|section| keep(&section)).transpose()?).unwrap_or_default(),
        nats,
        keys: match of("keys")? {
            Some(section) => keys(&section, folder)?,
            None => KeysConfig {
                folder: folder.join("keys"),
                sign_with: "main".to_owned(),
            },
        },
        page: (of("page")?.map(|section| PageConfig::decode(&section, folder))).transpose()?,
        rollout: (of("rollout")?.map(|section| rules(&section)).transpose()?).unwrap_or_default(),
        server: match of("server")? {
            Some(section) => ServerConfig::decode(&section, folder)?,
            None => ServerConfig::alone(folder),
        },
    })
}

fn path(value: &Value<'_>, folder: &Path) -> Result<PathBuf, InputError> {
    Ok(folder.join(value.text()?))
}

fn store(section: &Section<'_>, folder: &Path) -> Result<PathBuf, InputError> {
    if let Some(value) = section.get("postgres") {
        return Err(
            value.error("PostgreSQL is not supported any more, expected `file`, a SQLite file")
        );
    }
    section.allow(&["file"])?;
    match section.get("file") {
        Some(file) => path(&file, folder),
        None => Ok(folder.join("centre.db")),
    }
}

fn keep(section: &Section<'_>) -> Result<Keep, InputError> {
    section.allow(&["raw_h", "minutes_d", "telemetry_h", "telemetry_hourly_d"])?;
    let default = Keep::default();
    let days = |key, default_s: f64| {
        Ok::<_, InputError>(section.number_or(key, 1.0..=36_600.0, default_s / DAY_S)? * DAY_S)
    };
    let hours = |key, default_s: f64| {
        Ok::<_, InputError>(section.number_or(key, 1.0..=8784.0, default_s / 3600.0)? * 3600.0)
    };
    Ok(Keep {
        raw_s: hours("raw_h", default.raw_s)?,
        minutes_s: days("minutes_d", default.minutes_s)?,
        telemetry_s: hours("telemetry_h", default.telemetry_s)?,
        telemetry_hourly_s: days("telemetry_hourly_d", default.telemetry_hourly_s)?,
    })
}

/// The addresses of the servers.
fn url(value: &Value<'_>) -> Result<String, InputError> {
    let text = value.text()?;
    match wrong_address(text) {
        None => Ok(text.to_owned()),
        Some(found) => Err(value.error(format!("found {found:?}, expected {ADDRESSES}"))),
    }
}

fn nats(section: &Section<'_>, folder: &Path) -> Result<NatsConfig, InputError> {
    section.allow(&[
        "url",
        "nkey_file",
        "ca",
        "replicas",
        "telemetry_d",
        "telemetry_gib",
        "audit_d",
    ])?;
    let default = Keeping::default();
    let days = |key, default: Duration| {
        let days = section.number_or(key, 0.01..=3660.0, default.as_secs_f64() / DAY_S)?;
        Ok::<_, InputError>(Duration::from_secs_f64(days * DAY_S))
    };
    let gib: i64 = section.whole_or("telemetry_gib", 1..=65_536, default.telemetry_bytes >> 30)?;
    let replicas = match section.get("replicas") {
        Some(value) => match value.whole(1..=5)? {
            replicas @ (1 | 3 | 5) => replicas,
            other => {
                return Err(value.error(format!("found {other}, expected 1, 3 or 5")));
            }
        },
        None => default.replicas,
    };
    Ok(NatsConfig {
        url: url(&section.require("url")?)?,
        nkey_file: match section.get("nkey_file") {
            Some(file) => path(&file, folder)?,
            None => folder.join("centre.nkey"),
        },
        ca: section.optional("ca", |value| path(value, folder))?,
        keeping: Keeping {
            replicas,
            telemetry: days("telemetry_d", default.telemetry)?,
            telemetry_bytes: gib << 30,
            audit: days("audit_d", default.audit)?,
        },
    })
}

fn keys(section: &Section<'_>, folder: &Path) -> Result<KeysConfig, InputError> {
    section.allow(&["folder", "sign_with"])?;
    Ok(KeysConfig {
        folder: match section.get("folder") {
            Some(value) => path(&value, folder)?,
            None => folder.join("keys"),
        },
        sign_with: match section.get("sign_with") {
            Some(value) => value.text()?.to_owned(),
            None => "main".to_owned(),
        },
    })
}

fn rules(section: &Section<'_>) -> Result<Rules, InputError> {
    section.allow(&[
        "waves",
        "soak_s",
        "answer_s",
        "tolerate",
        "residual_ratio",
        "residual_um",
    ])?;
    let default = Rules::default();
    let waves = match section.get("waves") {
        None => default.waves,
        Some(value) => {
            let waves: Result<Vec<u32>, InputError> = value
                .items()?
                .iter()
                .map(|item| item.whole(1..=100))
                .collect();
            let waves = waves?;
            if !Rules::are_waves(&waves) {
                return Err(value.error(format!("found {waves:?}, expected {}", Rules::WAVES)));
            }
            waves
        }
    };
    Ok(Rules {
        waves,
        soak_s: section.number_or("soak_s", Rules::SOAK_S, default.soak_s)?,
        answer_s: section.number_or("answer_s", Rules::ANSWER_S, default.answer_s)?,
        tolerate: section.whole_or("tolerate", Rules::TOLERATE, default.tolerate)?,
        residual_ratio: section.number_or(
            "residual_ratio",
            Rules::RESIDUAL_RATIO,
            default.residual_ratio,
        )?,
        residual_um: section.number_or("residual_um", Rules::RESIDUAL_UM, default.residual_um)?,
    })
}

/// The table `[page]`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PageConfig {
    /// The address and port.
    pub listen: SocketAddr,
    /// Certificate and key, PEM.
    pub tls: Option<(PathBuf, PathBuf)>,
    /// Host names, besides addresses, under which browsers may ask.
    pub hosts: Vec<String>,
}

impl PageConfig {
    fn decode(section: &Section<'_>, folder: &Path) -> Result<Self, InputError> {
        section.allow(&["listen", "tls_certificate", "tls_key", "hosts"])?;
        let value = section.require("listen")?;
        let listen: SocketAddr = value
            .text()?
            .parse()
            .map_err(|_| value.error("expected an address and a port, such as 127.0.0.1:8460"))?;
        let tls = match (section.get("tls_certificate"), section.get("tls_key")) {
            (Some(certificate), Some(key)) => {
                Some((folder.join(certificate.text()?), folder.join(key.text()?)))
            }
            (None, None) if listen.ip().is_loopback() => None,
            (None, None) => {
                return Err(value.error(
                    "others can reach this address, expected tls_certificate and tls_key (volcomp-centre tls-init makes a pair)",
                ));
            }
            _ => {
                return Err(section
                    .error("found one of tls_certificate and tls_key, expected both or neither"));
            }
        };
        let hosts = match section.get("hosts") {
            Some(hosts) => hosts.texts()?.into_iter().map(str::to_owned).collect(),
            None => Vec::new(),
        };
        Ok(Self { listen, tls, hosts })
    }
}

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
    pub cluster: Option<ClusterConfig>,
}

impl ServerConfig {
    /// The server of a configuration without the table.
    fn alone(folder: &Path) -> Self {
        Self {
            name: "centre".to_owned(),
            listen: "127.0.0.1:4222".to_owned(),
            store: folder.join("streams"),
            tls: None,
            cluster: None,
        }
    }

    fn decode(section: &Section<'_>, folder: &Path) -> Result<Self, InputError> {
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
