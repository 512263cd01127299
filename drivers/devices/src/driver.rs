//! Interface of bus drivers: the function table of a driver, and the traits of the devices that a driver creates from a
//! configuration.

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
    first_config::{FirstConfig, FirstMachine, Setting},
    keys::{ControllerConfig, MapKeys, ThermometerConfig},
    probe::Probe,
};

/// Driver of a bus: its URLs and configuration keys, and the functions that create its devices.
pub struct Driver {
    /// Kind of controller and schemes of its URLs, for messages.
    pub name: &'static str,
    /// Keys of `[[controller]]` that the driver uses for corrected and for read-only controllers, in addition to the
    /// common keys.
    pub keys: &'static [&'static str],
    /// Additional keys that the driver uses only if axes are corrected.
    pub writer_keys: &'static [&'static str],
    /// Tables of a map sender's file that the driver uses; empty if the driver's controls accept no map.
    pub map_tables: &'static [&'static str],
    /// Default network port.
    pub port: u16,
    /// Canonical names of the devices at an address, so that two spellings of one address give the same names. A device
    /// that cannot be resolved, such as a host without a DNS entry, keeps the name in the URL.
    pub devices: fn(&Address) -> BTreeSet<String>,
    /// Whether only one program at a time can read from an address.
    pub is_exclusive: fn(&Address) -> bool,
    /// Checks the keys of `[[controller]]` that are specific to the driver.
    pub validate: fn(&ControllerConfig, &Rules<'_>, &mut Mistakes<'_>),
    /// Completes the driver's tables, and makes their paths relative to the folder of the file.
    pub complete: fn(&mut ControllerConfig, &Path),
    /// Creates the controller of a `[[controller]]`, without opening it.
    pub controller: fn(Address, &ControllerConfig) -> Configured,
    /// Creates the thermometer of a `[[thermometer]]`, without opening it.
    pub thermometer: fn(Address, &ThermometerConfig) -> Result<ThermometerDevice, DeviceError>,
    /// Checks the tables of a map sender's file, for these numbers of words in a frame and in a report.
    pub validate_map: fn(&MapKeys, [usize; 2], &mut Mistakes<'_>),
    /// Creates the control of a map sender without connecting to it.
    pub map: fn(&Address, &MapKeys) -> Result<MapDevice, DeviceError>,
    pub example: &'static str,
    /// Usual values of the keys of `[[controller]]`, for a first configuration.
    pub first: fn(&Address, &FirstMachine<'_>) -> FirstConfig,
    /// Usual values of the keys of `[[thermometer]]` for this number of sensors, for a first configuration.
    pub first_thermometer: fn(usize) -> Vec<Setting>,
    /// Reads a device once, within a maximum time. Writes nothing beyond what opening requires. GPIO outputs keep their
    /// levels.
    pub probe: fn(&Address, Duration) -> Result<Probe, DeviceError>,
}

/// A configured controller, or the reason why its configuration is invalid.
pub type Configured = Result<Box<dyn ControllerDevice>, DeviceError>;

/// Default fields of a driver: devices are identified by host, and there are no extra keys, temperatures or maps.
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
    example: "",
    first: |_, _| FirstConfig::default(),
    first_thermometer: |_| Vec::new(),
    probe: |address, _| Err(address.unsupported("this device cannot be probed", "name another")),
};

/// Context in which the keys of a driver are checked.
#[derive(Clone, Copy, Debug)]
pub struct Rules<'a> {
    /// Key of the controller's table, for messages.
    pub at: &'a str,
    /// Maximum hold time of a controller that receives only thermal terms.
    pub longest_hold: Duration,
    /// Whether any controller of the configuration has a barrier.
    pub has_barrier: bool,
}

/// Function that returns the travel of a machine axis, lower end first; `None` if the machine lacks the axis.
pub type Travels<'a> = dyn Fn(AxisName) -> Option<[Displacement; 2]> + 'a;

