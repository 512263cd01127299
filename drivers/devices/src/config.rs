//! The tables `[[controller]]` and `[[thermometer]]` of a gateway, key by key: the field names are the keys, and the keys
//! of a bus come with its feature.
#![expect(missing_docs, reason = "the manual describes the keys")]

use std::{
    collections::{BTreeMap, BTreeSet},
    path::{Path, PathBuf},
    time::Duration,
};

use serde::{Deserialize, Serialize};
use volcomp_document::Mistakes;
use volcomp_port::{DeviceError, ShownStates};
use volcomp_vocabulary::{AxisKind, AxisName, Displacement};

#[cfg(feature = "focas")]
use crate::focas::{AreaConfig, PmcByte, Referenced};
#[cfg(any(feature = "gpio", feature = "modbus"))]
use crate::lines::DigitalConfig;
#[cfg(feature = "linuxcnc")]
use crate::linuxcnc::LinuxCncTable;
#[cfg(feature = "sinumerik")]
use crate::sinumerik::SinumerikTable;
use crate::{
    address::Address,
    driver::{Driver, SCHEMES, Scheme},
};

/// One table `[[controller]]`: a path to the machine.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ControllerConfig {
    pub url: String,
    /// The name of the channel by which its corrections reach the axes; `None`: the driver's own.
    pub channel: Option<String>,
    pub axes: Vec<AxisName>,
    pub reads: Vec<AxisName>,
    pub fixed: BTreeMap<AxisName, f64>,
    pub not_driven: Vec<AxisName>,
    pub includes_correction: bool,
    /// The terms that it carries; `["thermal"]`, `None`: all.
    pub terms: Option<Vec<String>>,
    /// Older positions are held on this path; `None`: `hold_ms` of `[guard]`.
    pub hold_ms: Option<f64>,
    /// Whether the test shift at arming is made; `None`: where positions are fine enough.
    pub test_shift: Option<bool>,
    pub unwatched: bool,
    pub unseen: Vec<StateKey>,
    /// The smallest step of a correction of a linear axis; `None`: the driver's own.
    pub resolution_um: Option<f64>,
    /// The smallest step of a correction of a rotary axis; `None`: the driver's own.
    pub resolution_urad: Option<f64>,
    /// The words of the shifts in the PMC; `None`: the driver's own place.
    #[cfg(feature = "focas")]
    pub area: Option<AreaConfig>,
    #[cfg(feature = "focas")]
    pub heartbeat: Option<PmcByte>,
    /// The byte whose bits say which axes are referenced; `None`: the driver's own.
    #[cfg(feature = "focas")]
    pub referenced: Option<Referenced>,
    /// The barrier in the control that receives frames; `None`: corrections are written as plain values.
    pub barrier: Option<BarrierConfig>,
    /// The words on digital lines; `None`: another device.
    #[cfg(any(feature = "gpio", feature = "modbus"))]
    pub digital: Option<DigitalConfig>,
    /// How the server is reached, and its nodes; `None`: another device.
    #[cfg(feature = "sinumerik")]
    pub sinumerik: Option<SinumerikTable>,
    #[cfg(feature = "linuxcnc")]
    pub linuxcnc: Option<LinuxCncTable>,
}

/// One table `[[thermometer]]`: a device with temperatures.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ThermometerConfig {
    pub url: String,
    pub names: Vec<String>,
    #[cfg(feature = "sinumerik")]
    pub nodes: Vec<String>,
    /// How the server is reached; `None`: another device.
    #[cfg(feature = "sinumerik")]
    pub sinumerik: Option<SinumerikTable>,
}

/// A state of the control, by its key.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum StateKey {
    Referenced,
    Alarm,
    EmergencyStop,
}

/// The table `[controller.barrier]`: the barrier in the control, as its program is set.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct BarrierConfig {
    pub machine: u16,
    pub scan_ms: f64,
    #[cfg(feature = "focas")]
    pub frame: Option<PmcByte>,
    #[cfg(feature = "focas")]
    pub report: Option<PmcByte>,
}

/// The keys that every controller uses.
const KEYS: [&str; 4] = ["url", "axes", "reads", "unseen"];

/// The keys that every controller uses whose axes are written.
const WRITER_KEYS: [&str; 6] = [
    "channel",
    "fixed",
    "not_driven",
    "terms",
    "hold_ms",
    "test_shift",
];

/// The keys of controllers to which plain values are written in steps.
pub(crate) const PLAIN_KEYS: &[&str] = &[
    "includes_correction",
    "unwatched",
    "resolution_um",
    "resolution_urad",
];

/// The keys of a table in `[[controller]]` that mean nothing in the same table of `[[thermometer]]` and of a map sender.
pub const CONTROLLER_ONLY: [&str; 3] = ["numbers", "sign", "nodes"];

