//! What a bus has to have: its driver as data, and the traits of what that makes of a configuration.

use std::{
    any::Any,
    collections::{BTreeMap, BTreeSet},
    path::Path,
    time::{Duration, Instant},
};

use serde::{Deserialize, Serialize};
use volcomp_document::Mistakes;
use volcomp_port::{Controller, Description, DeviceError, Thermometer, Words};
use volcomp_vocabulary::{AxisName, Displacement};

use crate::{
    address::{Address, hosts},
    keys::{ControllerConfig, MapKeys, ThermometerConfig},
    probe::Probe,
};

/// The driver of a bus as data: what its URLs and its keys of a configuration mean, and how its devices are made of them.
pub struct Driver {
    /// Its controllers in words, with the schemes of their URLs.
    pub name: &'static str,
    /// The keys of `[[controller]]` that it uses besides those of every controller, also where nothing is written.
    pub keys: &'static [&'static str],
    /// The same, only where axes are written.
    pub writer_keys: &'static [&'static str],
    /// The tables of a map sender's file that it uses; none: its controls take no map.
    pub map_tables: &'static [&'static str],
    /// The port of a URL that names none.
    pub port: u16,
    /// The names of the devices that an address reaches, the same for all its spellings. One that cannot be found now,
    /// such as a host whose name nobody resolves, has the name by which it is called.
    pub devices: fn(&Address) -> BTreeSet<String>,
    /// Whether one program alone can read from an address.
    pub is_exclusive: fn(&Address) -> bool,
    /// Checks the keys of `[[controller]]` that it alone uses.
    pub validate: fn(&ControllerConfig, &Rules<'_>, &mut Mistakes<'_>),
    /// Fills in the tables that it alone uses, and makes their paths relative to the folder of the file.
    pub complete: fn(&mut ControllerConfig, &Path),
    /// The controller of a `[[controller]]`, not opened.
    pub controller: fn(Address, &ControllerConfig) -> Configured,
    /// The thermometer of a `[[thermometer]]`, not opened.
    pub thermometer: fn(Address, &ThermometerConfig) -> Result<ThermometerDevice, DeviceError>,
    /// Checks the tables of a map sender's file, for so many words of a frame and of a report.
    pub validate_map: fn(&MapKeys, [usize; 2], &mut Mistakes<'_>),
    /// The control of a map sender, not connected.
    pub map: fn(&Address, &MapKeys) -> Result<MapDevice, DeviceError>,
    /// Reads a device once. Nothing is written but what opening needs; GPIO outputs are taken as they are.
    pub probe: fn(&Address, Duration) -> Result<Probe, DeviceError>,
}

/// A controller as it is configured, or what is wrong with it.
pub type Configured = Result<Box<dyn ControllerDevice>, DeviceError>;

/// What a driver has that says nothing else: devices at hosts, no keys, no temperatures, no maps.
pub(crate) const USUAL: Driver = Driver {
    name: "",
    keys: &[],
    writer_keys: &[],
    map_tables: &[],
    port: 0,
    devices: |address| hosts(address, 0),
    is_exclusive: |_| false,
    validate: |_, _, _| {},
    complete: |_, _| {},
    controller: |address, _| Err(address.unsupported("this device is no controller", "name one")),
    thermometer: |address, _| {
        Err(address.unsupported(
            "this device has no temperatures",
            "expected modbus://, modbus-rtu://, can:// or opc.tcp://",
        ))
    },
    validate_map: |_, _, _| {},
    map: |address, _| Err(address.unsupported("this device takes no map", "name another")),
    probe: |address, _| Err(address.unsupported("this device cannot be probed", "name another")),
};

/// What the keys of a driver are checked against besides themselves.
#[derive(Clone, Copy, Debug)]
pub struct Rules<'a> {
    /// The table of the controller.
    pub at: &'a str,
    /// The longest hold of a path that carries thermal terms alone.
    pub longest_hold: Duration,
    /// Whether a controller of the configuration has a barrier.
    pub has_barrier: bool,
}

/// The ends of the travel of a machine axis.
pub type Travels<'a> = dyn Fn(AxisName) -> Option<[Displacement; 2]> + 'a;

/// One controller as it is configured, not opened. What a method does without a device fails where the configuration
/// makes no sense, the others where the device cannot be reached or contradicts it.
#[expect(clippy::missing_errors_doc, reason = "the trait says it once")]
pub trait ControllerDevice: Any + Send + Sync {
    /// The description of the controller by its driver, without opening it.
    fn describe(&self) -> Result<Description, DeviceError>;

    /// Opens it. Connections are made in the background; a CAN interface and GPIO lines must be there.
    fn open(&self) -> Result<Box<dyn Controller>, DeviceError>;

    /// What its readings mean to whoever judges them.
    fn settings(&self) -> Settings;

    /// Reads the properties of a control, and compares them with the configuration and the limits of its guard (`None`:
    /// it is only read); `None` where its bus has nothing to compare. Nothing is written.
    fn inspect(&self, _needs: Option<&Needs>) -> Result<Option<Inspected>, DeviceError> {
        Ok(None)
    }

    /// Checks the file of the control that the configuration names, for the limits of its guard (`None`: it is only read).
    fn check_file(&self, _needs: Option<&Needs>) -> Result<(), DeviceError> {
        Ok(())
    }

