//! Digital lines of any kind, told without opening them.

use volcomp_port::{DeviceError, UnopenedLines};

use crate::address::{Address, Scheme};

/// The digital lines of a `gpio://`, `modbus://` or `modbus-rtu://` URL, without opening the device: what is built on
/// them can be checked.
///
/// # Errors
/// Keys that make no sense, a device without digital lines.
pub fn digital_lines(address: &Address) -> Result<UnopenedLines, DeviceError> {
    match address.scheme {
        Scheme::Gpio => crate::gpio::unopened(address),
        Scheme::Modbus | Scheme::ModbusRtu => crate::modbus::unopened(address),
        Scheme::Focas | Scheme::Can | Scheme::OpcUa | Scheme::LinuxCnc => Err(address.wrong(
            "this device has no digital lines",
            "expected gpio://, modbus:// or modbus-rtu://",
        )),
    }
}
