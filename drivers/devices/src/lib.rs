#![doc = include_str!("../README.md")]

mod address;
#[cfg(feature = "can")]
mod can;
mod facts;
#[cfg(feature = "focas")]
mod focas;
#[cfg(feature = "gpio")]
mod gpio;
#[cfg(all(feature = "gpio", feature = "modbus"))]
mod lines;
#[cfg(feature = "linuxcnc")]
mod linuxcnc;
mod list;
#[cfg(feature = "modbus")]
mod modbus;
mod probe;
mod probed;
#[cfg(feature = "sinumerik")]
mod sinumerik;

pub use address::{Address, Scheme};
#[cfg(feature = "can")]
pub use can::signal_table;
pub use facts::{BusFacts, ControlFacts, Facts, ModuleFacts, SeenFrames};
#[cfg(feature = "focas")]
pub use focas::focas_config;
#[cfg(feature = "gpio")]
pub use gpio::gpio_port;
#[cfg(all(feature = "gpio", feature = "modbus"))]
pub use lines::digital_lines;
#[cfg(feature = "linuxcnc")]
pub use linuxcnc::{allows_remote_bridge, bridge_key_file};
pub use list::{CanInterface, GpioChip, GpioLine, LocalDevices, SerialPort, list};
#[cfg(feature = "modbus")]
pub use modbus::{MODBUS_PORT, digital_modules, thermometer, thermometer_names};
pub use probe::probe;
pub use probed::{Probe, ProbedTemperature};
