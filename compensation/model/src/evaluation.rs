//! Evaluation of a machine at a state: error, correction, and curves and axes outside their ranges.

use std::collections::BTreeMap;

use volcomp_kinematics::{
    Correction, CorrectionOptions, Form, State, VolumetricError, correct, volumetric_error,
};
use volcomp_vocabulary::{AxisName, Displacement, ErrorName, MAX_AXES};

use crate::{
    axis::Axis, error::ModelError, machine::Machine, source::MachineErrors, thermal::Temperatures,
};

/// Maximum coordinate, mm or deg: beyond it the products of a chain lose the micrometre, and soon every digit.
const MOST_COORDINATE: f64 = 1e9;

impl Machine {
    /// A state from coordinates in mm and deg; axes not named are at 0, approach unknown.
    ///
    /// # Errors
    /// [`ModelError::NoSuchAxis`]; [`ModelError::Coordinate`] for a coordinate that is not a number from −1e9 to 1e9 mm or deg;
    /// [`ModelError::AxisTwice`] for an axis with two coordinates.
    pub fn state(&self, coordinates: &[(AxisName, f64)]) -> Result<State, ModelError> {
        let mut state = State::default();
        for (place, &(axis, found)) in coordinates.iter().enumerate() {
            let index = self.index_of(axis)?;
            // Also rejects NaN.
            if !(-MOST_COORDINATE..=MOST_COORDINATE).contains(&found) {
                return Err(ModelError::Coordinate { axis, found });
            }
            if coordinates[..place]
                .iter()
                .any(|(before, _)| *before == axis)
            {
                return Err(ModelError::AxisTwice { axis });
            }
            state.q[index] = Displacement::from_coordinate(axis.kind(), found).mm_or_rad();
        }
        Ok(state)
    }

    /// The coordinates of every axis at a state, mm and deg.
    pub fn coordinates(&self, state: &State) -> BTreeMap<AxisName, f64> {
        let axes = self.axes().iter().zip(&state.q);
        axes.map(|(axis, &q)| {
            (
                axis.name,
                Displacement::new(axis.name.kind(), q).mm_or_deg(),
            )
        })
        .collect()
    }

    /// The errors as an `ErrorSource` of kinematics, at steady temperatures.
    pub fn source(&self, temperatures: &Temperatures) -> MachineErrors<'_> {
        MachineErrors::new(self, temperatures)
    }

    /// The volumetric error (mm, rad, workpiece axes) at a state.
    pub fn error_at(
        &self,
        state: &State,
        form: Form,
        temperatures: &Temperatures,
    ) -> VolumetricError {
        volumetric_error(self.chain(), &self.source(temperatures), state, form)
    }

    /// The correction options of the machine file: its key `correct`, else the defaults.
    pub fn correction_options(&self) -> CorrectionOptions {
        CorrectionOptions {
            // A machine has at most one axis for each letter, so the list fits.
            correct: self
                .correct()
                .map(|axes| axes.iter().copied().take(MAX_AXES).collect()),
            ..CorrectionOptions::default()
        }
    }

    /// The correction at a command: the displacement to add to it. If `options` name no axes, the axes of the machine file's key `correct`
    /// are used.
    pub fn correction_at(
        &self,
        state: &State,
        temperatures: &Temperatures,
        options: &CorrectionOptions,
    ) -> Correction {
        let source = self.source(temperatures);
        if options.correct.is_some() || self.correct().is_none() {
            return correct(self.chain(), &source, state, options);
        }
        let options = CorrectionOptions {
            correct: self.correction_options().correct,
            ..options.clone()
        };
        correct(self.chain(), &source, state, &options)
    }

    /// The error motions whose curves are evaluated outside their range at a state, sorted by name.
    pub fn outside_range(&self, state: &State) -> Vec<ErrorName> {
        let coordinates = self.curve_coordinates(state);
        let mut outside: Vec<ErrorName> = self
            .errors()
            .filter(|(name, curve)| {
                let own = self.chain().structure().index_of(name.axis).unwrap_or(0);
                !curve.contains(own, &coordinates[..])
            })
            .map(|(name, _)| name)
            .collect();
        outside.sort_unstable_by_key(ErrorName::to_string);
        outside
    }

    /// The axes outside their travel at a state, in chain order.
    pub fn outside_travel(&self, state: &State) -> Vec<AxisName> {
        let outside = |&(axis, &q): &(&Axis, &f64)| {
            let coordinate = Displacement::new(axis.name.kind(), q).mm_or_deg();
            !axis.may_stand_at(coordinate)
        };
        let stands = self.axes().iter().zip(&state.q);
        stands.filter(outside).map(|(axis, _)| axis.name).collect()
    }
}
