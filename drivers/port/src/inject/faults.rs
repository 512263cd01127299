//! Faults that occur with set probabilities, or on request.

use std::time::Duration;

/// Probabilities of faults per call, 0 to 1, and the size of the faults.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(default))]
pub struct Faults {
    /// Delay of every call; its maximum with `jitter`.
    pub delay: Duration,
    /// Whether the delay of each call is drawn uniformly from 0 to `delay`.
    pub jitter: bool,
    /// The call times out; the request does not reach the device.
    pub drop: f64,
    /// One number or bit of the answer is wrong: a jump, a NaN, an infinity.
    pub corrupt: f64,
    /// `calls` answers, from this one on, repeat the answer before.
    pub freeze: f64,
    /// `calls` calls, from this one on, find no connection.
    pub disconnect: f64,
    /// Duration of a freeze or disconnection, and maximum of the drawn duration or delay of every other lasting fault; in calls.
    pub calls: u32,
    /// The read-back of one reading is wrong in one of the ways of [`Lie`].
    pub lie: f64,
    /// Up to `calls` readings, from this one on, show the read-back or the barrier's report of this reading.
    pub constant: f64,
    /// The call of a write succeeds, but the write is delivered only after up to `calls` further calls, even if the connection was lost in
    /// between.
    pub late_write: f64,
    /// A write is delivered at once, and a second time after up to `calls` further calls.
    pub double_write: f64,
    /// Only some words or axes of a write are delivered; the rest follows with the next call.
    pub torn_write: f64,
    /// A write is delivered only after the one that follows it.
    pub reordered_write: f64,
    /// An answer arrives late, after up to 90 % of the time left before the deadline.
    pub late_answer: f64,
    /// Up to `calls` readings, from this one on, show the positions of this reading, with fresh times.
    pub frozen_positions: f64,
    /// The whole program pauses for up to `stop` after a reading.
    pub stop_after_read: f64,
    /// The whole program pauses for up to `stop` between the call of a write and its transmission.
    pub stop_before_write: f64,
    /// Maximum duration of such a pause.
    pub stop: Duration,
    /// Up to `calls` readings, from this one on, report: referenced, no alarm, no emergency stop.
    pub dropped_flag: f64,
    /// The position of one axis is one correction step too large in one reading.
    pub flicker: f64,
    /// Number of readings by which positions lag behind, with fresh times; at most 63.
    pub lag: u32,
}

/// Kind of a wrong read-back. If the control has a barrier, the words of its report are corrupted, and the checksum must reveal it.
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
    /// All kinds of read-back faults.
    pub const ALL: [Self; 5] =
        [Self::Value, Self::NotANumber, Self::OtherAxis, Self::Torn, Self::Zero];
}

/// A fault on request, injected at the next call to which it applies.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub enum Injection {
    /// `readings` readings, from the next one on, show a wrong read-back.
    Lie { lie: Lie, readings: u32 },
    /// `readings` readings, from the next one on, show the read-back of the first of them.
    Constant { readings: u32 },
    /// The next write is delivered after `calls` further calls on an open connection.
    LateWrite { calls: u32 },
    /// The next write is delivered at once, and a second time after `calls` further calls.
    DoubleWrite { calls: u32 },
    /// Only a part of the next write is delivered; the rest follows with the next call.
    TornWrite,
    /// The next write is delivered after the one that follows.
    ReorderedWrite,
    /// The next answer is delayed by this time, within its deadline.
    LateAnswer(Duration),
    /// `readings` readings, from the next one on, show the positions of the first of them.
    FrozenPositions { readings: u32 },
    /// `readings` readings report a wrong position of an axis, as after a jump or in another unit.
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
    /// `readings` readings, from the next one on, report: referenced, no alarm, no emergency stop.
    DroppedFlag { readings: u32 },
    /// The next reading shows the position of this axis one correction step too large.
    Flicker { axis: usize },
    /// Number of readings by which positions lag from now on, at most 63.
    Lag(u32),
    /// `calls` calls, from the next one on, find no connection.
    Disconnect { calls: u32 },
    /// The temperature of one sensor of a thermometer is wrong by this offset from now on; 0 K ends it.
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
