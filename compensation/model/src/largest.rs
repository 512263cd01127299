//! The largest correction of each axis within the travels.

use volcomp_kinematics::{Correctors, State};
use volcomp_vocabulary::{AxisName, Direction, Displacement, PerAxis};

use crate::{Machine, ModelError, Temperatures, Thermal, Tolerance};

/// Maximum number of grid states for each direction of approach.
const STATES: usize = 4000;
/// Maximum number of places along an axis of the grid.
const PLACES: usize = 21;

impl Machine {
    /// The largest correction of each axis that corrections move, in chain order: on an even grid over the travels of all
    /// axes with their ends and, from the largest of each axis, along every axis at [`Machine::places`], approached from
    /// either side.
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
        Ok(self.largest(correctors, &delta))
    }

    /// How much the correction of each axis may change with each kelvin of the sensors, in chain order, at the same places:
    /// what each sensor changes alone, added over all sensors. Empty for a machine without thermal terms. It leaves out what
    /// terms have seen ([`Thermal::seen`]): within that it holds.
    ///
    /// # Errors
    /// A machine that cannot be compiled.
    pub fn largest_corrections_per_k(&self) -> Result<Vec<(AxisName, Displacement)>, ModelError> {
        let mut machine = self.clone();
        machine.set_thermal(Thermal {
            seen: Vec::new(),
            ..self.thermal().clone()
        })?;
        let thermal = machine.thermal();
        let sensors = thermal.sensors();
        if sensors.is_empty() {
            return Ok(Vec::new());
        }
        // One kelvin more of one sensor.
        let at = |warmer: Option<&str>| {
            let degc = |sensor: &str| {
                let more = if warmer == Some(sensor) { 1.0 } else { 0.0 };
                (sensor.to_owned(), thermal.reference_degc + more)
            };
            let temperatures: Temperatures = sensors.iter().map(|sensor| degc(sensor)).collect();
            machine.compile_at(Tolerance::default(), &temperatures)
        };
        let reference = at(None)?;
        let warmer: Vec<_> = sensors
            .iter()
            .map(|sensor| at(Some(sensor)))
            .collect::<Result<_, _>>()?;
        let correctors = reference.correctors();
        let change = |state: &State| {
            let before = reference.parts_of(state, correctors).delta();
            let mut sum = PerAxis::ZERO;
            for warmer in &warmer {
                let after = warmer.parts_of(state, correctors).delta();
                for (sum, (after, before)) in sum.iter_mut().zip(after.iter().zip(&before)) {
                    *sum += (after - before).abs();
                }
            }
            sum
        };
        Ok(self.largest(correctors, &change))
    }

    /// The largest of something of each axis that corrects.
    fn largest(
        &self,
        correctors: &Correctors,
        of: &dyn Fn(&State) -> PerAxis<f64>,
    ) -> Vec<(AxisName, Displacement)> {
        let axes = self.axes();
        let inside = |axis: usize, mm_or_deg: f64| {
            Displacement::from_coordinate(axes[axis].name.kind(), mm_or_deg).mm_or_rad()
        };
        let mut largest: PerAxis<(f64, State)> = PerAxis::from_fn(|_| (0.0, State::default()));
        let sample = |state: &State, largest: &mut PerAxis<(f64, State)>| {
            for (most, now) in largest.iter_mut().zip(of(state)) {
                // A correction that is no number is larger than every one.
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
        let mut places = PLACES;
        while places > 2 && places.saturating_pow(exponent(axes.len())) > STATES {
            places -= 1;
        }
        for direction in Direction::BOTH {
            let mut state = State::default();
            for approach in state.approach.iter_mut().take(axes.len()) {
                *approach = Some(direction);
            }
            for node in 0..places.saturating_pow(exponent(axes.len())) {
                let mut rest = node;
                for (index, axis) in axes.iter().enumerate() {
                    let [low, high] = axis.travel;
                    let share = (rest % places) as f64 / (places - 1) as f64;
                    state.q[index] = inside(index, low + (high - low) * share);
                    rest /= places;
                }
                sample(&state, &mut largest);
            }
        }
        let along = self.places();
        for corrected in (0..axes.len()).filter(|axis| correctors.contains(*axis)) {
            for (axis, places) in along.iter().enumerate() {
                let mut state = largest[corrected].1;
                for place in places {
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

fn exponent(axes: usize) -> u32 {
    u32::try_from(axes).unwrap_or(u32::MAX)
}
