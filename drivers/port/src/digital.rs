//! The interface to digital inputs and outputs.

use std::time::{Duration, Instant};

use crate::Fault;

/// Digital inputs and outputs, 64 of each at the most: bit 0 is the first line.
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

    /// All inputs at one instant, as far as the device can.
    ///
    /// # Errors
    /// See [`Fault`].
    fn read(&mut self, deadline: Instant) -> Result<u64, Fault>;

    /// Sets all outputs.
    ///
    /// # Errors
    /// See [`Fault`].
    fn write(&mut self, levels: u64, deadline: Instant) -> Result<(), Fault>;
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

    fn read(&mut self, deadline: Instant) -> Result<u64, Fault> {
        (**self).read(deadline)
    }

    fn write(&mut self, levels: u64, deadline: Instant) -> Result<(), Fault> {
        (**self).write(levels, deadline)
    }
}
