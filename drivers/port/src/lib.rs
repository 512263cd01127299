#![doc = include_str!("../README.md")]

mod clock;
#[cfg(feature = "contract")]
pub mod contract;
mod controller;
mod device_error;
mod digital;
pub mod inject;
pub mod simulated;
mod supply;
mod thermometer;

pub use clock::Clock;
pub use controller::{
    Axis, ControlProgram, Controller, ControllerState, Description, Heartbeat, MOST_WORDS,
    ShownStates, Snapshot, UnfitAxes, Words,
};
pub use device_error::{DeviceError, DeviceProblem, Fault};
pub use digital::{DigitalIo, InputLevels, UnopenedLines};
pub use supply::{Backoff, Supply};
pub use thermometer::{
    Published, Publisher, Quality, Reason, Temperature, Thermometer, exception_name, published,
};

/// The vocabulary that the interface of this crate uses: axis letters, values by axis, units.
pub use volcomp_vocabulary as vocabulary;

#[cfg(feature = "mock")]
pub use {controller::MockController, digital::MockDigitalIo, thermometer::MockThermometer};
