//! The interface to a thermometer: temperatures in °C, each with its quality.

use std::{
    sync::{Arc, Weak},
    time::Instant,
};

/// Reasons why a temperature is bad or uncertain.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum Reason {
    /// There was no reading yet.
    #[error("no reading yet")]
    NotRead,
    /// The device does not answer.
    #[error("the device does not answer")]
    NoAnswer,
    /// The device refuses the request with a Modbus exception.
    #[error("the device refuses: exception {code:02}, {}", exception_name(*code))]
    Refused {
        /// The code of the exception.
        code: u8,
    },
    /// The device repeats the request and sends no answer: only the local echo of an RS-485 adapter was received.
    #[error("only the echo of the request came back, no answer")]
    Echo,
    /// The value is a float that no thermometer sends.
    #[error("no number of a thermometer: another byte_order or word_order?")]
    Implausible,
    /// The device reports a fault, or its value encodes one.
    #[error("the device reports a fault")]
    Reported,
    /// The sensor or its wire is broken, or the value is at the upper clamp of the module.
    #[error("open circuit, or the value above the range")]
    Open,
    /// The sensor is shorted, or the value is at the lower clamp of the module.
    #[error("short circuit, or the value below the range")]
    Short,
    /// The device reports that the value is outside its range.
    #[error("outside the range of the device")]
    OutOfRange,
    /// The value is not a number.
    #[error("not a number")]
    NotANumber,
}

/// The name of a Modbus exception.
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

/// The quality of a temperature as reported by the device. Drivers do not judge whether the temperature is plausible.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum Quality {
    /// The device reports no fault.
    Good,
    /// The temperature is usable, with a reservation.
    Uncertain(Reason),
    /// There is no usable temperature.
    Bad(Reason),
}

/// The last temperature of a sensor, with its quality and time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Temperature {
    /// Temperature, °C; `None` if bad.
    pub degc: Option<f64>,
    /// Whether the temperature is usable, by the device's own report.
    pub quality: Quality,
    /// When the temperature was measured; `None` before the first reading.
    pub taken: Option<Instant>,
}

impl Temperature {
    /// The state of a sensor before its first reading.
    pub const NOT_READ: Self =
        Self { degc: None, quality: Quality::Bad(Reason::NotRead), taken: None };

    /// A good temperature; bad if `degc` is not a number.
    pub fn good(degc: f64, taken: Instant) -> Self {
        if degc.is_finite() {
            Self { degc: Some(degc), quality: Quality::Good, taken: Some(taken) }
        } else {
            Self::bad(Reason::NotANumber, taken)
        }
    }

    /// A reading without a usable temperature.
    pub fn bad(reason: Reason, taken: Instant) -> Self {
        Self { degc: None, quality: Quality::Bad(reason), taken: Some(taken) }
    }
}

/// Named temperatures, updated in the background.
#[cfg_attr(feature = "mock", mockall::automock)]
pub trait Thermometer: Send {
    /// Name of the device in the configuration.
    fn device(&self) -> &str;

    /// The names of the sensors, in the order of the temperatures.
    fn names(&self) -> &[String];

    /// The last temperature of each sensor in the order of the names, regardless of its age. Never blocks or allocates.
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

/// The producing end of a [`Published`] thermometer, held by the driver's thread.
pub struct Publisher {
    into: triple_buffer::Input<Vec<Temperature>>,
    reader: Weak<()>,
}

impl Publisher {
    /// Publishes the temperatures of the sensors, in the order of the names. If there are fewer temperatures than sensors, the other sensors get
    /// older values than those published last.
    pub fn publish(&mut self, temperatures: &[Temperature]) {
        let buffer = self.into.input_buffer_mut();
        for (place, found) in buffer.iter_mut().zip(temperatures) {
            *place = *found;
        }
        self.into.publish();
    }

    /// Whether the thermometer still exists; otherwise the driver's thread ends.
    pub fn has_reader(&self) -> bool {
        self.reader.strong_count() > 0
    }
}

/// A thermometer that returns the temperatures published last.
pub struct Published {
    device: String,
    names: Vec<String>,
    from: triple_buffer::Output<Vec<Temperature>>,
    /// The publisher detects by this reference that the thermometer exists.
    _reader: Arc<()>,
}

/// Creates a thermometer without readings, and its publisher.
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
