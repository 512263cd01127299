use std::time::{Duration, Instant};

use crate::Fault;

/// Levels of all inputs, and the time at which they were sampled.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct InputLevels {
    /// Levels as a bit mask. Bit 0 is the first line. A set bit is a line that is on.
    pub levels: u64,
    /// Time at which the device delivered the oldest of these levels. This may be earlier than the request.
    pub taken: Instant,
}

impl InputLevels {
    /// Creates levels with the present time as their sampling time.
    pub fn now(levels: u64) -> Self {
        Self { levels, taken: Instant::now() }
    }
}

/// Digital inputs and outputs, at most 64 of each. Bit 0 is the first line.
#[cfg_attr(feature = "mock", mockall::automock)]
pub trait DigitalIo: Send {
    fn device(&self) -> &str;

    /// Number of inputs, at most 64.
    fn inputs(&self) -> u32;

    /// Number of outputs, at most 64.
    fn outputs(&self) -> u32;

    /// Shortest duration of one exchange. It is a lower bound of the cycle time of a controller on this port.
    fn shortest_cycle(&self) -> Duration;

    /// Returns the last received input levels with their arrival time, regardless of their age. The device samples all
    /// levels together if it can.
    ///
    /// # Errors
    /// See [`Fault`].
    fn read(&mut self, deadline: Instant) -> Result<InputLevels, Fault>;

    /// Sets all outputs. A device that is written in the background queues the levels, and reports a failed write at
    /// the next call.
    ///
    /// # Errors
    /// See [`Fault`]. After an error the levels of the outputs are unknown.
    fn write(&mut self, levels: u64, deadline: Instant) -> Result<(), Fault>;

    /// The output levels that the device confirmed last: those of its last accepted write or, before the first write,
    /// those that were read back. `None` if unknown.
    fn confirmed(&self) -> Option<u64>;

    /// Whether the device can report its output levels. If so, nothing is written until the levels are known. If not,
    /// unused outputs are written as off.
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

/// A digital port that is not open, for checks before opening. Every exchange fails with [`Fault::NotConnected`].
#[derive(Clone, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct UnopenedLines {
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
