//! Thermal terms over time: state are the lags, and how long sensors are missing.

use volcomp_curve::first_order_lag;
use volcomp_evaluator::CompiledMachine;
use volcomp_kinematics::ErrorMotion;
use volcomp_vocabulary::{Displacement, ErrorName, MAX_AXES};

use crate::{
    error::{ModelError, ThermalRefusal},
    machine::Machine,
    thermal::{Drift, Expansion, Thermal},
};

/// The times of fading: how a thermal term goes to zero while one of its sensors is missing.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Fading {
    /// Time for which the term holds its last value, s.
    pub hold_s: f64,
    /// Time within which it then goes to zero in a straight line, s.
    pub fade_s: f64,
}

impl Default for Fading {
    /// Five minutes of holding, then ten minutes of fading.
    fn default() -> Self {
        Self {
            hold_s: 300.0,
            fade_s: 600.0,
        }
    }
}

/// The thermal terms of a machine over time. State: the lagged temperature of each term, and how long its sensors have
/// been missing. No call but [`new`](Self::new) allocates.
///
/// A lag steps by [`first_order_lag`], which is exact for a temperature that holds for the step, and starts at its
/// first input. A term of which a sensor is missing holds, then fades ([`Fading`]).
#[derive(Clone, Debug, PartialEq)]
pub struct ThermalState {
    sensors: Vec<String>,
    reference_degc: f64,
    fading: Fading,
    terms: Vec<Term>,
}

#[derive(Clone, Debug, PartialEq)]
struct Term {
    axis: usize,
    component: usize,
    effect: Effect,
    /// Place of each sensor among the sensors, and its weight in Σ w·(T − T_ref).
    weights: Vec<(usize, f64)>,
    lag_s: f64,
    /// The lagged input, K; `None` until every sensor has given a temperature once.
    lagged_k: Option<f64>,
    missing_s: f64,
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Effect {
    /// mm for each mm of distance from the fixed point (mm) and each K.
    Expansion { per_k: f64, fixed_mm: f64 },
    /// mm or rad for each K.
    Drift { per_k: f64 },
}

impl ThermalState {
    /// The terms of a machine before any temperature is known.
    ///
    /// # Errors
    /// [`ThermalRefusal::Fading`]: times that are negative or not finite.
    pub fn new(machine: &Machine, fading: Fading) -> Result<Self, ModelError> {
        let Fading { hold_s, fade_s } = fading;
        if [hold_s, fade_s]
            .iter()
            .any(|s| !(*s >= 0.0 && s.is_finite()))
        {
            return Err(ThermalRefusal::Fading { hold_s, fade_s }.into());
        }
        let thermal = machine.thermal();
        let sensors: Vec<String> = thermal.sensors().into_iter().map(str::to_owned).collect();
        let mut terms = Vec::new();
        for term in &thermal.expansion {
            terms.push(Term::expansion(machine, term, &sensors)?);
        }
        for term in &thermal.drift {
            terms.push(Term::drift(machine, term, &sensors)?);
        }
        Ok(Self {
            sensors,
            reference_degc: thermal.reference_degc,
            fading,
            terms,
        })
    }

    /// The sensors that the terms name, in the order in which [`step`](Self::step) takes them.
    pub fn sensors(&self) -> &[String] {
        &self.sensors
    }

    /// Steps by `dt_s` with the temperature (°C) of each sensor, in the order of [`sensors`](Self::sensors). A sensor
    /// whose temperature is `None`, not finite or not there is missing. A `dt_s` that is negative or NaN counts as 0.
    pub fn step(&mut self, dt_s: f64, degc: &[Option<f64>]) {
        let over = |sensor: usize| {
            let degc = degc
                .get(sensor)
                .copied()
                .flatten()
                .filter(|t| t.is_finite());
            degc.map(|degc| degc - self.reference_degc)
        };
        for term in &mut self.terms {
            let weighted = |&(sensor, weight): &(usize, f64)| over(sensor).map(|k| weight * k);
            match term.weights.iter().map(weighted).sum::<Option<f64>>() {
                Some(input_k) => {
                    let before = term.lagged_k.unwrap_or(input_k);
                    term.lagged_k = Some(first_order_lag(before, input_k, dt_s, term.lag_s));
                    term.missing_s = 0.0;
                }
                None => term.missing_s += dt_s.max(0.0),
            }
        }
    }

