//! A thermometer with faults.

use rand::RngExt;

use super::Faulty;
use crate::{Temperature, Thermometer};

impl<T: Thermometer> Thermometer for Faulty<T> {
    fn device(&self) -> &str {
        self.device.device()
    }

    fn names(&self) -> &[String] {
        self.device.names()
    }

    fn latest(&mut self) -> &[Temperature] {
        self.take_orders();
        if self.is_frozen() && !self.last_temperatures.is_empty() {
            return &self.last_temperatures;
        }
        self.last_temperatures.clear();
        let latest = self.device.latest();
        self.last_temperatures.extend_from_slice(latest);
        if self.happens(self.faults.corrupt) && !self.last_temperatures.is_empty() {
            let sensor = self.random.random_range(0..self.last_temperatures.len());
            let degc = self.last_temperatures[sensor].degc.unwrap_or(20.0);
            self.last_temperatures[sensor].degc = Some(self.broken_number(degc));
        }
        if let Some((sensor, kelvin)) = self.asked.jump
            && let Some(Temperature {
                degc: Some(degc), ..
            }) = self.last_temperatures.get_mut(sensor)
        {
            *degc += kelvin;
        }
        &self.last_temperatures
    }
}
