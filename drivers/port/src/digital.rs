use std::time::{Duration, Instant};

use crate::Fault;

/// The levels of all inputs, and when they were sampled.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct InputLevels {
    /// Levels as a bit mask; bit 0 is the first line, and a set bit is a line that is on.
    pub levels: u64,
    /// When the device delivered the oldest of these levels (not when they were requested).
    pub taken: Instant,
}

impl InputLevels {
    /// Levels sampled now.
    pub fn now(levels: u64) -> Self {
        Self { levels, taken: Instant::now() }
    }
}

/// Digital inputs and outputs, at most 64 of each: bit 0 is the first line.
#[cfg_attr(feature = "mock", mockall::automock)]
pub trait DigitalIo: Send {
    /// Name of the device in the configuration.
    fn device(&self) -> &str;

    /// Number of inputs, at most 64.
    fn inputs(&self) -> u32;

    /// Number of outputs, at most 64.
    fn outputs(&self) -> u32;

    /// Shortest duration of one exchange: a lower bound for the cycle time of a controller that uses this port.
    fn shortest_cycle(&self) -> Duration;

    /// Returns the input levels received last, regardless of their age, with their arrival time. The device samples them together if it
    /// can.
    ///
    /// # Errors
    /// See [`Fault`].
    fn read(&mut self, deadline: Instant) -> Result<InputLevels, Fault>;

    /// Sets all outputs. A device that is written in the background queues the levels, and reports a failed write at the next call.
    ///
    /// # Errors
    /// See [`Fault`]. The levels of the outputs are then unknown.
    fn write(&mut self, levels: u64, deadline: Instant) -> Result<(), Fault>;

    /// The output levels that the device confirmed last: those of its last accepted write or, before the first write, those read back. `None` if
    /// unknown.
    fn confirmed(&self) -> Option<u64>;

    /// Whether the device can report its output levels. If it can, nothing is written until the levels are known; otherwise unused outputs are
    /// written as off.
    fn reports_outputs(&self) -> bool {
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

    fn reports_outputs(&self) -> bool {
        (**self).reports_outputs()
    }
}

/// A digital port that is not open, for checks before opening: every exchange fails with [`Fault::NotConnected`].
#[derive(Clone, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct UnopenedLines {
    /// Name of the device in the configuration.
    pub device: String,
    /// Number of inputs, at most 64.
    pub inputs: u32,
    /// Number of outputs, at most 64.
    pub outputs: u32,
    /// Shortest duration of one exchange.
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
