//! Device URLs, taken apart.

use std::collections::BTreeMap;

use url::Url;
use volcomp_port::DeviceError;

/// The bus or protocol by which a device is reached.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Scheme {
    /// A FANUC control on FOCAS, such as `focas://HOST:8193`.
    Focas,
    /// A module on Modbus TCP, such as `modbus://HOST:502?unit=1&profile=NAME`.
    Modbus,
    /// A module on Modbus RTU, such as `modbus-rtu:///dev/ttyUSB0?baud=9600&parity=none&stop=1&unit=1&profile=NAME`.
    ModbusRtu,
    /// A CAN interface of Linux, such as `can://can0?dbc=FILE`.
    Can,
    /// Lines of GPIO chips, such as `gpio://?position=CHIP:LINES&correction=CHIP:LINES`.
    Gpio,
    /// A SINUMERIK control on OPC UA, such as `opc.tcp://HOST:4840`.
    OpcUa,
    /// A LinuxCNC control by its bridge, such as `linuxcnc://127.0.0.1:47001`.
    LinuxCnc,
}

impl Scheme {
    /// The feature of this crate that has the bus.
    pub fn feature(self) -> &'static str {
        match self {
            Self::Focas => "focas",
            Self::Modbus | Self::ModbusRtu => "modbus",
            Self::Can => "can",
            Self::Gpio => "gpio",
            Self::OpcUa => "sinumerik",
            Self::LinuxCnc => "linuxcnc",
        }
    }

    const NAMES: [(&'static str, Self); 7] = [
        ("focas", Self::Focas),
        ("modbus", Self::Modbus),
        ("modbus-rtu", Self::ModbusRtu),
        ("can", Self::Can),
        ("gpio", Self::Gpio),
        ("opc.tcp", Self::OpcUa),
        ("linuxcnc", Self::LinuxCnc),
    ];

    /// The keys behind the question mark.
    fn keys(self) -> &'static [&'static str] {
        match self {
            Self::Focas => &["path"],
            Self::Modbus => &["unit", "profile", "names", "byte_order", "answer_ms"],
            Self::ModbusRtu => &[
                "unit",
                "profile",
                "names",
                "byte_order",
                "answer_ms",
                "baud",
                "parity",
                "stop",
            ],
            Self::Can => &["dbc"],
            Self::Gpio => &["position", "correction"],
            Self::OpcUa => &[],
            Self::LinuxCnc => &["remote", "key_file"],
        }
    }
}

/// The URL of a device, taken apart into scheme, host, port, path and keys.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Address {
    /// As it was written.
    pub text: String,
    /// The bus that the URL names before `://`.
    pub scheme: Scheme,
    /// Host or interface; empty where there is none.
    pub host: String,
    /// The TCP port; `None` where the URL gives none.
    pub port: Option<u16>,
    /// Path of a device file.
    pub path: String,
    keys: BTreeMap<String, String>,
}

impl Address {
    /// Takes a URL apart.
    ///
    /// # Errors
    /// No URL, an unknown scheme or key, a host or path that is missing.
    pub fn parse(text: &str) -> Result<Self, DeviceError> {
        let wrong = |what: String, remedy: &str| DeviceError::address(text, what, remedy);
        let forms = "expected focas://HOST, modbus://HOST?profile=…, modbus-rtu:///dev/…?profile=…, can://INTERFACE, gpio://?position=…, opc.tcp://HOST or linuxcnc://HOST";
        let url =
            Url::parse(text).map_err(|e| wrong(format!("this is no device URL: {e}"), forms))?;
        let known = Scheme::NAMES.iter().find(|(name, _)| *name == url.scheme());
        let scheme = known
            .ok_or_else(|| wrong(format!("found the scheme `{}`", url.scheme()), forms))?
            .1;
        let mut keys = BTreeMap::new();
        for (key, value) in url.query_pairs() {
            if !scheme.keys().contains(&&*key) {
                let expected = match scheme.keys() {
                    [] => "expected no keys".to_owned(),
                    known => format!("expected one of: {}", known.join(", ")),
                };
                let found = format!("found the key `{key}`");
                return Err(DeviceError::option(text, found, expected));
            }
            if keys
                .insert(key.clone().into_owned(), value.into_owned())
                .is_some()
            {
                let found = format!("the key `{key}` stands twice");
                return Err(DeviceError::option(text, found, "name it once"));
            }
        }
        let address = Self {
            text: text.to_owned(),
            scheme,
            host: url.host_str().unwrap_or_default().to_owned(),
            port: url.port(),
            path: url.path().to_owned(),
            keys,
        };
        let needs_host = matches!(
            scheme,
            Scheme::Focas | Scheme::Modbus | Scheme::Can | Scheme::OpcUa | Scheme::LinuxCnc
        );
        if needs_host && address.host.is_empty() {
            return Err(wrong("the host or interface is missing".to_owned(), forms));
        }
        if scheme == Scheme::ModbusRtu && address.path.len() < 2 {
            let remedy = "expected three slashes: modbus-rtu:///dev/ttyUSB0";
            return Err(wrong("the serial device is missing".to_owned(), remedy));
        }
        Ok(address)
    }

    /// An error in what the URL or the configuration states about this device.
    pub fn wrong(&self, found: impl Into<String>, expected: impl Into<String>) -> DeviceError {
        DeviceError::option(&*self.text, found, expected)
    }

    /// The error that the device, or this build, cannot do what is asked.
    pub fn unsupported(
        &self,
        found: impl Into<String>,
        expected: impl Into<String>,
    ) -> DeviceError {
        DeviceError::unsupported(&*self.text, found, expected)
    }

    /// The error that the device does not answer.
    #[cfg(any(feature = "modbus", feature = "can"))]
    pub(crate) fn no_answer(
        &self,
        found: impl Into<String>,
        expected: impl Into<String>,
    ) -> DeviceError {
        DeviceError::no_answer(&*self.text, found, expected)
    }

    /// The error of an exchange that failed.
    #[cfg(any(feature = "can", feature = "gpio"))]
    pub(crate) fn failed(
        &self,
        fault: volcomp_port::Fault,
        expected: impl Into<String>,
    ) -> DeviceError {
        DeviceError::of_fault(&*self.text, fault, expected)
    }

    /// The text of a key after the question mark; `None` where the URL does not have it.
    pub fn get(&self, key: &str) -> Option<&str> {
        self.keys.get(key).map(String::as_str)
    }

    /// A key's number.
    ///
    /// # Errors
    /// No number in its range.
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
            self.wrong(
                what,
                format!("expected a whole number from {low} to {high}"),
            )
        })
    }

    /// A key's list of words, commas between.
    pub fn list(&self, key: &str) -> Vec<String> {
        let words = self.get(key).unwrap_or_default().split(',');
        words
            .filter(|word| !word.is_empty())
            .map(str::to_owned)
            .collect()
    }
}
