//! One gateway on a computer for each controller: a name of the device in the kernel's abstract socket addresses, which
//! nobody can hold twice, every user sees, and no crash leaves behind.

use std::{
    collections::BTreeSet,
    io::ErrorKind,
    os::{
        linux::net::SocketAddrExt,
        unix::fs::MetadataExt,
        unix::net::{SocketAddr, UnixListener},
    },
    path::Path,
};

use sha2::{Digest, Sha256};
use volcomp_devices::Address;

use crate::{config::Config, error::GatewayError};

/// Locks the folder of the audit log and every device of a configuration that one gateway alone can have, for as long as the answer
/// lives.
///
/// # Errors
/// Another gateway on this computer has one of them.
pub(crate) fn lock(config: &Config) -> Result<Vec<UnixListener>, GatewayError> {
    let mut locked = BTreeSet::new();
    let mut locks = vec![lock_folder(config.audit_dir())?];
    let controllers = config.controllers.iter().map(|c| (&c.url, false));
    let thermometers = config.thermometers.iter().map(|t| (&t.url, true));
    for (url, only_read) in controllers.chain(thermometers) {
        let address = Address::parse(url).map_err(GatewayError::Device)?;
        let driver = address.driver().map_err(GatewayError::Device)?;
        if only_read && !(driver.is_exclusive)(&address) {
            continue;
        }
        for device in (driver.devices)(&address) {
            // Controllers and thermometers of one configuration may be on one device.
            if locked.insert(device.clone()) {
                locks.push(lock_device(url, &device)?);
            }
        }
    }
    Ok(locks)
}

/// Locks the control and the folder of the audit log of a map sender, for as long as the answer lives.
///
/// # Errors
/// A gateway or another sender on this computer has one of them.
pub(crate) fn lock_sender(url: &str, audit_dir: &Path) -> Result<Vec<UnixListener>, GatewayError> {
    let mut locks = vec![lock_folder(audit_dir)?];
    let address = Address::parse(url).map_err(GatewayError::Device)?;
    let driver = address.driver().map_err(GatewayError::Device)?;
    for device in (driver.devices)(&address) {
        locks.push(lock_device(url, &device)?);
    }
    Ok(locks)
}

/// Locks the folder of the audit log, in which a gateway remembers what it has written, confirmed and been told.
fn lock_folder(folder: &Path) -> Result<UnixListener, GatewayError> {
    let shown = folder.display().to_string();
    let wrong = |source| GatewayError::system(shown.clone(), source);
    std::fs::create_dir_all(folder).map_err(wrong)?;
    let found = std::fs::metadata(folder).map_err(wrong)?;
    // By what it is, not by its spelling.
    let name = format!("folder {} {}", found.dev(), found.ino());
    lock_device(&shown, &name).map_err(|error| match error {
        GatewayError::Locked { .. } => GatewayError::FolderLocked {
            folder: folder.to_owned(),
        },
        other => other,
    })
}

/// Locks the folder in which a gateway keeps what its centre has sent.
///
/// # Errors
/// Another gateway on this computer uses it.
#[cfg(feature = "fleet")]
pub(crate) fn lock_fleet(folder: &Path) -> Result<UnixListener, GatewayError> {
    lock_folder(folder).map_err(|error| match error {
        GatewayError::FolderLocked { folder } => GatewayError::FleetFolderLocked { folder },
        other => other,
    })
}

fn lock_device(url: &str, device: &str) -> Result<UnixListener, GatewayError> {
    let digest = crate::hex(&Sha256::digest(device.as_bytes())[..8]);
    let failed = |e| GatewayError::system(url.to_owned(), e);
    let address =
        SocketAddr::from_abstract_name(format!("volcomp-gateway-{digest}")).map_err(failed)?;
    UnixListener::bind_addr(&address).map_err(|e| match e.kind() {
        ErrorKind::AddrInUse => GatewayError::Locked {
            url: url.to_owned(),
        },
        _ => failed(e),
    })
}
