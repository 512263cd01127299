//! Device URLs, and canonical names of the devices that they address.

use std::{
    collections::{BTreeMap, BTreeSet},
    net::{IpAddr, Ipv4Addr, Ipv6Addr, ToSocketAddrs, UdpSocket},
};

use url::Url;
use volcomp_port::DeviceError;

#[derive(Clone, Copy)]
pub(crate) struct Scheme {
    pub(crate) name: &'static str,
    /// Form of the scheme's URLs, for error messages.
    pub(crate) form: &'static str,
    /// Cargo feature of this crate that includes the driver in the build.
    pub(crate) feature: &'static str,
    pub(crate) keys: &'static str,
}

const fn scheme([name, form, feature, keys]: [&'static str; 4]) -> Scheme {
    Scheme { name, form, feature, keys }
}

/// All schemes, including those whose drivers are not in this build.
pub(crate) const SCHEMES: [Scheme; 7] = [
    scheme(["focas", "focas://HOST", "focas", "path"]),
    scheme(["can", "can://INTERFACE", "can", "dbc"]),
    scheme(["gpio", "gpio://?position=…", "gpio", "position correction"]),
    scheme([
        "modbus",
        "modbus://HOST?profile=…",
        "modbus",
        "unit profile names byte_order answer_ms",
    ]),
    scheme([
        "modbus-rtu",
        "modbus-rtu:///dev/…?profile=…",
        "modbus",
        "unit profile names byte_order answer_ms baud parity stop",
    ]),
    scheme(["opc.tcp", "opc.tcp://HOST", "sinumerik", ""]),
    scheme(["linuxcnc", "linuxcnc://HOST", "linuxcnc", "remote key_file"]),
];

impl Scheme {
    pub(crate) fn named(name: &str) -> Option<Self> {
        SCHEMES.into_iter().find(|scheme| scheme.name == name)
    }
}

/// A parsed device URL: scheme, host, port, path and query keys.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Address {
    /// The URL as written, for error messages.
    pub text: String,
    /// Name of the scheme, which determines the bus.
    pub scheme: &'static str,
    /// Host or interface; empty if the scheme has none.
    pub host: String,
    /// Port; `None` if the URL has none.
    pub port: Option<u16>,
    /// Path of a device file; empty if the scheme has none.
    pub path: String,
    keys: BTreeMap<String, String>,
}

impl Address {
    /// Parses a URL.
    ///
    /// # Errors
    /// Text that is not a URL, an unknown scheme or key, a missing host or path.
    pub fn parse(text: &str) -> Result<Self, DeviceError> {
        let wrong = |what: String, remedy: &str| DeviceError::address(text, what, remedy);
        let [forms @ .., last] = SCHEMES.map(|scheme| scheme.form);
        let forms = &*format!("expected {} or {last}", forms.join(", "));
        let url =
            Url::parse(text).map_err(|e| wrong(format!("this is no device URL: {e}"), forms))?;
        let scheme = Scheme::named(url.scheme())
            .ok_or_else(|| wrong(format!("found the scheme `{}`", url.scheme()), forms))?;
        let mut keys = BTreeMap::new();
        for (key, value) in url.query_pairs() {
            let known: Vec<&str> = scheme.keys.split_whitespace().collect();
            if !known.contains(&&*key) {
                let expected = match &known[..] {
                    [] => "expected no keys".to_owned(),
                    known => format!("expected one of: {}", known.join(", ")),
                };
                let found = format!("found the key `{key}`");
                return Err(DeviceError::option(text, found, expected));
            }
            if keys.insert(key.clone().into_owned(), value.into_owned()).is_some() {
                let found = format!("the key `{key}` is listed twice");
                return Err(DeviceError::option(text, found, "name it once"));
            }
        }
        let address = Self {
            text: text.to_owned(),
            scheme: scheme.name,
            host: url.host_str().unwrap_or_default().to_owned(),
            port: url.port(),
            path: url.path().to_owned(),
            keys,
        };
        // A scheme has a host if capital letters follow `://` in its form, as in `://HOST` or `://INTERFACE`.
        let behind = scheme.form.split("://").nth(1);
        let has_host = behind.is_some_and(|behind| behind.starts_with(char::is_uppercase));
        if has_host && address.host.is_empty() {
            return Err(wrong("the host or interface is missing".to_owned(), forms));
        }
        if scheme.name == "modbus-rtu" && address.path.len() < 2 {
            let remedy = "expected three slashes: modbus-rtu:///dev/ttyUSB0";
            return Err(wrong("the serial device is missing".to_owned(), remedy));
        }
        Ok(address)
    }

