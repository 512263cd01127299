//! The temperatures of a cycle: read, checked, and passed to the thermal terms. State: the history of each sensor.

use std::time::{Duration, Instant};

use volcomp_guard::{
    MAX_SENSORS, SensorCheck, SensorLimits, SensorReading, SensorReport, judge_temperatures,
};
use volcomp_port::{Quality, Reason, Temperature, Thermometer};

/// Thermometers, and the checks of their temperatures.
pub struct Sensors {
    thermometers: Vec<Box<dyn Thermometer>>,
    limits: SensorLimits,
    checks: Vec<SensorCheck>,
}

impl Sensors {
    /// Uses the sensors of these thermometers; only the first [`MAX_SENSORS`] are read.
    pub fn new(thermometers: Vec<Box<dyn Thermometer>>, limits: SensorLimits) -> Self {
        let mut sensors = Self { thermometers, limits, checks: Vec::new() };
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

    /// Confirms sensors that jumped, so that their next readings are accepted.
    pub(crate) fn acknowledge(&mut self) {
        self.checks.iter_mut().for_each(SensorCheck::acknowledge);
    }

    /// Reads and checks the latest temperatures. Does not allocate.
    pub(crate) fn read(
        &mut self,
        now: Duration,
        start: Instant,
        reports: &mut [SensorReport; MAX_SENSORS],
    ) {
        let mut readings = [SensorReading::Silence; MAX_SENSORS];
        let mut places = readings.iter_mut();
        for thermometer in &mut self.thermometers {
            for (latest, place) in thermometer.latest().iter().zip(places.by_ref()) {
                *place = sensor_reading(latest, start);
            }
        }
        judge_temperatures(&mut self.checks, &readings, now, &self.limits, reports);
    }
}

fn sensor_reading(latest: &Temperature, start: Instant) -> SensorReading {
    match (latest.degc, latest.taken, latest.quality) {
        (Some(degc), Some(taken), Quality::Good | Quality::Uncertain(_)) => {
            SensorReading::Temperature { degc, taken: taken.saturating_duration_since(start) }
        }
        (_, _, Quality::Bad(Reason::NotRead | Reason::NoAnswer)) => SensorReading::Silence,
        _ => SensorReading::Fault,
    }
}

#[cfg(test)]
mod tests {
    use volcomp_guard::SensorFlaw;
    use volcomp_port::published;

    use super::*;

    #[test]
    fn sensors_of_several_thermometers() {
        let start = Instant::now();
        let names = |names: &[&str]| names.iter().map(ToString::to_string).collect::<Vec<_>>();
        let (mut first, one) = published("one", names(&["bed", "column"]));
        let (mut second, other) = published("other", names(&["spindle"]));
        let thermometers: Vec<Box<dyn Thermometer>> = vec![Box::new(one), Box::new(other)];
        let mut sensors = Sensors::new(thermometers, SensorLimits::default());
        let mut reports = [SensorReport::default(); MAX_SENSORS];
        let mut read = |sensors: &mut Sensors, seconds: u64, spindle: f64| {
            let now = Duration::from_secs(seconds);
            let taken = start + now;
            first.publish(&[Temperature::good(21.0, taken), Temperature::bad(Reason::Open, taken)]);
            second.publish(&[Temperature::good(spindle, taken)]);
            sensors.read(now, start, &mut reports);
            [0, 1, 2].map(|place| (reports[place].degc, reports[place].flaw))
        };
        let bed = (Some(21.0), None);
        let broken = (None, Some(SensorFlaw::Broken));
        let good = [bed, broken, (Some(30.0), None)];
        assert_eq!(read(&mut sensors, 1, 30.0), good);
        let jumped = [bed, broken, (None, Some(SensorFlaw::Jumped))];
        assert_eq!(read(&mut sensors, 2, 70.0), jumped);
        assert_eq!(read(&mut sensors, 1000, 70.0), jumped);
        sensors.acknowledge();
        assert_eq!(read(&mut sensors, 1001, 70.0), [bed, broken, (Some(70.0), None)]);
    }
}