/// Whether a controller of this driver uses a key.
pub fn uses(driver: &Driver, is_reader: bool, key: &str) -> bool {
    let is_writer_key = WRITER_KEYS.contains(&key) || driver.writer_keys.contains(&key);
    KEYS.contains(&key) || driver.keys.contains(&key) || (!is_reader && is_writer_key)
}

/// Checks the URL of a controller, and refuses keys that its driver does not use: whoever wrote one relies on it. `at` is
/// its table. `None`: the URL is wrong.
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

/// The address of a device and its driver; a URL that is none is a mistake.
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

/// Refuses a key whose unit none of the axes has.
pub fn has_axis(key: &str, kind: AxisKind, axes: &[AxisName], found: &mut Mistakes<'_>) {
    // Without axes there is another mistake.
    if !axes.is_empty() && !axes.iter().any(|name| name.kind() == kind) {
        let names: Vec<String> = axes.iter().map(ToString::to_string).collect();
        found.add(
            key,
            format!(
                "found this key for the axes {}, expected it only where an axis is {kind}",
                names.join(" ")
            ),
        );
    }
}

/// Refuses one of two keys without the other.
pub fn both(found: &mut Mistakes<'_>, at: &str, keys: [&str; 2], stated: [bool; 2], why: &str) {
    let [one, other] = keys;
    if let [true, false] | [false, true] = stated {
        let key = if stated[0] { one } else { other };
        found.add(
            &format!("{at}.{key}"),
            format!("found one of {one} and {other}, expected both or neither{why}"),
        );
    }
}

/// Refuses a path that is empty.
pub fn path(key: &str, path: &Path, found: &mut Mistakes<'_>) {
    if path.as_os_str().is_empty() {
        found.add(key, "found an empty text, expected a path");
    }
}

/// Makes paths relative to a folder.
pub fn join<'a>(folder: &Path, paths: impl IntoIterator<Item = &'a mut PathBuf>) {
    for path in paths {
        *path = folder.join(&*path);
    }
}

/// Milliseconds to the nanosecond, as they are written by hand.
pub fn ms(time: Duration) -> f64 {
    (time.as_secs_f64() * 1e9).round() / 1e6
}

/// A time that was checked to be positive.
pub fn of_ms(ms: f64) -> Duration {
    Duration::try_from_secs_f64(ms * 1e-3).unwrap_or_default()
}

impl BarrierConfig {
    /// The time from one scan of the control's program to the next.
    pub fn scan(&self) -> Duration {
        of_ms(self.scan_ms)
    }
}

impl ThermometerConfig {
    /// Reports what is wrong in it. `at` is its table.
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

    /// Makes every path relative to the folder of the file.
    pub fn join(&mut self, folder: &Path) {
        #[cfg(feature = "sinumerik")]
        if let Some(table) = &mut self.sinumerik {
            table.join(folder);
        }
        #[cfg(not(feature = "sinumerik"))]
        let _ = folder;
    }
}

impl ControllerConfig {
    /// Its driver; `None`: its URL is none, or this build does not have its bus.
    pub fn driver(&self) -> Option<&'static Driver> {
        Address::parse(&self.url).ok()?.driver().ok()
    }

    /// The states that are accepted as missing.
    pub fn unseen(&self) -> ShownStates {
        let has = |state| self.unseen.contains(&state);
        ShownStates {
            referenced: has(StateKey::Referenced),
            alarm: has(StateKey::Alarm),
            emergency_stop: has(StateKey::EmergencyStop),
        }
    }

    /// The smallest step of a correction that the configuration states for this kind of axis.
    pub fn resolution(&self, kind: AxisKind) -> Option<Displacement> {
        let micro = match kind {
            AxisKind::Linear => self.resolution_um,
            AxisKind::Rotary => self.resolution_urad,
        };
        micro.map(|micro| Displacement::from_micro(kind, micro))
    }

    /// The axes whose positions it shows.
    pub(crate) fn shown(&self) -> impl Iterator<Item = AxisName> {
        self.axes.iter().chain(&self.reads).copied()
    }

    /// Refuses another channel than the only one of a control.
    pub(crate) fn only_channel(
        &self,
        address: &Address,
        only: &str,
        control: &str,
    ) -> Result<(), DeviceError> {
        match &self.channel {
            Some(channel) if channel != only => Err(address.wrong(
                format!("channel: found {channel:?}"),
                format!("expected {only:?}, the only channel of {control}"),
            )),
            _ => Ok(()),
        }
    }

    /// The name of the channel, that of the driver where the configuration states none.
    pub(crate) fn channel_or(&self, default: &str) -> String {
        self.channel.as_deref().unwrap_or(default).to_owned()
    }
}
