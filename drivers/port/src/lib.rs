#![doc = include_str!("../README.md")]

mod clock;
#[cfg(feature = "contract")]
pub mod contract;
mod control_program;
mod controller;
mod device_error;
mod digital;
mod fault;
pub mod inject;
pub mod simulated;
mod supply;
mod thermometer;
mod words;

pub use clock::Clock;
pub use control_program::ControlProgram;
pub use controller::{
    Axis, Controller, ControllerState, Description, Heartbeat, ShownStates, Snapshot, UnfitAxes,
};
pub use device_error::{DeviceError, DeviceProblem};
pub use digital::{DigitalIo, InputLevels, UnopenedLines};
pub use fault::Fault;
pub use supply::{Backoff, Supply};
pub use thermometer::{
    Published, Publisher, Quality, Reason, Temperature, Thermometer, exception_name, published,
};
pub use words::{MOST_WORDS, Words};

/// The vocabulary that the interface of this crate uses: axis letters, values by axis, units.
pub use volcomp_vocabulary as vocabulary;

#[cfg(feature = "mock")]
pub use {controller::MockController, digital::MockDigitalIo, thermometer::MockThermometer};
