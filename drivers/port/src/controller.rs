//! The interface to a machine controller: its axes, its state, and the corrections that it applies.

use std::time::{Duration, Instant};

use volcomp_vocabulary::{AxisKind, AxisName, Displacement, MAX_AXES, PerChannel};

use crate::{Fault, Words};

/// Properties of an axis as the controller reports and corrects it.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Axis {
    /// Axis letter; it also determines whether the axis is linear or rotary.
    pub name: AxisName,
    /// Whether reported positions contain the applied correction.
    pub includes_correction: bool,
    /// Smallest step of a correction: a length for a linear, an angle for a rotary axis.
    pub resolution: Displacement,
    /// Largest correction, in either direction, that the device can carry; `None` if it has no such bound.
    pub largest: Option<Displacement>,
}

impl Axis {
    /// Whether the axis is linear or rotary, so that positions and corrections are lengths or angles.
    pub fn kind(&self) -> AxisKind {
        self.name.kind()
    }

    /// Smallest step of a correction, mm or rad.
    pub fn step(&self) -> f64 {
        self.resolution.mm_or_rad()
    }
}

/// Whether the control monitors the gateway, and ramps the correction out when the gateway stops.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum Heartbeat {
    /// The control monitors a word that [`Controller::apply`] advances.
    Watched,
    /// The control monitors nothing; the configuration must accept this (`unwatched`).
    Unwatched,
}

/// The operating states that a controller reports. The configuration must explicitly accept each state that it does not report.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct ShownStates {
    /// Whether the controller reports that every axis is referenced.
    pub referenced: bool,
    /// Whether the controller reports an active alarm.
    pub alarm: bool,
    /// Whether the controller reports the emergency stop.
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
    /// Name of the device in the configuration.
    pub device: String,
    /// Name of the channel through which corrections reach the axes. Controllers with the same name are alternatives. Different channels
    /// are never used together, because their corrections would add up.
    pub channel: String,
    /// The written axes in channel order, at most [`MAX_AXES`]. Empty if the controller only reports positions.
    pub axes: Vec<Axis>,
    /// Axes whose positions the controller reports but which it never writes; in all lists they follow `axes`.
    #[cfg_attr(feature = "serde", serde(default))]
    pub reads: Vec<AxisName>,
    /// Whether the control monitors the gateway.
    pub heartbeat: Heartbeat,
    /// True if corrections are sent in frames to a barrier in the control ([`Controller::post`]), which reports the applied correction; false if
    /// they are written as plain values ([`Controller::apply`]).
    pub barrier: bool,
    /// Whether the applied correction can be read back, as values or in reports.
    pub tells_applied: bool,
    /// The operating states that the controller reports.
    pub shown: ShownStates,
    /// Whether the driver detects a second gateway on the same controller.
    pub sees_other_gateways: bool,
    /// Shortest supported cycle time.
    pub shortest_cycle: Duration,
}

impl Description {
    /// Index of an axis in `axes`, the channel order; `None` for other axes, also those that are only read.
    pub fn index_of(&self, name: AxisName) -> Option<usize> {
        self.axes.iter().position(|axis| axis.name == name)
    }

    /// All axes whose positions the controller reports, in the order of the positions: written axes first.
    pub fn shown_axes(&self) -> impl Iterator<Item = AxisName> {
        let written = self.axes.iter().map(|axis| axis.name);
        written.chain(self.reads.iter().copied())
    }

    /// Whether the controller reports the position of an axis.
    pub fn shows(&self, name: AxisName) -> bool {
        self.shown_axes().any(|shown| shown == name)
    }

    /// Checks the rules for every driver: 1 to [`MAX_AXES`] axes (read-only ones included), each once; every written axis has a positive
    /// resolution in its own unit, and a largest correction of at least one step. Drivers call it before any device is opened.
    ///
    /// # Errors
    /// The first rule that is broken.
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

/// The operating state of a controller. A state that the controller reports, but that is missing or invalid in this reading, has its
/// safe value: not referenced, alarm, emergency stop.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct ControllerState {
    /// Every axis is referenced.
    pub referenced: bool,
    /// An alarm is active.
    pub alarm: bool,
    /// The emergency stop is pressed.
    pub emergency_stop: bool,
}

/// The positions, state and applied correction received last, each with the time at which it was valid. Drivers return them regardless of
/// their age.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Snapshot {
    /// Positions as reported, mm and rad: first the written axes, then the axes that are only read.
    pub positions: PerChannel<f64>,
    /// When the oldest position was valid, on the monotonic clock: the middle of the exchange or the arrival of its frame, unless the device
    /// reports a better time.
    pub taken: Instant,
    /// Uncertainty of `taken`, in either direction.
    pub uncertainty: Duration,
    /// The operating state of the controller.
    pub state: ControllerState,
    /// When the oldest part of `state` was valid, on the same clock as `taken`.
    pub state_taken: Instant,
    /// The applied correction, mm and rad, if the device has no barrier. It is read back; if the control has no read-back
    /// ([`Description::tells_applied`] is false), it is the correction on the outputs to the control, as far as the device knows it.
    pub applied: Option<PerChannel<f64>>,
    /// The last report of the barrier as received; its checksum shows whether it is complete. `None` without a barrier, or before the first report.
    pub report: Option<Words>,
    /// When the oldest part of `applied` or `report` was valid, on the same clock as `taken`.
    pub correction_taken: Instant,
}

impl Snapshot {
    /// This snapshot with all its times set to `taken`.
    #[must_use]
    pub fn at(self, taken: Instant) -> Self {
        Self { taken, state_taken: taken, correction_taken: taken, ..self }
    }

    /// When the most recent part was valid; nothing newer was received from the controller.
    pub fn youngest(&self) -> Instant {
        self.taken.max(self.state_taken).max(self.correction_taken)
    }
}

/// A machine controller whose positions are read and that accepts corrections.
///
/// Reads and writes are for a real-time loop: they use an open connection, are bounded by the deadline and do not allocate. Connecting and
/// reconnecting happen on another thread ([`Supply`](crate::Supply)); until then calls return [`Fault::NotConnected`]. After any other fault the
/// next call can be made at once.
#[cfg_attr(feature = "mock", mockall::automock)]
pub trait Controller: Send {
    /// The properties of the controller that follow from its configuration.
    fn description(&self) -> &Description;

    /// Returns the positions, state and applied correction received last, with the times at which they were valid. If the device sends
    /// unsolicited or is read in the background, the call does not wait for it, and the data of a silent device age.
    ///
    /// # Errors
    /// See [`Fault`].
    fn read(&mut self, deadline: Instant) -> Result<Snapshot, Fault>;

    /// Sends a frame to the barrier of the control, all words in one exchange where the bus allows it. Only for controllers with a `barrier` in
    /// their description; later reports contain the applied correction. A frame whose deadline has passed is not sent.
    ///
    /// # Errors
    /// See [`Fault`]. It is then unknown whether the frame arrived.
    fn post(&mut self, frame: &Words, deadline: Instant) -> Result<(), Fault> {
        let _ = (frame, deadline);
        Err(Fault::Unsupported("frames for a barrier"))
    }

    /// Applies `corrections` (mm and rad), rounded to the resolution and clamped to the range of the device, and advances the heartbeat. Only for
    /// controllers without a barrier. A write whose deadline has passed is not sent.
    ///
    /// # Errors
    /// See [`Fault`]. It is then unknown whether the device received the corrections; the next [`read`](Self::read) shows it.
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
