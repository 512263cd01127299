//! The interfaces of this computer to which machines can be connected: serial ports, CAN interfaces, GPIO chips and
//! their lines.

use std::{fs, path::Path};

use serde::Serialize;

/// The interfaces of this computer. Listing neither opens an interface for writing nor reserves it.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct LocalDevices {
    /// The serial ports, for `modbus-rtu://`.
    pub serial_ports: Vec<SerialPort>,
    /// The CAN interfaces, for `can://`.
    pub can_interfaces: Vec<CanInterface>,
    /// The GPIO chips, for `gpio://`.
    pub gpio_chips: Vec<GpioChip>,
}

/// A serial port of this computer.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct SerialPort {
    /// The device file, such as `/dev/ttyUSB0`.
    pub device: String,
    /// The maker, product and serial number of a USB adapter; empty for other ports.
    pub description: String,
}

/// A CAN interface of the kernel.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct CanInterface {
    /// The name, such as `can0`.
    pub name: String,
    /// Whether the interface is brought up.
    pub up: bool,
    /// The largest frame in bytes: 16 for classic CAN, 72 for CAN FD; `None` if the kernel does not report it.
    pub mtu: Option<u32>,
}

/// A GPIO chip of this computer.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct GpioChip {
    /// The kernel's name for the chip, such as `gpiochip0`.
    pub name: String,
    /// The label of the chip; URLs may use it instead of the name.
    pub label: String,
    /// The lines in the order of their numbers; empty if this user may not open the chip.
    pub lines: Vec<GpioLine>,
}

/// A line of a GPIO chip.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct GpioLine {
    /// The number of the line on its chip, as in URLs.
    pub number: u32,
    /// The name of the line; empty if it has none.
    pub name: String,
    /// Whether the line is an output now.
    pub output: bool,
    /// The program that uses the line; `None`: the line is free.
    pub used_by: Option<String>,
}

/// Lists the interfaces of this computer. Kinds that this build or the kernel does not support yield empty lists.
pub fn list() -> LocalDevices {
    LocalDevices {
        serial_ports: serial_ports(),
        can_interfaces: can_interfaces(Path::new("/sys/class/net")),
        gpio_chips: gpio_chips(),
    }
}

pub(crate) fn serial_ports() -> Vec<SerialPort> {
    #[cfg(feature = "modbus")]
    {
        let describe = |port: serialport::SerialPortInfo| SerialPort {
            description: match port.port_type {
                serialport::SerialPortType::UsbPort(usb) => {
                    let parts = [usb.manufacturer, usb.product, usb.serial_number];
                    parts.into_iter().flatten().collect::<Vec<_>>().join(" ")
                }
                _ => String::new(),
            },
            device: port.port_name,
        };
        let ports = serialport::available_ports().unwrap_or_default();
        let mut ports: Vec<SerialPort> = ports.into_iter().map(describe).collect();
        ports.sort_by(|a, b| a.device.cmp(&b.device));
        ports
    }
    #[cfg(not(feature = "modbus"))]
    Vec::new()
}

fn can_interfaces(folder: &Path) -> Vec<CanInterface> {
    /// Hardware type of CAN (ARPHRD_CAN).
    const CAN: u32 = 280;
    /// Flag of an interface that is up (IFF_UP).
    const UP: u32 = 1;
    let Ok(entries) = fs::read_dir(folder) else {
        return Vec::new();
    };
    let mut found: Vec<CanInterface> = entries
        .flatten()
        .filter_map(|entry| {
            let number = |file: &str| -> Option<u32> {
                let text = fs::read_to_string(entry.path().join(file)).ok()?;
                let text = text.trim();
                match text.strip_prefix("0x") {
                    Some(hex) => u32::from_str_radix(hex, 16).ok(),
                    None => text.parse().ok(),
                }
            };
            (number("type")? == CAN).then(|| CanInterface {
                name: entry.file_name().to_string_lossy().into_owned(),
                up: number("flags").is_some_and(|flags| flags & UP != 0),
                mtu: number("mtu"),
            })
        })
        .collect();
    found.sort_by(|a, b| a.name.cmp(&b.name));
    found
}

fn gpio_chips() -> Vec<GpioChip> {
    #[cfg(feature = "gpio")]
    {
        let chips = gpiocdev::chip::chips().unwrap_or_default();
        chips.iter().map(|path| gpio_chip(path)).collect()
    }
    #[cfg(not(feature = "gpio"))]
    Vec::new()
}

#[cfg(feature = "gpio")]
fn gpio_chip(path: &Path) -> GpioChip {
    use gpiocdev::{Chip, line::Direction};
    let file = path.file_name().unwrap_or_default();
    let mut found = GpioChip {
        name: file.to_string_lossy().into_owned(),
        label: String::new(),
        lines: Vec::new(),
    };
    let Ok(chip) = Chip::from_path(path) else {
        return found;
    };
    if let Ok(info) = chip.info() {
        found.label = info.label;
    }
    if let Ok(lines) = chip.line_info_iter() {
        found.lines = lines
            .flatten()
            .map(|line| GpioLine {
                number: line.offset,
                name: line.name,
                output: line.direction == Direction::Output,
                used_by: line.used.then_some(line.consumer),
            })
            .collect();
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The folder imitates the kernel's sysfs. It has two CAN interfaces, one of which is up, and other interfaces.
    #[test]
    fn can_interfaces_are_recognised_by_their_hardware() {
        let folder = tempfile::tempdir().expect("writable");
        for (name, kind, flags, mtu) in [
            ("eth0", "1", "0x1003", "1500"),
            ("vcan1", "280", "0x40081", "72"),
            ("can0", "280", "0x40080", "16"),
        ] {
            let dir = folder.path().join(name);
            fs::create_dir(&dir).expect("writable");
            for (file, text) in [("type", kind), ("flags", flags), ("mtu", mtu)] {
                fs::write(dir.join(file), format!("{text}\n")).expect("writable");
            }
        }
        let can = |name: &str, up, mtu| CanInterface { name: name.to_owned(), up, mtu: Some(mtu) };
        let found = can_interfaces(folder.path());
        assert_eq!(found, [can("can0", false, 16), can("vcan1", true, 72)]);
        assert!(can_interfaces(&folder.path().join("none")).is_empty());
    }
}
