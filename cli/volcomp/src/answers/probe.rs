//! The JSON documents of `volcomp probe` and `volcomp probe --list`.

#![expect(clippy::struct_field_names, reason = "the keys are named in full")]

use std::collections::BTreeMap;

use schemars::JsonSchema;
use serde::Serialize;
use serde_json::{Map, Value, json};
use volcomp_devices as devices;
use volcomp_port::Quality;
use volcomp_vocabulary::AxisKind;

/// The document of `volcomp probe`: the values that a device reports. Keys that do not apply to the device are left out.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct Probe {
    /// The URL of the device.
    pub(crate) device: String,
    /// The positions of linear axes by their letter or name, mm.
    #[serde(skip_serializing_if = "Map::is_empty")]
    #[schemars(with = "BTreeMap<String, f64>")]
    pub(crate) positions_mm: Map<String, Value>,
    /// The positions of rotary axes by their letter or name, deg.
    #[serde(skip_serializing_if = "Map::is_empty")]
    #[schemars(with = "BTreeMap<String, f64>")]
    pub(crate) positions_deg: Map<String, Value>,
    /// The temperatures in the order of the device.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub(crate) temperatures: Vec<Temperature>,
    /// The levels of the digital inputs, line 0 first.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub(crate) inputs: Vec<bool>,
    /// Further properties that the kind of device has.
    #[serde(flatten)]
    pub(crate) facts: Option<Facts>,
}

/// The temperature of one sensor.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct Temperature {
    /// The name of the sensor.
    pub(crate) name: String,
    /// The temperature, °C; null when it is bad.
    pub(crate) degc: Option<f64>,
    /// How far the temperature can be trusted: `good`, `uncertain` or `bad`.
    pub(crate) quality: &'static str,
    /// The reason in words; left out when the temperature is good.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) reason: Option<String>,
}

/// Further properties of a device, by its kind.
#[derive(Debug, Serialize, JsonSchema)]
#[serde(untagged)]
pub(crate) enum Facts {
    /// The properties of a control over FOCAS.
    Control(Control),
    /// The properties of a Modbus module.
    Module(Module),
    /// The traffic that was seen on a CAN bus.
    Bus(Bus),
}

/// The properties of a control over FOCAS.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct Control {
    /// The type of the control and of the machine, such as `31 M`.
    pub(crate) control: String,
    /// The series and the version of the control's software.
    pub(crate) series: String,
    /// The version of the protocol in the control's answers: 2, 3 or 4.
    pub(crate) version: u16,
    /// Whether the emergency stop is pressed.
    pub(crate) emergency_stop: bool,
    /// Whether the control shows an alarm.
    pub(crate) alarm: bool,
    /// Whether the extended external machine zero point shift is in use (parameter 1203#0); null where the control does not
    /// tell.
    pub(crate) shift_in_use: Option<bool>,
    /// The first byte in R of the words from which the control takes the shifts of its axes (parameter 1280); null where
    /// the control does not tell.
    pub(crate) shift_words: Option<u32>,
    /// Why the control does not tell these parameters; null where it does.
    pub(crate) shift_untold: Option<String>,
    /// The median of the times from a request to its answer, µs.
    pub(crate) round_trip_p50_us: f64,
    /// The longest of the times from a request to its answer, µs.
    pub(crate) round_trip_max_us: f64,
}

/// The properties of a Modbus module.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct Module {
    /// The name of the profile by which the registers of the module are read.
    pub(crate) profile: String,
    /// The parts of the profile that nobody has compared with a real module yet, separated by `; `; left out when
    /// there are none.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) not_proven: Option<String>,
    /// Whether the module tells the levels of its outputs; left out when it has none. Where it does not, outputs that carry
    /// no correction are switched off when a correction is written.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) outputs_told: Option<bool>,
}

/// The traffic that was seen on a CAN bus.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct Bus {
    /// The identifiers that were seen, in hexadecimal digits, each with the number of its frames: `100 (12), 7E5 (3)`.
    pub(crate) frames: String,
    /// The number of error frames and of frames whose checksum or length is wrong.
    pub(crate) errors: u64,
}

/// The document of `volcomp probe --list`: the interfaces of this computer to which machines can be connected.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct ProbeList {
    /// The serial ports, for `modbus-rtu://`.
    pub(crate) serial_ports: Vec<SerialPort>,
    /// The CAN interfaces, for `can://`.
    pub(crate) can_interfaces: Vec<CanInterface>,
    /// The GPIO chips, for `gpio://`.
    pub(crate) gpio_chips: Vec<GpioChip>,
}

/// A serial port of this computer.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct SerialPort {
    /// The device file, such as `/dev/ttyUSB0`.
    pub(crate) device: String,
    /// The maker, product and serial number of a USB adapter; empty for other ports.
    pub(crate) description: String,
}

