//! Real-time controller: one read and one write per cycle.

use std::time::{Duration, Instant};

use volcomp_port::{Controller, Description, DeviceError, Fault, Snapshot, Supply, Words};
use volcomp_vocabulary::PerChannel;

use crate::{
    config::FocasConfig,
    link::{Inspection, Link},
    plan::Abilities,
};

/// Reads and corrects a control by one read and one write per cycle. A separate thread connects and reconnects.
pub struct FocasController {
    description: Description,
    supply: Supply<Link>,
}

impl FocasController {
    /// Starts to connect in the background. The connecting thread also logs connection errors as warnings (`tracing`).
    ///
    /// # Errors
    /// The axes of the configuration are invalid, or no thread can be started for the connection.
    pub fn new(config: FocasConfig) -> Result<Self, DeviceError> {
        let device = config.device();
        let backoff = config.backoff;
        let description = config.describe().map_err(|error| error.of(&*device))?;
        let of_device = device.clone();
        // Log the same error once only, not at every attempt.
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
        Ok(Self { description, supply: Supply::new(&device, backoff, open)? })
    }

    /// Waits until the first connection is open.
    ///
    /// # Errors
    /// There is no connection within `at_most`. The error is that of the last attempt. If the control rejected the
    /// attempt, it contains the return code and its meaning.
    pub fn wait(&mut self, at_most: Duration) -> Result<(), DeviceError> {
        self.supply.wait(at_most).map(|_| ())
    }

    /// Number of connections opened so far.
    pub fn connections(&self) -> u64 {
        self.supply.opened()
    }

    /// Error of the last connection attempt; `None` if the attempt succeeded. Takes a lock, so do not call this in a
    /// cycle.
    pub fn last_error(&self) -> Option<DeviceError> {
        self.supply.last_error()
    }

    /// Properties that the control reported when the present connection was opened; `None` without a connection.
    /// Allocates, so do not call this in a cycle.
    pub fn inspection(&mut self) -> Option<Inspection> {
        self.supply.current().ok().map(|link| link.found().clone())
    }

    /// Request forms that the control accepts; `None` without a connection.
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
