//! The values that a device reports when it is asked once.

use std::time::Duration;

use volcomp_port::{DeviceError, Temperature};
use volcomp_vocabulary::Displacement;

use crate::{
    address::{Address, Scheme},
    facts::Facts,
};

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
    pub(crate) fn new(address: &Address) -> Self {
        Self {
            device: address.text.clone(),
            ..Self::default()
        }
    }
}

/// Asks a device what it says now. Nothing is written but what opening needs; GPIO outputs are taken, at 0.
///
/// # Errors
/// A device that is not there or does not answer, a bus that this build does not have.
pub fn probe(address: &Address, at_most: Duration) -> Result<Probe, DeviceError> {
    #[expect(
        unreachable_patterns,
        reason = "with every bus built in there is nothing left"
    )]
    match address.scheme {
        #[cfg(feature = "focas")]
        Scheme::Focas => crate::focas::probe(address, at_most),
        #[cfg(feature = "modbus")]
        Scheme::Modbus | Scheme::ModbusRtu => crate::modbus::probe(address, at_most),
        #[cfg(feature = "can")]
        Scheme::Can => crate::can::probe(address, at_most),
        #[cfg(feature = "gpio")]
        Scheme::Gpio => crate::gpio::probe(address, at_most),
        _ => {
            // Without any bus nothing waits.
            let _ = at_most;
            Err(address.unsupported("this build has no such bus", "build it with its feature"))
        }
    }
}
