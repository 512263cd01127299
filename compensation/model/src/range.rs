//! The range of an error over the travels.

use volcomp_curve::Field;
use volcomp_vocabulary::{AxisName, Direction, ErrorName, MAX_AXES};

use crate::Machine;

/// Number of even steps over the travel of an axis at which a curve is evaluated, in addition to its own sampling coordinates.
const STEPS: usize = 1000;

/// The minimum and maximum of an error, in its unit, over the travels of all axes that it depends on, with approach from either direction.
#[derive(Clone, Debug, PartialEq)]
pub struct ErrorRange {
    /// The smallest value, µm or µrad.
    pub smallest: f64,
    /// The largest value, µm or µrad.
    pub largest: f64,
    /// Where the absolute value is largest, mm or deg of each axis that it depends on there.
    pub at: Vec<(AxisName, f64)>,
}

impl Machine {
    /// The range of an error motion; `None` if the machine does not state it.
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
                    let largest_size = range
                        .as_ref()
                        .map(|range| range.smallest.abs().max(range.largest.abs()));
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

    /// The coordinates at which a field is evaluated along each axis it depends on. A grid is bilinear: its extremes are at nodes and ends
    /// of travel.
    fn points_of(&self, field: &Field, own: usize) -> Vec<(usize, Vec<f64>)> {
        let within = |place: usize, steps: usize, places: &[f64]| {
            let [low, high] = self.axes()[place].travel;
            let even = (0..=steps).map(|step| low + (high - low) * (step as f64 / steps as f64));
            let inside = places
                .iter()
                .copied()
                .filter(|at| (low..=high).contains(at));
            (place, even.chain(inside).collect())
        };
        match field {
            Field::Curve(curve) => vec![within(own, STEPS, &curve.places())],
            Field::Grid(grid) => {
                let axes = grid.axes().into_iter().zip(grid.nodes());
                // A machine rejects grids over axes that it does not have.
                let there = axes.filter(|(place, _)| *place < self.axes().len());
                there
                    .map(|(place, nodes)| within(place, 1, nodes))
                    .collect()
            }
        }
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
