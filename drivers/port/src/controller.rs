//! What a machine controller is.

use std::time::{Duration, Instant};

use crate::Fault;

/// Axes of one controller at the most.
pub const MAX_AXES: usize = 9;

/// A number for each axis of a controller in the order of its [`Description`]: mm, rotary axes rad; the rest 0.
pub type AxisValues = [f64; MAX_AXES];

/// One axis of a controller.
#[derive(Clone, Debug, PartialEq)]
pub struct Axis {
    /// Its letter.
    pub name: char,
    /// Whether its positions and corrections are angles.
    pub rotary: bool,
    /// Whether reported positions contain the applied correction.
    pub includes_correction: bool,
    /// Smallest step of a correction, mm or rad.
    pub resolution: f64,
}

/// Who ramps a correction out when the cycle stops.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Heartbeat {
    /// The controller's side watches a word that [`Controller::apply`] moves on.
    Watched,
    /// Nobody: the configuration must say so.
    Unwatched,
}

/// What is fixed about a controller for as long as it is configured.
#[derive(Clone, Debug, PartialEq)]
pub struct Description {
    /// The device as the configuration names it.
    pub device: String,
    /// Paths with the same channel name replace one another, those with different names add.
    pub channel: String,
    /// Its axes, at most [`MAX_AXES`].
    pub axes: Vec<Axis>,
    /// Who watches it.
    pub heartbeat: Heartbeat,
    /// Whether a second gateway on the same controller is noticed.
    pub sees_other_gateways: bool,
    /// The shortest cycle it keeps up with.
    pub shortest_cycle: Duration,
}

impl Description {
    /// The place of an axis.
    pub fn index_of(&self, name: char) -> Option<usize> {
        self.axes.iter().position(|axis| axis.name == name)
    }
}

/// What state a controller is in.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ControllerState {
    /// Every axis was sent to its reference.
    pub referenced: bool,
    /// An alarm is on.
    pub alarm: bool,
    /// The emergency stop is pressed.
    pub emergency_stop: bool,
}

/// What a controller says at one instant.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Snapshot {
    /// Positions as reported, mm and rad.
    pub positions: AxisValues,
    /// When they held, on the monotonic clock: the middle of the exchange, unless the device tells better.
    pub taken: Instant,
    /// How far from `taken` that may have been.
    pub uncertainty: Duration,
    /// Its state.
    pub state: ControllerState,
    /// The correction that is applied, mm and rad, where the device can be asked.
    pub applied: Option<AxisValues>,
}

/// A machine controller whose positions are read and that takes corrections.
///
/// Both calls are for a real-time loop: on a connection that is open, bounded by the deadline, without
/// allocation. Opening and opening again happen elsewhere ([`Supply`](crate::Supply)); until then calls
/// answer [`Fault::NotConnected`]. After any other fault the implementation is ready for the next call.
#[cfg_attr(feature = "mock", mockall::automock)]
pub trait Controller: Send {
    /// What is fixed about it.
    fn description(&self) -> &Description;

    /// Positions, state and what is applied.
    ///
    /// # Errors
    /// See [`Fault`].
    fn read(&mut self, deadline: Instant) -> Result<Snapshot, Fault>;

    /// Makes `corrections` (mm and rad) the applied ones, rounded to the resolution and held within what the
    /// device can express, and moves the heartbeat on.
    ///
    /// # Errors
    /// See [`Fault`]. Whether the device took the corrections is not known then: the next
    /// [`read`](Self::read) tells.
    fn apply(&mut self, corrections: &AxisValues, deadline: Instant) -> Result<(), Fault>;
}

impl<C: Controller + ?Sized> Controller for Box<C> {
    fn description(&self) -> &Description {
        (**self).description()
    }

    fn read(&mut self, deadline: Instant) -> Result<Snapshot, Fault> {
        (**self).read(deadline)
    }

    fn apply(&mut self, corrections: &AxisValues, deadline: Instant) -> Result<(), Fault> {
        (**self).apply(corrections, deadline)
    }
}
