//! Watches over time whether temperatures and rates are within the tested ranges of the terms of an error.

use volcomp_curve::SmoothedRate;
use volcomp_vocabulary::ErrorName;

use crate::{
    seen::{Seen, beyond, share_beyond},
    thermal::Thermal,
    thermal_state::Fading,
};

/// Watch over the sensors of the terms of one error. State: the smoothed rates, and how far the terms have faded.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Watch {
    pub(crate) error: ErrorName,
    margin_k: f64,
    sensors: Vec<Watched>,
    /// The active share of the terms, 0 to 1; `None` until every sensor has delivered a temperature.
    share: Option<f64>,
}

#[derive(Clone, Debug, PartialEq)]
struct Watched {
    /// Index of the sensor.
    sensor: usize,
    /// Lowest and highest tested temperature above the reference, K.
    over_k: [f64; 2],
    k_per_s: Option<[f64; 2]>,
    rate: SmoothedRate,
    /// Time since its last temperature, s.
    unheard_s: f64,
    /// Distance beyond the tested range, K; `None` until the first temperature.
    beyond_k: Option<f64>,
}

impl Watched {
    fn new(seen: &Seen, reference_degc: f64, sensor: usize) -> Self {
        Self {
            sensor,
            over_k: seen.degc.map(|degc| degc - reference_degc),
            k_per_s: seen.k_per_min.map(|rates| rates.map(|rate| rate / 60.0)),
            rate: SmoothedRate::default(),
            unheard_s: 0.0,
            beyond_k: None,
        }
    }

    /// Steps by `dt_s` with the temperature above the reference, if there is one.
    fn step(&mut self, dt_s: f64, over_k: Option<f64>) {
        self.unheard_s += dt_s;
        let Some(over_k) = over_k else { return };
        let rate = self.rate.step(over_k, self.unheard_s);
        self.unheard_s = 0.0;
        let too_fast = self
            .k_per_s
            .map_or(0.0, |rates| beyond(rates, rate) * SmoothedRate::TIME_S);
        self.beyond_k = Some(beyond(self.over_k, over_k).max(too_fast));
    }
}

impl Watch {
    /// One watch for each error with stated tested ranges.
    pub(crate) fn over(thermal: &Thermal, sensors: &[String]) -> Vec<Self> {
        let mut watches: Vec<Self> = Vec::new();
        for seen in &thermal.seen {
            let Some(sensor) = sensors.iter().position(|name| *name == seen.sensor) else {
                continue;
            };
            let watched = Watched::new(seen, thermal.reference_degc, sensor);
            match watches.iter_mut().find(|watch| watch.error == seen.error) {
                Some(watch) => watch.sensors.push(watched),
                None => watches.push(Self {
                    error: seen.error,
                    margin_k: thermal.margin_k,
                    sensors: vec![watched],
                    share: None,
                }),
            }
        }
        watches
    }

    /// Steps by `dt_s` with the temperature of each sensor above the reference, K.
    pub(crate) fn step(
        &mut self,
        dt_s: f64,
        over_k: impl Fn(usize) -> Option<f64>,
        fading: Fading,
    ) {
        for watched in &mut self.sensors {
            watched.step(dt_s, over_k(watched.sensor));
        }
        let all_heard = self.sensors.iter().all(|s| s.beyond_k.is_some());
        let target = share_beyond(self.beyond_k(), self.margin_k);
        self.share = match self.share {
            Some(share) => Some(fading.towards(share, target, dt_s)),
            None => all_heard.then_some(target),
        };
    }

    /// Advances over time in which no sensor was sampled.
    pub(crate) fn stand(&mut self, stood_s: f64) {
        for watched in &mut self.sensors {
            watched.unheard_s += stood_s;
        }
    }

    /// Takes over the rates of another watch over the same sensors (`same` maps them) and, if it is over the same error, how far the terms
    /// had faded.
    pub(crate) fn carry_over(&mut self, from: &Self, same: impl Fn(usize, usize) -> bool) {
        for watched in &mut self.sensors {
            let other = from.sensors.iter().find(|o| same(watched.sensor, o.sensor));
            if let Some(other) = other {
                watched.rate = other.rate.clone();
                watched.unheard_s = other.unheard_s;
            }
        }
        if from.error == self.error {
            self.share = from.share;
        }
    }

    /// The temperature of a sensor above the reference, clamped to the tested range.
    pub(crate) fn held_k(&self, sensor: usize, over_k: f64) -> f64 {
        let mut sensors = self.sensors.iter();
        let watched = sensors.find(|watched| watched.sensor == sensor);
        watched.map_or(over_k, |watched| {
            over_k.clamp(watched.over_k[0], watched.over_k[1])
        })
    }

    /// The largest distance of any sensor beyond the tested range, K.
    fn beyond_k(&self) -> f64 {
        let beyond = self.sensors.iter().filter_map(|s| s.beyond_k);
        beyond.fold(0.0, f64::max)
    }

    /// The active share of the terms, 0 to 1: 0 until every sensor has delivered a temperature, since until then it is unknown whether they
    /// are within the tested range.
    pub(crate) fn share(&self) -> f64 {
        self.share.unwrap_or(0.0)
    }

    /// True if a sensor is beyond the tested range, or the terms are still returning after that. A sensor without a temperature yet does
    /// not count: its terms have not started.
    pub(crate) fn is_beyond(&self) -> bool {
        self.beyond_k() > 0.0 || self.share.is_some_and(|share| share < 1.0)
    }
}
