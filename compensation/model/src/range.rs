//! Sizes of errors over the travels: the range of each, what a kelvin changes, and the differences between two machines.

use std::collections::BTreeSet;

use volcomp_curve::{Curve, Field};
use volcomp_kinematics::{Correctors, State};
use volcomp_vocabulary::{AxisName, Direction, Displacement, ErrorName, MAX_AXES, PerAxis};

use crate::{
    CompiledMachine, Thermal, Tolerance, error::ModelError, machine::Machine, thermal::Temperatures,
};

/// Number of even steps over the travel of an axis at which a curve is evaluated, in addition to the sampling
/// coordinates of the curve.
const STEPS: usize = 1000;

/// The minimum and maximum of an error, in its unit, over the travels of the axes on which it depends and over both directions of approach.
#[derive(Clone, Debug, PartialEq)]
pub struct ErrorRange {
    /// The smallest value, µm or µrad.
    pub smallest: f64,
    /// The largest value, µm or µrad.
    pub largest: f64,
    /// Coordinates at which the absolute value is largest, mm or deg, of the axes on which the
    /// error depends.
    pub at: Vec<(AxisName, f64)>,
}

impl Machine {
    /// The range of an error motion; `None` if the machine does not have it.
    pub fn range_of(&self, error: ErrorName) -> Option<ErrorRange> {
        let curve = self.error(error)?;
        let own = self.index_of(error.axis).ok()?;
        let mut range: Option<ErrorRange> = None;
        for field in curve.fields() {
            let points = self.points_of(field, own);
            let mut coordinates = [0.0; MAX_AXES];
            every(&points, &mut coordinates, &mut |coordinates| {
                for direction in Direction::BOTH {
                    let value = curve.value(own, coordinates, Some(direction));
                    let largest_size =
                        range.as_ref().map(|range| range.smallest.abs().max(range.largest.abs()));
                    let range = range.get_or_insert_with(|| ErrorRange {
                        smallest: value,
                        largest: value,
                        at: Vec::new(),
                    });
                    range.smallest = range.smallest.min(value);
                    range.largest = range.largest.max(value);
                    if largest_size.is_none_or(|size| value.abs() > size) {
                        let at = points
                            .iter()
                            .map(|(place, _)| (self.axes()[*place].name, coordinates[*place]));
                        range.at = at.collect();
                    }
                }
            });
        }
        range
    }

    /// The coordinates at which a field is evaluated along each axis on which it depends. A grid is bilinear, so its extremes are at nodes
    /// and ends of travel.
    fn points_of(&self, field: &Field, own: usize) -> Vec<(usize, Vec<f64>)> {
        let within = |place: usize, steps: usize, places: &[f64]| {
            let [low, high] = self.axes()[place].travel;
            let even = (0..=steps).map(|step| low + (high - low) * (step as f64 / steps as f64));
            let inside = places.iter().copied().filter(|at| (low..=high).contains(at));
            (place, even.chain(inside).collect())
        };
        match field {
            Field::Curve(curve) => vec![within(own, STEPS, &curve.places())],
            Field::Grid(grid) => {
                let axes = grid.axes().into_iter().zip(grid.nodes());
                // A machine rejects grids over axes that it lacks.
                let there = axes.filter(|(place, _)| *place < self.axes().len());
                there.map(|(place, nodes)| within(place, 1, nodes)).collect()
            }
        }
    }
}

fn every(
    points: &[(usize, Vec<f64>)],
    coordinates: &mut [f64; MAX_AXES],
    visit: &mut impl FnMut(&[f64; MAX_AXES]),
) {
    let Some(((place, values), others)) = points.split_first() else {
        visit(coordinates);
        return;
    };
    for value in values {
        coordinates[*place] = *value;
        every(others, coordinates, visit);
    }
}

impl Machine {
    /// Arguments at which the machine's curves and grids may change abruptly, along each axis, mm or deg
    /// ([`Curve::breakpoints`](volcomp_curve::Curve::breakpoints)), inside and outside the travel. Ascending, without duplicates.
    pub fn nodes(&self) -> Vec<Vec<f64>> {
        self.along_axes(Curve::breakpoints)
    }

