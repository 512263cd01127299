//! The buses of this build: the driver of each scheme, and the functions that call it.

use std::{collections::BTreeSet, time::Duration};

use volcomp_document::Mistakes;
use volcomp_port::DeviceError;

use crate::{
    address::{Address, SCHEMES, Scheme},
    driver::{Configured, Driver, MapDevice, ThermometerDevice},
    keys::{ControllerConfig, MapKeys, ThermometerConfig},
    probe::Probe,
};

const KEYS: [&str; 4] = ["url", "axes", "reads", "unseen"];

/// Keys common to all controllers with written axes.
const WRITER_KEYS: [&str; 6] = ["channel", "fixed", "not_driven", "terms", "hold_ms", "test_shift"];

impl Scheme {
    /// Driver of the scheme; `None` if the driver is not in this build.
    pub(crate) fn driver(self) -> Option<&'static Driver> {
        match self.feature {
            #[cfg(feature = "focas")]
            "focas" => Some(&crate::focas::DRIVER),
            #[cfg(feature = "can")]
            "can" => Some(&crate::can::DRIVER),
            #[cfg(feature = "gpio")]
            "gpio" => Some(&crate::gpio::DRIVER),
            #[cfg(feature = "modbus")]
            "modbus" => Some(&crate::modbus::DRIVER),
            #[cfg(feature = "sinumerik")]
            "sinumerik" => Some(&crate::sinumerik::DRIVER),
            #[cfg(feature = "linuxcnc")]
            "linuxcnc" => Some(&crate::linuxcnc::DRIVER),
            _ => None,
        }
    }
}

impl Address {
    /// Driver of the address's bus.
    ///
    /// # Errors
    /// A bus that is not in this build.
    pub fn driver(&self) -> Result<&'static Driver, DeviceError> {
        let scheme = Scheme::named(self.scheme);
        scheme.and_then(Scheme::driver).ok_or_else(|| {
            let feature = scheme.map_or(self.scheme, |scheme| scheme.feature);
            self.unsupported(
                format!("this program was built without the feature `{feature}`"),
                format!("a program built with `--features {feature}`"),
            )
        })
    }
}

impl ControllerConfig {
    /// Driver of the URL; `None` if the URL is invalid or its bus is not in this build.
    pub fn driver(&self) -> Option<&'static Driver> {
        Address::parse(&self.url).ok()?.driver().ok()
    }
}

impl ThermometerConfig {
    /// Reports all mistakes in the table; `at` is the key of the table.
    pub fn validate(&self, at: &str, found: &mut Mistakes<'_>) {
        found.require(at, "names");
        let Some((address, _)) = address(at, &self.url, found) else {
            return;
        };
        #[cfg(feature = "sinumerik")]
        crate::sinumerik::validate_thermometer(self, address.scheme, at, found);
        #[cfg(not(feature = "sinumerik"))]
        let _ = address;
    }
}

impl ThermometerDevice {
    /// Whether both tables describe the same module, regardless of the spelling of their URLs: the same unit at the
    /// same host or serial device, or the same signals of the same CAN interface.
    pub fn is_same(&self, other: &Self) -> bool {
        let module = |Self { address, .. }: &Self| {
            let port = address.driver().map_or(0, |driver| driver.port);
            (
                address.scheme,
                address.host.to_lowercase(),
                address.port.unwrap_or(port),
                address.path.clone(),
                address.number("unit", [1, 247], 1_u8).unwrap_or(1),
                address.get("dbc").map(str::to_owned),
            )
        };
        module(self) == module(other)
    }
}

impl MapKeys {
    /// Checks the URL of the control and the tables of its bus. `sizes` is the number of words in a frame and in a
    /// report.
    pub fn validate_control(&self, sizes: [usize; 2], found: &mut Mistakes<'_>) {
        let address = Address::parse(&self.url);
        let driver = address.as_ref().ok().map(Address::driver);
        let driver = match driver {
            Some(Ok(driver)) if !driver.map_tables.is_empty() => driver,
            Some(Err(error)) => return found.add("url", error.to_string()),
            _ => {
                if found.states("url") {
                    let message = format!(
                        "found {:?}, expected opc.tcp://HOST:4840 (SINUMERIK) or focas://HOST:8193 (FANUC)",
                        self.url
                    );
                    found.add("url", message);
                }
                return;
            }
        };
        (driver.validate_map)(self, sizes, found);
        for scheme in SCHEMES {
            let tables = scheme.driver().map_or(&[][..], |driver| driver.map_tables);
            for key in tables.iter().filter(|key| !driver.map_tables.contains(key)) {
                if found.states(key) {
                    let only = scheme.name;
                    found.add(key, format!("found this table, expected it only for {only}://"));
                }
            }
        }
    }
}

/// Creates the controller of a `[[controller]]` without opening it.
///
/// # Errors
/// An invalid URL or key, a bus that is not in this build.
pub fn controller(own: &ControllerConfig) -> Configured {
    let address = Address::parse(&own.url)?;
    (address.driver()?.controller)(address, own)
}