/// A CAN interface of the kernel.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct CanInterface {
    /// The name, such as `can0`.
    pub(crate) name: String,
    /// Whether the interface is brought up.
    pub(crate) up: bool,
    /// The largest frame in bytes: 16 for classic CAN, 72 for CAN FD; null where the kernel does not tell.
    pub(crate) mtu: Option<u32>,
}

/// A GPIO chip of this computer.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct GpioChip {
    /// The name of the kernel, such as `gpiochip0`.
    pub(crate) name: String,
    /// The label of the chip's driver, which names the chip in URLs just as well.
    pub(crate) label: String,
    /// The lines in the order of their numbers; empty where this user may not open the chip.
    pub(crate) lines: Vec<GpioLine>,
}

/// A line of a GPIO chip.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct GpioLine {
    /// The number of the line on its chip, as URLs have it.
    pub(crate) number: u32,
    /// The name of the line; empty where it has none.
    pub(crate) name: String,
    /// Whether the line is an output now.
    pub(crate) output: bool,
    /// The program that has taken the line; null: it is free.
    pub(crate) used_by: Option<String>,
}

impl From<&devices::Probe> for Probe {
    fn from(found: &devices::Probe) -> Self {
        // In the order of the device; an axis that a device names twice keeps its last position.
        let positions = |kind: AxisKind| {
            let of_kind = found.positions.iter().filter(|p| p.at.kind() == kind);
            of_kind
                .map(|p| (p.name.clone(), json!(p.at.mm_or_deg())))
                .collect()
        };
        let temperatures = found.temperatures.iter().map(|(name, temperature)| {
            let (quality, reason) = match temperature.quality {
                Quality::Good => ("good", None),
                Quality::Uncertain(reason) => ("uncertain", Some(reason.to_string())),
                Quality::Bad(reason) => ("bad", Some(reason.to_string())),
            };
            Temperature {
                name: name.clone(),
                degc: temperature.degc,
                quality,
                reason,
            }
        });
        Self {
            device: found.device.clone(),
            positions_mm: positions(AxisKind::Linear),
            positions_deg: positions(AxisKind::Rotary),
            temperatures: temperatures.collect(),
            inputs: found.inputs.clone(),
            facts: found.facts.as_ref().map(Facts::from),
        }
    }
}

impl From<&devices::Facts> for Facts {
    fn from(facts: &devices::Facts) -> Self {
        let microseconds = |time: std::time::Duration| (time.as_secs_f64() * 1e6).round();
        match facts {
            devices::Facts::Control(facts) => Self::Control(Control {
                control: facts.control.clone(),
                series: facts.series.clone(),
                version: facts.version,
                emergency_stop: facts.emergency_stop,
                alarm: facts.alarm,
                shift_in_use: facts.shift_source.as_ref().ok().map(|found| found.in_use),
                shift_words: facts.shift_source.as_ref().ok().map(|found| found.first),
                shift_untold: facts.shift_source.as_ref().err().cloned(),
                round_trip_p50_us: microseconds(facts.round_trip_median),
                round_trip_max_us: microseconds(facts.round_trip_longest),
            }),
            devices::Facts::Module(facts) => Self::Module(Module {
                profile: facts.profile.clone(),
                not_proven: (!facts.unproven.is_empty()).then(|| facts.unproven.join("; ")),
                outputs_told: facts.outputs_told,
            }),
            devices::Facts::Bus(facts) => Self::Bus(Bus {
                frames: facts
                    .frames
                    .iter()
                    .map(ToString::to_string)
                    .collect::<Vec<_>>()
                    .join(", "),
                errors: facts.errors,
            }),
        }
    }
}

impl From<devices::LocalDevices> for ProbeList {
    fn from(found: devices::LocalDevices) -> Self {
        let port = |port: devices::SerialPort| SerialPort {
            device: port.device,
            description: port.description,
        };
        let interface = |interface: devices::CanInterface| CanInterface {
            name: interface.name,
            up: interface.up,
            mtu: interface.mtu,
        };
        let line = |line: devices::GpioLine| GpioLine {
            number: line.number,
            name: line.name,
            output: line.output,
            used_by: line.used_by,
        };
        let chip = |chip: devices::GpioChip| GpioChip {
            name: chip.name,
            label: chip.label,
            lines: chip.lines.into_iter().map(line).collect(),
        };
        Self {
            serial_ports: found.serial_ports.into_iter().map(port).collect(),
            can_interfaces: found.can_interfaces.into_iter().map(interface).collect(),
            gpio_chips: found.gpio_chips.into_iter().map(chip).collect(),
        }
    }
}
