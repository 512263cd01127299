//! A digital port that is only described.

use std::time::{Duration, Instant};

use crate::{DigitalIo, Fault, InputLevels};

/// A digital port that is described and not opened: what is built on it can be checked, and every exchange fails with
/// [`Fault::NotConnected`].
#[derive(Clone, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct UnopenedLines {
    /// The device as the configuration names it.
    pub device: String,
    /// The number of inputs.
    pub inputs: u32,
    /// The number of outputs.
    pub outputs: u32,
    /// The shortest time that an exchange takes.
    pub shortest_cycle: Duration,
}

impl DigitalIo for UnopenedLines {
    fn device(&self) -> &str {
        &self.device
    }

    fn inputs(&self) -> u32 {
        self.inputs
    }

    fn outputs(&self) -> u32 {
        self.outputs
    }

    fn shortest_cycle(&self) -> Duration {
        self.shortest_cycle
    }

    fn read(&mut self, _deadline: Instant) -> Result<InputLevels, Fault> {
        Err(Fault::NotConnected)
    }

    fn write(&mut self, _levels: u64, _deadline: Instant) -> Result<(), Fault> {
        Err(Fault::NotConnected)
    }

    fn confirmed(&self) -> Option<u64> {
        None
    }
}