/// Creates the thermometer of a `[[thermometer]]` without opening it.
///
/// # Errors
/// An invalid URL or name, a device without temperatures, a bus that is not in this build.
pub fn thermometer(own: &ThermometerConfig) -> Result<ThermometerDevice, DeviceError> {
    let address = Address::parse(&own.url)?;
    (address.driver()?.thermometer)(address, own)
}

/// Creates the control of a map sender without connecting to it.
///
/// # Errors
/// A file that cannot be read, a control that accepts no map, a bus that is not in this build.
pub fn map_device(keys: &MapKeys) -> Result<MapDevice, DeviceError> {
    let address = Address::parse(&keys.url)?;
    (address.driver()?.map)(&address, keys)
}

/// Reads a device once, within the time `at_most`. Writes nothing beyond what opening requires. GPIO outputs keep their
/// levels.
///
/// # Errors
/// A device that does not exist or does not answer, a bus that is not in this build.
pub fn probe(address: &Address, at_most: Duration) -> Result<Probe, DeviceError> {
    (address.driver()?.probe)(address, at_most)
}

/// Whether a controller of this driver uses a key of its table. `is_reader` means that no axes are corrected.
pub fn uses(driver: &Driver, is_reader: bool, key: &str) -> bool {
    let is_writer_key = WRITER_KEYS.contains(&key) || driver.writer_keys.contains(&key);
    KEYS.contains(&key) || driver.keys.contains(&key) || (!is_reader && is_writer_key)
}

/// Checks the URL of a controller, and rejects keys that its driver would silently ignore. `at` is the key of the
/// controller's table. Returns the driver, or `None` if the URL is invalid or its bus is not in this build.
pub fn check_keys(
    own: &ControllerConfig,
    at: &str,
    is_reader: bool,
    found: &mut Mistakes<'_>,
) -> Option<&'static Driver> {
    let (address, driver) = address(at, &own.url, found)?;
    for key in ["frame", "report"].map(|key| format!("{at}.barrier.{key}")) {
        if found.is_read(&key) && address.scheme != "focas" {
            found.add(
                &key,
                "found this key for a controller that is no FANUC control, expected it only for focas://",
            );
        }
    }
    let mut drivers: Vec<&Driver> = SCHEMES.into_iter().filter_map(Scheme::driver).collect();
    drivers.dedup_by_key(|driver| driver.name);
    let of_drivers = drivers.iter();
    let of_drivers = of_drivers.flat_map(|other| [other.keys, other.writer_keys].concat());
    let keys: BTreeSet<&str> = of_drivers.chain(WRITER_KEYS).collect();
    for key in keys {
        let place = format!("{at}.{key}");
        if !found.states(&place) || uses(driver, is_reader, key) {
            continue;
        }
        if uses(driver, false, key) {
            found.add(
                &place,
                "found this key for a controller that is only read (axes = []), expected it only where axes are written",
            );
            continue;
        }
        let names = drivers.iter().filter(|other| uses(other, false, key));
        let names: Vec<&str> = names.map(|other| other.name).collect();
        let message = format!(
            "found this key for {}, expected it only for {}",
            driver.name,
            names.join(" or ")
        );
        found.add(&place, message);
    }
    Some(driver)
}

fn address(at: &str, url: &str, found: &mut Mistakes<'_>) -> Option<(Address, &'static Driver)> {
    let key = format!("{at}.url");
    if !found.states(&key) {
        found.require(at, "url");
        return None;
    }
    if url.starts_with("sinumerik-s7") {
        found.add(
            &key,
            format!("found {url:?}, the S7 protocol, which is gone, expected opc.tcp://HOST:4840, the control's OPC UA server"),
        );
        return None;
    }
    Address::parse(url)
        .and_then(|address| address.driver().map(|driver| (address, driver)))
        .map_err(|error| found.add(&key, error.to_string()))
        .ok()
}

#[cfg(all(test, feature = "focas", feature = "modbus", feature = "can", feature = "gpio"))]
mod tests {
    use std::collections::BTreeSet;

    use super::Address;

    fn of(url: &str) -> BTreeSet<String> {
        let address = Address::parse(url).unwrap_or_else(|e| panic!("{e}"));
        let driver = address.driver().unwrap_or_else(|e| panic!("{e}"));
        (driver.devices)(&address)
    }

    /// All spellings of an address must give the same device, so that they share one lock.
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
        for other in ["focas://127.0.0.1:8194", "focas://192.0.2.10", "focas://127.0.0.2"] {
            assert!(of(other).is_disjoint(&one), "{other}");
        }
        let module = of("modbus://localhost?profile=ADAM-6050");
        assert_eq!(module, of("modbus://127.0.0.1:502?unit=1&profile=ADAM-6050"));
        assert!(module.is_disjoint(&one));
    }

    /// The loopback interface, which every computer has, is identified by its kernel index.
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
        assert_eq!(both, ["gpio panel-in".to_owned(), "gpio panel-out".to_owned()].into());
    }
}
