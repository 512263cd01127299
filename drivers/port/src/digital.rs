//! The interface to digital inputs and outputs.

use std::time::{Duration, Instant};

use crate::Fault;

/// The levels of all inputs, bit 0 the first line, and when they were so.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct InputLevels {
    /// The levels.
    pub levels: u64,
    /// When the oldest part of them came from the device; not when they were asked for here.
    pub taken: Instant,
}

impl InputLevels {
    /// Levels that are read now.
    pub fn now(levels: u64) -> Self {
        Self {
            levels,
            taken: Instant::now(),
        }
    }
}

/// Digital inputs and outputs, at most 64 of each: bit 0 is the first line.
#[cfg_attr(feature = "mock", mockall::automock)]
pub trait DigitalIo: Send {
    /// The device as the configuration names it.
    fn device(&self) -> &str;

    /// How many inputs there are.
    fn inputs(&self) -> u32;

    /// How many outputs there are.
    fn outputs(&self) -> u32;

    /// The shortest time that an exchange takes: how fast anything built on it can be.
    fn shortest_cycle(&self) -> Duration;

    /// All inputs at one instant, as far as the device can: those that were received last, with the time at which they came,
    /// however long ago.
    ///
    /// # Errors
    /// See [`Fault`].
    fn read(&mut self, deadline: Instant) -> Result<InputLevels, Fault>;

    /// Sets all outputs. A device that is written in the background takes the levels here and reports with the next call
    /// when they did not arrive.
    ///
    /// # Errors
    /// See [`Fault`]. Which levels the outputs have is not known then.
    fn write(&mut self, levels: u64, deadline: Instant) -> Result<(), Fault>;

    /// The levels of the outputs that the device confirmed last: those of the last write that it took, before the first
    /// one those that it was found with. `None` where they are not known.
    fn confirmed(&self) -> Option<u64>;

    /// Whether the device can report the levels of its outputs. Where it cannot, or has reported that it has no such function,
    /// outputs that carry nothing are written as off; otherwise nothing is written until their levels are known.
    fn tells_outputs(&self) -> bool {
        true
    }
}

impl<D: DigitalIo + ?Sized> DigitalIo for Box<D> {
    fn device(&self) -> &str {
        (**self).device()
    }

    fn inputs(&self) -> u32 {
        (**self).inputs()
    }

    fn outputs(&self) -> u32 {
        (**self).outputs()
    }

    fn shortest_cycle(&self) -> Duration {
        (**self).shortest_cycle()
    }

    fn read(&mut self, deadline: Instant) -> Result<InputLevels, Fault> {
        (**self).read(deadline)
    }

    fn write(&mut self, levels: u64, deadline: Instant) -> Result<(), Fault> {
        (**self).write(levels, deadline)
    }

    fn confirmed(&self) -> Option<u64> {
        (**self).confirmed()
    }

    fn tells_outputs(&self) -> bool {
        (**self).tells_outputs()
    }
}

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
