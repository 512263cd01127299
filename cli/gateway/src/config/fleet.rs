//! The table `[fleet]`: the centre of which the machine gets its machine file, and to which it tells its condition.

use std::path::{Path, PathBuf};

use volcomp_document::{InputError, Section, Value};
use volcomp_fleet::{ADDRESSES, Identity, VerifyingKey, trusted_key, wrong_address};

use super::is_blank;

/// The table `[fleet]`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FleetConfig {
    /// The addresses of the NATS servers, separated by commas.
    pub url: String,
    /// The site and the name of the machine in the fleet.
    pub identity: Identity,
    /// The serial number of the machine tool.
    pub serial: String,
    /// The file with the seed of the nkey of the machine, mode 0600.
    pub nkey_file: PathBuf,
    /// The keys whose manifests count.
    pub trusted_keys: Vec<VerifyingKey>,
    /// The folder in which accepted manifests, their machine files and messages that wait are kept.
    pub dir: PathBuf,
    /// Certificates that are trusted besides those of the system, PEM.
    pub ca: Option<PathBuf>,
}

pub(super) fn fleet(section: &Section<'_>, folder: &Path) -> Result<FleetConfig, InputError> {
    section.allow(&[
        "url",
        "site",
        "machine",
        "serial",
        "nkey_file",
        "trusted_keys",
        "dir",
        "ca",
    ])?;
    let name = |key: &str| section.require(key);
    let url = name("url")?;
    let site = name("site")?;
    let machine = name("machine")?;
    let ca = section.optional("ca", |value| path(value, folder))?;
    let servers = address(&url)?;
    if let Some(ca) = section.get("ca").filter(|_| !servers.contains("tls://")) {
        return Err(ca.error("found this key without a tls:// in url, expected it only there"));
    }
    Ok(FleetConfig {
        url: servers,
        identity: Identity {
            site: id(&site)?,
            machine: id(&machine)?,
        },
        serial: serial(&name("serial")?)?,
        nkey_file: path(&name("nkey_file")?, folder)?,
        trusted_keys: trusted_keys(&name("trusted_keys")?)?,
        dir: match section.get("dir") {
            Some(dir) => path(&dir, folder)?,
            None => folder.join("fleet"),
        },
        ca,
    })
}

/// Addresses of servers.
fn address(value: &Value<'_>) -> Result<String, InputError> {
    let text = value.text()?;
    match wrong_address(text) {
        None => Ok(text.to_owned()),
        Some(found) => Err(value.error(format!("found {found:?}, expected {ADDRESSES}"))),
    }
}

/// A name of a site or a machine.
fn id<T: std::str::FromStr<Err = volcomp_fleet::UnknownId>>(
    value: &Value<'_>,
) -> Result<T, InputError> {
    let name = value.text()?.parse::<T>();
    name.map_err(|e| value.error(e.to_string()))
}

fn serial(value: &Value<'_>) -> Result<String, InputError> {
    match value.text()? {
        text if is_blank(text) => Err(value.error(format!(
            "found {text:?}, expected the serial number of the machine tool"
        ))),
        text => Ok(text.to_owned()),
    }
}

fn path(value: &Value<'_>, folder: &Path) -> Result<PathBuf, InputError> {
    match value.text()? {
        "" => Err(value.error("found an empty text, expected a path")),
        text => Ok(folder.join(text)),
    }
}

fn trusted_keys(value: &Value<'_>) -> Result<Vec<VerifyingKey>, InputError> {
    let mut keys = Vec::new();
    for text in value.texts()? {
        let key = trusted_key(text).map_err(|e| value.error(format!("found {text:?}: {e}")))?;
        if keys.contains(&key) {
            return Err(value.error(format!("the key {text} stands twice")));
        }
        keys.push(key);
    }
    if keys.is_empty() {
        return Err(value.error("found no key, expected at least one public key"));
    }
    Ok(keys)
}
