#![doc = include_str!("../README.md")]

mod bus;
mod digital;
mod exchange;
pub mod iec60751;
mod profile;
mod thermometer;

pub use bus::{ANSWER_WITHIN, Bus, Parity};
pub use digital::{DigitalModule, ModbusDigital};
pub use profile::{
    ByteOrder, Channels, Digital, Fault, NumberType, Profile, ProfileError, Unit, WordOrder,
    read_channel,
};
pub use thermometer::{ThermometerConfig, ThermometerUnit, poll_temperatures};
