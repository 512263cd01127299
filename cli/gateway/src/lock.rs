//! One gateway on a computer for each controller: a name of the device in the kernel's abstract socket addresses, which
//! nobody can hold twice, every user sees, and no crash leaves behind.

use std::{
    io::ErrorKind,
    os::{
        linux::net::SocketAddrExt,
        unix::net::{SocketAddr, UnixListener},
    },
};

use sha2::{Digest, Sha256};

use crate::{config::Config, error::GatewayError};

/// Locks every controller of a configuration for as long as the answer lives.
///
/// # Errors
/// Another gateway on this computer corrects one of them.
pub(crate) fn lock(config: &Config) -> Result<Vec<UnixListener>, GatewayError> {
    let devices = config.controllers.iter().map(|controller| &controller.url);
    devices.map(|device| lock_device(device)).collect()
}

fn lock_device(device: &str) -> Result<UnixListener, GatewayError> {
    let digest = crate::hex(&Sha256::digest(device.as_bytes())[..8]);
    let failed = |e| GatewayError::system(device.to_owned(), e);
    let address =
        SocketAddr::from_abstract_name(format!("volcomp-gateway-{digest}")).map_err(failed)?;
    UnixListener::bind_addr(&address).map_err(|e| match e.kind() {
        ErrorKind::AddrInUse => GatewayError::Locked {
            url: device.to_owned(),
        },
        _ => failed(e),
    })
}
