//! How large each error is over travel, and which are zero or not stated.

use std::collections::BTreeMap;

use volcomp_curve::{ErrorCurve, Field};
use volcomp_model::{Component, ErrorName, Machine};
use volcomp_vocabulary::{AxisKind, AxisName, Direction, MAX_AXES};

use super::{Size, text::meaning};

/// Points over the travel of an axis at which a curve is looked up, besides the places that it has itself.
const STEPS: usize = 1000;

/// The same along each axis of a grid.
const GRID_STEPS: usize = 100;

/// The errors of a machine by what is known of them.
pub(super) struct Sizes {
    pub(super) there: Vec<Size>,
    pub(super) zero: Vec<ErrorName>,
    pub(super) not_stated: Vec<ErrorName>,
}

/// Every error motion of every axis and the location errors that ISO 230-1 names, axis by axis.
pub(super) fn sizes(machine: &Machine, axes: &[AxisName]) -> Sizes {
    let mut sizes = Sizes {
        there: Vec::new(),
        zero: Vec::new(),
        not_stated: Vec::new(),
    };
    for &axis in axes {
        for component in Component::ALL {
            let name = ErrorName::motion(component, axis);
            match machine.error(name) {
                Some(curve) => sizes.take(over_travel(machine, name, curve)),
                None => sizes.not_stated.push(name),
            }
        }
        for component in Component::ALL {
            let name = ErrorName::location(component, axis);
            match machine.locations().get(&name) {
                Some(&value) => sizes.take(Size {
                    name,
                    meaning: meaning(name),
                    unit: component.unit(),
                    smallest: value,
                    largest: value,
                    at: None,
                }),
                None if is_expected(name, axes) => sizes.not_stated.push(name),
                None => {}
            }
        }
    }
    sizes
}

impl Sizes {
    fn take(&mut self, size: Size) {
        if size.smallest == 0.0 && size.largest == 0.0 {
            self.zero.push(size.name);
        } else {
            self.there.push(size);
        }
    }
}

/// Whether a machine with these axes usually has the location error: squareness between X, Y and Z, shift and tilt
/// of the line of a rotary axis.
fn is_expected(name: ErrorName, axes: &[AxisName]) -> bool {
    match name.axis.kind() {
        AxisKind::Rotary => name.component.mcs_index() != name.axis.mcs_index(),
        AxisKind::Linear => {
            let reference = match (name.component, name.axis) {
                (Component::EC, AxisName::Y) | (Component::EB, AxisName::Z) => AxisName::X,
                (Component::EA, AxisName::Z) => AxisName::Y,
                _ => return false,
            };
            axes.contains(&reference)
        }
    }
}

/// Smallest and largest value of a curve over the travels of the axes that it is looked up at.
fn over_travel(machine: &Machine, name: ErrorName, curve: &ErrorCurve) -> Size {
    let axes = machine.axes();
    let own = axes.iter().position(|axis| axis.name == name.axis);
    let own = own.unwrap_or_default();
    let looked_at = arguments(curve, own);
    let steps = if looked_at.len() == 1 {
        STEPS
    } else {
        GRID_STEPS
    };
    let points: Vec<(usize, Vec<f64>)> = looked_at
        .iter()
        .filter_map(|(place, nodes)| Some((*place, points(axes.get(*place)?.travel, steps, nodes))))
        .collect();
    let mut found = Extremes::default();
    let mut coordinates = [0.0; MAX_AXES];
    every(&points, &mut coordinates, &mut |coordinates| {
        for branch in Direction::BOTH {
            found.see(curve.value(own, coordinates, Some(branch)), coordinates);
        }
    });
    let at = points
        .iter()
        .filter_map(|(place, _)| Some((axes.get(*place)?.name, found.at[*place])));
    Size {
        name,
        meaning: meaning(name),
        unit: name.component.unit(),
        smallest: found.smallest,
        largest: found.largest,
        at: Some(at.collect()),
    }
}

/// Smallest and largest value, and the coordinates of the one with the larger size.
#[derive(Default)]
struct Extremes {
    seen: bool,
    smallest: f64,
    largest: f64,
    size: f64,
    at: [f64; MAX_AXES],
}

impl Extremes {
    fn see(&mut self, value: f64, coordinates: &[f64; MAX_AXES]) {
        if !self.seen {
            (self.smallest, self.largest) = (value, value);
        }
        self.smallest = self.smallest.min(value);
        self.largest = self.largest.max(value);
        if !self.seen || value.abs() > self.size {
            (self.size, self.at) = (value.abs(), *coordinates);
        }
        self.seen = true;
    }
}

/// Visits every combination of the points.
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

/// The places of the axes that a curve is looked up at, and the places along each.
fn arguments(curve: &ErrorCurve, own: usize) -> BTreeMap<usize, Vec<f64>> {
    let mut looked_at: BTreeMap<usize, Vec<f64>> = BTreeMap::new();
    for field in curve.fields() {
        match field {
            Field::Curve(curve) => looked_at.entry(own).or_default().extend(curve.places()),
            Field::Grid(grid) => {
                for (axis, nodes) in grid.axes().into_iter().zip(grid.nodes()) {
                    looked_at.entry(axis).or_default().extend(nodes);
                }
            }
        }
    }
    looked_at
}

/// Evenly spread points of a travel with the places inside it.
fn points([low, high]: [f64; 2], steps: usize, nodes: &[f64]) -> Vec<f64> {
    let spread = (0..=steps).map(|step| low + (high - low) * (step as f64 / steps as f64));
    let inside = nodes
        .iter()
        .copied()
        .filter(|node| (low..=high).contains(node));
    spread.chain(inside).collect()
}
