//! Faults, by chance or on request.

use std::time::Duration;

/// Fault probabilities per call, 0 to 1, unless stated otherwise.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(default))]
pub struct Faults {
    /// Maximum or fixed delay of each call, see `jitter`.
    pub delay: Duration,
    /// Whether the delay is drawn uniformly from 0 to `delay` (otherwise it is `delay`).
    pub jitter: bool,
    /// The answer does not arrive before the deadline.
    pub drop: f64,
    /// One number or bit of the answer is wrong: a jump, a NaN, an infinity.
    pub corrupt: f64,
    /// The next `calls` answers repeat the last one.
    pub freeze: f64,
    /// The next `calls` calls find no connection.
    pub disconnect: f64,
    /// Duration of a freeze, a disconnection and every other lasting fault, in calls.
    pub calls: u32,
    /// The read-back of one reading is wrong, as described by [`Lie`].
    pub lie: f64,
    /// The next `calls` readings repeat the read-back, or the report of the barrier, of the present reading.
    pub constant: f64,
    /// A write is delayed although the call succeeds, and delivered after up to `calls` further calls, even if the connection was lost in
    /// between.
    pub late_write: f64,
    /// A write is delivered at once, and a second time after up to `calls` further calls.
    pub double_write: f64,
    /// Only some words or axes of a write are delivered; the rest follows with the next call.
    pub torn_write: f64,
    /// A write is delivered only after the next one.
    pub reordered_write: f64,
    /// An answer arrives late, by up to 90 % of the time left before the deadline.
    pub late_answer: f64,
    /// The next `calls` readings repeat the positions of the present reading, with fresh times.
    pub frozen_positions: f64,
    /// The whole program stops for up to `stop` after a reading.
    pub stop_after_read: f64,
    /// The whole program stops for up to `stop` between the call of a write and its transmission.
    pub stop_before_write: f64,
    /// Maximum duration of such a stop.
    pub stop: Duration,
    /// The next `calls` readings report: referenced, no alarm, no emergency stop.
    pub dropped_flag: f64,
    /// The position of one axis is off by one correction step in this reading.
    pub flicker: f64,
    /// Number of readings by which the positions lag, with fresh times; at most 63.
    pub lag: u32,
}

/// Kind of read-back fault. If the control has a barrier, the fault corrupts the words of its report, and the checksum must detect it.
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

/// A fault on request, injected from the next applicable call on.
#[expect(missing_docs, reason = "numbers of readings or calls, and places of axes")]
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub enum Injection {
    /// Readings report a wrong read-back.
    Lie { lie: Lie, readings: u32 },
    /// The read-back of the next reading is repeated.
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
    /// The positions of the next reading are repeated.
    FrozenPositions { readings: u32 },
    /// Readings report a wrong position of an axis, as after a jump or in another unit.
    WrongPosition {
        axis: usize,
        /// Factor by which the position is multiplied.
        factor: f64,
        /// Offset added after the multiplication, mm or rad.
        add: f64,
        readings: u32,
    },
    /// The program stops for this time after the next reading.
    StopAfterRead(Duration),
    /// The program stops for this time before the next write is sent.
    StopBeforeWrite(Duration),
    /// Readings report: referenced, no alarm, no emergency stop.
    DroppedFlag { readings: u32 },
    /// The next reading reports one step more for this axis.
    Flicker { axis: usize },
    /// Number of readings by which positions lag from now on, at most 63.
    Lag(u32),
    /// The next calls find no connection.
    Disconnect { calls: u32 },
    /// One sensor of a thermometer has this offset from now on; 0 K ends it.
    Jump {
        sensor: usize,
        /// Offset of the temperature, K.
        kelvin: f64,
    },
    /// The next call on an open connection delivers all delayed writes.
    Release,
    /// Replaces the fault probabilities.
    Faults(Faults),
}
