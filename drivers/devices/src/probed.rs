//! The values that a device reports when it is asked once.

use std::collections::BTreeMap;

use serde::Serialize;
use volcomp_port::{Quality, Temperature};
use volcomp_vocabulary::{AxisKind, Displacement};

use crate::facts::Facts;

/// The values that a device reports when it is asked once; the parts that a device lacks stay empty, and are left out of a document.
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
    /// Further properties that the kind of device has; `None` for digital lines.
    #[serde(flatten)]
    pub facts: Option<Facts>,
}

/// The temperature of one sensor.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct ProbedTemperature {
    /// The name of the sensor.
    pub name: String,
    /// The temperature, °C; `None` when it is bad.
    pub degc: Option<f64>,
    /// `good`, `uncertain` or `bad`.
    pub quality: &'static str,
    /// The reason in words; `None` when the temperature is good.
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
    /// A report of the device at this URL without any value yet.
    pub(crate) fn of(device: &str) -> Self {
        Self {
            device: device.to_owned(),
            ..Self::default()
        }
    }

    /// Adds a position; of an axis that a device names twice the last one counts.
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
        self.temperatures.push(ProbedTemperature {
            name,
            degc: temperature.degc,
            quality,
            reason,
        });
    }
}
