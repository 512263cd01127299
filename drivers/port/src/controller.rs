//! Interface of a machine controller: its axes, its state, and the corrections that it applies.

use std::time::{Duration, Instant};

use volcomp_vocabulary::{AxisKind, AxisName, Displacement, MAX_AXES, PerChannel};

use crate::Fault;

/// Properties of an axis as the controller reports and corrects it.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Axis {
    /// Letter of the axis. The letter determines whether the axis is linear or rotary.
    pub name: AxisName,
    /// Whether reported positions contain the applied correction.
    pub includes_correction: bool,
    /// Smallest step of a correction: a length for a linear axis, an angle for a rotary axis.
    pub resolution: Displacement,
    /// Largest correction in either direction that the device can transfer; `None` if unlimited.
    pub largest: Option<Displacement>,
}

impl Axis {
    /// Kind of the axis. Positions and corrections of a linear axis are lengths, those of a rotary axis angles.
    pub fn kind(&self) -> AxisKind {
        self.name.kind()
    }

    /// Smallest step of a correction, mm or rad.
    pub fn step(&self) -> f64 {
        self.resolution.mm_or_rad()
    }
}

/// Whether the control monitors the gateway, and ramps the correction out if the gateway stops.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum Heartbeat {
    /// The control monitors a word that [`Controller::apply`] advances.
    Watched,
    /// The control does not monitor the gateway. The configuration must accept this (`unwatched`).
    Unwatched,
}

/// The operating states that a controller reports. The configuration must explicitly accept each missing state.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct ShownStates {
    pub referenced: bool,
    pub alarm: bool,
    pub emergency_stop: bool,
}

impl ShownStates {
    /// A controller that reports all three states.
    pub const ALL: Self = Self { referenced: true, alarm: true, emergency_stop: true };
    /// A controller that reports none of the three states, such as one that only has digital lines.
    pub const NONE: Self = Self { referenced: false, alarm: false, emergency_stop: false };
}

/// The properties of a controller that follow from its configuration.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Description {
    pub device: String,
    /// Name of the channel through which corrections reach the axes. Controllers with the same channel are
    /// alternatives. Different channels are never used together, because their corrections would add up.
    pub channel: String,
    /// Corrected axes in channel order, at most [`MAX_AXES`]; empty if the controller only reports positions.
    pub axes: Vec<Axis>,
    /// Read-only axes: the controller reports their positions, but does not correct them. In all lists they follow
    /// `axes`.
    #[cfg_attr(feature = "serde", serde(default))]
    pub reads: Vec<AxisName>,
    pub heartbeat: Heartbeat,
    /// Whether the control has a barrier, a program that checks and limits corrections. If `true`, corrections are sent
    /// in frames to the barrier ([`Controller::post`]), which reports the applied correction. If `false`, corrections
    /// are written as plain values ([`Controller::apply`]).
    pub barrier: bool,
    /// Whether the applied correction can be read back, as values or in reports of the barrier.
    pub tells_applied: bool,
    pub shown: ShownStates,
    /// Whether the driver detects a second gateway on the same controller.
    pub sees_other_gateways: bool,
    /// Shortest supported cycle time.
    pub shortest_cycle: Duration,
}

impl Description {
    /// Index of an axis in `axes`, the channel order; `None` for read-only and unknown axes.
    pub fn index_of(&self, name: AxisName) -> Option<usize> {
        self.axes.iter().position(|axis| axis.name == name)
    }

    /// All axes whose positions the controller reports, in the order of the positions: corrected axes, then read-only
    /// axes.
    pub fn shown_axes(&self) -> impl Iterator<Item = AxisName> {
        let written = self.axes.iter().map(|axis| axis.name);
        written.chain(self.reads.iter().copied())
    }

    pub fn shows(&self, name: AxisName) -> bool {
        self.shown_axes().any(|shown| shown == name)
    }

