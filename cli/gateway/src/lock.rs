//! One gateway on a computer for each controller: a name of the device in the kernel's abstract socket addresses, which
//! nobody can hold twice, every user sees, and no crash leaves behind.
//!
//! The name is that of the address that is reached, not its spelling: `localhost`, `127.0.0.1` and a second name in the
//! DNS are one device.

use std::{
    collections::BTreeSet,
    io::ErrorKind,
    net::{IpAddr, Ipv4Addr, Ipv6Addr, ToSocketAddrs, UdpSocket},
    os::{
        linux::net::SocketAddrExt,
        unix::fs::MetadataExt,
        unix::net::{SocketAddr, UnixListener},
    },
    path::Path,
};

use rustix::net::{AddressFamily, SocketType, netdevice::name_to_index, socket};
use sha2::{Digest, Sha256};
use volcomp_devices::{Address, MODBUS_PORT, Scheme};
use volcomp_digital_io::LineSet;

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
        // Two programs cannot ask on one serial line; other thermometers may be asked by many.
        if only_read && address.scheme != Scheme::ModbusRtu {
            continue;
        }
        for device in devices(&address) {
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
    for device in devices(&address) {
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

/// The names of the devices that an address reaches, the same for all its spellings. One that cannot be found now, such
/// as a host whose name nobody resolves, has the name by which it is called.
fn devices(address: &Address) -> BTreeSet<String> {
    match address.scheme {
        Scheme::Focas => hosts(&address.host, address.port.unwrap_or(volcomp_focas::PORT)),
        Scheme::Modbus => hosts(&address.host, address.port.unwrap_or(MODBUS_PORT)),
        Scheme::OpcUa => hosts(
            &address.host,
            address.port.unwrap_or(volcomp_sinumerik::PORT),
        ),
        Scheme::LinuxCnc => hosts(
            &address.host,
            address.port.unwrap_or(volcomp_linuxcnc::PORT),
        ),
        Scheme::ModbusRtu => {
            let path = std::fs::canonicalize(&address.path);
            let path = path.map_or_else(|_| address.path.clone(), |p| p.display().to_string());
            [format!("serial {path}")].into()
        }
        Scheme::Can => [interface(&address.host)].into(),
        Scheme::Gpio => ["position", "correction"]
            .into_iter()
            .filter_map(|key| address.get(key))
            .map(chip)
            .collect(),
    }
}

/// A host and port by the addresses to which the name leads.
fn hosts(host: &str, port: u16) -> BTreeSet<String> {
    // URLs put IPv6 addresses into brackets.
    let host = host.trim_start_matches('[').trim_end_matches(']');
    let found: Vec<IpAddr> = match (host, port).to_socket_addrs() {
        Ok(found) => found.map(|address| address.ip()).collect(),
        Err(e) => {
            tracing::warn!("{host}: {e}: a gateway that calls it by another name is not noticed");
            Vec::new()
        }
    };
    if found.is_empty() {
        return [format!("{} port {port}", host.to_lowercase())].into();
    }
    let of = |ip| format!("{} port {port}", canonical(ip));
    found.into_iter().map(of).collect()
}

/// One address for all by which this computer reaches itself; IPv4 in IPv6 is IPv4.
fn canonical(ip: IpAddr) -> IpAddr {
    let ip = ip.to_canonical();
    let is_this_computer = match ip {
        // The others of 127.0.0.0/8 are addresses of their own, as tests use them.
        IpAddr::V4(v4) if v4.is_loopback() => v4 == Ipv4Addr::LOCALHOST,
        // The unspecified address reaches this computer.
        ip => ip.is_loopback() || ip.is_unspecified() || is_own(ip),
    };
    if is_this_computer {
        Ipv4Addr::LOCALHOST.into()
    } else {
        ip
    }
}

/// Whether an address is one of this computer: packets to it would come from itself. Nothing is sent.
fn is_own(ip: IpAddr) -> bool {
    let any: IpAddr = match ip {
        IpAddr::V4(_) => Ipv4Addr::UNSPECIFIED.into(),
        IpAddr::V6(_) => Ipv6Addr::UNSPECIFIED.into(),
    };
    let from = || -> std::io::Result<IpAddr> {
        let socket = UdpSocket::bind((any, 0))?;
        socket.connect((ip, 9))?;
        Ok(socket.local_addr()?.ip())
    };
    from().is_ok_and(|from| from == ip)
}

/// A network interface by its number: it may have several names.
fn interface(name: &str) -> String {
    let number = socket(AddressFamily::INET, SocketType::DGRAM, None)
        .and_then(|socket| name_to_index(socket, name));
    number.map_or_else(
        |_| format!("interface {name}"),
        |number| format!("interface number {number}"),
    )
}

/// The chip of `CHIP:LINES` by its device file: it has a label and a name besides.
fn chip(lines: &str) -> String {
    let file = LineSet::parse(lines).and_then(|set| set.chip_file());
    let named = || lines.rsplit_once(':').map_or(lines, |(chip, _)| chip);
    let chip = file.map_or_else(|_| named().to_owned(), |file| file.display().to_string());
    format!("gpio {chip}")
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

#[cfg(test)]
mod tests {
    use super::*;

    fn of(url: &str) -> BTreeSet<String> {
        devices(&Address::parse(url).unwrap_or_else(|e| panic!("{e}")))
    }

    /// Before, each of these spellings had a lock of its own.
    #[test]
    fn every_spelling_of_an_address_is_one_device() {
        let one = of("focas://127.0.0.1");
        assert_eq!(one.len(), 1);
        for spelling in [
            "focas://127.0.0.1:8193",
            "focas://localhost:8193",
            "focas://LOCALHOST",
            "focas://[::1]",
            "focas://[::ffff:127.0.0.1]:8193",
            "focas://0.0.0.0",
            "focas://[::]",
            "focas://127.0.0.1?path=2",
        ] {
            assert_eq!(of(spelling), one, "{spelling}");
        }
        for other in [
            "focas://127.0.0.1:8194",
            "focas://192.0.2.10",
            "focas://127.0.0.2",
        ] {
            assert!(of(other).is_disjoint(&one), "{other}");
        }
        let module = of("modbus://localhost?profile=ADAM-6050");
        assert_eq!(
            module,
            of("modbus://127.0.0.1:502?unit=1&profile=ADAM-6050")
        );
        assert!(module.is_disjoint(&one));
    }

    /// The interface that every computer has, under the number that the kernel gives it.
    #[test]
    fn an_interface_is_known_by_its_number() {
        let number = std::fs::read_to_string("/sys/class/net/lo/ifindex").expect("there");
        let expected = format!("interface number {}", number.trim());
        assert_eq!(of("can://lo"), [expected].into());
        assert_eq!(of("can://can99"), ["interface can99".to_owned()].into());
    }

    #[test]
    fn a_serial_device_is_known_by_its_file() {
        let dir = tempfile::tempdir().expect("writable");
        let [file, link] = ["tty", "by-id"].map(|name| dir.path().join(name));
        std::fs::write(&file, "").expect("writable");
        std::os::unix::fs::symlink(&file, &link).expect("writable");
        let url =
            |path: &std::path::Path| format!("modbus-rtu://{}?profile=ADAM-4015", path.display());
        assert_eq!(of(&url(&file)), of(&url(&link)));
    }

    #[test]
    fn the_chips_of_both_words_are_locked() {
        let both = of("gpio://?position=panel-out:0-14&correction=panel-in:0-7");
        assert_eq!(
            both,
            ["gpio panel-in".to_owned(), "gpio panel-out".to_owned()].into()
        );
    }
}
