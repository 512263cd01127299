#![doc = include_str!("../README.md")]

mod address;
#[cfg(feature = "can")]
mod can;
pub mod config;
mod driver;
mod facts;
#[cfg(feature = "focas")]
mod focas;
#[cfg(feature = "gpio")]
mod gpio;
#[cfg(any(feature = "gpio", feature = "modbus"))]
mod lines;
#[cfg(feature = "linuxcnc")]
mod linuxcnc;
mod list;
pub mod map;
#[cfg(feature = "modbus")]
mod modbus;
mod places;
mod probed;
#[cfg(feature = "sinumerik")]
mod sinumerik;

pub use address::Address;
pub use driver::{
    Block, Configured, ControlMemory, ControllerDevice, Driver, Inspected, Needs, PmcPlan, Rules,
    Settings, ThermometerDevice, Travels, controller, map_device, probe, thermometer,
};
pub use facts::{BusFacts, ControlFacts, Facts, ModuleFacts, SeenFrames};
#[cfg(feature = "focas")]
pub use focas::{AreaConfig, PmcByte, PmcLetter, Referenced};
#[cfg(any(feature = "gpio", feature = "modbus"))]
pub use lines::DigitalConfig;
#[cfg(feature = "linuxcnc")]
pub use linuxcnc::LinuxCncTable;
pub use list::{CanInterface, GpioChip, GpioLine, LocalDevices, SerialPort, list};
pub use probed::{Probe, ProbedTemperature};
#[cfg(feature = "sinumerik")]
pub use sinumerik::SinumerikTable;
