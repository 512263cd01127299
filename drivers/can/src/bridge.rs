//! A control whose PLC does the last step: positions and state come in plain frames, corrections go out. The
//! names of the signals say what they are, so ids, places and scaling are the user's to change.

use std::time::{Duration, Instant};

use volcomp_port::{
    Axis, Controller, ControllerState, Description, DeviceError, Fault, Heartbeat, ShownStates,
    Snapshot,
};

use volcomp_vocabulary::{AxisName, Displacement, PerChannel};

use crate::{
    ears::{Ears, Health, Heard, Place, hear, to_internal},
    frame::{CanPort, Frame},
    signals::{Message, Signal, SignalTable},
    unopened::Unopened,
};

/// The signals, axes and time limit by which a control on a CAN bus is read and corrected.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct BridgeConfig {
    /// The table of signals.
    pub table: SignalTable,
    /// Name of the channel by which corrections get in.
    pub channel: String,
    /// The axes in channel order; signals `X_POS`, `X_CORR` and, where there is one, `X_APPLIED`.
    pub axes: Vec<AxisName>,
    /// Whether positions contain the correction.
    pub includes_correction: bool,
    /// Positions older than this are stale: the control sends them by itself.
    pub stale_after: Duration,
}

impl BridgeConfig {
    /// The description of the controller that this configuration makes, without opening a bus.
    ///
    /// # Errors
    /// Axes without signals, units that are not known.
    pub fn describe(&self, device: &str) -> Result<Description, DeviceError> {
        let unopened = Unopened(device.to_owned());
        Ok(CanController::new(unopened, self)?.description)
    }
}

struct BridgeAxis {
    position: Place,
    applied: Option<Place>,
    /// Which message that is sent.
    sent: usize,
    correction: Signal,
    to_internal: f64,
}

/// A controller over plain frames.
pub struct CanController<P> {
    ears: Ears<P>,
    description: Description,
    axes: Vec<BridgeAxis>,
    flags: [Option<Place>; 3],
    sent: Vec<(Message, Frame)>,
    counter: u64,
    stale_after: Duration,
    saturated: u64,
}

impl<P: CanPort> CanController<P> {
    /// A controller on a bus.
    ///
    /// # Errors
    /// Axes without signals.
    pub fn new(port: P, config: &BridgeConfig) -> Result<Self, DeviceError> {
        let device = port.device().to_owned();
        let refused =
            |what: String| DeviceError::option(&*device, what, "correct the DBC file or the axes");
        let table = &config.table;
        let (mut heard, mut sent) = (Vec::new(), Vec::new());
        let mut axes = Vec::new();
        let mut described = Vec::new();
        for name in &config.axes {
            let needed = |suffix: &str| {
                let signal = format!("{name}_{suffix}");
                table
                    .find(&signal)
                    .ok_or_else(|| refused(format!("there is no signal {signal}")))
            };
            let position = needed("POS")?;
            let (message, place) = needed("CORR")?;
            let correction = table.messages[message].signals[place].clone();
            let to_internal = to_internal(&correction);
            let largest = correction.largest() * to_internal;
            let applied = table.find(&format!("{name}_APPLIED"));
            let applied = applied.map(|at| hear(table, &mut heard, at));
            described.push(Axis {
                name: *name,
                includes_correction: config.includes_correction,
                resolution: Displacement::new(name.kind(), correction.step() * to_internal),
                largest: Some(Displacement::new(name.kind(), largest)),
            });
            axes.push(BridgeAxis {
                position: hear(table, &mut heard, position),
                applied,
                sent: send(table, &mut sent, message).ok_or_else(|| {
                    refused(format!("{} makes no frame", table.messages[message].name))
                })?,
                correction,
                to_internal,
            });
        }
        let flag = |name: &str, heard: &mut Vec<Heard>| {
            let at = table.find(name)?;
            Some(hear(table, heard, at))
        };
        let flags = ["REFERENCED", "ALARM", "EMERGENCY_STOP"].map(|name| flag(name, &mut heard));
        let watched = sent
            .iter()
            .all(|(message, frame)| message.counter(frame.data()).is_some());
        let description = Description {
            channel: config.channel.clone(),
            axes: described,
            heartbeat: if watched {
                Heartbeat::Watched
            } else {
                Heartbeat::Unwatched
            },
            barrier: false,
            tells_applied: axes.iter().all(|axis| axis.applied.is_some()),
            shown: ShownStates {
                referenced: flags[0].is_some(),
                alarm: flags[1].is_some(),
                emergency_stop: flags[2].is_some(),
            },
            sees_other_gateways: false,
            shortest_cycle: Duration::from_millis(1),
            device: device.clone(),
        };
        description.check().map_err(|e| refused(e.to_string()))?;
        Ok(Self {
            ears: Ears::new(port, heard),
            description,
            axes,
            flags,
            sent,
            counter: 0,
            stale_after: config.stale_after,
            saturated: 0,
        })
    }

