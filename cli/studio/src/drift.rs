//! Drift of a machine: earlier models in comparison with the newest one.

use serde::Serialize;
use volcomp_model::Machine;
use volcomp_report::{Report, Stated};
use volcomp_vocabulary::ErrorName;

use crate::{
    error::StudioError,
    folder::{FITTED, Folder},
};

/// A model of the folder in comparison with the newest one.
#[derive(Clone, Debug, Serialize)]
pub struct ModelDrift {
    /// Largest volumetric error after best-fit rigid-body alignment, µm, as in the verdict on V.
    pub position_um: Option<f64>,
    /// The errors that differ from the newest model, the largest effect first. The effect of an angle is its
    /// displacement over the diagonal of the travels.
    pub changes: Vec<ErrorChange>,
}

/// Difference of an error between two models.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ErrorChange {
    pub error: String,
    /// Largest difference over the travel, µm or µrad.
    pub largest: f64,
    /// `µm` or `µrad`.
    pub unit: &'static str,
}

impl Folder {
    /// Compares a model with `result/machine.toml`. The model is that file itself or one of
    /// [`State::models`](crate::State::models).
    ///
    /// # Errors
    /// There is no result, the model is unknown, or it has another geometry.
    pub fn drift(&self, name: &str) -> Result<ModelDrift, StudioError> {
        if !self.at(FITTED).exists() {
            return Err(StudioError::NoResult);
        }
        let newest = Machine::read(self.at(FITTED))?;
        let model = if name == FITTED { newest.clone() } else { self.earlier(name, &newest)? };
        let mut report = Report::of_machine(name, &model, &Stated::default());
        report.add_working_space(&model, None, None, &[], &|| self.interrupt.is_cancelled())?;
        self.interrupt.check()?;
        let position_um = report.volume.map(|volume| volume.before.found.form_max_um);
        Ok(ModelDrift { position_um, changes: changes(&model, &newest) })
    }
}

fn changes(model: &Machine, newest: &Machine) -> Vec<ErrorChange> {
    let lever_m = 1e-3 * newest.diagonal_of_travels_mm();
    let effect_um = |(error, largest): &(ErrorName, f64)| {
        if error.component.is_angular() { *largest * lever_m } else { *largest }
    };
    let mut all = newest.differences(model);
    all.retain(|(_, largest)| *largest != 0.0);
    all.sort_by(|a, b| effect_um(b).total_cmp(&effect_um(a)));
    let named = all.into_iter().map(|(error, largest)| ErrorChange {
        error: error.to_string(),
        largest,
        unit: error.component.symbol(),
    });
    named.collect()
}
