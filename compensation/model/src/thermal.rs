//! Thermal terms in the steady state: expansion and drift added to error motions.

use core::ops::RangeInclusive;
use std::collections::BTreeMap;

use volcomp_kinematics::{Structure, nalgebra::Vector3};
use volcomp_vocabulary::{AxisKind, ErrorName, bounds::PLAUSIBLE_DEGC};

use crate::error::ThermalRefusal;

/// Temperatures by sensor name, °C. A sensor that is not listed has an unknown temperature.
pub type Temperatures = BTreeMap<String, f64>;

/// The thermal terms of a machine: the table `[thermal]` of a machine file.
#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Thermal {
    /// The temperature at which the curves are valid, °C.
    pub reference_degc: f64,
    /// Thermal expansion of scales or screws.
    pub expansion: Vec<Expansion>,
    /// Errors that follow temperatures with a lag.
    pub drift: Vec<Drift>,
    /// Tested temperature ranges; beyond them the terms are held and fade to zero.
    #[serde(default)]
    pub seen: Vec<Seen>,
    /// Distance beyond the tested range at which the terms are zero, K.
    #[serde(default = "default_margin_k")]
    pub margin_k: f64,
}

pub(crate) const MARGINS_K: RangeInclusive<f64> = 0.1..=100.0;

pub(crate) fn default_margin_k() -> f64 {
    5.0
}

/// Expansion of a scale or screw with a temperature: E += k·(T − T_ref)·(q − q_fixed). If the error
/// is the positioning deviation of the axis (`EXX`, `EYV`), the expansion acts along the direction
/// of the axis, even if that is oblique.
#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Expansion {
    /// The linear error motion to which the expansion is added.
    pub error: ErrorName,
    /// Name of the temperature sensor.
    pub sensor: String,
    /// k, µm/(m·K): positive if the scale or screw expands.
    pub um_per_m_k: f64,
    /// Coordinate of the fixed point, mm.
    pub fixed_mm: f64,
}

/// Drift of an error with temperatures: E += k·L, where L is the first-order lag of Σ w·T − T_ref·Σ w.
#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Drift {
    /// The error motion to which the drift is added.
    pub error: ErrorName,
    /// Weight w of each sensor, by name.
    pub sensors: BTreeMap<String, f64>,
    /// The factor k: µm/K for a linear error, µrad/K for an angular one.
    pub per_k: f64,
    /// Time constant of the lag, s; 0 for no lag.
    pub lag_s: f64,
}

impl Default for Thermal {
    fn default() -> Self {
        Self {
            reference_degc: 20.0,
            expansion: Vec::new(),
            drift: Vec::new(),
            seen: Vec::new(),
            margin_k: default_margin_k(),
        }
    }
}

impl Thermal {
    /// Checks that the terms are valid for a machine with this structure.
    ///
    /// # Errors
    /// The reason for the first invalid term.
    pub fn check(&self, structure: &Structure) -> Result<(), ThermalRefusal> {
        if !PLAUSIBLE_DEGC.contains(&self.reference_degc) {
            return Err(ThermalRefusal::Reference { found: self.reference_degc });
        }
        for term in &self.expansion {
            term.check(structure)?;
        }
        for term in &self.drift {
            term.check(structure)?;
        }
        if !MARGINS_K.contains(&self.margin_k) {
            let found = self.margin_k;
            return Err(ThermalRefusal::Margin { found });
        }
        self.seen.iter().try_for_each(|seen| seen.check(self))
    }

    /// Offset (µm or µrad) and slope (µm/mm) that the terms add to `error`, an error of an axis with this unit direction (in MCS), in the
    /// steady state. Terms with an unknown temperature are omitted; beyond tested ranges the terms are held and fade ([`Seen`]).
    pub fn offset_and_slope(
        &self,
        error: ErrorName,
        direction: &Vector3<f64>,
        temperatures: &Temperatures,
    ) -> [f64; 2] {
        let mut sum = [0.0; 2];
        for term in &self.expansion {
            if error.location || error.component.is_angular() || error.axis != term.error.axis {
                continue;
            }
            if let Some(&degc) = temperatures.get(&term.sensor) {
                let share = term.shares(direction)[error.component.mcs_index()]
                    * self.steady_share(term.error, temperatures);
                let degc = self.held_degc(term.error, &term.sensor, degc);
                let slope = share * term.um_per_m_k * 1e-3 * (degc - self.reference_degc);
                sum[0] -= slope * term.fixed_mm;
                sum[1] += slope;
            }
        }
        for term in self.drift.iter().filter(|term| term.error == error) {
            let difference = |(sensor, weight): (&String, &f64)| {
                let degc = self.held_degc(error, sensor, *temperatures.get(sensor)?);
                Some(weight * (degc - self.reference_degc))
            };
            if let Some(input) = term.sensors.iter().map(difference).sum::<Option<f64>>() {
                sum[0] += self.steady_share(error, temperatures) * term.per_k * input;
            }
        }
        sum
    }