    /// Checks rules that hold for every driver. There must be 1 to [`MAX_AXES`] axes including read-only axes, each
    /// once. Every corrected axis must have a positive resolution in its own unit, and a largest correction of at least
    /// one step. Drivers call this before they open a device.
    ///
    /// # Errors
    /// The first violated rule.
    pub fn check(&self) -> Result<(), UnfitAxes> {
        let count = self.shown_axes().count();
        if !(1..=MAX_AXES).contains(&count) {
            return Err(UnfitAxes::Count(count));
        }
        for (index, name) in self.shown_axes().enumerate() {
            if self.shown_axes().take(index).any(|before| before == name) {
                return Err(UnfitAxes::Twice(name));
            }
        }
        for axis in &self.axes {
            let (name, resolution) = (axis.name, axis.resolution);
            if resolution.kind() != axis.kind() {
                return Err(UnfitAxes::Kind { name, resolution });
            }
            let step = resolution.mm_or_rad();
            if !(step > 0.0 && step.is_finite()) {
                return Err(UnfitAxes::Resolution { name, resolution });
            }
            if let Some(largest) = axis.largest
                && !(largest.kind() == axis.kind() && largest.mm_or_rad() >= step)
            {
                return Err(UnfitAxes::Largest { name, largest });
            }
        }
        Ok(())
    }
}

/// Reasons why the axes of a [`Description`] are invalid.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum UnfitAxes {
    #[error("found {0} axes, expected 1 to {MAX_AXES}")]
    Count(usize),
    #[error("axis {0}: found twice, expected once")]
    Twice(AxisName),
    #[error("axis {name}: found a resolution of {resolution}, expected {}", match name.kind() {
        AxisKind::Linear => "a length, since the axis is linear",
        AxisKind::Rotary => "an angle, since the axis is rotary",
    })]
    Kind { name: AxisName, resolution: Displacement },
    #[error("axis {name}: found a resolution of {resolution}, expected a positive one")]
    Resolution { name: AxisName, resolution: Displacement },
    #[error(
        "axis {name}: found a largest correction of {largest}, expected at least one step in either direction"
    )]
    Largest { name: AxisName, largest: Displacement },
}

/// The operating state of a controller. A state that is missing or invalid in a reading, although the controller
/// reports it, gets its safe value: not referenced, alarm, emergency stop.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct ControllerState {
    pub referenced: bool,
    pub alarm: bool,
    pub emergency_stop: bool,
}

/// The last received positions, state and applied correction, each with the time at which it was valid. Drivers return
/// them regardless of their age.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Snapshot {
    /// Positions as reported, mm and rad: corrected axes, then read-only axes.
    pub positions: PerChannel<f64>,
    /// Time on the monotonic clock at which the oldest position was valid: the middle of the exchange, or the arrival
    /// of the frame, unless the device reports a better time.
    pub taken: Instant,
    /// Uncertainty of `taken`, in either direction.
    pub uncertainty: Duration,
    pub state: ControllerState,
    /// Time at which the oldest part of `state` was valid, on the same clock as `taken`.
    pub state_taken: Instant,
    /// Applied correction, mm and rad, as read back from the control. If the control has no read-back
    /// ([`Description::tells_applied`] is false), it is the correction on the outputs to the control. `None` if there
    /// is a barrier or the device knows no applied correction.
    pub applied: Option<PerChannel<f64>>,
    /// Last report of the barrier, as received. Its checksum shows whether the report is complete. `None` without a
    /// barrier, or before the first report.
    pub report: Option<Words>,
    /// Time at which the oldest part of `applied` or `report` was valid, on the same clock as `taken`.
    pub correction_taken: Instant,
}

impl Snapshot {
    /// Returns this snapshot with all its times set to `taken`.
    #[must_use]
    pub fn at(self, taken: Instant) -> Self {
        Self { taken, state_taken: taken, correction_taken: taken, ..self }
    }

    /// Time at which the most recent part of the snapshot was valid.
    pub fn youngest(&self) -> Instant {
        self.taken.max(self.state_taken).max(self.correction_taken)
    }
}

/// A machine controller whose positions are read, and which accepts corrections.
///
/// Reads and writes are for a real-time loop: they use an open connection, end at their deadline and do not allocate.
/// Another thread ([`Supply`](crate::Supply)) connects and reconnects; meanwhile calls return [`Fault::NotConnected`].
/// After any other fault the next call can be made at once.
#[cfg_attr(feature = "mock", mockall::automock)]
pub trait Controller: Send {
    fn description(&self) -> &Description;

