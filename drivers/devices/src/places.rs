//! The devices that URLs reach, by names that do not depend on the spelling: `localhost`, `127.0.0.1` and a second name
//! in the DNS are one device.

use std::{
    collections::BTreeSet,
    net::{IpAddr, Ipv4Addr, Ipv6Addr, ToSocketAddrs, UdpSocket},
};

use crate::address::Address;

/// The host and port of a URL by the addresses to which the name leads.
pub(crate) fn hosts(address: &Address) -> BTreeSet<String> {
    let usual = address.driver().map_or(0, |driver| driver.port);
    let (host, port) = (&*address.host, address.port.unwrap_or(usual));
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

#[cfg(all(
    test,
    feature = "focas",
    feature = "modbus",
    feature = "can",
    feature = "gpio"
))]
mod tests {
    use std::collections::BTreeSet;

    use crate::address::Address;

    fn of(url: &str) -> BTreeSet<String> {
        let address = Address::parse(url).unwrap_or_else(|e| panic!("{e}"));
        let driver = address.driver().unwrap_or_else(|e| panic!("{e}"));
        (driver.devices)(&address)
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
