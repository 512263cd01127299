use std::time::Instant;

use volcomp_port::{DeviceError, Reason, Temperature, Thermometer};

use crate::{
    frame::{CanPort, UnopenedBus},
    receiver::{Health, ReceivedSignal, Receiver, subscribe},
    signals::SignalTable,
};

/// Names of the temperatures in a table, in the order of [`CanThermometer`].
///
/// # Errors
/// A table without temperatures.
pub fn temperature_names(table: &SignalTable, device: &str) -> Result<Vec<String>, DeviceError> {
    let bus = UnopenedBus(device.to_owned());
    Ok(CanThermometer::new(bus, table, &[])?.names)
}

/// Temperatures in plain frames: signals that end in `_TEMP`, named in lower case without this suffix. The lowest raw
/// number encodes a shorted sensor, the highest a broken one. Reading processes the received frames and does not block.
/// A temperature that is no longer received keeps its value and time. While the interface is down, all temperatures are
/// bad.
pub struct CanThermometer<P> {
    receiver: Receiver<P>,
    names: Vec<String>,
    signals: Vec<ReceivedSignal>,
    latest: Vec<Temperature>,
}

impl<P: CanPort> CanThermometer<P> {
    /// Creates a thermometer for the temperature signals with these names, in this order. If `names` is empty, all
    /// temperatures of the table are used.
    ///
    /// # Errors
    /// A table without temperatures, an unknown name, or a duplicate.
    pub fn new(port: P, table: &SignalTable, names: &[String]) -> Result<Self, DeviceError> {
        let refused =
            |what: String| DeviceError::option(port.device(), what, "correct the DBC file");
        let (selected, mut found) = (names, Vec::new());
        for (message, of_message) in table.messages.iter().enumerate() {
            for (index, signal) in of_message.signals.iter().enumerate() {
                if let Some(name) = signal.name.strip_suffix("_TEMP") {
                    found.push((name.to_lowercase(), (message, index)));
                }
            }
        }
        if found.is_empty() {
            return Err(refused("there is no signal that ends in _TEMP".to_owned()));
        }
        let known: Vec<String> = found.iter().map(|(name, _)| name.clone()).collect();
        let selected = if selected.is_empty() { &known } else { selected };
        let (mut messages, mut names, mut signals) = (Vec::new(), Vec::new(), Vec::new());
        for name in selected {
            let Some((_, at)) = found.iter().find(|(known, _)| known == name) else {
                let known = known.join(", ");
                return Err(refused(format!(
                    "found no temperature {name}, expected one of {known}"
                )));
            };
            if names.contains(name) {
                return Err(refused(format!("the sensor {name} is listed twice")));
            }
            names.push(name.clone());
            signals.push(subscribe(table, &mut messages, *at).map_err(&refused)?);
        }
        Ok(Self {
            latest: vec![Temperature::NOT_READ; names.len()],
            receiver: Receiver::new(port, messages),
            names,
            signals,
        })
    }

    pub fn health(&self) -> Health {
        self.receiver.health
    }
}

impl<P: CanPort> Thermometer for CanThermometer<P> {
    fn device(&self) -> &str {
        self.receiver.port.device()
    }

    fn names(&self) -> &[String] {
        &self.names
    }

    fn latest(&mut self) -> &[Temperature] {
        let listened = self.receiver.listen(Instant::now(), false, |_, _| ());
        for (latest, signal) in self.latest.iter_mut().zip(&self.signals) {
            let message = self.receiver.message(signal);
            let Some(taken) = message.taken else { continue };
            let raw = signal.signal.raw(message.data());
            let [lowest, highest] = signal.signal.raw_ends();
            *latest = if listened.is_err() {
                Temperature::bad(Reason::NoAnswer, taken)
            } else if raw == lowest {
                Temperature::bad(Reason::Short, taken)
            } else if raw == highest {
                Temperature::bad(Reason::Open, taken)
            } else {
                Temperature::good(signal.signal.value(message.data()) * signal.to_internal, taken)
            };
        }
        &self.latest
    }
}
