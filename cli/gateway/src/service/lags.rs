//! Tracks the thermal lags of the running model, which determine the effect of replacing the model now. State: a copy
//! of the model, stepped with the temperatures that the cycle reports.

use std::time::Duration;

use volcomp_runtime::{Model, Report};

/// Maximum time between two reports for which the reported temperatures are used. Beyond it, the lags are stepped
/// without temperatures.
const MAX_REPORT_GAP: Duration = Duration::from_secs(1);

pub(super) struct Lags {
    model: Model,
    /// Index of each sensor of the model among the temperatures; `None` if no thermometer measures it.
    indices: Vec<Option<usize>>,
    at: Duration,
}

impl Lags {
    pub(super) fn new(model: &Model, names: &[String]) -> Self {
        let place = |wanted: &String| names.iter().position(|name| name == wanted);
        Self {
            indices: model.sensors().iter().map(place).collect(),
            model: model.clone(),
            at: Duration::ZERO,
        }
    }

    pub(super) fn replace(&mut self, model: &Model, names: &[String]) {
        let mut next = Self::new(model, names);
        next.model.carry_over(&self.model);
        next.at = self.at;
        *self = next;
    }

    pub(super) fn follow(&mut self, report: &Report) {
        let passed = report.now.saturating_sub(self.at);
        self.at = report.now;
        let seen = passed.min(MAX_REPORT_GAP);
        let sensor = |place: &Option<usize>| report.sensors.get((*place)?)?.degc;
        let degc: Vec<Option<f64>> = self.indices.iter().map(sensor).collect();
        self.model.stand(passed.saturating_sub(seen).as_secs_f64());
        self.model.step(seen.as_secs_f64(), &degc);
    }

    pub(super) fn model(&self) -> &Model {
        &self.model
    }
}