    /// Goes on with the lags of another state, such as that of the machine file of before: a term takes the lagged
    /// temperature of a term there that has the same sensors, weights and lag, whatever error either of them moves.
    /// Terms that have none there begin with their first temperature. Allocates nothing.
    pub fn carry_over(&mut self, from: &Self) {
        let shift_k = from.reference_degc - self.reference_degc;
        for term in &mut self.terms {
            let is_same = |other: &&Term| {
                let pairs = term.weights.iter().zip(&other.weights);
                term.lag_s.to_bits() == other.lag_s.to_bits()
                    && term.weights.len() == other.weights.len()
                    && pairs.into_iter().all(|(own, others)| {
                        own.1.to_bits() == others.1.to_bits()
                            && self.sensors.get(own.0) == from.sensors.get(others.0)
                    })
            };
            if let Some(other) = from.terms.iter().find(is_same) {
                let weight: f64 = term.weights.iter().map(|(_, weight)| weight).sum();
                term.lagged_k = other.lagged_k.map(|lagged| lagged + shift_k * weight);
                term.missing_s = other.missing_s;
            }
        }
    }

    /// Whether a term holds, fades or has not started because one of its sensors is missing.
    pub fn is_degraded(&self) -> bool {
        let missing = |term: &Term| term.missing_s > 0.0 || term.lagged_k.is_none();
        self.terms.iter().any(missing)
    }

    /// Puts the terms as they stand now into a compiled machine of the same structure, which was compiled without
    /// temperatures.
    pub fn apply(&self, machine: &mut CompiledMachine) {
        let mut offsets = [[0.0; 6]; MAX_AXES];
        let mut slopes = [[0.0; 3]; MAX_AXES];
        for term in &self.terms {
            let kelvin = term.lagged_k.unwrap_or(0.0) * self.fading.share(term.missing_s);
            match term.effect {
                Effect::Expansion { per_k, fixed_mm } => {
                    let slope = per_k * kelvin;
                    slopes[term.axis][term.component] += slope;
                    offsets[term.axis][term.component] -= slope * fixed_mm;
                }
                Effect::Drift { per_k } => offsets[term.axis][term.component] += per_k * kelvin,
            }
        }
        for axis in 0..machine.chain().joints().len() {
            let [x, y, z, a, b, c] = offsets[axis];
            let offset = ErrorMotion {
                linear_mm: [x, y, z].into(),
                angular_rad: [a, b, c].into(),
            };
            machine.set_thermal_offset(axis, &offset, slopes[axis]);
        }
    }
}

impl Fading {
    /// The share of a term that is left when a sensor has been missing for so long, 0 to 1.
    fn share(&self, missing_s: f64) -> f64 {
        let faded_s = (missing_s - self.hold_s).max(0.0);
        (1.0 - faded_s / self.fade_s.max(f64::MIN_POSITIVE)).max(0.0)
    }
}

impl Term {
    fn expansion(
        machine: &Machine,
        term: &Expansion,
        sensors: &[String],
    ) -> Result<Self, ModelError> {
        let effect = Effect::Expansion {
            // µm/(m·K) is 1e-6 mm/(mm·K).
            per_k: term.um_per_m_k * 1e-6,
            fixed_mm: term.fixed_mm,
        };
        Self::of(machine, term.error, effect, [(&term.sensor, 1.0)], sensors)
    }

    fn drift(machine: &Machine, term: &Drift, sensors: &[String]) -> Result<Self, ModelError> {
        let effect = Effect::Drift {
            per_k: Displacement::from_micro(term.error.component.kind(), term.per_k).mm_or_rad(),
        };
        let weights = term.sensors.iter().map(|(name, weight)| (name, *weight));
        let made = Self::of(machine, term.error, effect, weights, sensors)?;
        Ok(Self {
            lag_s: term.lag_s,
            ..made
        })
    }

    fn of<'a>(
        machine: &Machine,
        error: ErrorName,
        effect: Effect,
        weights: impl IntoIterator<Item = (&'a String, f64)>,
        sensors: &[String],
    ) -> Result<Self, ModelError> {
        let place = |(name, weight): (&String, f64)| {
            let place = sensors.iter().position(|sensor| sensor == name);
            place.map(|place| (place, weight))
        };
        Ok(Self {
            axis: machine.index_of(error.axis)?,
            component: error.component.index(),
            effect,
            weights: weights.into_iter().filter_map(place).collect(),
            lag_s: 0.0,
            lagged_k: None,
            missing_s: 0.0,
        })
    }
}

impl Thermal {
    /// Whether there is no term.
    pub fn is_empty(&self) -> bool {
        self.expansion.is_empty() && self.drift.is_empty()
    }
}