    /// Returns the last received positions, state and applied correction, with the times at which they were valid. If
    /// the device sends its values unsolicited, or is read in the background, the call does not wait for new values. If
    /// the device stops sending, the values grow older.
    ///
    /// # Errors
    /// See [`Fault`].
    fn read(&mut self, deadline: Instant) -> Result<Snapshot, Fault>;

    /// Sends a frame to the barrier of the control, all words in one exchange if the bus allows it. Only for
    /// controllers with a `barrier` in their description. Later reports contain the applied correction. A frame whose
    /// deadline has passed is not sent.
    ///
    /// # Errors
    /// See [`Fault`]. After an error it is unknown whether the frame arrived.
    fn post(&mut self, frame: &Words, deadline: Instant) -> Result<(), Fault> {
        let _ = (frame, deadline);
        Err(Fault::Unsupported("frames for a barrier"))
    }

    /// Applies `corrections` (mm and rad), rounded to the resolution and clamped to the range of the device, and
    /// advances the heartbeat. Only for controllers without a barrier. A write whose deadline has passed is not sent.
    ///
    /// # Errors
    /// See [`Fault`]. After an error it is unknown whether the device received the corrections; the next
    /// [`read`](Self::read) shows it.
    fn apply(&mut self, corrections: &PerChannel<f64>, deadline: Instant) -> Result<(), Fault>;
}

impl<C: Controller + ?Sized> Controller for Box<C> {
    fn description(&self) -> &Description {
        (**self).description()
    }

    fn read(&mut self, deadline: Instant) -> Result<Snapshot, Fault> {
        (**self).read(deadline)
    }

    fn post(&mut self, frame: &Words, deadline: Instant) -> Result<(), Fault> {
        (**self).post(frame, deadline)
    }

    fn apply(&mut self, corrections: &PerChannel<f64>, deadline: Instant) -> Result<(), Fault> {
        (**self).apply(corrections, deadline)
    }
}

/// Program of a simulated control, such as a barrier. It determines the corrections of the axes, as a ladder program
/// does in a real control. Values are whole counts of each axis, in channel order.
pub trait ControlProgram: Send {
    /// Runs one scan and returns the report to publish. `mailboxes` has the words of each mailbox, copied before this
    /// call. `holds` is true during emergency stop or alarm, or while an axis is not referenced.
    fn scan(&mut self, mailboxes: &[&[u16]], holds: bool) -> Words;

    /// Sets the digital lines for the next scans: `value` (counts) for the axis with this index, and the level of the
    /// latch line, which toggles after the other lines have settled. By default the lines have no effect.
    fn lines(&mut self, latch: bool, axis: usize, value: i16) {
        let _ = (latch, axis, value);
    }

    /// Correction applied to each axis, counts.
    fn applied(&self) -> PerChannel<i16>;

    /// Restarts the program at power-up or reset of the control. `applied` is the correction that the axis words
    /// contain, counts.
    fn restart(&mut self, applied: &PerChannel<i16>);
}

/// Maximum number of words of a block.
pub const MOST_WORDS: usize = 40;

/// A block of 16-bit words with fixed capacity, so that copying does not allocate. A comparison ignores the unused
/// capacity.
#[derive(Clone, Copy)]
pub struct Words {
    words: [u16; MOST_WORDS],
    length: usize,
}

impl Words {
    pub const EMPTY: Self = Self { words: [0; MOST_WORDS], length: 0 };

    /// Creates a block of these words; `None` if there are more than [`MOST_WORDS`].
    #[must_use]
    pub fn new(words: &[u16]) -> Option<Self> {
        let mut block = Self { words: [0; MOST_WORDS], length: words.len() };
        block.words.get_mut(..words.len())?.copy_from_slice(words);
        Some(block)
    }

    #[must_use]
    pub fn as_slice(&self) -> &[u16] {
        &self.words[..self.length]
    }

    pub fn as_mut_slice(&mut self) -> &mut [u16] {
        &mut self.words[..self.length]
    }
}

impl Default for Words {
    fn default() -> Self {
        Self::EMPTY
    }
}

impl PartialEq for Words {
    fn eq(&self, other: &Self) -> bool {
        self.as_slice() == other.as_slice()
    }
}

impl Eq for Words {}

impl core::fmt::Debug for Words {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.debug_list().entries(self.as_slice()).finish()
    }
}
