//! The file of a map sender, key by key, and the words of a map in a control.
#![expect(missing_docs, reason = "the manual describes the keys")]

use std::{
    path::{Path, PathBuf},
    time::Duration,
};

use serde::{Deserialize, Serialize};
use volcomp_document::Mistakes;

#[cfg(feature = "focas")]
use crate::focas::PmcTable;
#[cfg(feature = "sinumerik")]
use crate::sinumerik::SinumerikTable;
use crate::{address::Address, config::join, driver::SCHEMES};

/// The keys of the file of a map sender; the tables of a bus come with its feature.
#[derive(Clone, Debug, Default, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct MapKeys {
    pub map: PathBuf,
    pub url: String,
    pub number: u16,
    pub capacity: usize,
    pub scan_ms: f64,
    pub limit_um: f64,
    pub slew_um_per_s: f64,
    pub zero_after_ms: f64,
    #[cfg(feature = "sinumerik")]
    pub sinumerik: SinumerikTable,
    #[cfg(feature = "sinumerik")]
    pub nodes: volcomp_sinumerik::MapNodes,
    #[cfg(feature = "focas")]
    pub pmc: PmcTable,
    pub audit: AuditConfig,
}

/// The table `[audit]`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct AuditConfig {
    pub dir: PathBuf,
}

impl Default for AuditConfig {
    fn default() -> Self {
        Self {
            dir: PathBuf::from("audit"),
        }
    }
}

impl MapKeys {
    /// Makes every path relative to the folder of the file.
    pub fn join(&mut self, folder: &Path) {
        #[cfg(feature = "sinumerik")]
        self.sinumerik.join(folder);
        join(folder, [&mut self.map, &mut self.audit.dir]);
    }

    /// Checks the URL of the control and the tables of its bus, for so many words of a frame and of a report.
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
                    found.add(
                        key,
                        format!("found this table, expected it only for {only}://"),
                    );
                }
            }
        }
    }
}

/// Connects to a control that takes a map.
pub(crate) type OpenMap = Box<dyn Fn() -> Result<Box<dyn MapWords>, MapError>>;

/// A control that takes a map, not connected.
pub struct MapDevice {
    /// How long to wait between two frames that keep a map.
    pub period: Duration,
    /// Connects.
    pub open: OpenMap,
}

/// The words of a map in a control, over an open session. Every exchange ends within its time, and fails where words cannot
/// be read, were refused, or nobody knows whether they arrived.
#[expect(clippy::missing_errors_doc, reason = "the trait says it once")]
pub trait MapWords {
    /// Reads the first `count` words of the report, or more.
    fn report(&mut self, count: usize) -> Result<Vec<u16>, MapError>;

    /// Writes the words of the mailbox in one piece.
    fn write(&mut self, frame: &[u16]) -> Result<(), MapError>;

    /// Reads the first `count` words of a buffer, 0 or 1.
    fn buffer(&mut self, buffer: u16, count: usize) -> Result<Vec<u16>, MapError>;

    /// Ends the session in good order.
    fn close(self: Box<Self>) {}
}

/// Why words of a map do not get through, as the driver says it.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
pub struct MapError(String);

impl MapError {
    #[expect(clippy::needless_pass_by_value, reason = "for map_err")]
    pub(crate) fn of(error: impl ToString) -> Self {
        Self(error.to_string())
    }
}
