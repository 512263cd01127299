//! The table `[page]` of the configuration: where the page is served, and under which names.

use std::{
    net::SocketAddr,
    path::{Path, PathBuf},
};

use volcomp_document::{InputError, Section};

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
    pub(crate) fn decode(section: &Section<'_>, folder: &Path) -> Result<Self, InputError> {
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
