//! The interface to a machine controller: its axes, its state, and the corrections that it applies.

use std::time::{Duration, Instant};

use volcomp_vocabulary::{AxisKind, AxisName, Displacement, MAX_AXES, PerChannel};

use crate::{Fault, Words};

/// One axis of a controller.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Axis {
    /// The letter of the axis, which also says whether it slides or turns.
    pub name: AxisName,
    /// Whether reported positions contain the applied correction.
    pub includes_correction: bool,
    /// The smallest step of a correction: a length for a linear, an angle for a rotary axis.
    pub resolution: Displacement,
    /// The largest correction, in either direction, that the device can carry; `None` if there is no such bound.
    pub largest: Option<Displacement>,
}

impl Axis {
    /// Whether positions and corrections of this axis are lengths or angles.
    pub fn kind(&self) -> AxisKind {
        self.name.kind()
    }

    /// The smallest step of a correction as a number in mm or rad.
    pub fn step(&self) -> f64 {
        self.resolution.mm_or_rad()
    }
}

/// Who ramps a correction out when the cycle stops.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum Heartbeat {
    /// The controller's side watches a word that [`Controller::apply`] moves on.
    Watched,
    /// Nothing: the configuration must accept it.
    Unwatched,
}

/// Which of its states a controller shows. A state that is not shown is never known: a machine may only be corrected
/// then if the configuration accepts that.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct ShownStates {
    /// Whether every axis was sent to its reference.
    pub referenced: bool,
    /// Whether an alarm is on.
    pub alarm: bool,
    /// Whether the emergency stop is pressed.
    pub emergency_stop: bool,
}

impl ShownStates {
    /// A controller that shows all of them.
    pub const ALL: Self = Self {
        referenced: true,
        alarm: true,
        emergency_stop: true,
    };
    /// A controller that shows none of them, such as plain lines.
    pub const NONE: Self = Self {
        referenced: false,
        alarm: false,
        emergency_stop: false,
    };
}

/// The properties of a controller that stay the same as long as its configuration does.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Description {
    /// The device as the configuration names it.
    pub device: String,
    /// The name of the way by which corrections reach the axes. Controllers with the same name replace one another; those
    /// with different names would add up, and are not used together.
    pub channel: String,
    /// The axes in channel order: those that it writes, at most [`MAX_AXES`]. None where it only reports positions.
    pub axes: Vec<Axis>,
    /// Axes whose positions it reports, after those of `axes`, and which it never writes.
    #[cfg_attr(feature = "serde", serde(default))]
    pub reads: Vec<AxisName>,
    /// Whether the controller's side ramps the correction out when the cycle stops.
    pub heartbeat: Heartbeat,
    /// Whether corrections go in frames to a barrier in the control ([`Controller::post`]), which reports what
    /// it applies; otherwise they are written as plain values ([`Controller::apply`]).
    pub barrier: bool,
    /// Whether the correction that is applied can be read back, in values or reports.
    pub tells_applied: bool,
    /// The states that the controller shows.
    pub shown: ShownStates,
    /// Whether a second gateway on the same controller is noticed.
    pub sees_other_gateways: bool,
    /// The shortest cycle it keeps up with.
    pub shortest_cycle: Duration,
}

impl Description {
    /// The place of an axis in channel order.
    pub fn index_of(&self, name: AxisName) -> Option<usize> {
        self.axes.iter().position(|axis| axis.name == name)
    }

    /// All axes whose positions it reports, in the order of the positions: first those that it writes.
    pub fn shown_axes(&self) -> impl Iterator<Item = AxisName> {
        let written = self.axes.iter().map(|axis| axis.name);
        written.chain(self.reads.iter().copied())
    }

    /// Whether it reports the position of an axis.
    pub fn shows(&self, name: AxisName) -> bool {
        self.shown_axes().any(|shown| shown == name)
    }

