//! A control whose PLC does the last step: positions and state come in plain frames, corrections go out. The
//! names of the signals say what they are, so ids, places and scaling are the user's to change.

use std::time::{Duration, Instant};

use volcomp_port::{
    Axis, Controller, ControllerState, Description, DeviceError, Fault, Heartbeat, Reason,
    Snapshot, Temperature, Thermometer,
};

use volcomp_vocabulary::{AxisName, Displacement, PerChannel};

use crate::{
    frame::{CanPort, Frame, Received},
    signals::{Message, Signal, SignalTable},
};

/// The signals, axes and time limit by which a control on a CAN bus is read and corrected.
#[derive(Clone, Debug, PartialEq)]
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

/// The names of the temperatures of a table, in the order in which [`CanThermometer`] tells them.
///
/// # Errors
/// A table without temperatures.
pub fn temperature_names(table: &SignalTable, device: &str) -> Result<Vec<String>, DeviceError> {
    let unopened = Unopened(device.to_owned());
    Ok(CanThermometer::new(unopened, table, Duration::ZERO)?.names)
}

/// A bus that is only named: what is built on it can be checked, and never hears a frame.
struct Unopened(String);

impl CanPort for Unopened {
    fn device(&self) -> &str {
        &self.0
    }

    fn receive(&mut self, _deadline: Instant) -> Result<Option<Received>, Fault> {
        Err(Fault::NotConnected)
    }

    fn send(&mut self, _frame: &Frame, _deadline: Instant) -> Result<(), Fault> {
        Err(Fault::NotConnected)
    }
}

/// The errors that were noticed on the bus so far: counts of frames, and whether the controller is off the bus.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Health {
    /// Frames of other lengths or with a wrong checksum.
    pub broken: u64,
    /// Frames with the counter of the one before: the sender stands still, or somebody repeats it.
    pub repeated: u64,
    /// Counters left out: frames were lost.
    pub lost: u64,
    /// Error frames of the bus's controller.
    pub errors: u64,
    /// The controller has left the bus, and nothing came since.
    pub bus_off: bool,
}

/// A message that is received: the last data that were whole.
struct Heard {
    message: Message,
    data: [u8; 64],
    counter: Option<u64>,
    taken: Option<Instant>,
}

impl Heard {
    fn new(message: &Message) -> Self {
        Self {
            message: message.clone(),
            data: [0; 64],
            counter: None,
            taken: None,
        }
    }

    fn data(&self) -> &[u8] {
        &self.data[..self.message.length]
    }

    fn is_fresh(&self, stale_after: Duration) -> bool {
        self.taken
            .is_some_and(|taken| taken.elapsed() <= stale_after)
    }

    /// Takes a frame of this message.
    fn hear(&mut self, frame: &Frame, taken: Instant, health: &mut Health) {
        if !self.message.is_whole(frame.data()) {
            health.broken += 1;
            return;
        }
        if let (Some(before), Some(now)) = (self.counter, self.message.counter(frame.data())) {
            match (now + 16 - before % 16) % 16 {
                0 => {
                    health.repeated += 1;
                    return;
                }
                ahead => health.lost += ahead - 1,
            }
        }
        self.counter = self.message.counter(frame.data());
        self.data[..self.message.length].copy_from_slice(frame.data());
        self.taken = Some(taken);
    }
}

/// Everything that is received over one port.
struct Ears<P> {
    port: P,
    heard: Vec<Heard>,
    health: Health,
}

impl<P: CanPort> Ears<P> {
    /// Takes what there is; waits for one frame until the deadline where `wait`. Whether one came.
    fn listen(&mut self, deadline: Instant, wait: bool) -> Result<bool, Fault> {
        let mut came = false;
        let until = if wait { deadline } else { Instant::now() };
        // A flooded bus must not hold a cycle up.
        for _ in 0..256 {
            let until = if came { Instant::now() } else { until };
            match self.port.receive(until)? {
                None => break,
                Some(Received::Error) => self.health.errors += 1,
                Some(Received::BusOff) => {
                    self.health.errors += 1;
                    self.health.bus_off = true;
                }
                Some(Received::Frame(frame, taken)) => {
                    self.health.bus_off = false;
                    let same = |heard: &&mut Heard| {
                        let message = &heard.message;
                        (message.id, message.extended) == (frame.id, frame.extended)
                    };
                    if let Some(heard) = self.heard.iter_mut().find(same) {
                        heard.hear(&frame, taken, &mut self.health);
                        came = true;
                    }
                }
            }
        }
        Ok(came)
    }
}

