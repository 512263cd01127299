//! The temperatures of a cycle: read, judged, and handed to the model's terms. State: the memory of each sensor.

use std::time::{Duration, Instant};

use volcomp_guard::{
    Heard, MAX_SENSORS, SensorCheck, SensorLimits, SensorReport, judge_temperatures,
};
use volcomp_port::{Quality, Reason, Temperature, Thermometer};

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

    /// A person confirms that sensors which jumped are right: their next readings are believed.
    pub(crate) fn acknowledge(&mut self) {
        self.checks.iter_mut().for_each(SensorCheck::acknowledge);
    }

    /// Takes the latest temperatures and judges them. Allocates nothing.
    pub(crate) fn read(
        &mut self,
        now: Duration,
        start: Instant,
        told: &mut [SensorReport; MAX_SENSORS],
    ) {
        let mut heard = [Heard::Silence; MAX_SENSORS];
        let mut places = heard.iter_mut();
        for thermometer in &mut self.thermometers {
            for (latest, place) in thermometer.latest().iter().zip(places.by_ref()) {
                *place = what_was_heard(latest, start);
            }
        }
        judge_temperatures(&mut self.checks, &heard, now, &self.limits, told);
    }
}

fn what_was_heard(latest: &Temperature, start: Instant) -> Heard {
    match (latest.degc, latest.taken, latest.quality) {
        (Some(degc), Some(taken), Quality::Good | Quality::Uncertain(_)) => Heard::Temperature {
            degc,
            taken: taken.saturating_duration_since(start),
        },
        (_, _, Quality::Bad(Reason::NotRead | Reason::NoAnswer)) => Heard::Silence,
        _ => Heard::Fault,
    }
}
