//! What thermal terms have seen: the temperatures and the rates of the tests that they were found from.

use volcomp_vocabulary::{ErrorName, bounds::PLAUSIBLE_DEGC};

use crate::{
    error::ThermalRefusal,
    thermal::{Temperatures, Thermal},
};

/// What the terms of an error have seen of a sensor: a `[[thermal.seen]]` of a machine file.
///
/// Terms that were found by experiment are worth nothing far from where they were found. A temperature beyond the range
/// counts as the end of the range, and all terms of the error go to zero in a straight line over the next
/// [`Thermal::margin_k`]. A rate counts as the change that it makes in ten minutes: one that is beyond the range by a
/// margin in ten minutes takes the terms to zero as well.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Seen {
    /// The error motion whose terms are meant.
    pub error: ErrorName,
    /// Name of the temperature sensor.
    pub sensor: String,
    /// Lowest and highest temperature, °C.
    pub degc: [f64; 2],
    /// Fastest fall (0 or less) and fastest rise (0 or more), K/min, smoothed as by
    /// [`SmoothedRate`](volcomp_curve::SmoothedRate); `None` is any.
    pub k_per_min: Option<[f64; 2]>,
}

/// How far a value is beyond a range.
pub(crate) fn beyond([low, high]: [f64; 2], value: f64) -> f64 {
    (low - value).max(value - high).max(0.0)
}

/// The share of the terms that is in effect so far (K) beyond what they have seen.
pub(crate) fn share_beyond(beyond_k: f64, margin_k: f64) -> f64 {
    (1.0 - beyond_k / margin_k).clamp(0.0, 1.0)
}

impl Seen {
    pub(crate) fn check(&self, thermal: &Thermal) -> Result<(), ThermalRefusal> {
        let (error, sensor) = (self.error, self.sensor.clone());
        let [low, high] = self.degc;
        let possible = |degc: &f64| PLAUSIBLE_DEGC.contains(degc);
        if !(low < high && self.degc.iter().all(possible)) {
            return Err(ThermalRefusal::SeenTemperatures {
                error,
                sensor,
                low,
                high,
            });
        }
        if let Some([fall, rise]) = self.k_per_min
            && !(fall <= 0.0 && rise >= 0.0 && fall.is_finite() && rise.is_finite())
        {
            return Err(ThermalRefusal::SeenRates {
                error,
                sensor,
                fall,
                rise,
            });
        }
        let same = |other: &&Self| other.error == error && other.sensor == sensor;
        if thermal.seen.iter().filter(same).count() > 1 {
            return Err(ThermalRefusal::SeenTwice { error, sensor });
        }
        if !thermal.uses(error, &sensor) {
            return Err(ThermalRefusal::SeenUnused { error, sensor });
        }
        Ok(())
    }
}

impl Thermal {
    /// Whether a term of the error has this sensor.
    fn uses(&self, error: ErrorName, sensor: &str) -> bool {
        let mut expansion = self.expansion.iter();
        let mut drift = self.drift.iter();
        expansion.any(|term| term.error == error && term.sensor == sensor)
            || drift.any(|term| term.error == error && term.sensors.contains_key(sensor))
    }

    /// What the terms of an error have seen of a sensor, where it is stated.
    pub(crate) fn seen_of(&self, error: ErrorName, sensor: &str) -> Option<&Seen> {
        let mut seen = self.seen.iter();
        seen.find(|seen| seen.error == error && seen.sensor == sensor)
    }

    /// A temperature (°C) as the terms of an error take it: within what they have seen.
    pub(crate) fn held_degc(&self, error: ErrorName, sensor: &str, degc: f64) -> f64 {
        self.seen_of(error, sensor)
            .map_or(degc, |seen| degc.clamp(seen.degc[0], seen.degc[1]))
    }

    /// The share of the terms of an error that is in effect at steady temperatures, 0 to 1.
    pub(crate) fn steady_share(&self, error: ErrorName, temperatures: &Temperatures) -> f64 {
        let of_error = self.seen.iter().filter(|seen| seen.error == error);
        let beyond = of_error.filter_map(|seen| {
            let degc = temperatures.get(&seen.sensor)?;
            Some(beyond(seen.degc, *degc))
        });
        share_beyond(beyond.fold(0.0, f64::max), self.margin_k)
    }

    /// What is stated as seen, and is exceeded at these steady temperatures.
    pub fn beyond_seen(&self, temperatures: &Temperatures) -> Vec<&Seen> {
        let is_beyond = |seen: &&Seen| {
            let degc = temperatures.get(&seen.sensor);
            degc.is_some_and(|degc| beyond(seen.degc, *degc) > 0.0)
        };
        self.seen.iter().filter(is_beyond).collect()
    }
}
