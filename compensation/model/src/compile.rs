//! From a machine to its compiled form.

use volcomp_curve::{ErrorCurve, Field, Grid};
use volcomp_evaluator::{AxisParts, Branches, CompiledMachine, MachineParts, Patch, Tolerance};
use volcomp_kinematics::ErrorMotion;
use volcomp_vocabulary::{Component, Direction, MAX_AXES};

use crate::{error::ModelError, machine::Machine, source::branch, thermal::Temperatures};

impl Machine {
    /// The machine with every curve as piecewise cubics within `tolerance` of it, for the tool that is
    /// in the spindle; without thermal terms.
    ///
    /// # Errors
    /// [`ModelError::Compile`]: a curve that needs more than 1 MiB, a tolerance that is not positive.
    pub fn compile(&self, tolerance: Tolerance) -> Result<CompiledMachine, ModelError> {
        self.compile_at(tolerance, &Temperatures::new())
    }

    /// The same with the thermal terms at steady temperatures.
    ///
    /// # Errors
    /// As [`compile`](Self::compile).
    pub fn compile_at(
        &self,
        tolerance: Tolerance,
        temperatures: &Temperatures,
    ) -> Result<CompiledMachine, ModelError> {
        let thermal = |axis: usize| self.thermal_of(axis, temperatures);
        let thermal: Vec<_> = (0..self.axes().len()).map(thermal).collect();
        let raw: Vec<_> = thermal
            .iter()
            .enumerate()
            .map(|(axis, six)| {
                let offsets = six.map(|[offset, _]| offset);
                move |x: f64, approach: Option<Direction>| {
                    self.curve_errors(axis, x, approach, offsets)
                }
            })
            .collect();
        let axes = raw.iter().enumerate();
        let parts = MachineParts {
            chain: self.chain(),
            axes: axes
                .map(|(axis, errors)| self.axis_parts(axis, errors, &thermal[axis]))
                .collect(),
            location: core::array::from_fn(|axis| self.location_of(axis)),
            assembly: core::array::from_fn(|axis| ErrorMotion::from_um_urad(self.assembly(axis))),
        };
        CompiledMachine::new(parts, tolerance).map_err(|error| ModelError::Compile {
            machine: self.name.clone(),
            error,
        })
    }

    /// What the curves over the axis's own coordinate (mm or deg) give, on top of offsets (um, urad).
    fn curve_errors(
        &self,
        axis: usize,
        x: f64,
        approach: Option<Direction>,
        offsets: [f64; 6],
    ) -> ErrorMotion {
        let mut coordinates = [0.0; MAX_AXES];
        coordinates[axis] = x;
        let mut six = offsets;
        for (component, value) in six.iter_mut().enumerate() {
            if let Some(curve) = self.curve(axis, component) {
                *value += one_argument(curve, axis, &coordinates, branch(approach));
            }
        }
        ErrorMotion::from_um_urad(six)
    }

    fn axis_parts<'a>(
        &'a self,
        axis: usize,
        errors: &'a dyn Fn(f64, Option<Direction>) -> ErrorMotion,
        thermal: &[[f64; 2]; 6],
    ) -> AxisParts<'a> {
        let stated = &self.axes()[axis];
        let mut parts = AxisParts {
            errors,
            branches: Branches::One,
            breakpoints: Default::default(),
            // Only linear error motions of linear axes expand.
            slope_mm: core::array::from_fn(|component| thermal[component][1] * 1e-3),
            travel: stated.travel,
            modulo: stated.modulo,
            patches: Vec::new(),
            ranges: Vec::new(),
        };
        for component in 0..Component::ALL.len() {
            let Some(curve) = self.curve(axis, component) else {
                continue;
            };
            if !matches!(curve, ErrorCurve::Single(_)) {
                parts.branches = Branches::Three;
            }
            for (field, weights) in weighted_fields(curve) {
                match field {
                    Field::Curve(curve) => {
                        parts.breakpoints[component].extend(curve.breakpoints());
                        let range = curve.domain().map(|domain| (component, axis, domain));
                        parts.ranges.extend(range);
                    }
                    Field::Grid(grid) => {
                        let looked_at = grid.axes().into_iter().zip(grid.domain());
                        parts
                            .ranges
                            .extend(looked_at.map(|(at, range)| (component, at, range)));
                        parts.patches.push(patch(component, grid, weights));
                    }
                }
            }
        }
        parts
    }
}

/// The fields of a curve with their weights forward, backward and with unknown approach.
fn weighted_fields(curve: &ErrorCurve) -> Vec<(&Field, [f64; 3])> {
    match curve {
        ErrorCurve::Single(field) | ErrorCurve::Reversal { mean: field, .. } => {
            vec![(field, [1.0; 3])]
        }
        ErrorCurve::Pair { forward, backward } => {
            vec![(forward, [1.0, 0.0, 0.5]), (backward, [0.0, 1.0, 0.5])]
        }
    }
}

/// A curve without its parts over two arguments: the reversal stays.
fn one_argument(
    curve: &ErrorCurve,
    own: usize,
    coordinates: &[f64],
    branch: Option<Direction>,
) -> f64 {
    let on_grids: f64 = weighted_fields(curve)
        .into_iter()
        .filter(|(field, _)| matches!(field, Field::Grid(_)))
        .map(|(field, weights)| {
            let weight = match branch {
                Some(Direction::Positive) => weights[0],
                Some(Direction::Negative) => weights[1],
                None => weights[2],
            };
            weight * field.value(own, coordinates)
        })
        .sum();
    curve.value(own, coordinates, branch) - on_grids
}

/// A grid in µm or µrad as a patch in mm or rad.
fn patch(component: usize, grid: &Grid, weights: [f64; 3]) -> Patch {
    let to_internal = if component < 3 { 1e-3 } else { 1e-6 };
    let values = grid.values().iter().flatten();
    Patch {
        component,
        weights,
        axes: grid.axes(),
        nodes: grid.nodes().clone(),
        values: values.map(|value| value * to_internal).collect(),
    }
}
