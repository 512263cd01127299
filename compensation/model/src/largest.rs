//! Largest correction of each axis within the travels.

use volcomp_kinematics::{Correctors, State};
use volcomp_vocabulary::{AxisName, Direction, Displacement, PerAxis};

use crate::{CompiledMachine, Machine, ModelError, Temperatures, Thermal, Tolerance};

/// Maximum number of grid states for each direction of approach.
const STATES: usize = 4000;
/// Maximum number of grid coordinates along an axis.
const PLACES: usize = 21;

impl Machine {
    /// The largest correction of each corrected axis, in chain order: on an even grid over the travels of all axes with their ends and,
    /// from the maximum of each axis, along every axis at [`Machine::places`], with approach from either side.
    ///
    /// # Errors
    /// A machine that cannot be compiled.
    pub fn largest_corrections(
        &self,
        temperatures: &Temperatures,
    ) -> Result<Vec<(AxisName, Displacement)>, ModelError> {
        let compiled = self.compile_at(Tolerance::default(), temperatures)?;
        let correctors = compiled.correctors();
        let delta = |state: &State| compiled.parts_of(state, correctors).delta();
        Ok(self.largest_within_travels(correctors, &PerAxis::default(), &delta))
    }

    /// Maximum change of the correction of each axis per kelvin of the sensors, in chain order, at the same coordinates as
    /// `largest_corrections`. Empty for a machine without thermal terms.
    ///
    /// # Errors
    /// A machine that cannot be compiled.
    pub fn largest_corrections_per_k(&self) -> Result<Vec<(AxisName, Displacement)>, ModelError> {
        let Some(kelvin) = self.each_kelvin()? else {
            return Ok(Vec::new());
        };
        let correctors = kelvin.reference.correctors();
        let change = |state: &State| kelvin.change(state, correctors);
        Ok(self.largest_within_travels(correctors, &PerAxis::default(), &change))
    }

    /// The effect of one kelvin at each sensor; `None` for a machine without thermal terms. It ignores the tested ranges
    /// ([`Thermal::seen`]), so it holds within them only.
    ///
    /// # Errors
    /// A machine that cannot be compiled.
    pub fn each_kelvin(&self) -> Result<Option<EachKelvin>, ModelError> {
        let mut machine = self.clone();
        machine.set_thermal(Thermal {
            seen: Vec::new(),
            ..self.thermal().clone()
        })?;
        let thermal = machine.thermal();
        let sensors = thermal.sensors();
        if sensors.is_empty() {
            return Ok(None);
        }
        // One sensor warmer by one kelvin.
        let at = |warmer: Option<&str>| {
            let degc = |sensor: &str| {
                let more = if warmer == Some(sensor) { 1.0 } else { 0.0 };
                (sensor.to_owned(), thermal.reference_degc + more)
            };
            let temperatures: Temperatures = sensors.iter().map(|sensor| degc(sensor)).collect();
            machine.compile_at(Tolerance::default(), &temperatures)
        };
        let warmer = sensors.iter().map(|sensor| at(Some(sensor)));
        Ok(Some(EachKelvin {
            reference: at(None)?,
            warmer: warmer.collect::<Result<_, _>>()?,
        }))
    }

    /// The maximum of a quantity (mm, rad) of each corrected axis, in chain order: on an even grid over the travels of all axes with their
    /// ends, except those `fixed` at a coordinate (mm, rad), and, from the maximum of each axis, along every axis at [`Machine::places`],
    /// with approach from either side. NaN counts as larger than every number.
    pub fn largest_within_travels(
        &self,
        correctors: &Correctors,
        fixed: &PerAxis<Option<f64>>,
        of: &dyn Fn(&State) -> PerAxis<f64>,
    ) -> Vec<(AxisName, Displacement)> {
        let axes = self.axes();
        let inside = |axis: usize, mm_or_deg: f64| {
            Displacement::from_coordinate(axes[axis].name.kind(), mm_or_deg).mm_or_rad()
        };
        let moves: Vec<usize> = (0..axes.len()).filter(|i| fixed[*i].is_none()).collect();
        let held = |direction: Direction| State {
            q: PerAxis::from_fn(|axis| fixed[axis].unwrap_or_default()),
            approach: PerAxis::from_fn(|axis| (axis < axes.len()).then_some(direction)),
        };
        let mut largest: PerAxis<(f64, State)> =
            PerAxis::from_fn(|_| (0.0, held(Direction::Positive)));
        let sample = |state: &State, largest: &mut PerAxis<(f64, State)>| {
            for (most, now) in largest.iter_mut().zip(of(state)) {
                let now = if now.is_nan() {
                    f64::INFINITY
                } else {
                    now.abs()
                };
                if now > most.0 {
                    *most = (now, *state);
                }
            }
        };
        let exponent = u32::try_from(moves.len()).unwrap_or(u32::MAX);
        let mut places = PLACES;
        while places > 2 && places.saturating_pow(exponent) > STATES {
            places -= 1;
        }
        for direction in Direction::BOTH {
            let mut state = held(direction);
            for node in 0..places.saturating_pow(exponent) {
                let mut rest = node;
                for &axis in &moves {
                    let [low, high] = axes[axis].travel;
                    let share = (rest % places) as f64 / (places - 1) as f64;
                    state.q[axis] = inside(axis, low + (high - low) * share);
                    rest /= places;
                }
                sample(&state, &mut largest);
            }
        }
        let along = self.places();
        for corrected in (0..axes.len()).filter(|axis| correctors.contains(*axis)) {
            for &axis in &moves {
                let mut state = largest[corrected].1;
                for place in &along[axis] {
                    state.q[axis] = inside(axis, *place);
                    sample(&state, &mut largest);
                }
            }
        }
        let found = axes.iter().zip(largest).enumerate();
        found
            .filter(|(index, _)| correctors.contains(*index))
            .map(|(_, (axis, (most, _)))| (axis.name, Displacement::new(axis.name.kind(), most)))
            .collect()
    }
}

/// A machine at its reference temperature, and with each sensor one kelvin warmer.
pub struct EachKelvin {
    reference: CompiledMachine,
    warmer: Vec<CompiledMachine>,
}

impl EachKelvin {
    /// Maximum change of the correction of each axis (mm, rad) for one kelvin of every sensor: the sum of the effects of the single sensors.
    pub fn change(&self, state: &State, correctors: &Correctors) -> PerAxis<f64> {
        let correction = |machine: &CompiledMachine| machine.parts_of(state, correctors).delta();
        let before = correction(&self.reference);
        let mut sum = PerAxis::ZERO;
        for warmer in &self.warmer {
            for (sum, (after, before)) in
                (sum.iter_mut()).zip(correction(warmer).iter().zip(&before))
            {
                *sum += (after - before).abs();
            }
        }
        sum
    }
}
