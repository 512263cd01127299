//! Thermal terms over time.

use volcomp_curve::{SmoothedRate, first_order_lag};
use volcomp_evaluator::CompiledMachine;
use volcomp_kinematics::ErrorMotion;
use volcomp_vocabulary::{Displacement, ErrorName, MAX_AXES};

use crate::{
    error::{ModelError, ThermalRefusal},
    machine::Machine,
    thermal::{Drift, Expansion, Seen, Thermal, beyond, share_beyond},
};

/// How a thermal term goes to zero while one of its sensors is missing.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Fading {
    /// Time for which the term holds its last value, s.
    pub hold_s: f64,
    /// Time over which the term then fades linearly to zero, s.
    pub fade_s: f64,
}

impl Default for Fading {
    /// Holds for five minutes, then fades over ten minutes.
    fn default() -> Self {
        Self { hold_s: 300.0, fade_s: 600.0 }
    }
}

/// The thermal terms of a machine over time. State: the lagged temperatures of each term, the time for which its
/// sensors have been missing, its active fraction, and the rates of the sensors. Only [`new`](Self::new) allocates.
///
/// A lag advances by [`first_order_lag`], which is exact for a temperature that is constant over the step, and starts
/// at its first input. A term with a missing sensor is held, and then fades ([`Fading`]). When the sensor returns, the
/// lag advances over the whole missing time with the new temperature, and the active fraction rises as slowly as it
/// fell.
///
/// Beyond their tested ranges ([`Seen`](crate::Seen)) all terms of an error are held and fade together, so that terms
/// that cancel each other continue to do so. Their active fraction changes no faster than [`Fading::fade_s`] allows.
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
    /// Index of the watch that monitors the tested ranges for the term's error; `None` if no range
    /// is stated.
    watch: Option<usize>,
    effect: Effect,
    inputs: Vec<Input>,
    lag_s: f64,
    /// Time since the lag last received temperatures of all sensors, s.
    unheard_s: f64,
    missing_s: f64,
    /// The active fraction of the term, 0 to 1: less than 1 while it fades and while it returns.
    share: f64,
}

/// A sensor of a term, with its own lag: the lag of a sum is the sum of the lags.
#[derive(Clone, Debug, PartialEq)]
struct Input {
    sensor: usize,
    /// Weight w in Σ w·(T − T_ref).
    weight: f64,
    /// The lagged temperature above T_ref, K; `None` until every sensor of the term has delivered a temperature.
    lagged_k: Option<f64>,
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Effect {
    /// mm along X, Y and Z per mm of distance from the fixed point (mm) and per K.
    Expansion { per_k: [f64; 3], fixed_mm: f64 },
    /// mm or rad of one component per K.
    Drift { component: usize, per_k: f64 },
}

impl ThermalState {
    /// The thermal terms of a machine, before the first temperatures.
    ///
    /// # Errors
    /// [`ThermalRefusal::Fading`]: times that are negative or not finite.
    pub fn new(machine: &Machine, fading: Fading) -> Result<Self, ModelError> {
        let Fading { hold_s, fade_s } = fading;
        if [hold_s, fade_s].iter().any(|s| !(*s >= 0.0 && s.is_finite())) {
            return Err(ThermalRefusal::Fading { hold_s, fade_s }.into());
        }
        let thermal = machine.thermal();
        let sensors: Vec<String> = thermal.sensors().into_iter().map(str::to_owned).collect();
        let watches = Watch::over(thermal, &sensors);
        let watch = |error| watches.iter().position(|watch| watch.error == error);
        let mut terms = Vec::new();
        for term in &thermal.expansion {
            let found = Term::expansion(machine, term, &sensors)?;
            terms.push(Term { watch: watch(term.error), ..found });
        }
        for term in &thermal.drift {
            let found = Term::drift(machine, term, &sensors)?;
            terms.push(Term { watch: watch(term.error), ..found });
        }
        Ok(Self { sensors, reference_degc: thermal.reference_degc, fading, terms, watches })
    }

    /// The sensors of the terms, in the order expected by [`step`](Self::step).
    pub fn sensors(&self) -> &[String] {
        &self.sensors
    }

