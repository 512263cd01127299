use std::collections::BTreeMap;

use serde::Serialize;
use volcomp_port::{Quality, Temperature};
use volcomp_vocabulary::{AxisKind, Displacement};

/// Values and properties read once from a device. Parts that a device lacks are empty, and omitted from a document.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Probe {
    /// The URL of the device.
    pub device: String,
    /// The positions of linear axes by their letter or name, mm.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    pub positions_mm: BTreeMap<String, f64>,
    /// The positions of rotary axes by their letter or name, deg.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    pub positions_deg: BTreeMap<String, f64>,
    /// The temperatures in the order of the device.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub temperatures: Vec<ProbedTemperature>,
    /// The levels of the digital inputs, line 0 first.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub inputs: Vec<bool>,
    /// Further properties, by kind of device; `None` for digital lines.
    #[serde(flatten)]
    pub facts: Option<Facts>,
}

/// The temperature of one sensor.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct ProbedTemperature {
    /// The name of the sensor.
    pub name: String,
    /// The temperature, °C; `None` if bad.
    pub degc: Option<f64>,
    /// `good`, `uncertain` or `bad`.
    pub quality: &'static str,
    /// Reason for the quality; `None` if the temperature is good.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub reason: Option<String>,
}

#[cfg(any(
    feature = "focas",
    feature = "modbus",
    feature = "can",
    feature = "gpio",
    feature = "linuxcnc",
    feature = "sinumerik"
))]
impl Probe {
    pub(crate) fn of(device: &str) -> Self {
        Self { device: device.to_owned(), ..Self::default() }
    }

    /// Adds a position, mm or rad. If a device has two axes of one name, the last position is kept.
    pub(crate) fn add_position(&mut self, name: String, at: Displacement) {
        let positions = match at.kind() {
            AxisKind::Linear => &mut self.positions_mm,
            AxisKind::Rotary => &mut self.positions_deg,
        };
        positions.insert(name, at.mm_or_deg());
    }

    pub(crate) fn add_temperature(&mut self, name: String, temperature: Temperature) {
        let (quality, reason) = match temperature.quality {
            Quality::Good => ("good", None),
            Quality::Uncertain(reason) => ("uncertain", Some(reason.to_string())),
            Quality::Bad(reason) => ("bad", Some(reason.to_string())),
        };
        self.temperatures.push(ProbedTemperature { name, degc: temperature.degc, quality, reason });
    }
}

/// Further properties read once from a device.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(untagged)]
pub enum Facts {
    /// The properties of a control over FOCAS.
    Control(ControlFacts),
    /// The properties of a Modbus module.
    Module(ModuleFacts),
    /// The traffic seen on a CAN bus.
    Bus(BusFacts),
}

/// The properties of a control over FOCAS.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct ControlFacts {
    /// The type of the control and of the machine, such as `31 M`.
    pub control: String,
    /// The series and the version of the control's software, such as `D4G3 28.0`.
    pub series: String,
    /// The version of the protocol in the control's answers: 2, 3 or 4.
    pub version: u16,
    /// Whether the emergency stop is pressed.
    pub emergency_stop: bool,
    /// Whether the control reports an alarm.
    pub alarm: bool,
    /// Whether the extended external machine zero point shift is in use (parameter 1203#0); `None` if the control does
    /// not report it.
    pub shift_in_use: Option<bool>,
    /// The first byte in R of the words of this shift, two bytes for each axis of the control (parameter 1280); `None`
    /// if the control does not report it.
    pub shift_words: Option<u32>,
    /// Why the control does not report these parameters; `None` if it does.
    pub shift_untold: Option<String>,
    /// Median round-trip time of a request, µs.
    pub round_trip_p50_us: f64,
    /// Maximum round-trip time of a request, µs.
    pub round_trip_max_us: f64,
}

/// The properties of a Modbus module.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct ModuleFacts {
    /// The name of the profile by which the registers of the module are read.
    pub profile: String,
    /// Parts of the profile that were never checked on a real module.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub unproven: Vec<String>,
    /// Whether the module can report the levels of its outputs; `None`: it has no outputs. If it cannot, unused outputs
    /// are switched off when a correction is written.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub outputs_told: Option<bool>,
}

/// The traffic seen on a CAN bus.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct BusFacts {
    /// The identifiers seen, classic ones first, each group in ascending order.
    pub frames: Vec<SeenFrames>,
    /// Number of error frames, and of frames with a wrong checksum or length.
    pub errors: u64,
}

/// The frames with one identifier seen on a CAN bus.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct SeenFrames {
    /// The identifier of the frames.
    pub id: u32,
    /// Whether the identifier has 29 bits (extended) instead of 11.
    pub extended: bool,
    /// Number of these frames.
    pub count: u64,
}

impl core::fmt::Display for SeenFrames {
    /// Writes the identifier in hexadecimal (3 digits, or 8 if extended) and the number of frames in parentheses.
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        let digits = if self.extended { 8 } else { 3 };
        write!(f, "{:0digits$X} ({})", self.id, self.count)
    }
}
