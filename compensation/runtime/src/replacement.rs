//! A model with what belongs to it in a cycle: what is exchanged when the model is.

use std::{ops::Deref, time::Duration};

use volcomp_guard::{MAX_SENSORS, SensorReport};

use crate::model::Model;

/// A model with the places of its sensors among the temperatures of a cycle.
pub struct Replacement {
    model: Box<Model>,
    /// For each sensor of the model its place among the temperatures.
    places: Vec<Option<usize>>,
    degc: Vec<Option<f64>>,
}

impl Replacement {
    /// A model for temperatures of these names.
    pub fn new(model: Box<Model>, names: &[String]) -> Self {
        let wanted = model.sensors();
        let places = wanted
            .iter()
            .map(|wanted| names.iter().position(|name| name == wanted));
        Self {
            places: places.collect(),
            degc: vec![None; wanted.len()],
            model,
        }
    }

    /// Goes on with the lags of the model that it replaces. Allocates nothing.
    pub(crate) fn carry_over(&mut self, from: &Self) {
        self.model.carry_over(&from.model);
    }

    /// Lets the thermal terms go on by `dt` with the temperatures of a cycle, after the program has stood for `stood`
    /// besides. Whether a term has to do without its sensor. Allocates nothing.
    pub(crate) fn warm(
        &mut self,
        dt: Duration,
        stood: Duration,
        sensors: &[SensorReport; MAX_SENSORS],
    ) -> bool {
        for (degc, place) in self.degc.iter_mut().zip(&self.places) {
            *degc = place
                .and_then(|place| sensors.get(place))
                .and_then(|sensor| sensor.degc);
        }
        self.model.stand(stood.as_secs_f64());
        self.model.step(dt.as_secs_f64(), &self.degc)
    }
}

impl Deref for Replacement {
    type Target = Model;

    fn deref(&self) -> &Model {
        &self.model
    }
}
