#![doc = include_str!("../README.md")]

mod bus;
mod digital;
pub mod iec60751;
mod profile;
mod quality;
mod registers;
mod thermometer;

pub use bus::{Bus, Parity};
pub use digital::{DigitalModule, ModbusDigital};
pub use profile::{Channels, Digital, Fault, NumberType, Profile, ProfileError, Unit, WordOrder};
pub use quality::{Judge, Limits};
pub use registers::{Raw, read_channel};
pub use thermometer::{ModbusThermometer, ThermometerConfig, ThermometerUnit};