    /// Advances by `dt_s` with the temperature (°C) of each sensor, in the order of [`sensors`](Self::sensors). A sensor is missing if its
    /// temperature is `None`, not finite or absent. A negative or NaN `dt_s` counts as 0.
    pub fn step(&mut self, dt_s: f64, degc: &[Option<f64>]) {
        let over = |sensor: usize| {
            let degc = degc.get(sensor).copied().flatten().filter(|t| t.is_finite());
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

    /// Advances over `stood_s`, a pause of the program in which no sensor was sampled. The next temperatures advance
    /// the lags over the pause as well. The pause does not count as missing time of a sensor.
    pub fn stand(&mut self, stood_s: f64) {
        for term in &mut self.terms {
            term.unheard_s += stood_s.max(0.0);
        }
        for watch in &mut self.watches {
            watch.stand(stood_s.max(0.0));
        }
    }

    /// Continues the lags of another state, such as that of the previous machine file, so that a changed lag or weight
    /// does not restart them. Each sensor of a term takes its lagged temperature from the term of the other state with
    /// the same sensor and the nearest lag; error and weight of that term do not matter. A sensor without such a term
    /// starts at its first temperature. Does not allocate.
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

    /// Whether temperatures or rates are beyond the tested range of an error's terms, or these terms have not fully returned since.
    pub fn is_beyond_seen(&self) -> bool {
        self.watches.iter().any(Watch::is_beyond)
    }

    /// Whether a term is held, fades or has not started because of a missing sensor, or is returning after that.
    pub fn is_degraded(&self) -> bool {
        let missing = |term: &Term| term.missing_s > 0.0 || term.share < 1.0 || !term.has_begun();
        self.terms.iter().any(missing)
    }

    /// Writes the present terms into a compiled machine of the same structure that was compiled without temperatures.
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
            let offset = ErrorMotion { linear_mm: [x, y, z].into(), angular_rad: [a, b, c].into() };
            machine.set_thermal_offset(axis, &offset, slopes[axis]);
        }
    }
}

impl Fading {
    /// The active fraction of a term, 0 to 1, whose sensor has been missing for this time.
    fn share(&self, missing_s: f64) -> f64 {
        let faded_s = (missing_s - self.hold_s).max(0.0);
        (1.0 - faded_s / self.fade_s.max(f64::MIN_POSITIVE)).max(0.0)
    }

    /// The active fraction after `dt_s` of movement towards `target`, at most 1 per `fade_s`.
    pub(crate) fn towards(self, share: f64, target: f64, dt_s: f64) -> f64 {
        let step = dt_s / self.fade_s.max(f64::MIN_POSITIVE);
        share + (target - share).clamp(-step, step)
    }

    /// The active fraction after a further `dt_s` in which all sensors delivered temperatures.
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
            Some(Input { sensor, weight, lagged_k: None })
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

    /// The lagged Σ w·(T − T_ref), K; 0 until every sensor has delivered a temperature.
    fn lagged_k(&self) -> f64 {
        let inputs = self.inputs.iter();
        let sum: Option<f64> = inputs.map(|input| Some(input.weight * input.lagged_k?)).sum();
        sum.unwrap_or(0.0)
    }

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

/// Monitors whether the sensors of the terms of one error are within their tested ranges. State: the smoothed rates,
/// and the active fraction of the terms.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Watch {
    pub(crate) error: ErrorName,
    margin_k: f64,
    sensors: Vec<Watched>,
    /// The active fraction of the terms, 0 to 1; `None` until every sensor has delivered a
    /// temperature.
    share: Option<f64>,
}

#[derive(Clone, Debug, PartialEq)]
struct Watched {
    sensor: usize,
    /// Lowest and highest tested temperature above the reference, K.
    over_k: [f64; 2],
    k_per_s: Option<[f64; 2]>,
    rate: SmoothedRate,
    /// Time since the sensor's last temperature, s.
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

    /// Advances by `dt_s`; `over_k` is the temperature above the reference, K, if the sensor delivered a temperature.
    fn step(&mut self, dt_s: f64, over_k: Option<f64>) {
        self.unheard_s += dt_s;
        let Some(over_k) = over_k else { return };
        let rate = self.rate.step(over_k, self.unheard_s);
        self.unheard_s = 0.0;
        let too_fast = self.k_per_s.map_or(0.0, |rates| beyond(rates, rate) * SmoothedRate::TIME_S);
        self.beyond_k = Some(beyond(self.over_k, over_k).max(too_fast));
    }
}

impl Watch {
    /// One watch for each error that has tested ranges.
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

    /// Advances by `dt_s` with the temperature of each sensor above the reference, K.
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

    /// Advances over a pause in which no sensor was sampled.
    pub(crate) fn stand(&mut self, stood_s: f64) {
        for watched in &mut self.sensors {
            watched.unheard_s += stood_s;
        }
    }

    /// Takes over the rates of the watch `from` for the same sensors (compared by `same`). If `from` monitors the same
    /// error, the active fraction is taken over as well.
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

    /// The temperature of a sensor above the reference, K, clamped to the tested range; unchanged if no range is stated for the sensor.
    pub(crate) fn held_k(&self, sensor: usize, over_k: f64) -> f64 {
        let mut sensors = self.sensors.iter();
        let watched = sensors.find(|watched| watched.sensor == sensor);
        watched.map_or(over_k, |watched| over_k.clamp(watched.over_k[0], watched.over_k[1]))
    }

    fn beyond_k(&self) -> f64 {
        let beyond = self.sensors.iter().filter_map(|s| s.beyond_k);
        beyond.fold(0.0, f64::max)
    }

    /// The active fraction of the terms, 0 to 1. It is 0 until every sensor has delivered a temperature, because until
    /// then a sensor may be outside its tested range.
    pub(crate) fn share(&self) -> f64 {
        self.share.unwrap_or(0.0)
    }

    /// Whether a sensor is beyond its tested range, or the terms have not fully returned since. False until the first
    /// temperature, because the terms have not started.
    pub(crate) fn is_beyond(&self) -> bool {
        self.beyond_k() > 0.0 || self.share.is_some_and(|share| share < 1.0)
    }
}
