//! Differences of the errors of two machines.

use std::collections::BTreeSet;

use volcomp_vocabulary::{Direction, ErrorName, MAX_AXES};

use crate::machine::Machine;

/// Number of equidistant positions along each axis at which curves are compared, in addition to the sampling positions
/// of the curves ([`Machine::places`]).
const PLACES: u32 = 41;

impl Machine {
    /// The largest absolute difference of each error between this machine and another machine with the same axes, µm or
    /// µrad. Curves are compared over the travel of their axis in this machine, for approach from both directions. All
    /// other axes, on which a grid may depend, are together at their lower ends, middles or upper ends. Errors without
    /// a difference are listed with 0. An error that one machine lacks counts as 0 there. The difference is NaN if a
    /// value is NaN.
    pub fn differences(&self, other: &Self) -> Vec<(ErrorName, f64)> {
        let names: BTreeSet<ErrorName> = [other, self]
            .into_iter()
            .flat_map(|of| {
                let motions = of.errors().map(|(name, _)| name);
                motions.chain(of.locations().keys().copied())
            })
            .collect();
        let places = [other, self].map(Machine::places);
        let by = |name: ErrorName| {
            let difference = if name.location {
                let [a, b] = [other, self].map(|of| of.locations().get(&name).copied());
                (a.unwrap_or(0.0) - b.unwrap_or(0.0)).abs()
            } else {
                of_curves(name, [other, self], &places)
            };
            (name, difference)
        };
        names.into_iter().map(by).collect()
    }
}

/// The largest absolute difference of one error motion between two machines, µm or µrad. `places` are the results of
/// [`Machine::places`] for the two machines.
fn of_curves(name: ErrorName, machines: [&Machine; 2], places: &[Vec<Vec<f64>>; 2]) -> f64 {
    let [_, machine] = machines;
    let Ok(own) = machine.index_of(name.axis) else {
        return 0.0; // both have the same axes
    };
    let curves = machines.map(|of| of.error(name));
    let at = |of_travel: f64, others: f64| {
        let mut coordinates = [0.0; MAX_AXES];
        for (index, (place, axis)) in coordinates.iter_mut().zip(machine.axes()).enumerate() {
            let [low, high] = axis.travel;
            let share = if index == own { of_travel } else { others };
            *place = low + (high - low) * share;
        }
        coordinates
    };
    let [low, high] = machine.axes()[own].travel;
    let even = (0..PLACES).map(|step| f64::from(step) / f64::from(PLACES - 1));
    let of_curves = places.iter().flat_map(|of| &of[own]);
    let of_curves = of_curves.map(|place| (place - low) / (high - low));
    let mut largest = 0.0_f64;
    for of_travel in even.chain(of_curves) {
        for others in [0.0, 0.5, 1.0] {
            let coordinates = at(of_travel, others);
            for branch in [Direction::Positive, Direction::Negative] {
                let [a, b] = curves.map(|curve| {
                    curve.map_or(0.0, |curve| curve.value(own, &coordinates, Some(branch)))
                });
                let by = (a - b).abs();
                if by.is_nan() {
                    return by;
                }
                largest = largest.max(by);
            }
        }
    }
    largest
}
