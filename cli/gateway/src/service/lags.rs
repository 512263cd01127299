//! The model that runs with its lags as they are in the cycle: what a change of model moves now depends on them. State: a
//! copy of the model, which goes on with the temperatures that the cycle reports.

use std::time::Duration;

use volcomp_runtime::{Model, Report};

/// Time between two looks that is longer is not counted as time for which a sensor was missing.
const LOOKS: Duration = Duration::from_secs(1);

/// A copy of the model that follows that of the cycle.
pub(super) struct Lags {
    model: Model,
    /// For each sensor of the model its place among the temperatures.
    places: Vec<Option<usize>>,
    at: Duration,
}

impl Lags {
    /// A copy of a model, with the names of all temperatures.
    pub(super) fn new(model: &Model, names: &[String]) -> Self {
        let place = |wanted: &String| names.iter().position(|name| name == wanted);
        Self {
            places: model.sensors().iter().map(place).collect(),
            model: model.clone(),
            at: Duration::ZERO,
        }
    }

    /// Goes on with another model, as the cycle does.
    pub(super) fn replace(&mut self, model: &Model, names: &[String]) {
        let mut next = Self::new(model, names);
        next.model.carry_over(&self.model);
        next.at = self.at;
        *self = next;
    }

    /// Goes on to a report of the cycle.
    pub(super) fn follow(&mut self, report: &Report) {
        let passed = report.now.saturating_sub(self.at);
        self.at = report.now;
        let seen = passed.min(LOOKS);
        let sensor = |place: &Option<usize>| report.sensors.get((*place)?)?.degc;
        let degc: Vec<Option<f64>> = self.places.iter().map(sensor).collect();
        self.model.stand(passed.saturating_sub(seen).as_secs_f64());
        self.model.step(seen.as_secs_f64(), &degc);
    }

    /// The model with the lags of now.
    pub(super) fn model(&self) -> &Model {
        &self.model
    }
}
