//! Thermal terms over time: state are the lags, and how long sensors are missing.

use volcomp_curve::first_order_lag;
use volcomp_evaluator::CompiledMachine;
use volcomp_kinematics::ErrorMotion;
use volcomp_vocabulary::{Displacement, MAX_AXES};

use crate::{
    error::{ModelError, ThermalRefusal},
    machine::Machine,
    thermal::{Drift, Expansion, Thermal},
    watch::Watch,
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

/// The thermal terms of a machine over time. State: the lagged temperatures of each term, how long its sensors have been
/// missing, how far it has faded, and how fast sensors change. No call but [`new`](Self::new) allocates.
///
/// A lag steps by [`first_order_lag`], which is exact for a temperature that holds for the step, and starts at its
/// first input. A term of which a sensor is missing holds, then fades ([`Fading`]). When the sensor is back the lag goes
/// on over the whole time for which it was missing, with the temperature that it tells then; what had faded comes in
/// again as slowly as it went.
///
/// Beyond what the terms of an error have seen ([`Seen`](crate::Seen)) they hold and fade together, so that terms which
/// work against each other stay so; their share changes no faster than in the time of [`Fading::fade_s`].
#[derive(Clone, Debug, PartialEq)]
pub struct ThermalState {
    sensors: Vec<String>,
    reference_degc: f64,
    fading: Fading,
    terms: Vec<Term>,
    watches: Vec<Watch>,
}

#[derive(Clone, Debug, PartialEq)]
struct Term {
    axis: usize,
    /// Place of the watch over its error, where there is one.
    watch: Option<usize>,
    effect: Effect,
    inputs: Vec<Input>,
    lag_s: f64,
    /// Time since the last input of the lag, s.
    unheard_s: f64,
    /// Time for which a sensor has been missing, s.
    missing_s: f64,
    /// The share of the term that is in effect, 0 to 1: less than 1 while it fades, and while it comes in again.
    share: f64,
}

/// A sensor of a term. The lag of a sum is the sum of the lags, so each sensor keeps its own.
#[derive(Clone, Debug, PartialEq)]
struct Input {
    /// Place among the sensors.
    sensor: usize,
    /// Its weight in Σ w·(T − T_ref).
    weight: f64,
    /// The lagged temperature over T_ref, K; `None` until every sensor of the term has given a temperature once.
    lagged_k: Option<f64>,
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Effect {
    /// mm along X, Y and Z for each mm of distance from the fixed point (mm) and each K.
    Expansion { per_k: [f64; 3], fixed_mm: f64 },
    /// mm or rad of one component for each K.
    Drift { component: usize, per_k: f64 },
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
        let watches = Watch::over(thermal, &sensors);
        let watch = |error| watches.iter().position(|watch| watch.error == error);
        let mut terms = Vec::new();
        for term in &thermal.expansion {
            let found = Term::expansion(machine, term, &sensors)?;
            terms.push(Term {
                watch: watch(term.error),
                ..found
            });
        }
        for term in &thermal.drift {
            let found = Term::drift(machine, term, &sensors)?;
            terms.push(Term {
                watch: watch(term.error),
                ..found
            });
        }
        Ok(Self {
            sensors,
            reference_degc: thermal.reference_degc,
            fading,
            terms,
            watches,
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
        for watch in &mut self.watches {
            watch.step(dt_s.max(0.0), over, self.fading);
        }
        for term in &mut self.terms {
            term.unheard_s += dt_s.max(0.0);
            let watch = term.watch.and_then(|place| self.watches.get(place));
            let held = |sensor: usize| {
                let over_k = over(sensor)?;
                Some(watch.map_or(over_k, |watch| watch.held_k(sensor, over_k)))
            };
            if term.inputs.iter().all(|input| over(input.sensor).is_some()) {
                for input in &mut term.inputs {
                    input.lagged_k = held(input.sensor).map(|k| {
                        first_order_lag(input.lagged_k.unwrap_or(k), k, term.unheard_s, term.lag_s)
                    });
                }
                (term.unheard_s, term.missing_s) = (0.0, 0.0);
                term.share = self.fading.returned(term.share, dt_s);
            } else {
                term.missing_s += dt_s.max(0.0);
                term.share = term.share.min(self.fading.share(term.missing_s));
            }
        }
    }

    /// Lets `stood_s` pass in which nobody asked the sensors, since the program stood. The lags go on by it with the next
    /// temperatures; no sensor counts as missing for it.
    pub fn stand(&mut self, stood_s: f64) {
        for term in &mut self.terms {
            term.unheard_s += stood_s.max(0.0);
        }
        for watch in &mut self.watches {
            watch.stand(stood_s.max(0.0));
        }
    }

    /// Goes on with the lags of another state, such as that of the machine file of before: each sensor of a term takes
    /// its lagged temperature from the term there whose lag is nearest, whatever error either of them moves and by how
    /// much, so that no change of a lag or a weight begins anew in the middle of the work. A sensor that no term there
    /// has begins with its first temperature. Allocates nothing.
    pub fn carry_over(&mut self, from: &Self) {
        let shift_k = from.reference_degc - self.reference_degc;
        for term in &mut self.terms {
            for input in &mut term.inputs {
                let name = self.sensors.get(input.sensor);
                let of_sensor = from.terms.iter().filter_map(|other| {
                    let mut inputs = other.inputs.iter();
                    let input = inputs.find(|input| from.sensors.get(input.sensor) == name)?;
                    Some((other, input.lagged_k?))
                });
                let distance = |other: &Term| (other.lag_s - term.lag_s).abs();
                let nearest = of_sensor.min_by(|a, b| distance(a.0).total_cmp(&distance(b.0)));
                if let Some((other, lagged_k)) = nearest {
                    input.lagged_k = Some(lagged_k + shift_k);
                    term.unheard_s = term.unheard_s.max(other.unheard_s);
                    term.missing_s = term.missing_s.max(other.missing_s);
                    term.share = term.share.min(other.share);
                }
            }
        }
        for watch in &mut self.watches {
            let same =
                |mine: usize, other: usize| self.sensors.get(mine) == from.sensors.get(other);
            for other in &from.watches {
                watch.carry_over(other, same);
            }
        }
    }

    /// Whether temperatures or their rates are beyond what the terms of an error have seen, or its terms still come in
    /// again after that.
    pub fn is_beyond_seen(&self) -> bool {
        self.watches.iter().any(Watch::is_beyond)
    }

    /// Whether a term holds, fades or has not started because one of its sensors is missing, or comes in again after that.
    pub fn is_degraded(&self) -> bool {
        let missing = |term: &Term| term.missing_s > 0.0 || term.share < 1.0 || !term.has_begun();
        self.terms.iter().any(missing)
    }

    /// Puts the terms as they stand now into a compiled machine of the same structure, which was compiled without
    /// temperatures.
    pub fn apply(&self, machine: &mut CompiledMachine) {
        let mut offsets = [[0.0; 6]; MAX_AXES];
        let mut slopes = [[0.0; 3]; MAX_AXES];
        for term in &self.terms {
            let watch = term.watch.and_then(|place| self.watches.get(place));
            let kelvin = term.lagged_k() * term.share * watch.map_or(1.0, Watch::share);
            match term.effect {
                Effect::Expansion { per_k, fixed_mm } => {
                    for (component, per_k) in per_k.into_iter().enumerate() {
                        let slope = per_k * kelvin;
                        slopes[term.axis][component] += slope;
                        offsets[term.axis][component] -= slope * fixed_mm;
                    }
                }
                Effect::Drift { component, per_k } => {
                    offsets[term.axis][component] += per_k * kelvin;
                }
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

    /// The share after `dt_s` on its way to `target`.
    pub(crate) fn towards(self, share: f64, target: f64, dt_s: f64) -> f64 {
        let step = dt_s / self.fade_s.max(f64::MIN_POSITIVE);
        share + (target - share).clamp(-step, step)
    }

    /// The share after `dt_s` in which every sensor was heard.
    fn returned(&self, share: f64, dt_s: f64) -> f64 {
        (share + dt_s.max(0.0) / self.fade_s.max(f64::MIN_POSITIVE)).min(1.0)
    }
}

impl Term {
    fn expansion(
        machine: &Machine,
        term: &Expansion,
        sensors: &[String],
    ) -> Result<Self, ModelError> {
        let axis = machine.index_of(term.error.axis)?;
        let shares = term.shares(&machine.chain().joints()[axis].direction);
        let effect = Effect::Expansion {
            // µm/(m·K) is 1e-6 mm/(mm·K).
            per_k: shares.map(|share| share * term.um_per_m_k * 1e-6),
            fixed_mm: term.fixed_mm,
        };
        Ok(Self::of(axis, effect, [(&term.sensor, 1.0)], 0.0, sensors))
    }

    fn drift(machine: &Machine, term: &Drift, sensors: &[String]) -> Result<Self, ModelError> {
        let error = term.error;
        let effect = Effect::Drift {
            component: error.component.index(),
            per_k: Displacement::from_micro(error.component.kind(), term.per_k).mm_or_rad(),
        };
        let weights = term.sensors.iter().map(|(name, weight)| (name, *weight));
        let axis = machine.index_of(error.axis)?;
        Ok(Self::of(axis, effect, weights, term.lag_s, sensors))
    }

    fn of<'a>(
        axis: usize,
        effect: Effect,
        weights: impl IntoIterator<Item = (&'a String, f64)>,
        lag_s: f64,
        sensors: &[String],
    ) -> Self {
        let input = |(name, weight): (&String, f64)| {
            let sensor = sensors.iter().position(|sensor| sensor == name)?;
            Some(Input {
                sensor,
                weight,
                lagged_k: None,
            })
        };
        Self {
            axis,
            watch: None,
            effect,
            inputs: weights.into_iter().filter_map(input).collect(),
            lag_s,
            unheard_s: 0.0,
            missing_s: 0.0,
            share: 1.0,
        }
    }

    /// The lagged Σ w·(T − T_ref), K; 0 while a sensor has not been heard yet.
    fn lagged_k(&self) -> f64 {
        let inputs = self.inputs.iter();
        let sum: Option<f64> = inputs
            .map(|input| Some(input.weight * input.lagged_k?))
            .sum();
        sum.unwrap_or(0.0)
    }

    /// Whether every sensor has been heard.
    fn has_begun(&self) -> bool {
        self.inputs.iter().all(|input| input.lagged_k.is_some())
    }
}

impl Thermal {
    /// Whether there is no term.
    pub fn is_empty(&self) -> bool {
        self.expansion.is_empty() && self.drift.is_empty()
    }
}
