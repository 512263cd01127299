//! The tables of other systems that read the gateway: `[shdr]`, `[sparkplug]`, `[opc_ua]`.

use std::{
    net::SocketAddr,
    path::{Path, PathBuf},
    time::Duration,
};

use volcomp_document::{InputError, Section};

/// The ways over which other systems read the gateway; `None`: not over this one.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct InteropConfig {
    /// The table `[shdr]`.
    pub shdr: Option<ShdrConfig>,
    /// The table `[sparkplug]`.
    pub sparkplug: Option<SparkplugConfig>,
    /// The table `[opc_ua]`.
    pub opc_ua: Option<OpcUaConfig>,
}

/// The table `[opc_ua]`: a server that clients read.
#[derive(Clone, Debug, PartialEq)]
pub struct OpcUaConfig {
    /// The address and port on which it listens.
    pub listen: SocketAddr,
}

/// The table `[shdr]`: an adapter for agents of MTConnect.
#[derive(Clone, Debug, PartialEq)]
pub struct ShdrConfig {
    /// The address and port on which it listens.
    pub listen: SocketAddr,
    /// The name of the device that an agent shows; `None`: that of the machine.
    pub device: Option<String>,
}

/// The table `[sparkplug]`: an edge node at a broker of MQTT.
#[derive(Clone, Debug, PartialEq)]
pub struct SparkplugConfig {
    /// The URL of the broker as the file states it.
    pub url: String,
    /// Its host.
    pub host: String,
    /// Its port.
    pub port: u16,
    /// The name of the group.
    pub group: String,
    /// The name of the edge node.
    pub node: String,
    /// The name of the device; `None`: that of the machine.
    pub device: Option<String>,
    /// The user at the broker.
    pub user: Option<String>,
    /// The file with the user's password, mode 0600.
    pub password_file: Option<PathBuf>,
    /// The file with the certificates of the authorities that may vouch for the broker, PEM; `None`: without TLS.
    pub ca: Option<PathBuf>,
    /// The time between two looks at what has changed.
    pub interval: Duration,
    /// The broker tells that the gateway is gone when it has heard nothing for half as long again.
    pub keep_alive: Duration,
    /// How much a number must change before it is told again.
    pub deadbands: Deadbands,
}

impl SparkplugConfig {
    /// The name of the client at the broker, who lets go of one when another of the same name comes.
    pub fn client(&self) -> String {
        format!("volcomp-{}-{}", self.group, self.node)
    }

    /// The name of the device: the stated one, else that of the machine without the signs that divide topics.
    pub fn device_or(&self, machine: &str) -> String {
        let own = || machine.replace(DIVIDERS, "_");
        self.device.clone().unwrap_or_else(own)
    }
}

/// How much a number must change before it is told again, by its unit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Deadbands {
    /// Millimetres.
    pub mm: f64,
    /// Degrees.
    pub deg: f64,
    /// Micrometres.
    pub um: f64,
    /// Microradians.
    pub urad: f64,
    /// Kelvin.
    pub degc: f64,
}

impl Default for Deadbands {
    fn default() -> Self {
        Self {
            mm: 0.01,
            deg: 0.01,
            um: 0.5,
            urad: 0.5,
            degc: 0.05,
        }
    }
}

/// The signs that divide the levels of a topic or stand for any level.
const DIVIDERS: [char; 3] = ['/', '+', '#'];

pub(super) fn interop(root: &Section<'_>, folder: &Path) -> Result<InteropConfig, InputError> {
    let own = root.section("sparkplug")?;
    Ok(InteropConfig {
        shdr: root.section("shdr")?.map(|own| shdr(&own)).transpose()?,
        sparkplug: own.map(|own| sparkplug(&own, folder)).transpose()?,
        opc_ua: root
            .section("opc_ua")?
            .map(|own| opc_ua(&own))
            .transpose()?,
    })
}

fn sparkplug(section: &Section<'_>, folder: &Path) -> Result<SparkplugConfig, InputError> {
    section.allow(&[
        "url",
        "group",
        "node",
        "device",
        "user",
        "password_file",
        "ca",
        "interval_ms",
        "keep_alive_s",
        "deadband_mm",
        "deadband_deg",
        "deadband_um",
        "deadband_urad",
        "deadband_degc",
    ])?;
    let url = section.require("url")?;
    let (host, port, tls) = broker(url.text()?).ok_or_else(|| {
        url.error(format!(
            "found `{}`, expected mqtt://HOST:PORT or, with TLS, mqtts://HOST:PORT",
            url.text().unwrap_or_default()
        ))
    })?;
    let path =
        |key: &str| section.optional(key, |value| Ok::<_, InputError>(folder.join(value.text()?)));
    let ca = path("ca")?;
    if tls != ca.is_some() {
        return Err(section.error(if tls {
            "mqtts: ca is missing, expected the file with the certificate of the authority that vouches for the broker"
        } else {
            "ca is for mqtts://, and the URL says mqtt://, without TLS"
        }));
    }
    let (user, password_file) = (section.optional("user", named)?, path("password_file")?);
    if user.is_some() != password_file.is_some() {
        return Err(section.error("found one of user and password_file, expected both or neither"));
    }
    let none = Deadbands::default();
    let deadband = |key: &str, default: f64| section.number_or(key, 0.0..=1e6, default);
    Ok(SparkplugConfig {
        url: url.text()?.to_owned(),
        host,
        port,
        group: level(&section.require("group")?)?,
        node: level(&section.require("node")?)?,
        device: section.optional("device", level)?,
        user,
        password_file,
        ca,
        interval: Duration::from_millis(section.whole_or("interval_ms", 100..=60_000, 1000)?),
        keep_alive: Duration::from_secs(section.whole_or("keep_alive_s", 4..=3600, 20)?),
        deadbands: Deadbands {
            mm: deadband("deadband_mm", none.mm)?,
            deg: deadband("deadband_deg", none.deg)?,
            um: deadband("deadband_um", none.um)?,
            urad: deadband("deadband_urad", none.urad)?,
            degc: deadband("deadband_degc", none.degc)?,
        },
    })
}