/// Where a signal is: which message that is heard, and it itself.
#[derive(Clone)]
struct Place {
    heard: usize,
    signal: Signal,
    /// Its unit in mm, rad or °C.
    to_internal: f64,
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
            let applied = table.find(&format!("{name}_APPLIED"));
            let applied = applied.map(|at| hear(table, &mut heard, at));
            described.push(Axis {
                name: *name,
                includes_correction: config.includes_correction,
                resolution: Displacement::new(name.kind(), correction.step() * to_internal),
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
            sees_other_gateways: false,
            shortest_cycle: Duration::from_millis(1),
            device: device.clone(),
        };
        description.check().map_err(|e| refused(e.to_string()))?;
        Ok(Self {
            ears: Ears {
                port,
                heard,
                health: Health::default(),
            },
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
        let heard = &self.ears.heard[place.heard];
        place.signal.value(heard.data()) * place.to_internal
    }

    fn all_fresh(&self) -> bool {
        let places = self.axes.iter().map(|axis| &axis.position);
        places
            .chain(self.flags.iter().flatten())
            .all(|place| self.ears.heard[place.heard].is_fresh(self.stale_after))
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
            if let Some(when) = self.ears.heard[axis.position.heard].taken {
                taken = taken.min(when);
                newest = newest.max(Some(when));
            }
        }
        let flag = |place: &Option<Place>| place.as_ref().map(|place| self.value(place) != 0.0);
        let knows_applied = self.axes.iter().all(|axis| {
            let place = axis.applied.as_ref();
            place.is_some_and(|p| self.ears.heard[p.heard].is_fresh(self.stale_after))
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

/// The factor from a signal's unit to mm, rad or °C; flags have no unit. [`SignalTable::parse`] refuses other units.
fn to_internal(signal: &Signal) -> f64 {
    signal.to_internal().unwrap_or(1.0)
}

/// Adds the message of a signal to those that are heard.
fn hear(table: &SignalTable, heard: &mut Vec<Heard>, (message, place): (usize, usize)) -> Place {
    let message = &table.messages[message];
    let known = heard.iter().position(|h| h.message.name == message.name);
    let index = known.unwrap_or_else(|| {
        heard.push(Heard::new(message));
        heard.len() - 1
    });
    let signal = message.signals[place].clone();
    Place {
        heard: index,
        to_internal: to_internal(&signal),
        signal,
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

/// Temperatures in plain frames: signals that end in `_TEMP`, named by what stands before, in small letters.
/// Raw 0 stands for a shorted sensor, the highest raw number for a broken one. Reading takes what has come:
/// it does not wait.
pub struct CanThermometer<P> {
    ears: Ears<P>,
    names: Vec<String>,
    places: Vec<Place>,
    latest: Vec<Temperature>,
    stale_after: Duration,
}

impl<P: CanPort> CanThermometer<P> {
    /// The temperatures of a table.
    ///
    /// # Errors
    /// A table without temperatures.
    pub fn new(port: P, table: &SignalTable, stale_after: Duration) -> Result<Self, DeviceError> {
        let refused =
            |what: String| DeviceError::option(port.device(), what, "correct the DBC file");
        let (mut heard, mut names, mut places) = (Vec::new(), Vec::new(), Vec::new());
        for (message, found) in table.messages.iter().enumerate() {
            for (place, signal) in found.signals.iter().enumerate() {
                if let Some(name) = signal.name.strip_suffix("_TEMP") {
                    names.push(name.to_lowercase());
                    places.push(hear(table, &mut heard, (message, place)));
                }
            }
        }
        if names.is_empty() {
            return Err(refused("there is no signal that ends in _TEMP".to_owned()));
        }
        Ok(Self {
            latest: vec![Temperature::NOT_READ; names.len()],
            ears: Ears {
                port,
                heard,
                health: Health::default(),
            },
            names,
            places,
            stale_after,
        })
    }

    /// The errors that were noticed on the bus so far.
    pub fn health(&self) -> Health {
        self.ears.health
    }
}

impl<P: CanPort> Thermometer for CanThermometer<P> {
    fn device(&self) -> &str {
        self.ears.port.device()
    }

    fn names(&self) -> &[String] {
        &self.names
    }

    fn latest(&mut self) -> &[Temperature] {
        let listened = self.ears.listen(Instant::now(), false);
        for (latest, place) in self.latest.iter_mut().zip(&self.places) {
            let heard = &self.ears.heard[place.heard];
            let Some(taken) = heard.taken else { continue };
            let raw = place.signal.raw(heard.data());
            *latest = if listened.is_err() || taken.elapsed() > self.stale_after {
                Temperature::bad(Reason::NoAnswer, taken)
            } else if raw == 0 {
                Temperature::bad(Reason::Short, taken)
            } else if raw == u64::MAX >> (64 - place.signal.bits) {
                Temperature::bad(Reason::Open, taken)
            } else {
                Temperature::good(place.signal.value(heard.data()) * place.to_internal, taken)
            };
        }
        &self.latest
    }
}
