//! The temperatures of a cycle: read, judged, and handed to the model's terms. State: what each sensor said last.

use std::time::Duration;

use volcomp_guard::{Rejected, SensorCheck, SensorLimits};
use volcomp_port::{Quality, Thermometer};

use std::time::Instant;

use crate::report::{MAX_SENSORS, SensorReport};

/// Thermometers, and which of their temperatures are believed.
pub struct Sensors {
    thermometers: Vec<Box<dyn Thermometer>>,
    limits: SensorLimits,
    checks: Vec<SensorCheck>,
}

impl Sensors {
    /// The sensors of some thermometers, of which the first [`MAX_SENSORS`] count.
    pub fn new(thermometers: Vec<Box<dyn Thermometer>>, limits: SensorLimits) -> Self {
        let mut sensors = Self {
            thermometers,
            limits,
            checks: Vec::new(),
        };
        sensors.checks = vec![SensorCheck::default(); sensors.names().len()];
        sensors
    }

    /// The names of all sensors, in the order of the thermometers.
    pub fn names(&self) -> Vec<String> {
        self.thermometers
            .iter()
            .flat_map(|thermometer| thermometer.names().iter().cloned())
            .take(MAX_SENSORS)
            .collect()
    }

    /// Takes the latest temperatures and judges them. Allocates nothing.
    pub(crate) fn read(
        &mut self,
        now: Duration,
        start: Instant,
        told: &mut [SensorReport; MAX_SENSORS],
    ) {
        let mut places = self.checks.iter_mut().zip(told);
        for thermometer in &mut self.thermometers {
            for latest in thermometer.latest() {
                let Some((check, told)) = places.next() else {
                    return;
                };
                let taken = latest
                    .taken
                    .map(|taken| taken.saturating_duration_since(start));
                let degc = latest
                    .degc
                    .filter(|_| !matches!(latest.quality, Quality::Bad(_)));
                *told = report(check.check(now, degc, taken, &self.limits));
            }
        }
    }
}

fn report(found: Result<f64, Rejected>) -> SensorReport {
    SensorReport {
        degc: found.ok(),
        flaw: found.err(),
    }
}
