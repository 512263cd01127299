//! What may go wrong: by chance, or on request.

use std::time::Duration;

/// How often what goes wrong: chances of a call, 0 to 1, unless stated otherwise.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Serialize, serde::Deserialize),
    serde(default)
)]
pub struct Faults {
    /// Additional time of a call.
    pub delay: Duration,
    /// The delay is random up to that.
    pub jitter: bool,
    /// The answer does not come before the deadline.
    pub drop: f64,
    /// One number or bit of the answer is wrong: a jump, a NaN, an infinity.
    pub corrupt: f64,
    /// The next `calls` answers are the last one again.
    pub freeze: f64,
    /// The next `calls` calls find no connection.
    pub disconnect: f64,
    /// The number of calls that a freeze, a disconnection or any other fault that lasts goes on.
    pub calls: u32,
    /// The read-back of one reading is wrong, in one of the ways of [`Lie`].
    pub lie: f64,
    /// The next `calls` readings report the read-back, or the report of the barrier, of this one.
    pub constant: f64,
    /// A write is held back although the call succeeds, and delivered after up to `calls` further
    /// calls, also when the connection was lost in between.
    pub late_write: f64,
    /// A write is delivered, and once more after up to `calls` further calls.
    pub double_write: f64,
    /// Of a write only some words or axes are delivered; the rest comes with the next call.
    pub torn_write: f64,
    /// A write is delivered only after the next one.
    pub reordered_write: f64,
    /// An answer takes up to nine tenths of the time that is left before the deadline to come back.
    pub late_answer: f64,
    /// The next `calls` readings report the positions of this one, with fresh times.
    pub frozen_positions: f64,
    /// The whole program stops for up to `stop` after a reading.
    pub stop_after_read: f64,
    /// The whole program stops for up to `stop` when a write was handed over and is not sent yet.
    pub stop_before_write: f64,
    /// The longest time that the program stops.
    pub stop: Duration,
    /// The next `calls` readings say: referenced, no alarm, no emergency stop.
    pub dropped_flag: f64,
    /// The position of one axis is one step of its correction further in this reading.
    pub flicker: f64,
    /// Positions are those of this number of readings before, at most 63, with fresh times. Not a chance.
    pub lag: u32,
}

/// In which way a read-back is wrong. Where the control has a barrier, the words of its report are: the reader has to
/// find that by the checksum.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum Lie {
    /// One axis by up to 5000 steps, or one word that is any number.
    Value,
    /// One axis is no number, or all words are 65535.
    NotANumber,
    /// Two axes, or two words, are exchanged.
    OtherAxis,
    /// Some axes, or words, are those of the reading before.
    Torn,
    /// All axes, or words, are zero.
    Zero,
}

impl Lie {
    /// All ways.
    pub const ALL: [Self; 5] = [
        Self::Value,
        Self::NotANumber,
        Self::OtherAxis,
        Self::Torn,
        Self::Zero,
    ];
}

/// One requested fault; it begins with the next call that it concerns.
#[expect(
    missing_docs,
    reason = "numbers of readings or calls, and places of axes"
)]
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub enum Injection {
    /// Readings report a wrong read-back.
    Lie { lie: Lie, readings: u32 },
    /// Readings report the read-back of the next one.
    Constant { readings: u32 },
    /// The next write is delivered after further calls on an open connection.
    LateWrite { calls: u32 },
    /// The next write is delivered, and once more after further calls.
    DoubleWrite { calls: u32 },
    /// Of the next write only a part is delivered; the rest comes with the next call.
    TornWrite,
    /// The next write is delivered after the one that follows.
    ReorderedWrite,
    /// The delay of the next answer, within its deadline.
    LateAnswer(Duration),
    /// Readings report the positions of the next one.
    FrozenPositions { readings: u32 },
    /// Readings report another position of an axis: it jumped, or is in another unit.
    WrongPosition {
        axis: usize,
        /// By how much the position is multiplied.
        factor: f64,
        /// What is added then, mm or rad.
        add: f64,
        readings: u32,
    },
    /// The time that the program stops after the next reading.
    StopAfterRead(Duration),
    /// The time that the program stops before the next write is sent.
    StopBeforeWrite(Duration),
    /// Readings report: referenced, no alarm, no emergency stop.
    DroppedFlag { readings: u32 },
    /// The next reading reports one step more for this axis.
    Flicker { axis: usize },
    /// The number of readings by which positions are late from now on, at most 63.
    Lag(u32),
    /// Calls find no connection.
    Disconnect { calls: u32 },
    /// One sensor of a thermometer reports more from now on: it jumped, and stays there. 0 ends it.
    Jump {
        sensor: usize,
        /// The difference, K.
        kelvin: f64,
    },
    /// All writes that are held back are delivered with the next call on an open connection.
    Release,
    /// From now on these chances.
    Faults(Faults),
}
