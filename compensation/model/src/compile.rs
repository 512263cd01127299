use volcomp_curve::{ErrorCurve, Field, Grid};
use volcomp_evaluator::{AxisParts, CompiledMachine, MachineParts, Patch, Tolerance};
use volcomp_kinematics::{ErrorMotion, ErrorSource};
use volcomp_vocabulary::{AxisName, Component, Deg, Direction, Displacement, MAX_AXES};

use crate::{error::ModelError, machine::Machine, thermal::Temperatures};

/// Maximum deviation of a curve of [`Machine::fine_source`], nm and nrad: far below the last printed digit.
pub const FINE_CURVES_NM: f64 = 0.01;

impl Machine {
    /// The errors as [`source`](Self::source) states them, for many evaluations: with curves compiled within [`FINE_CURVES_NM`], or those of the file if
    /// they cannot be compiled.
    pub fn fine_source<'a>(
        &'a self,
        temperatures: &Temperatures,
    ) -> Box<dyn ErrorSource + Sync + 'a> {
        match self.compile_at(Tolerance::from_nm(FINE_CURVES_NM), temperatures) {
            Ok(compiled) => Box::new(compiled),
            Err(_) => Box::new(self.source(temperatures)),
        }
    }

    /// Compiles the machine for the tool in the spindle: every curve becomes piecewise cubics that deviate from it by at most `tolerance`.
    /// Thermal terms are not included.
    ///
    /// # Errors
    /// [`ModelError::Compile`]: a curve that needs more than 1 MiB or has values that are not finite, or a tolerance that is not positive.
    pub fn compile(&self, tolerance: Tolerance) -> Result<CompiledMachine, ModelError> {
        self.compile_at(tolerance, &Temperatures::new())
    }

    /// Compiles the machine with its thermal terms at steady temperatures.
    ///
    /// # Errors
    /// See [`compile`](Self::compile).
    pub fn compile_at(
        &self,
        tolerance: Tolerance,
        temperatures: &Temperatures,
    ) -> Result<CompiledMachine, ModelError> {
        let refused = |source| ModelError::Compile { machine: self.name.clone(), source };
        let mut parts = MachineParts::new(self.chain());
        for (index, axis) in self.axes().iter().enumerate() {
            let thermal = self.thermal_of(index, temperatures);
            parts = parts.axis(axis.name, self.axis_parts(index, &thermal)).map_err(refused)?;
            let assembly = ErrorMotion::from_um_urad(self.assembly(index));
            parts = parts.assembly(axis.name, assembly).map_err(refused)?;
        }
        for (&name, &value) in self.locations() {
            let value = Displacement::from_micro(name.component.kind(), value);
            parts = parts.location(name, value).map_err(refused)?;
        }
        let mut compiled = CompiledMachine::new(parts, tolerance).map_err(refused)?;
        if let Some(axes) = self.correct() {
            compiled.set_correctors(axes).map_err(refused)?;
        }
        Ok(compiled)
    }

    /// The error motion of an axis at its own coordinate (mm or deg): the sum of its curves there and of constant offsets (µm, µrad).
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
                *value += one_argument(curve, axis, &coordinates, approach);
            }
        }
        ErrorMotion::from_um_urad(six)
    }

    fn axis_parts(&self, axis: usize, thermal: &[[f64; 2]; 6]) -> AxisParts<'_> {
        let stated = &self.axes()[axis];
        let kind = stated.name.kind();
        let offsets = thermal.map(|[offset, _]| offset);
        let travel = stated.travel.map(|end| Displacement::from_coordinate(kind, end));
        let mut parts = AxisParts::new(travel, move |x, approach| {
            self.curve_errors(axis, x, approach, offsets)
        })
        // Only linear error motions of linear axes have an expansion.
        .slope_mm(core::array::from_fn(|component| thermal[component][1] * 1e-3));
        if let Some(period) = stated.modulo {
            parts = parts.modulo(Deg(period));
        }
        let name = |index: usize| self.axes().get(index).map_or(stated.name, |axis| axis.name);
        for component in Component::ALL {
            let Some(curve) = self.curve(axis, component.index()) else {
                continue;
            };
            if curve.has_directions() {
                parts = parts.bidirectional();
            }
            for (field, weights) in weighted_fields(curve) {
                match field {
                    Field::Curve(curve) => {
                        parts = parts.breakpoints(component, curve.breakpoints());
                        if let Some(domain) = curve.domain() {
                            parts = parts.range(component, stated.name, domain);
                        }
                    }
                    Field::Grid(grid) => {
                        let axes = grid.axes().map(name);
                        for (looked_at, domain) in axes.into_iter().zip(grid.domain()) {
                            parts = parts.range(component, looked_at, domain);
                        }
                        parts = parts.patch(patch(component, grid, weights, axes));
                    }
                }
            }
        }
        parts
    }
}

/// The fields of a curve, each with its weights for forward, backward and unknown approach.
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

/// Converts a grid from µm or µrad to a patch in mm or rad.
fn patch(component: Component, grid: &Grid, weights: [f64; 3], axes: [AxisName; 2]) -> Patch {
    let values = grid.values().iter().flatten();
    Patch {
        component,
        weights,
        axes,
        nodes: grid.nodes().clone(),
        values: values
            .map(|&value| Displacement::from_micro(component.kind(), value).mm_or_rad())
            .collect(),
    }
}
