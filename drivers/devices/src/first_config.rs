//! First configuration of a device, as `volcomp-gateway init` writes it: each key with a usual value, its unit and its
//! meaning. Every driver defines its own keys next to the code that reads them.

use std::fmt::Display;

use volcomp_document::toml_string;
use volcomp_port::DeviceError;
use volcomp_vocabulary::{AxisKind, AxisName, Displacement};

use crate::address::{Address, SCHEMES, Scheme};

/// One key of a first configuration, with its value.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Setting {
    /// Name of the key in its table. A key of an inner table has the name of that table and a dot in front.
    pub key: &'static str,
    /// Value in TOML syntax.
    pub value: String,
    /// Meaning and unit of the value. They are written as a comment.
    pub meaning: &'static str,
    /// Whether the line is only an example and is commented out.
    pub is_example: bool,
}

impl Setting {
    /// Creates a key with a value in TOML syntax.
    pub fn new(key: &'static str, value: impl Display, meaning: &'static str) -> Self {
        Self { key, value: value.to_string(), meaning, is_example: false }
    }

    pub fn number(key: &'static str, value: f64, meaning: &'static str) -> Self {
        // The debug format keeps the decimal point, which TOML needs in a fraction.
        Self::new(key, format_args!("{value:?}"), meaning)
    }

    pub fn text(key: &'static str, value: &str, meaning: &'static str) -> Self {
        Self::new(key, toml_string(value), meaning)
    }

    pub fn list(
        key: &'static str,
        values: impl IntoIterator<Item = impl Display>,
        meaning: &'static str,
    ) -> Self {
        let values = values.into_iter();
        let values: Vec<String> = values.map(|value| toml_string(&value.to_string())).collect();
        Self::new(key, format_args!("[{}]", values.join(", ")), meaning)
    }

    /// Turns the key into an example, which is commented out.
    #[must_use]
    pub fn example(self) -> Self {
        Self { is_example: true, ..self }
    }
}

/// First configuration of a controller.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct FirstConfig {
    /// Usual cycle period of the bus, ms.
    pub cycle_ms: f64,
    /// Keys of `[[controller]]`.
    pub settings: Vec<Setting>,
    /// Name of the file that must contain a random key of 128 bits, as written in `settings`; `None`: no file is
    /// needed.
    pub key_file: Option<&'static str>,
    /// Whether the device reports a single axis, so that positions of the other axes must be configured.
    pub(crate) shows_one_axis: bool,
}

/// Properties of the machine for which a driver makes its first configuration.
pub struct FirstMachine<'a> {
    /// Axes to be corrected.
    pub axes: &'a [AxisName],
    /// All axes of the machine, with the ends of their travel.
    pub travel: &'a [(AxisName, [Displacement; 2])],
}

impl FirstMachine<'_> {
    #[cfg(any(feature = "gpio", feature = "modbus"))]
    pub(crate) fn travel_of(&self, axis: AxisName) -> Option<[Displacement; 2]> {
        let mut travel = self.travel.iter();
        Some(travel.find(|(name, _)| *name == axis)?.1)
    }
}

#[cfg(any(feature = "focas", feature = "can", feature = "linuxcnc"))]
pub(crate) fn barrier(scan_ms: f64) -> [Setting; 2] {
    [
        Setting::new(
            "barrier.machine",
            1,
            "Number of the machine that is set in the barrier, 0 to 65534",
        ),
        Setting::number(
            "barrier.scan_ms",
            scan_ms,
            "Scan time of the control's program, ms: 0.1 to 100",
        ),
    ]
}

#[cfg(any(
    feature = "focas",
    feature = "can",
    feature = "gpio",
    feature = "modbus",
    feature = "sinumerik"
))]
pub(crate) fn includes_correction(value: bool) -> Setting {
    Setting::new(
        "includes_correction",
        value,
        "Whether reported positions contain the applied correction; the test shift at arming verifies it",
    )
}

#[cfg(any(feature = "gpio", feature = "modbus", feature = "sinumerik"))]
pub(crate) fn unwatched() -> Setting {
    Setting::new(
        "unwatched",
        true,
        "Accept that the control keeps the correction when the gateway stops",
    )
}

#[cfg(any(feature = "gpio", feature = "modbus", feature = "sinumerik"))]
pub(crate) fn unseen() -> Setting {
    Setting::list(
        "unseen",
        ["referenced", "alarm", "emergency_stop"],
        "States that the device does not show and the machine is corrected without",
    )
}

/// Controllers of this build, as pairs: an example of the URL, and the name of the control.
pub fn controllers() -> Vec<(&'static str, &'static str)> {
    let drivers = SCHEMES.into_iter().filter_map(Scheme::driver);
    let mut found: Vec<_> = drivers.map(|own| (own.example, own.name)).collect();
    // A driver with several schemes would be listed several times.
    found.dedup();
    found
}

/// First configuration of a controller for the axes of a machine.
///
/// # Errors
/// An invalid URL, or a bus that is not in this build.
pub fn first_controller(url: &str, machine: &FirstMachine<'_>) -> Result<FirstConfig, DeviceError> {
    let address = Address::parse(url)?;
    let driver = address.driver()?;
    let mut first = (driver.first)(&address, machine);
    let mut settings = vec![
        Setting::text("url", url, "Device URL of the control"),
        Setting::list("axes", machine.axes, "Corrected axes, in the control's order"),
    ];
    let others = machine.travel.iter();
    let others = others.filter(|(name, _)| !machine.axes.contains(name));
    let (fixed, reads): (Vec<_>, Vec<_>) =
        others.partition(|(name, _)| first.shows_one_axis && name.kind() == AxisKind::Linear);
    if !fixed.is_empty() {
        settings.push(fixed_positions(&fixed));
    }
    if !reads.is_empty() {
        settings.push(Setting::list(
            "reads",
            reads.iter().map(|(name, _)| name),
            "Axes that are read and not corrected",
        ));
    }
    settings.append(&mut first.settings);
    first.settings = settings;
    Ok(first)
}

/// Key `fixed`, which sets each axis to zero, or to the end of its travel nearest to zero.
fn fixed_positions(axes: &[&(AxisName, [Displacement; 2])]) -> Setting {
    let positions = axes.iter().map(|(name, travel)| {
        let [low, high] = travel.map(Displacement::mm_or_deg);
        format!("{name} = {:?}", low.max(0.0).min(high))
    });
    Setting::new(
        "fixed",
        format_args!("{{ {} }}", positions.collect::<Vec<_>>().join(", ")),
        "Positions of the axes that the device does not show, mm: set them to where these axes are",
    )
}

/// First configuration of a thermometer with these sensors.
///
/// # Errors
/// An invalid URL, or a bus that is not in this build.
pub fn first_thermometer(url: &str, names: &[String]) -> Result<Vec<Setting>, DeviceError> {
    let driver = Address::parse(url)?.driver()?;
    let mut settings = vec![
        Setting::text("url", url, "Device URL of the thermometer"),
        Setting::list(
            "names",
            names,
            "Names of the sensors, as in the thermal terms of the machine file; on Modbus in channel order",
        ),
    ];
    settings.extend((driver.first_thermometer)(names.len()));
    Ok(settings)
}