    /// Checks that every position within the travel of an axis can be shown.
    fn check_travel(&self, _travel: &Travels<'_>) -> Result<(), DeviceError> {
        Ok(())
    }

    /// Two blocks of a control's memory that this controller uses and that share a byte; `None`: there are none.
    fn overlap(&self) -> Option<[Block; 2]> {
        None
    }

    /// A block that this controller uses and one of another controller of the same control that share a byte which one of
    /// them writes; `None`: there are none.
    fn overlap_with(&self, _other: &dyn Any) -> Option<[Block; 2]> {
        None
    }

    /// What follows from the configuration for the memory of the control.
    fn memory(&self) -> ControlMemory {
        ControlMemory::default()
    }
}

/// A bridge tells what is applied in messages of its own, which it sends when it likes: so late at the most a correction
/// shows in them. How old such a message may be is for the guard to judge.
#[cfg(any(feature = "can", feature = "linuxcnc"))]
pub(crate) const REPORTED_WITHIN: Duration = Duration::from_millis(100);

/// What the readings of a controller mean to whoever judges them.
#[derive(Clone, Debug, Default)]
pub struct Settings {
    /// The longest time until a correction shows; `None`: it shows in the next cycle.
    pub shown_within: Option<Duration>,
    /// The smallest steps of positions that come in steps.
    pub position_steps: BTreeMap<AxisName, Displacement>,
    /// Whether its positions are too coarse for the test shift at arming.
    pub is_coarse: bool,
    /// The time without an edge of a latch after which the control takes the correction to zero.
    pub time_out: Option<Duration>,
}

/// What the guard of a controller needs of its control.
#[derive(Clone, Debug, Default)]
pub struct Needs {
    /// The slew of each axis in channel order, mm/min or rad/min.
    pub slew_per_min: Vec<f64>,
    /// The largest correction of linear axes, mm, and of rotary ones, rad.
    pub limit: [f64; 2],
    /// The smallest rate of a barrier, mm/s and rad/s.
    pub rate_per_s: [f64; 2],
    /// After this time the guard ramps out.
    pub zero_after: Duration,
}

/// The properties of a control.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Inspected {
    /// The letters of the control's axes.
    pub axes: Vec<String>,
    /// SINUMERIK: how fast each axis takes a changed correction at the most (MD32760 times MD32000), mm/min or rev/min;
    /// missing for others, and axes for which the control does not tell.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub fastest_per_min: Option<BTreeMap<String, f64>>,
    /// Whether the extended external machine zero point shift is in use (parameter 1203#0); null: the control does not
    /// tell.
    pub shift_in_use: Option<bool>,
    /// The first R address of the words from which the control takes the shifts of its axes (parameter 1280); null: the
    /// control does not tell.
    pub shift_words: Option<u32>,
    /// LinuxCNC: the version of the protocol that the bridge speaks; missing for others.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub protocol: Option<u8>,
    /// LinuxCNC: what the control is doing, in words; missing for others.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub state: Option<String>,
    /// The reports of its barrier.
    #[serde(skip)]
    pub reports: Vec<(Instant, Words)>,
    /// What deserves to be known and forbids nothing, in words.
    #[serde(skip)]
    pub notes: Vec<String>,
}

/// The memory of a control that a controller uses, where its bus has addresses.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct ControlMemory {
    /// FANUC controls: the addresses in the PMC that are written and read.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub pmc: Option<PmcPlan>,
}

/// The addresses in the PMC of a FANUC control, as ladders name them, such as `R100`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct PmcPlan {
    /// The first byte of the words into which shifts are written; null with a barrier, where the ladder writes them.
    pub shift_words: Option<String>,
    /// How many bytes the shift of an axis has; null with a barrier.
    pub shift_bytes: Option<u16>,
    /// Whether a ladder copies the shifts on to the words from which the control takes them.
    pub copied: bool,
    /// The first byte of the frame that goes to the barrier; null without a barrier.
    pub frame: Option<String>,
    /// The first byte of the report of the barrier; null without a barrier.
    pub report: Option<String>,
    /// The byte that every correction moves on, for the ladder to watch; null: none, or a barrier watches.
    pub heartbeat: Option<String>,
    /// The byte whose bits say which axes are referenced; null: not asked, the axes are taken to be referenced.
    pub referenced: Option<String>,
}

/// Bytes of a control's memory that belong together.
#[derive(Clone, Debug)]
pub struct Block {
    /// The key of the configuration that says where they are.
    pub key: &'static str,
    /// What the bytes are for and where they lie, in words.
    pub text: String,
    /// Whether it is one byte.
    pub is_byte: bool,
}

/// Opens a thermometer. Connections are made in the background; a CAN interface must be there.
pub(crate) type OpenThermometer =
    Box<dyn Fn() -> Result<Box<dyn Thermometer>, DeviceError> + Send + Sync>;

/// One thermometer as it is configured, not opened.
pub struct ThermometerDevice {
    pub(crate) address: Address,
    /// The names of its sensors, in the order of the device.
    pub names: Vec<String>,
    pub(crate) open: OpenThermometer,
}

impl ThermometerDevice {
    /// Opens it. Connections are made in the background; a CAN interface must be there.
    ///
    /// # Errors
    /// A device that cannot be opened.
    pub fn open(&self) -> Result<Box<dyn Thermometer>, DeviceError> {
        (self.open)()
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
