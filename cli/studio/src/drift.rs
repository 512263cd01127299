//! Drift of a machine: its earlier models in comparison with the newest.

use std::collections::BTreeSet;

use serde::Serialize;
use volcomp_model::Machine;
use volcomp_report::{Report, Stated};
use volcomp_vocabulary::{Direction, ErrorName};

use crate::{
    error::StudioError,
    folder::{FITTED, Folder},
};

/// Number of equidistant positions at which curves are compared.
const POINTS: usize = 241;

/// A model of the folder in comparison with the newest.
#[derive(Clone, Debug, Serialize)]
pub struct ModelDrift {
    /// Largest volumetric error after best-fit rigid-body alignment, µm, as in the verdict on V.
    pub position_um: Option<f64>,
    /// The errors that differ from the newest model. The largest effect comes first, for angles on the diagonal of the travels.
    pub changes: Vec<ErrorChange>,
}

/// Difference of an error between two models.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ErrorChange {
    /// Name of the error.
    pub error: String,
    /// Largest difference over the travel, µm or µrad.
    pub largest: f64,
    /// `µm` or `µrad`.
    pub unit: &'static str,
}

impl Folder {
    /// Compares a model with `result/machine.toml`: that file itself, or one of [`State::models`](crate::State::models).
    ///
    /// # Errors
    /// There is no result; an unknown model, or one of another geometry.
    pub fn drift(&self, name: &str) -> Result<ModelDrift, StudioError> {
        if !self.at(FITTED).exists() {
            return Err(StudioError::NoResult);
        }
        let newest = Machine::read(self.at(FITTED))?;
        let model = if name == FITTED { newest.clone() } else { self.earlier(name, &newest)? };
        let mut report = Report::of_machine(name, &model, &Stated::default());
        report.add_working_space(&model, None, &|| self.interrupt.is_cancelled())?;
        self.interrupt.check()?;
        let position_um = report.volume.map(|volume| volume.before.found.form_max_um);
        Ok(ModelDrift { position_um, changes: changes(&model, &newest) })
    }
}

fn changes(model: &Machine, newest: &Machine) -> Vec<ErrorChange> {
    let both = [model, newest];
    let motions: BTreeSet<ErrorName> =
        both.into_iter().flat_map(Machine::errors).map(|(error, _)| error).collect();
    let motions = motions.into_iter().map(|error| (error, of_curve(error, both)));
    let locations: BTreeSet<&ErrorName> =
        both.into_iter().flat_map(|of| of.locations().keys()).collect();
    let locations = locations.into_iter().map(|error| {
        let [then, now] = both.map(|of| of.locations().get(error).copied().unwrap_or_default());
        (*error, (now - then).abs())
    });
    let lever_m = 1e-3 * newest.diagonal_of_travels_mm();
    let effect_um = |error: ErrorName, largest: f64| {
        if error.component.is_angular() { largest * lever_m } else { largest }
    };
    let mut all: Vec<_> = motions.chain(locations).filter(|(_, largest)| *largest != 0.0).collect();
    all.sort_by(|(a, x), (b, y)| effect_um(*b, *y).total_cmp(&effect_um(*a, *x)));
    let named = all.into_iter().map(|(error, largest)| ErrorChange {
        error: error.to_string(),
        largest,
        unit: error.component.symbol(),
    });
    named.collect()
}

/// Largest difference of an error motion over the travel of its axis and both directions, the other axes nearest to 0.
fn of_curve(error: ErrorName, both: [&Machine; 2]) -> f64 {
    let [_, newest] = both;
    let (Some(axis), Ok(own)) = (newest.axis(error.axis), newest.index_of(error.axis)) else {
        return 0.0;
    };
    let mut at: Vec<f64> = newest.axes().iter().map(volcomp_model::Axis::nearest_zero).collect();
    let mut largest = 0.0_f64;
    for place in axis.nodes(POINTS) {
        at[own] = place;
        for direction in Direction::BOTH {
            let [then, now] = both.map(|of| {
                of.error(error).map_or(0.0, |curve| curve.value(own, &at, Some(direction)))
            });
            largest = largest.max((now - then).abs());
        }
    }
    largest
}
