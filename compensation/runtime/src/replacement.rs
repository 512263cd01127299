use std::{ops::Deref, time::Duration};

use volcomp_guard::{MAX_SENSORS, SensorReport};

use crate::model::Model;

/// A model, and the index of the temperature of each of its sensors among those of a cycle.
pub struct Replacement {
    model: Box<Model>,
    places: Vec<Option<usize>>,
    degc: Vec<Option<f64>>,
}

impl Replacement {
    /// Assigns the sensors of a model to the temperatures with these names.
    pub fn new(model: Box<Model>, names: &[String]) -> Self {
        let wanted = model.sensors();
        let places = wanted.iter().map(|wanted| names.iter().position(|name| name == wanted));
        Self { places: places.collect(), degc: vec![None; wanted.len()], model }
    }

    /// Takes over the thermal lags of the replaced model. Does not allocate.
    pub(crate) fn carry_over(&mut self, from: &Self) {
        self.model.carry_over(&from.model);
    }

    /// Advances the thermal terms by `dt` with the temperatures of a cycle, after the program was paused for `stood`. Returns whether a
    /// term lacks its sensor. Does not allocate.
    pub(crate) fn warm(
        &mut self,
        dt: Duration,
        stood: Duration,
        sensors: &[SensorReport; MAX_SENSORS],
    ) -> bool {
        for (degc, place) in self.degc.iter_mut().zip(&self.places) {
            *degc = place.and_then(|place| sensors.get(place)).and_then(|sensor| sensor.degc);
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