    pub fn wrong(&self, found: impl Into<String>, expected: impl Into<String>) -> DeviceError {
        DeviceError::option(&*self.text, found, expected)
    }

    /// Creates the error for a request that this device or this build does not support.
    pub fn unsupported(
        &self,
        found: impl Into<String>,
        expected: impl Into<String>,
    ) -> DeviceError {
        DeviceError::unsupported(&*self.text, found, expected)
    }

    #[cfg(any(feature = "modbus", feature = "can"))]
    pub(crate) fn no_answer(
        &self,
        found: impl Into<String>,
        expected: impl Into<String>,
    ) -> DeviceError {
        DeviceError::no_answer(&*self.text, found, expected)
    }

    #[cfg(any(feature = "can", feature = "gpio"))]
    pub(crate) fn failed(
        &self,
        fault: volcomp_port::Fault,
        expected: impl Into<String>,
    ) -> DeviceError {
        DeviceError::of_fault(&*self.text, fault, expected)
    }

    /// Value of a query key; `None` if the URL lacks the key.
    pub fn get(&self, key: &str) -> Option<&str> {
        self.keys.get(key).map(String::as_str)
    }

    /// Value of a numeric query key, or `default` if the URL lacks the key.
    ///
    /// # Errors
    /// Not a number in the range of the key.
    pub fn number<N: std::str::FromStr + PartialOrd + std::fmt::Display>(
        &self,
        key: &str,
        [low, high]: [N; 2],
        default: N,
    ) -> Result<N, DeviceError> {
        let Some(text) = self.get(key) else {
            return Ok(default);
        };
        let number = text.parse().ok().filter(|n| low <= *n && *n <= high);
        number.ok_or_else(|| {
            let what = format!("found {key}={text}");
            self.wrong(what, format!("expected a whole number from {low} to {high}"))
        })
    }

    /// Comma-separated values of a query key; empty if the URL lacks the key.
    pub fn list(&self, key: &str) -> Vec<String> {
        let words = self.get(key).unwrap_or_default().split(',');
        words.filter(|word| !word.is_empty()).map(str::to_owned).collect()
    }
}

/// Canonical names of the device at the host and port of a URL, from the resolved addresses: `localhost`, `127.0.0.1`
/// and a DNS alias are one device. `usual` is the default port.
pub(crate) fn hosts(address: &Address, usual: u16) -> BTreeSet<String> {
    let (host, port) = (&*address.host, address.port.unwrap_or(usual));
    // URLs enclose IPv6 addresses in brackets.
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

/// Maps every address of this computer to 127.0.0.1, and IPv4-mapped IPv6 addresses to IPv4.
fn canonical(ip: IpAddr) -> IpAddr {
    let ip = ip.to_canonical();
    let is_this_computer = match ip {
        // Other addresses of 127.0.0.0/8 stay distinct, because tests use them as separate devices.
        IpAddr::V4(v4) if v4.is_loopback() => v4 == Ipv4Addr::LOCALHOST,
        // Connections to the unspecified address reach this computer.
        ip => ip.is_loopback() || ip.is_unspecified() || is_own(ip),
    };
    if is_this_computer { Ipv4Addr::LOCALHOST.into() } else { ip }
}

/// Whether an address belongs to this computer. In that case the kernel uses it as the source address of packets to it.
/// Sends nothing.
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