    /// The coordinates along each axis, mm or deg, at which the machine's curves must be sampled: their nodes, and
    /// points between the nodes as required by the kind of curve ([`Curve::places`](volcomp_curve::Curve::places)).
    /// Equidistant samples alone could sample a periodic screw error only at its zeros. Within the travel, ends
    /// included; ascending, without duplicates.
    pub fn places(&self) -> Vec<Vec<f64>> {
        let mut places = self.along_axes(Curve::places);
        for (places, axis) in places.iter_mut().zip(self.axes()) {
            let [low, high] = axis.travel;
            places.retain(|place| (low..=high).contains(place));
            places.extend([low, high]);
            in_order(places);
        }
        places
    }

    /// Along each axis, the coordinates that `of` returns for the curves of the axis, and the nodes of grids.
    fn along_axes(&self, of: fn(&Curve) -> Vec<f64>) -> Vec<Vec<f64>> {
        let mut along = vec![Vec::new(); self.axes().len()];
        for (name, curve) in self.errors() {
            for field in curve.fields() {
                match field {
                    Field::Curve(curve) => {
                        let own = self.index_of(name.axis).ok();
                        if let Some(along) = own.and_then(|own| along.get_mut(own)) {
                            along.extend(of(curve));
                        }
                    }
                    Field::Grid(grid) => {
                        for (axis, nodes) in grid.axes().into_iter().zip(grid.nodes()) {
                            if let Some(along) = along.get_mut(axis) {
                                along.extend(nodes);
                            }
                        }
                    }
                }
            }
        }
        for along in &mut along {
            in_order(along);
        }
        along
    }
}

pub(crate) fn in_order(places: &mut Vec<f64>) {
    places.sort_by(f64::total_cmp);
    places.dedup();
}

const STATES: usize = 4000;
const PLACES: usize = 21;

impl Machine {
    /// The largest correction of each correcting axis, in chain order. The search evaluates an even grid over the travels of all axes, ends included,
    /// with approach from either side; from the maximum of each axis it then scans every axis at [`Machine::places`].
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

    /// Maximum change of the correction of each axis per kelvin of the sensors, in chain order, at the coordinates of
    /// [`largest_corrections`](Self::largest_corrections). Empty without thermal terms.
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

    /// The effect of one kelvin at each sensor; `None` without thermal terms. The tested ranges ([`Thermal::seen`]) are
    /// ignored, but the result is valid only within them.
    ///
    /// # Errors
    /// A machine that cannot be compiled.
    pub fn each_kelvin(&self) -> Result<Option<EachKelvin>, ModelError> {
        let mut machine = self.clone();
        machine.set_thermal(Thermal { seen: Vec::new(), ..self.thermal().clone() })?;
        let thermal = machine.thermal();
        let sensors = thermal.sensors();
        if sensors.is_empty() {
            return Ok(None);
        }
        // The sensor `warmer` is one kelvin above the reference temperature, and all other sensors are at that
        // temperature.
        let at = |warmer: Option<&str>| {
            let degc = |sensor: &str| {
                let more = if warmer == Some(sensor) { 1.0 } else { 0.0 };
                (sensor.to_owned(), thermal.reference_degc + more)
            };
            let temperatures: Temperatures = sensors.iter().map(|sensor| degc(sensor)).collect();
            machine.compile_at(Tolerance::default(), &temperatures)
        };
        let warmer = sensors.iter().map(|sensor| at(Some(sensor)));
        Ok(Some(EachKelvin { reference: at(None)?, warmer: warmer.collect::<Result<_, _>>()? }))
    }

    /// The maximum absolute value of `of` (mm, rad) for each correcting axis, in chain order. The search evaluates an
    /// even grid over the travels of all axes, ends included, with approach from either side; from the maximum of each
    /// axis it then scans every axis at [`Machine::places`]. Axes `fixed` at a coordinate (mm, rad) do not move. NaN
    /// counts as infinite.
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
                let now = if now.is_nan() { f64::INFINITY } else { now.abs() };
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

/// A machine at its reference temperature, and with each sensor warmer by one kelvin.
pub struct EachKelvin {
    reference: CompiledMachine,
    warmer: Vec<CompiledMachine>,
}

impl EachKelvin {
    /// Maximum change of the correction of each axis (mm, rad) if every sensor changes by one kelvin in either
    /// direction: the sum of the absolute effects of the sensors.
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

/// Number of equidistant positions along each axis at which curves are compared, in addition to the sampling positions
/// of the curves ([`Machine::places`]).
const COMPARED_PLACES: u32 = 41;

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
    let even = (0..COMPARED_PLACES).map(|step| f64::from(step) / f64::from(COMPARED_PLACES - 1));
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