/// A configured controller that is not opened. Methods that need no device fail if the configuration is invalid. The
/// other methods fail if the device cannot be reached or does not match the configuration.
#[expect(clippy::missing_errors_doc, reason = "the trait says it once")]
pub trait ControllerDevice: Any + Send + Sync {
    /// Describes the controller without opening it.
    fn describe(&self) -> Result<Description, DeviceError>;

    /// Opens the controller. Connections are made in the background, but a CAN interface and GPIO lines must exist.
    fn open(&self) -> Result<Box<dyn Controller>, DeviceError>;

    fn settings(&self) -> Settings;

    /// Reads the properties of a control, and compares them with the configuration and with the guard's requirements
    /// (`None` for a read-only controller). Returns `None` if the bus provides nothing to compare. Writes nothing to
    /// the control.
    fn inspect(
        &self,
        _needs: Option<&GuardRequirements>,
    ) -> Result<Option<Inspected>, DeviceError> {
        Ok(None)
    }

    /// Checks the control's own file against the guard's requirements (`None` for a read-only controller). Does nothing
    /// if the configuration names no such file.
    fn check_file(&self, _needs: Option<&GuardRequirements>) -> Result<(), DeviceError> {
        Ok(())
    }

    /// Checks that the control can report every position within the travel of its axes.
    fn check_travel(&self, _travel: &Travels<'_>) -> Result<(), DeviceError> {
        Ok(())
    }

    /// Two memory blocks of this controller that share a byte in the control; `None` if no blocks overlap.
    fn overlap(&self) -> Option<[Block; 2]> {
        None
    }

    /// Two memory blocks that share a byte: one of this controller, and one of another controller of the same control.
    /// At least one of the blocks is written. `None` if no such blocks overlap.
    fn overlap_with(&self, _other: &dyn Any) -> Option<[Block; 2]> {
        None
    }

    fn memory(&self) -> ControlMemory {
        ControlMemory::default()
    }
}

/// Maximum delay until a correction appears in the messages of a bridge, which sends them at its own interval. The
/// guard checks the age of the messages.
#[cfg(any(feature = "can", feature = "linuxcnc"))]
pub(crate) const REPORTED_WITHIN: Duration = Duration::from_millis(100);

/// Properties of a controller's readings that the guard needs.
#[derive(Clone, Debug, Default)]
pub struct Settings {
    /// Maximum time until a correction appears in readings; `None`: it appears in the next cycle.
    pub shown_within: Option<Duration>,
    /// Resolution of the positions, for the axes whose positions the control reports in steps.
    pub position_steps: BTreeMap<AxisName, Displacement>,
    /// Whether positions are too coarse for the test shift at arming.
    pub is_coarse: bool,
    /// Time without an edge of the latch after which the control ramps the correction to zero; `None`: the control
    /// never does so.
    pub time_out: Option<Duration>,
}

/// Requirements of a controller's guard on its control.
#[derive(Clone, Debug, Default)]
pub struct GuardRequirements {
    /// Slew of each axis in channel order, mm/min or rad/min.
    pub slew_per_min: Vec<f64>,
    /// Largest correction: mm for linear axes, then rad for rotary axes.
    pub limit: [f64; 2],
    /// Minimum rate of a barrier: mm/s for linear axes, then rad/s for rotary axes.
    pub rate_per_s: [f64; 2],
    /// Age of positions after which the guard ramps out.
    pub zero_after: Duration,
}

