//! The values that a device reports when it is asked once.

use volcomp_port::Temperature;
use volcomp_vocabulary::Displacement;

use crate::facts::Facts;

/// A position as a device tells it.
#[derive(Clone, Debug, PartialEq)]
pub struct ProbedPosition {
    /// The letter of the axis, or the name under which the device tells the position.
    pub name: String,
    /// Where the axis stands.
    pub at: Displacement,
}

/// The values that a device reports when it is asked once; the parts that a device lacks stay empty.
#[derive(Clone, Debug, Default)]
pub struct Probe {
    /// The URL of the device.
    pub device: String,
    /// The positions of the axes.
    pub positions: Vec<ProbedPosition>,
    /// The temperatures in °C, each with the name of its sensor.
    pub temperatures: Vec<(String, Temperature)>,
    /// Levels of digital inputs.
    pub inputs: Vec<bool>,
    /// Further properties that the kind of device has; `None` for digital lines.
    pub facts: Option<Facts>,
}

impl Probe {
    /// A report of the device at this URL without any value yet.
    #[cfg(any(
        feature = "focas",
        feature = "modbus",
        feature = "can",
        feature = "gpio",
        feature = "linuxcnc",
        feature = "sinumerik"
    ))]
    pub(crate) fn of(device: &str) -> Self {
        Self {
            device: device.to_owned(),
            ..Self::default()
        }
    }
}
