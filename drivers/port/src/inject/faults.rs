//! Faults that occur with set probabilities or on request.

use std::time::Duration;

/// Probabilities of the faults per call, 0 to 1, and the size of the faults.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(default))]
pub struct Faults {
    /// Delay of every call. With `jitter` it is the maximum delay.
    pub delay: Duration,
    /// Whether the delay of each call is drawn uniformly from 0 to `delay`.
    pub jitter: bool,
    /// Probability that a call times out and its request does not reach the device.
    pub drop: f64,
    /// Probability that one number or bit of the answer is wrong: a jump, a NaN, an infinity.
    pub corrupt: f64,
    /// Probability that this answer and the next ones, `calls` answers in total, repeat the previous answer.
    pub freeze: f64,
    /// Probability that this call and the next ones, `calls` calls in total, find no connection.
    pub disconnect: f64,
    /// Duration of a freeze or disconnection, calls. For every other lasting fault, the maximum of the drawn duration
    /// or delay.
    pub calls: u32,
    /// Probability that the read-back of one reading is wrong, by one of the kinds of [`Lie`].
    pub lie: f64,
    /// Probability that this reading and the next ones, up to `calls` readings in total, show the read-back or the
    /// barrier's report of this reading.
    pub constant: f64,
    /// Probability that the call of a write succeeds, but the write is delivered only after up to `calls` further
    /// calls, even if the connection was lost in between.
    pub late_write: f64,
    /// Probability that a write is delivered at once, and a second time after up to `calls` further calls.
    pub double_write: f64,
    /// Probability that only some words or axes of a write are delivered. The rest follows with the next call.
    pub torn_write: f64,
    /// Probability that a write is delivered after the next write.
    pub reordered_write: f64,
    /// Probability that an answer arrives late, after up to 90 % of the time left before the deadline.
    pub late_answer: f64,
    /// Probability that this reading and the next ones, up to `calls` readings in total, show the positions of this
    /// reading with fresh times.
    pub frozen_positions: f64,
    /// Probability that the whole program pauses for up to `stop` after a reading.
    pub stop_after_read: f64,
    /// Probability that the whole program pauses for up to `stop` between the call of a write and its transmission.
    pub stop_before_write: f64,
    /// Maximum duration of the pauses of the program.
    pub stop: Duration,
    /// Probability that up to `calls` readings, starting with this one, report: referenced, no alarm, no emergency
    /// stop.
    pub dropped_flag: f64,
    /// Probability that the position of one axis is one correction step too large in one reading.
    pub flicker: f64,
    /// Number of readings by which positions lag, with fresh times; at most 63.
    pub lag: u32,
}

/// Kind of a wrong read-back. If the control has a barrier, the words of its report are corrupted, which its checksum
/// must reveal.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum Lie {
    /// One axis is off by up to 5000 steps, or one word is random.
    Value,
    /// One axis is NaN, or all words are 65535.
    NotANumber,
    /// Two axes, or two words, are exchanged.
    OtherAxis,
    /// Some axes or words have the values of the previous reading.
    Torn,
    /// All axes, or words, are zero.
    Zero,
}

impl Lie {
    pub const ALL: [Self; 5] =
        [Self::Value, Self::NotANumber, Self::OtherAxis, Self::Torn, Self::Zero];
}

/// A requested fault. It is injected at the next call to which it applies.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub enum Injection {
    /// The next `readings` readings show a wrong read-back.
    Lie { lie: Lie, readings: u32 },
    /// The next `readings` readings show the read-back of the first of these readings.
    Constant { readings: u32 },
    /// The next write is delivered after `calls` further calls on an open connection.
    LateWrite { calls: u32 },
    /// The next write is delivered at once, and a second time after `calls` further calls.
    DoubleWrite { calls: u32 },
    /// Only a part of the next write is delivered. The rest follows with the next call.
    TornWrite,
    /// The next write is delivered after the write that follows it.
    ReorderedWrite,
    /// The next answer is delayed by this time, but arrives before the deadline.
    LateAnswer(Duration),
    /// The next `readings` readings show the positions of the first of these readings.
    FrozenPositions { readings: u32 },
    /// The next `readings` readings report a wrong position of one axis, as after a jump or in another unit.
    WrongPosition {
        axis: usize,
        /// Factor by which the position is multiplied.
        factor: f64,
        /// Offset added after the multiplication, mm or rad.
        add: f64,
        readings: u32,
    },
    /// The program pauses for this time after the next reading.
    StopAfterRead(Duration),
    /// The program pauses for this time before the next write is sent.
    StopBeforeWrite(Duration),
    /// The next `readings` readings report: referenced, no alarm, no emergency stop.
    DroppedFlag { readings: u32 },
    /// The next reading shows the position of this axis one correction step too large.
    Flicker { axis: usize },
    /// From now on, positions lag by this number of readings, at most 63.
    Lag(u32),
    /// The next `calls` calls find no connection.
    Disconnect { calls: u32 },
    /// From now on, the temperature of one sensor of a thermometer is wrong by this offset. An offset of 0 K ends the
    /// fault.
    Jump {
        sensor: usize,
        /// Offset of the temperature, K.
        kelvin: f64,
    },
    /// The next call on an open connection delivers all delayed writes.
    Release,
    /// Replaces the probabilities and sizes of random faults.
    Faults(Faults),
}