    /// Checks what every driver promises: 1 to [`MAX_AXES`] axes, those that are only read among them, each once; each
    /// that is written with a positive resolution of its own kind, and a largest correction of at least that much.
    /// Drivers call it when they are set up, before any device is opened.
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

/// Why a [`Description`] cannot be one of a controller.
#[expect(missing_docs, reason = "the messages say what the fields are")]
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum UnfitAxes {
    /// There is no axis, or more than [`MAX_AXES`].
    #[error("found {0} axes, expected 1 to {MAX_AXES}")]
    Count(usize),
    /// An axis is named more than once.
    #[error("axis {0}: found twice, expected once")]
    Twice(AxisName),
    /// The resolution is a length for a rotary axis, or an angle for a linear one.
    #[error("axis {name}: found a resolution of {resolution}, expected {}", match name.kind() {
        AxisKind::Linear => "a length, since the axis is linear",
        AxisKind::Rotary => "an angle, since the axis is rotary",
    })]
    Kind {
        name: AxisName,
        resolution: Displacement,
    },
    /// The resolution is zero, negative or no finite number.
    #[error("axis {name}: found a resolution of {resolution}, expected a positive one")]
    Resolution {
        name: AxisName,
        resolution: Displacement,
    },
    /// The largest correction is less than one step, or of the other kind.
    #[error(
        "axis {name}: found a largest correction of {largest}, expected at least one step in either direction"
    )]
    Largest {
        name: AxisName,
        largest: Displacement,
    },
}

/// The operating state of a controller. A state that it shows but that is missing or makes no sense now stands in the
/// sense that forbids: not referenced, alarm, emergency stop.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct ControllerState {
    /// Every axis was sent to its reference.
    pub referenced: bool,
    /// An alarm is on.
    pub alarm: bool,
    /// The emergency stop is pressed.
    pub emergency_stop: bool,
}

/// The positions, the state and the applied correction of a controller, each with the time at which it held: what was received
/// last, however long ago. Whether that is young enough is not judged by drivers.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Snapshot {
    /// Positions as reported, mm and rad: those of the axes that are written, then those that are only read.
    pub positions: PerChannel<f64>,
    /// When the oldest of them held, on the monotonic clock: the middle of the exchange, or when its frame arrived,
    /// unless the device reports a better time.
    pub taken: Instant,
    /// How far from `taken` that may have been.
    pub uncertainty: Duration,
    /// The operating state of the controller.
    pub state: ControllerState,
    /// When the oldest part of that state held, as `taken`.
    pub state_taken: Instant,
    /// The correction that is applied, mm and rad, where the device has a read-back and no barrier. Where the control
    /// has none (see [`Description::tells_applied`]): what the outputs to it carry, as far as the device knows it.
    pub applied: Option<PerChannel<f64>>,
    /// The last report of the control's barrier, as its words came: whether they are whole, the checksum in them shows.
    /// `None` where there is no barrier, or nothing came yet.
    pub report: Option<Words>,
    /// When the oldest part of `applied` or `report` held, as `taken`.
    pub correction_taken: Instant,
}

impl Snapshot {
    /// The same, all of it at one instant.
    #[must_use]
    pub fn at(self, taken: Instant) -> Self {
        Self {
            taken,
            state_taken: taken,
            correction_taken: taken,
            ..self
        }
    }

    /// When the youngest part held: since then nothing was received from the controller.
    pub fn youngest(&self) -> Instant {
        self.taken.max(self.state_taken).max(self.correction_taken)
    }
}

/// A machine controller whose positions are read and that takes corrections.
///
/// Both calls are for a real-time loop: on a connection that is open, bounded by the deadline, without
/// allocation. Opening and opening again happen elsewhere ([`Supply`](crate::Supply)); until then calls
/// answer [`Fault::NotConnected`]. After any other fault the implementation is ready for the next call.
#[cfg_attr(feature = "mock", mockall::automock)]
pub trait Controller: Send {
    /// The properties of the controller that its configuration fixes.
    fn description(&self) -> &Description;

    /// Positions, state and what is applied, as they were received last and with the times at which they held. A device that
    /// sends on its own, or is read in the background, is not waited for again where it has become silent: what it sent
    /// last grows old.
    ///
    /// # Errors
    /// See [`Fault`].
    fn read(&mut self, deadline: Instant) -> Result<Snapshot, Fault>;

    /// Hands over a frame for the barrier of the control, all of its words in one exchange where the bus allows it. For a
    /// controller whose description says that it has a `barrier`; what is applied is in the next reports. A frame whose
    /// deadline has passed is not sent.
    ///
    /// # Errors
    /// See [`Fault`]. Whether the frame arrived is not known then.
    fn post(&mut self, frame: &Words, deadline: Instant) -> Result<(), Fault> {
        let _ = (frame, deadline);
        Err(Fault::Unsupported("frames for a barrier"))
    }

    /// Makes `corrections` (mm and rad) the applied ones, rounded to the resolution and held within what the
    /// device can express, and moves the heartbeat on. For a controller without a barrier. A write whose deadline has
    /// passed is not sent.
    ///
    /// # Errors
    /// See [`Fault`]. Whether the device took the corrections is not known then: the next
    /// [`read`](Self::read) tells.
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
