//! Tested ranges of thermal terms: the temperatures and rates of the tests from which they were identified.

use volcomp_vocabulary::{ErrorName, bounds::PLAUSIBLE_DEGC};

use crate::{
    error::ThermalRefusal,
    thermal::{Temperatures, Thermal},
};

/// The tested range of a sensor for the terms of an error: a `[[thermal.seen]]` of a machine file.
///
/// Terms identified by experiment are not valid far from the tested conditions. A temperature beyond the range counts as the end of the
/// range, and all terms of the error fade linearly to zero over the next [`Thermal::margin_k`]. A rate counts as the change that it makes
/// in ten minutes: a rate that exceeds the range by one margin in ten minutes also fades the terms to zero.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Seen {
    /// The error motion whose terms this limits.
    pub error: ErrorName,
    /// Name of the temperature sensor.
    pub sensor: String,
    /// Lowest and highest tested temperature, °C.
    pub degc: [f64; 2],
    /// Fastest tested fall (0 or less) and rise (0 or more), K/min, smoothed like [`SmoothedRate`](volcomp_curve::SmoothedRate); `None` is
    /// unlimited.
    pub k_per_min: Option<[f64; 2]>,
}

/// Distance of a value from a range; 0 within it.
pub(crate) fn beyond([low, high]: [f64; 2], value: f64) -> f64 {
    (low - value).max(value - high).max(0.0)
}

/// The active share of the terms, 0 to 1, at this distance (K) beyond their tested range.
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
    /// True if a term of the error has this sensor.
    fn uses(&self, error: ErrorName, sensor: &str) -> bool {
        let mut expansion = self.expansion.iter();
        let mut drift = self.drift.iter();
        expansion.any(|term| term.error == error && term.sensor == sensor)
            || drift.any(|term| term.error == error && term.sensors.contains_key(sensor))
    }

    /// The tested range of a sensor for the terms of an error, if stated.
    pub(crate) fn seen_of(&self, error: ErrorName, sensor: &str) -> Option<&Seen> {
        let mut seen = self.seen.iter();
        seen.find(|seen| seen.error == error && seen.sensor == sensor)
    }

    /// A temperature (°C) clamped to the tested range of the terms of an error.
    pub(crate) fn held_degc(&self, error: ErrorName, sensor: &str, degc: f64) -> f64 {
        self.seen_of(error, sensor)
            .map_or(degc, |seen| degc.clamp(seen.degc[0], seen.degc[1]))
    }

    /// The active share of the terms of an error at steady temperatures, 0 to 1.
    pub(crate) fn steady_share(&self, error: ErrorName, temperatures: &Temperatures) -> f64 {
        let of_error = self.seen.iter().filter(|seen| seen.error == error);
        let beyond = of_error.filter_map(|seen| {
            let degc = temperatures.get(&seen.sensor)?;
            Some(beyond(seen.degc, *degc))
        });
        share_beyond(beyond.fold(0.0, f64::max), self.margin_k)
    }

    /// The tested ranges that these steady temperatures exceed.
    pub fn beyond_seen(&self, temperatures: &Temperatures) -> Vec<&Seen> {
        let is_beyond = |seen: &&Seen| {
            let degc = temperatures.get(&seen.sensor);
            degc.is_some_and(|degc| beyond(seen.degc, *degc) > 0.0)
        };
        self.seen.iter().filter(is_beyond).collect()
    }
}
