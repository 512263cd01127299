//! Device URLs, taken apart.

use std::collections::BTreeMap;

use url::Url;
use volcomp_port::DeviceError;

use crate::driver::{Driver, SCHEMES, Scheme};

/// The URL of a device, taken apart into scheme, host, port, path and keys.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Address {
    /// As it was written.
    pub text: String,
    /// The scheme before `://`, which names the bus.
    pub scheme: &'static str,
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
            scheme: scheme.name,
            host: url.host_str().unwrap_or_default().to_owned(),
            port: url.port(),
            path: url.path().to_owned(),
            keys,
        };
        // Such as `://HOST` or `://INTERFACE`.
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

    /// The driver of its bus.
    ///
    /// # Errors
    /// A bus that this build does not have.
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
