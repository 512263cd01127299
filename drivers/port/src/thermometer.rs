//! Interface of a thermometer: temperatures in °C, each with its quality.

use std::{
    sync::{Arc, Weak},
    time::Instant,
};

/// Reasons why a temperature is bad or uncertain.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum Reason {
    #[error("no reading yet")]
    NotRead,
    #[error("the device does not answer")]
    NoAnswer,
    /// The device rejects the request with a Modbus exception.
    #[error("the device refuses: exception {code:02}, {}", exception_name(*code))]
    Refused {
        /// Code of the Modbus exception.
        code: u8,
    },
    /// Only the request came back, as the local echo of an RS-485 adapter. The device sent no answer.
    #[error("only the echo of the request came back, no answer")]
    Echo,
    /// The value is a float that no thermometer sends.
    #[error("no number of a thermometer: another byte_order or word_order?")]
    Implausible,
    /// The device reports a fault, or its value encodes a fault.
    #[error("the device reports a fault")]
    Reported,
    /// The sensor or its wire is broken, or the value is at the upper end of the module's range.
    #[error("open circuit, or the value above the range")]
    Open,
    /// The sensor is shorted, or the value is at the lower end of the module's range.
    #[error("short circuit, or the value below the range")]
    Short,
    /// The device reports that the value is outside the device's range.
    #[error("outside the range of the device")]
    OutOfRange,
    #[error("not a number")]
    NotANumber,
}

pub fn exception_name(code: u8) -> &'static str {
    match code {
        1 => "illegal function",
        2 => "illegal data address",
        3 => "illegal data value",
        4 => "server device failure",
        5 => "acknowledge, still at work",
        6 => "server device busy",
        8 => "memory parity error",
        10 => "gateway path unavailable",
        11 => "gateway target device failed to respond",
        _ => "a code without a name in the standard",
    }
}

/// Quality of a temperature as reported by the device. Drivers do not check whether the temperature is plausible.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum Quality {
    /// The device reports no fault.
    Good,
    /// The temperature is usable, but the device reports a reason for doubt.
    Uncertain(Reason),
    /// There is no usable temperature.
    Bad(Reason),
}

/// Last temperature of a sensor, with its quality and time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Temperature {
    /// Temperature, °C; `None` if the quality is bad.
    pub degc: Option<f64>,
    pub quality: Quality,
    /// Time at which the temperature was measured; `None` before the first reading.
    pub taken: Option<Instant>,
}

impl Temperature {
    /// State of a sensor before its first reading.
    pub const NOT_READ: Self =
        Self { degc: None, quality: Quality::Bad(Reason::NotRead), taken: None };

    /// Creates a good temperature. If `degc` is not finite, the temperature is bad.
    pub fn good(degc: f64, taken: Instant) -> Self {
        if degc.is_finite() {
            Self { degc: Some(degc), quality: Quality::Good, taken: Some(taken) }
        } else {
            Self::bad(Reason::NotANumber, taken)
        }
    }

    pub fn bad(reason: Reason, taken: Instant) -> Self {
        Self { degc: None, quality: Quality::Bad(reason), taken: Some(taken) }
    }
}

/// Named temperatures, which are updated in the background.
#[cfg_attr(feature = "mock", mockall::automock)]
pub trait Thermometer: Send {
    fn device(&self) -> &str;

    /// Names of the sensors, in the order of the temperatures.
    fn names(&self) -> &[String];

    /// Last temperature of each sensor, in the order of the names, regardless of its age. Never blocks or allocates.
    fn latest(&mut self) -> &[Temperature];
}

impl<T: Thermometer + ?Sized> Thermometer for Box<T> {
    fn device(&self) -> &str {
        (**self).device()
    }

    fn names(&self) -> &[String] {
        (**self).names()
    }

    fn latest(&mut self) -> &[Temperature] {
        (**self).latest()
    }
}

/// The sending end of a [`Published`] thermometer, owned by the thread of the driver.
pub struct Publisher {
    into: triple_buffer::Input<Vec<Temperature>>,
    reader: Weak<()>,
}

impl Publisher {
    /// Publishes the temperatures of the sensors, in the order of the names. If there are fewer temperatures than
    /// sensors, the remaining sensors get an older value, which need not be their last one.
    pub fn publish(&mut self, temperatures: &[Temperature]) {
        let buffer = self.into.input_buffer_mut();
        for (place, found) in buffer.iter_mut().zip(temperatures) {
            *place = *found;
        }
        self.into.publish();
    }

    /// Whether the thermometer still exists. If not, the thread of the driver ends.
    pub fn has_reader(&self) -> bool {
        self.reader.strong_count() > 0
    }
}

/// A thermometer that returns the last published temperatures.
pub struct Published {
    device: String,
    names: Vec<String>,
    from: triple_buffer::Output<Vec<Temperature>>,
    /// While this reference exists, [`Publisher::has_reader`] is true.
    _reader: Arc<()>,
}

/// Creates a thermometer that has no readings yet, and its publisher.
pub fn published(device: impl Into<String>, names: Vec<String>) -> (Publisher, Published) {
    let empty = vec![Temperature::NOT_READ; names.len()];
    let (into, from) = triple_buffer::triple_buffer(&empty);
    let alive = Arc::new(());
    let publisher = Publisher { into, reader: Arc::downgrade(&alive) };
    let thermometer = Published { device: device.into(), names, from, _reader: alive };
    (publisher, thermometer)
}

impl Thermometer for Published {
    fn device(&self) -> &str {
        &self.device
    }

    fn names(&self) -> &[String] {
        &self.names
    }

    fn latest(&mut self) -> &[Temperature] {
        self.from.read()
    }
}