    /// All sensors of the terms, sorted, without duplicates.
    pub fn sensors(&self) -> Vec<&str> {
        let expansion = self.expansion.iter().map(|term| &term.sensor);
        let drift = self.drift.iter().flat_map(|term| term.sensors.keys());
        let mut names: Vec<&str> = expansion.chain(drift).map(String::as_str).collect();
        names.sort_unstable();
        names.dedup();
        names
    }
}

impl Expansion {
    /// The components of k along X, Y and Z of MCS, for an axis with this unit direction. An
    /// expansion p of the positioning deviation acts as δ = u·p; an expansion of any other linear
    /// error motion acts along the letter of the error.
    pub(crate) fn shares(&self, direction: &Vector3<f64>) -> [f64; 3] {
        let component = self.error.component.mcs_index();
        if component == self.error.axis.mcs_index() {
            return (*direction).into();
        }
        let mut shares = [0.0; 3];
        shares[component] = 1.0;
        shares
    }

    /// Checks that the term is valid for a machine with this structure.
    ///
    /// # Errors
    /// An error motion that is missing or is not a linear one of a linear axis, numbers that are not finite.
    pub fn check(&self, structure: &Structure) -> Result<(), ThermalRefusal> {
        motion_of(self.error, structure)?;
        if self.error.axis.kind() == AxisKind::Rotary || self.error.component.is_angular() {
            return Err(ThermalRefusal::NotLength { error: self.error });
        }
        finite("expansion, µm/(m·K),", self.um_per_m_k)?;
        finite("fixed point, mm,", self.fixed_mm)
    }
}

impl Drift {
    /// Checks that the term is valid for a machine with this structure.
    ///
    /// # Errors
    /// A missing error motion, no sensor, a negative lag, numbers that are not finite.
    pub fn check(&self, structure: &Structure) -> Result<(), ThermalRefusal> {
        let error = self.error;
        motion_of(error, structure)?;
        if self.sensors.is_empty() {
            return Err(ThermalRefusal::NoSensor { error });
        }
        if !(self.lag_s >= 0.0 && self.lag_s.is_finite()) {
            let found = self.lag_s;
            return Err(ThermalRefusal::Lag { error, found });
        }
        for &weight in self.sensors.values() {
            finite("weight of a sensor", weight)?;
        }
        finite("drift per kelvin", self.per_k)
    }
}

fn motion_of(error: ErrorName, structure: &Structure) -> Result<(), ThermalRefusal> {
    if !error.location && structure.index_of(error.axis).is_some() {
        return Ok(());
    }
    Err(ThermalRefusal::Motion { found: error.to_string(), structure: structure.to_string() })
}

fn finite(what: &'static str, found: f64) -> Result<(), ThermalRefusal> {
    if found.is_finite() { Ok(()) } else { Err(ThermalRefusal::NotFinite { what, found }) }
}

/// The tested range of a sensor, for the terms of an error: a `[[thermal.seen]]` of a machine file.
///
/// Terms that were identified by experiment are invalid far from the tested conditions. A
/// temperature beyond the range is replaced by the end of the range, and all terms of the error
/// fade linearly to zero over the next [`Thermal::margin_k`]. A rate is converted to the
/// temperature change in ten minutes: if that exceeds the range by one margin, the terms are zero
/// as well.
#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Seen {
    /// The error motion whose terms are limited.
    pub error: ErrorName,
    /// Name of the temperature sensor.
    pub sensor: String,
    /// Lowest and highest tested temperature, °C.
    pub degc: [f64; 2],
    /// Fastest tested fall (0 or less) and rise (0 or more), K/min, smoothed like [`SmoothedRate`](volcomp_curve::SmoothedRate); `None`:
    /// unlimited.
    pub k_per_min: Option<[f64; 2]>,
}

pub(crate) fn beyond([low, high]: [f64; 2], value: f64) -> f64 {
    (low - value).max(value - high).max(0.0)
}

/// The active fraction of the terms, 0 to 1, at this distance (K) beyond the tested range.
pub(crate) fn share_beyond(beyond_k: f64, margin_k: f64) -> f64 {
    (1.0 - beyond_k / margin_k).clamp(0.0, 1.0)
}

impl Seen {
    pub(crate) fn check(&self, thermal: &Thermal) -> Result<(), ThermalRefusal> {
        let (error, sensor) = (self.error, self.sensor.clone());
        let [low, high] = self.degc;
        let possible = |degc: &f64| PLAUSIBLE_DEGC.contains(degc);
        if !(low < high && self.degc.iter().all(possible)) {
            return Err(ThermalRefusal::SeenTemperatures { error, sensor, low, high });
        }
        if let Some([fall, rise]) = self.k_per_min
            && !(fall <= 0.0 && rise >= 0.0 && fall.is_finite() && rise.is_finite())
        {
            return Err(ThermalRefusal::SeenRates { error, sensor, fall, rise });
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
        self.seen_of(error, sensor).map_or(degc, |seen| degc.clamp(seen.degc[0], seen.degc[1]))
    }

    /// The active fraction of the terms of an error in the steady state, 0 to 1.
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
