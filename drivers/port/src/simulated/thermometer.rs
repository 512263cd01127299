use std::time::Duration;

use crate::{Clock, Temperature, Thermometer};

/// A sensor that warms up by T = start + rise·(1 − exp(−t/τ)).
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Warming {
    pub name: String,
    /// Temperature at the start, °C.
    pub start_degc: f64,
    /// Final rise above `start_degc`, K.
    pub rise_k: f64,
    /// Time constant τ of the warming, s.
    pub time_constant_s: f64,
}

impl Warming {
    pub(super) fn at(&self, elapsed: Duration) -> f64 {
        let passed = elapsed.as_secs_f64() / self.time_constant_s;
        self.start_degc - self.rise_k * (-passed).exp_m1()
    }
}

/// The thermometer of a simulated machine. Its sensors warm up by the formula of [`Warming`].
pub struct SimulatedThermometer {
    device: String,
    names: Vec<String>,
    sensors: Vec<Warming>,
    clock: Clock,
    latest: Vec<Temperature>,
}

impl SimulatedThermometer {
    pub(super) fn new(sensors: &[Warming], clock: Clock) -> Self {
        Self {
            device: "simulated".to_owned(),
            names: sensors.iter().map(|s| s.name.clone()).collect(),
            latest: vec![Temperature::NOT_READ; sensors.len()],
            sensors: sensors.to_vec(),
            clock,
        }
    }
}

impl Thermometer for SimulatedThermometer {
    fn device(&self) -> &str {
        &self.device
    }

    fn names(&self) -> &[String] {
        &self.names
    }

    fn latest(&mut self) -> &[Temperature] {
        let (elapsed, now) = (self.clock.elapsed(), self.clock.now());
        for (latest, sensor) in self.latest.iter_mut().zip(&self.sensors) {
            *latest = Temperature::good(sensor.at(elapsed), now);
        }
        &self.latest
    }
}