/// Host and port of the URL of a broker, and whether it wants TLS.
fn broker(url: &str) -> Option<(String, u16, bool)> {
    let (rest, tls) = match url.strip_prefix("mqtts://") {
        Some(rest) => (rest, true),
        None => (url.strip_prefix("mqtt://")?, false),
    };
    let rest = rest.strip_suffix('/').unwrap_or(rest);
    let is_no_port = |port: &str| port.ends_with(']');
    let (host, port) = match rest.rsplit_once(':') {
        Some((host, port)) if !is_no_port(port) => (host, port.parse().ok()?),
        _ => (rest, if tls { 8883 } else { 1883 }),
    };
    let host = match host.strip_prefix('[') {
        Some(inner) => inner.strip_suffix(']')?,
        None => Some(host).filter(|host| !host.contains(':'))?,
    };
    let is_host = |c: char| c.is_ascii_alphanumeric() || "-._:".contains(c);
    (!host.is_empty() && host.chars().all(is_host)).then(|| (host.to_owned(), port, tls))
}

/// A name that is one level of a topic.
fn level(value: &volcomp_document::Value<'_>) -> Result<String, InputError> {
    let text = named(value)?;
    if text.contains(DIVIDERS) {
        return Err(value.error(format!(
            "found `{text}`, expected a name without `/`, `+` and `#`"
        )));
    }
    Ok(text)
}

fn shdr(section: &Section<'_>) -> Result<ShdrConfig, InputError> {
    section.allow(&["listen", "anyone_may_read", "device"])?;
    Ok(ShdrConfig {
        listen: open_address(section, 7878)?,
        device: section.optional("device", named)?,
    })
}

fn opc_ua(section: &Section<'_>) -> Result<OpcUaConfig, InputError> {
    section.allow(&["listen", "anyone_may_read"])?;
    Ok(OpcUaConfig {
        listen: open_address(section, 4840)?,
    })
}

/// The address of a server that asks nobody who he is: of this computer, or it is said that anyone may read.
fn open_address(section: &Section<'_>, port: u16) -> Result<SocketAddr, InputError> {
    let default = SocketAddr::from(([127, 0, 0, 1], port));
    let listen = address(section, "listen", default)?;
    if !section.truth_or("anyone_may_read", false)? && !listen.ip().is_loopback() {
        return Err(section.require("listen")?.error(format!(
            "found `{listen}`, which other computers reach, and whoever comes is asked for no password and nothing is encrypted: \
             expected an address such as {default}, or anyone_may_read = true"
        )));
    }
    Ok(listen)
}

/// An address and port, or the default.
fn address(
    section: &Section<'_>,
    key: &str,
    default: SocketAddr,
) -> Result<SocketAddr, InputError> {
    let stated = section.optional(key, |value| {
        let text = value.text()?;
        text.parse().map_err(|_| {
            value.error(format!(
                "found `{text}`, expected an address and port such as {default}"
            ))
        })
    })?;
    Ok(stated.unwrap_or(default))
}

/// A name that can be read.
fn named(value: &volcomp_document::Value<'_>) -> Result<String, InputError> {
    let text = value.text()?;
    if super::is_blank(text) {
        return Err(value.error(format!("found `{text}`, expected a name")));
    }
    Ok(text.to_owned())
}

#[cfg(test)]
mod tests {
    use super::broker;

    #[test]
    fn urls_of_brokers() {
        let whole = |host: &str, port, tls| Some((host.to_owned(), port, tls));
        for (url, expected) in [
            ("mqtt://192.0.2.9", whole("192.0.2.9", 1883, false)),
            ("mqtt://192.0.2.9:1884", whole("192.0.2.9", 1884, false)),
            (
                "mqtts://broker.shop.lan/",
                whole("broker.shop.lan", 8883, true),
            ),
            (
                "mqtts://[2001:db8::1]:8884",
                whole("2001:db8::1", 8884, true),
            ),
            ("mqtts://[2001:db8::1]", whole("2001:db8::1", 8883, true)),
            ("mqtt://2001:db8::1", None),
            ("mqtt://", None),
            ("mqtt://host:port", None),
            ("mqtt://host:70000", None),
            ("mqtt://user@host", None),
            ("mqtt://host/path", None),
            ("http://host", None),
        ] {
            assert_eq!(broker(url), expected, "{url}");
        }
    }
}
