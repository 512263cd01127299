//! The controller of a correction in real time: one read and one write a cycle.

use std::time::{Duration, Instant};

use volcomp_port::{Controller, Description, DeviceError, Fault, Snapshot, Supply, Words};
use volcomp_vocabulary::PerChannel;

use crate::{
    config::FocasConfig,
    link::{Inspection, Link},
    plan::Abilities,
};

/// A control that is corrected. The connection is made, and made again, on a thread of its own.
pub struct FocasController {
    description: Description,
    supply: Supply<Link>,
}

impl FocasController {
    /// Begins to connect. Why there is no connection is logged as a warning (`tracing`), too, on the thread that
    /// connects.
    ///
    /// # Errors
    /// The axes of the configuration make no sense, or there is no thread for the connection.
    pub fn new(config: FocasConfig) -> Result<Self, DeviceError> {
        let device = config.device();
        let backoff = config.backoff;
        let description = config.describe().map_err(|error| error.of(&*device))?;
        let of_device = device.clone();
        // Every trouble is logged once, not at every try.
        let mut logged = String::new();
        let open = move || {
            let opened = Link::open(&config).map_err(|error| error.of(&*of_device));
            let text = match &opened {
                Ok(link) if link.found().notes.is_empty() => String::new(),
                Ok(link) => format!("{of_device}: {}", link.found().notes.join("; ")),
                Err(error) => error.to_string(),
            };
            if !text.is_empty() && text != logged {
                tracing::warn!("{text}");
            }
            logged = text;
            opened
        };
        Ok(Self {
            description,
            supply: Supply::new(&device, backoff, open)?,
        })
    }

    /// Waits for the first connection.
    ///
    /// # Errors
    /// Why there is none: where the control refuses, with its return code in words.
    pub fn wait(&mut self, at_most: Duration) -> Result<(), DeviceError> {
        self.supply.wait(at_most).map(|_| ())
    }

    /// How often a connection was made.
    pub fn connections(&self) -> u64 {
        self.supply.opened()
    }

    /// Why there is no connection. Takes a lock: not for a cycle.
    pub fn last_error(&self) -> Option<DeviceError> {
        self.supply.last_error()
    }

    /// What the control told when the present connection was made; `None` where there is none. Allocates: not for a cycle.
    pub fn inspection(&mut self) -> Option<Inspection> {
        self.supply.current().ok().map(|link| link.found().clone())
    }

    /// In which form the control accepts requests; `None` where there is no connection.
    pub fn abilities(&mut self) -> Option<Abilities> {
        self.supply.current().ok().map(|link| link.abilities())
    }

    fn call<T>(&mut self, call: impl FnOnce(&mut Link) -> Result<T, Fault>) -> Result<T, Fault> {
        let link = self.supply.current()?;
        let result = call(link);
        if link.is_dead() || matches!(result, Err(Fault::Protocol(_))) {
            self.supply.lose();
        }
        result
    }
}

impl Controller for FocasController {
    fn description(&self) -> &Description {
        &self.description
    }

    fn read(&mut self, deadline: Instant) -> Result<Snapshot, Fault> {
        self.call(|link| link.read(deadline))
    }

    fn post(&mut self, frame: &Words, deadline: Instant) -> Result<(), Fault> {
        self.call(|link| link.post(frame, deadline))
    }

    fn apply(&mut self, corrections: &PerChannel<f64>, deadline: Instant) -> Result<(), Fault> {
        self.call(|link| link.apply(corrections, deadline))
    }
}