/// Properties that a control reports.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Inspected {
    /// Letters of the axes of the control.
    pub axes: Vec<String>,
    /// SINUMERIK: maximum rate of a changed correction (MD32760 times MD32000) by axis, mm/min or
    /// rev/min. Missing for other controls, and for axes whose rate the control does not report.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub fastest_per_min: Option<BTreeMap<String, f64>>,
    /// Whether the extended external machine zero point shift is in use (parameter 1203#0); null: not reported.
    pub shift_in_use: Option<bool>,
    /// The first R address of the words from which the control takes the shifts of its axes (parameter 1280); null: not
    /// reported.
    pub shift_words: Option<u32>,
    /// LinuxCNC: the protocol version of the bridge; missing for others.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub protocol: Option<u8>,
    /// LinuxCNC: state of the control as text; missing for others.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub state: Option<String>,
    /// The reports of the control's barrier.
    #[serde(skip)]
    pub reports: Vec<(Instant, Words)>,
    /// Remarks for the user about the properties of the control. They do not prevent a correction.
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

/// The addresses in the PMC of a FANUC control in the notation of ladders, such as `R100`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct PmcPlan {
    /// First byte of the words to which shifts are written; null with a barrier, because the ladder
    /// writes them.
    pub shift_words: Option<String>,
    /// Number of bytes of each axis's shift; null with a barrier.
    pub shift_bytes: Option<u16>,
    /// Whether a ladder copies the shifts to the words from which the control takes them.
    pub copied: bool,
    /// The first byte of the frame to the barrier; null without a barrier.
    pub frame: Option<String>,
    /// The first byte of the report of the barrier; null without a barrier.
    pub report: Option<String>,
    /// The byte that every correction increments, for monitoring by the ladder; null without a heartbeat. It is also
    /// null with a barrier, which does the monitoring.
    pub heartbeat: Option<String>,
    /// The byte with a bit for each referenced axis; null: not read, the axes are assumed to be referenced.
    pub referenced: Option<String>,
}

/// A block in a control's memory.
#[derive(Clone, Debug)]
pub struct Block {
    /// Configuration key that sets the address of the block.
    pub key: &'static str,
    /// Purpose and location of the block, for messages.
    pub text: String,
    /// Whether the block is a single byte.
    pub is_byte: bool,
}

/// Function that opens a thermometer. Connections are made in the background, but a CAN interface must exist.
pub(crate) type OpenThermometer =
    Box<dyn Fn() -> Result<Box<dyn Thermometer>, DeviceError> + Send + Sync>;

/// A configured thermometer that is not opened.
pub struct ThermometerDevice {
    pub(crate) address: Address,
    /// Names of the sensors, in the order of the device.
    pub names: Vec<String>,
    pub(crate) open: OpenThermometer,
}

impl ThermometerDevice {
    /// Opens the thermometer. Connections are made in the background, but a CAN interface must exist.
    ///
    /// # Errors
    /// A device that cannot be opened.
    pub fn open(&self) -> Result<Box<dyn Thermometer>, DeviceError> {
        (self.open)()
    }
}

pub(crate) type OpenMap = Box<dyn Fn() -> Result<Box<dyn MapWords>, MapError>>;

/// A control that accepts a map. It is not connected yet.
pub struct MapDevice {
    /// Interval at which frames must be sent to keep a map active.
    pub period: Duration,
    pub open: OpenMap,
}

/// Access to the words of a map in a control, over an open session. Every call ends within the timeout of the session.
/// A call fails if words cannot be read, are rejected, or may not have arrived.
#[expect(clippy::missing_errors_doc, reason = "the trait says it once")]
pub trait MapWords {
    /// Reads at least the first `count` words of the report.
    fn report(&mut self, count: usize) -> Result<Vec<u16>, MapError>;

    /// Writes the words of the mailbox in one request.
    fn write(&mut self, frame: &[u16]) -> Result<(), MapError>;

    /// Reads the first `count` words of buffer 0 or 1.
    fn buffer(&mut self, buffer: u16, count: usize) -> Result<Vec<u16>, MapError>;

    fn close(self: Box<Self>) {}
}

/// Error of a transfer of map words.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
pub struct MapError(String);

impl MapError {
    #[expect(clippy::needless_pass_by_value, reason = "for map_err")]
    pub(crate) fn of(error: impl ToString) -> Self {
        Self(error.to_string())
    }
}
