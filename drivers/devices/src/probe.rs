//! Asks the device of a URL, whatever its bus.

use std::time::Duration;

use volcomp_port::DeviceError;

#[cfg(any(
    feature = "focas",
    feature = "modbus",
    feature = "can",
    feature = "gpio",
    feature = "linuxcnc",
    feature = "sinumerik"
))]
use crate::address::Scheme;
use crate::{address::Address, probed::Probe};

/// Asks a device what it says now. Nothing is written but what opening needs; GPIO outputs are taken as they are.
///
/// # Errors
/// A device that is not there or does not answer, a bus that this build does not have.
pub fn probe(address: &Address, at_most: Duration) -> Result<Probe, DeviceError> {
    match address.scheme {
        #[cfg(feature = "focas")]
        Scheme::Focas => crate::focas::probe(address, at_most),
        #[cfg(feature = "modbus")]
        Scheme::Modbus | Scheme::ModbusRtu => crate::modbus::probe(address, at_most),
        #[cfg(feature = "can")]
        Scheme::Can => crate::can::probe(address, at_most),
        #[cfg(feature = "gpio")]
        Scheme::Gpio => crate::gpio::probe(address, at_most),
        #[cfg(feature = "sinumerik")]
        Scheme::OpcUa => crate::sinumerik::probe(address, at_most),
        #[cfg(feature = "linuxcnc")]
        Scheme::LinuxCnc => crate::linuxcnc::probe(address, at_most),
        #[cfg(not(all(
            feature = "focas",
            feature = "modbus",
            feature = "can",
            feature = "gpio",
            feature = "linuxcnc",
            feature = "sinumerik"
        )))]
        _ => {
            // Without any bus nothing waits.
            let _ = at_most;
            let feature = address.scheme.feature();
            Err(address.unsupported(
                format!("this program was built without the feature `{feature}`"),
                format!("a program built with `--features {feature}`"),
            ))
        }
    }
}
