//! The tables of other systems that read the gateway: `[shdr]`, `[opc_ua]`.

use std::net::SocketAddr;

use volcomp_document::{InputError, Section};

/// The ways over which other systems read the gateway; `None`: not over this one.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct InteropConfig {
    /// The table `[shdr]`.
    pub shdr: Option<ShdrConfig>,
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

pub(super) fn interop(root: &Section<'_>) -> Result<InteropConfig, InputError> {
    Ok(InteropConfig {
        shdr: root.section("shdr")?.map(|own| shdr(&own)).transpose()?,
        opc_ua: root
            .section("opc_ua")?
            .map(|own| opc_ua(&own))
            .transpose()?,
    })
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