    /// The errors that were noticed on the bus so far.
    pub fn health(&self) -> Health {
        self.ears.health
    }

    /// How often a correction was larger than its signal can say.
    pub fn saturated(&self) -> u64 {
        self.saturated
    }

    fn value(&self, place: &Place) -> f64 {
        let heard = self.ears.heard(place);
        place.signal.value(heard.data()) * place.to_internal
    }

    fn all_fresh(&self) -> bool {
        let places = self.axes.iter().map(|axis| &axis.position);
        places
            .chain(self.flags.iter().flatten())
            .all(|place| self.ears.heard(place).is_fresh(self.stale_after))
    }
}

impl<P: CanPort> Controller for CanController<P> {
    fn description(&self) -> &Description {
        &self.description
    }

    /// The last positions, state and applied correction from the control; where they are stale, waits for its next
    /// frames.
    fn read(&mut self, deadline: Instant) -> Result<Snapshot, Fault> {
        self.ears.listen(deadline, false)?;
        while !self.all_fresh() {
            if self.ears.health.bus_off {
                return Err(Fault::Disconnected);
            }
            if Instant::now() >= deadline || !self.ears.listen(deadline, true)? {
                return Err(Fault::TimedOut);
            }
        }
        let mut positions = PerChannel::ZERO;
        let mut applied = PerChannel::ZERO;
        let mut taken = Instant::now();
        let mut newest = None;
        for (index, axis) in self.axes.iter().enumerate() {
            positions[index] = self.value(&axis.position);
            applied[index] = axis.applied.as_ref().map_or(0.0, |place| self.value(place));
            if let Some(when) = self.ears.heard(&axis.position).taken {
                taken = taken.min(when);
                newest = newest.max(Some(when));
            }
        }
        let flag = |place: &Option<Place>| place.as_ref().map(|place| self.value(place) != 0.0);
        let knows_applied = self.axes.iter().all(|axis| {
            let place = axis.applied.as_ref();
            place.is_some_and(|p| self.ears.heard(p).is_fresh(self.stale_after))
        });
        Ok(Snapshot {
            positions,
            taken,
            // Positions of several messages are as far apart as these came.
            uncertainty: newest.map_or(Duration::ZERO, |newest| {
                newest.saturating_duration_since(taken)
            }),
            state: ControllerState {
                referenced: flag(&self.flags[0]).unwrap_or(true),
                alarm: flag(&self.flags[1]).unwrap_or(false),
                emergency_stop: flag(&self.flags[2]).unwrap_or(false),
            },
            applied: knows_applied.then_some(applied),
            report: None,
        })
    }

    fn apply(&mut self, corrections: &PerChannel<f64>, deadline: Instant) -> Result<(), Fault> {
        for (axis, correction) in self.axes.iter().zip(corrections) {
            let (_, frame) = &mut self.sent[axis.sent];
            let within = axis
                .correction
                .put(frame.data_mut(), correction / axis.to_internal);
            self.saturated += u64::from(!within);
        }
        self.counter = (self.counter + 1) % 16;
        for (message, frame) in &mut self.sent {
            message.seal(frame.data_mut(), self.counter);
            self.ears.port.send(frame, deadline)?;
        }
        Ok(())
    }
}

/// Adds a message to those that are sent.
fn send(table: &SignalTable, sent: &mut Vec<(Message, Frame)>, message: usize) -> Option<usize> {
    let message = &table.messages[message];
    let known = sent
        .iter()
        .position(|(other, _)| other.name == message.name);
    if known.is_some() {
        return known;
    }
    sent.push((message.clone(), message.frame()?));
    Some(sent.len() - 1)
}
