//! Allows one gateway per controller on a computer. The lock is an abstract socket address named after the device. It
//! is exclusive, visible to all users, and released by the kernel after a crash.

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

/// Locks the folder of the audit log and every exclusive device of a configuration, until the returned value is
/// dropped.
///
/// # Errors
/// Another gateway on this computer holds one of the locks.
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
            // Controllers and thermometers of one configuration may share a device.
            if locked.insert(device.clone()) {
                locks.push(lock_device(url, &device)?);
            }
        }
    }
    Ok(locks)
}

/// Locks the control and the audit-log folder of a map sender, until the returned value is dropped.
///
/// # Errors
/// A gateway or another sender on this computer holds one of the locks.
pub(crate) fn lock_sender(url: &str, audit_dir: &Path) -> Result<Vec<UnixListener>, GatewayError> {
    let mut locks = vec![lock_folder(audit_dir)?];
    let address = Address::parse(url).map_err(GatewayError::Device)?;
    let driver = address.driver().map_err(GatewayError::Device)?;
    for device in (driver.devices)(&address) {
        locks.push(lock_device(url, &device)?);
    }
    Ok(locks)
}

/// Locks the folder of the audit log, which also contains the last output, the confirmed model and the standing state.
fn lock_folder(folder: &Path) -> Result<UnixListener, GatewayError> {
    try_folder(folder)?.ok_or_else(|| in_use("[audit] dir", folder))
}

/// Locks the folder of manifests received from the centre.
///
/// # Errors
/// Another gateway on this computer uses the folder.
#[cfg(feature = "fleet")]
pub(crate) fn lock_fleet(folder: &Path) -> Result<UnixListener, GatewayError> {
    try_folder(folder)?.ok_or_else(|| in_use("[fleet] dir", folder))
}

fn in_use(key: &str, folder: &Path) -> GatewayError {
    GatewayError::failed(format!(
        "{key}: another gateway on this computer uses the folder {}, expected a separate folder",
        folder.display()
    ))
}

/// True if a gateway or a map sender on this computer uses a folder.
///
/// # Errors
/// The folder cannot be created or accessed.
pub(crate) fn is_folder_locked(folder: &Path) -> Result<bool, GatewayError> {
    Ok(try_folder(folder)?.is_none())
}

/// Locks a folder, creating it if it is missing. `None`: another program holds the lock.
fn try_folder(folder: &Path) -> Result<Option<UnixListener>, GatewayError> {
    let shown = folder.display().to_string();
    let wrong = |source| GatewayError::system(shown.clone(), source);
    std::fs::create_dir_all(folder).map_err(wrong)?;
    let found = std::fs::metadata(folder).map_err(wrong)?;
    // The inode identifies the folder, which may have several paths.
    try_lock(&format!("folder {} {}", found.dev(), found.ino())).map_err(wrong)
}

fn lock_device(url: &str, device: &str) -> Result<UnixListener, GatewayError> {
    let lock = try_lock(device).map_err(|e| GatewayError::system(url.to_owned(), e))?;
    lock.ok_or_else(|| {
        GatewayError::failed(format!("{url}: another gateway on this computer uses it"))
    })
}

/// Takes the lock of this name; `None`: another program holds the lock.
fn try_lock(name: &str) -> std::io::Result<Option<UnixListener>> {
    let digest = volcomp_model::hexadecimal(&Sha256::digest(name.as_bytes())[..8]);
    let address = SocketAddr::from_abstract_name(format!("volcomp-gateway-{digest}"))?;
    match UnixListener::bind_addr(&address) {
        Ok(lock) => Ok(Some(lock)),
        Err(e) if e.kind() == ErrorKind::AddrInUse => Ok(None),
        Err(e) => Err(e),
    }
}
