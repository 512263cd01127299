#![doc = include_str!("../README.md")]

mod address;
mod buses;
#[cfg(feature = "can")]
mod can;
mod driver;
mod first_config;
#[cfg(feature = "focas")]
mod focas;
#[cfg(feature = "gpio")]
mod gpio;
mod keys;
#[cfg(any(feature = "gpio", feature = "modbus"))]
mod lines;
#[cfg(feature = "linuxcnc")]
mod linuxcnc;
mod list;
#[cfg(feature = "modbus")]
mod modbus;
mod probe;
#[cfg(feature = "sinumerik")]
mod sinumerik;

pub use address::Address;
pub use buses::{controller, map_device, probe, thermometer};
pub use driver::{
    Block, Configured, ControlMemory, ControllerDevice, Driver, GuardRequirements, Inspected,
    PmcPlan, Rules, Settings, ThermometerDevice, Travels,
};
pub use first_config::{
    FirstConfig, FirstMachine, Setting, controllers, first_controller, first_thermometer,
};
#[cfg(any(feature = "gpio", feature = "modbus"))]
pub use keys::DigitalConfig;
#[cfg(feature = "linuxcnc")]
pub use keys::LinuxCncTable;
#[cfg(feature = "sinumerik")]
pub use keys::SinumerikTable;
#[cfg(feature = "focas")]
pub use keys::{AreaConfig, PmcByte, PmcLetter, Referenced};
pub use list::{CanInterface, GpioChip, GpioLine, LocalDevices, SerialPort, list};
pub use probe::{BusFacts, ControlFacts, Facts, ModuleFacts, Probe, ProbedTemperature, SeenFrames};

/// Tables `[[controller]]` and `[[thermometer]]` of a gateway, and the checks of their keys.
pub mod config {
    pub use crate::{
        buses::{check_keys, uses},
        keys::{
            BarrierConfig, CONTROLLER_ONLY, ControllerConfig, StateKey, ThermometerConfig, both,
            has_axis, join, ms, of_ms, path,
        },
    };
}

/// File of a map sender, and access to the words of a map in a control.
pub mod map {
    pub use crate::{
        driver::{MapDevice, MapError, MapWords},
        keys::{AuditConfig, MapKeys},
    };
}
