//! A control whose PLC applies the corrections. The control sends positions and state in plain frames, and receives
//! corrections as plain values or as words for a barrier. Signals are found by name; ids, bit positions and scaling are
//! free.

use std::{
    collections::BTreeMap,
    time::{Duration, Instant},
};

use volcomp_port::{
    Axis, Controller, ControllerState, Description, DeviceError, Fault, Heartbeat, ShownStates,
    Snapshot, Words,
};
use volcomp_vocabulary::{AxisName, Displacement, PerChannel};

use crate::{
    barrier::{Barrier, Count},
    frame::{CanPort, UnopenedBus},
    plain::{PlainCorrections, required_signal},
    quantity::STATES,
    receiver::{Health, ReceivedMessage, ReceivedSignal, Receiver, subscribe},
    signals::SignalTable,
};

/// Signals and axes for reading and correcting a control on a CAN bus.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct BridgeConfig {
    pub table: SignalTable,
    /// Name of the channel through which corrections reach the axes.
    pub channel: String,
    /// Corrected axes in channel order. Signals of each: `X_POS` and, without a barrier, `X_CORR` and optionally
    /// `X_APPLIED`.
    pub axes: Vec<AxisName>,
    /// Axes whose positions are only read (signal `X_POS`). If `axes` is empty, nothing is sent.
    pub reads: Vec<AxisName>,
    /// Whether reported positions contain the correction.
    pub includes_correction: bool,
}

impl BridgeConfig {
    /// Resolution of the reported positions, by axis.
    pub fn position_steps(&self) -> BTreeMap<AxisName, Displacement> {
        let step = |name: &AxisName| {
            let (message, place) = self.table.find(&format!("{name}_POS"))?;
            let signal = &self.table.messages[message].signals[place];
            let step = signal.step() * signal.to_internal()?;
            Some((*name, Displacement::new(name.kind(), step)))
        };
        let axes = self.axes.iter().chain(&self.reads);
        axes.filter_map(step).collect()
    }

    /// Describes the controller without opening a bus.
    ///
    /// # Errors
    /// Axes without signals, unknown units.
    pub fn describe(&self, device: &str) -> Result<Description, DeviceError> {
        let bus = UnopenedBus(device.to_owned());
        Ok(CanController::new(bus, self)?.description)
    }
}

enum Transport {
    /// Corrections are sent as words of a frame for the barrier of the control.
    Barrier(Barrier),
    Plain(PlainCorrections),
    ReadOnly,
}

/// Reads and corrects a control by cyclic CAN frames. A signal table describes the frames.
pub struct CanController<P> {
    receiver: Receiver<P>,
    description: Description,
    positions: Vec<ReceivedSignal>,
    /// Signals of the applied corrections, by axis; empty unless every axis has one.
    applied: Vec<ReceivedSignal>,
    states: [Option<ReceivedSignal>; 3],
    transport: Transport,
}

impl<P: CanPort> CanController<P> {
    /// Creates a controller on a bus.
    ///
    /// # Errors
    /// Axes without signals, unknown units, words of a barrier that do not fit the axes.
    pub fn new(port: P, config: &BridgeConfig) -> Result<Self, DeviceError> {
        let device = port.device().to_owned();
        let refused =
            |what: String| DeviceError::option(&*device, what, "correct the DBC file or the axes");
        let table = &config.table;
        let mut messages: Vec<ReceivedMessage> = Vec::new();
        let mut positions = Vec::new();
        for name in config.axes.iter().chain(&config.reads) {
            let place = required_signal(table, *name, "POS").map_err(&refused)?;
            positions.push(subscribe(table, &mut messages, place).map_err(&refused)?);
        }
        let only_reads = config.axes.is_empty();
        let barrier = if only_reads {
            None
        } else {
            Barrier::of(table, &config.axes, &mut messages).map_err(&refused)?
        };
        let mut applied = Vec::new();
        let (transport, counts, heartbeat) = if only_reads {
            (Transport::ReadOnly, Vec::new(), Heartbeat::Unwatched)
        } else if let Some((barrier, counts)) = barrier {
            (Transport::Barrier(barrier), counts, Heartbeat::Watched)
        } else {
            let (plain, counts) = PlainCorrections::of(table, &config.axes).map_err(&refused)?;
            for name in &config.axes {
                if let Some(at) = table.find(&format!("{name}_APPLIED")) {
                    applied.push(subscribe(table, &mut messages, at).map_err(&refused)?);
                }
            }
            let heartbeat = plain.heartbeat();
            (Transport::Plain(plain), counts, heartbeat)
        };
        if applied.len() < config.axes.len() {
            applied.clear();
        }
        let mut states = [const { None }; 3];
        for (state, name) in states.iter_mut().zip(STATES) {
            if let Some(at) = table.find(name) {
                *state = Some(subscribe(table, &mut messages, at).map_err(&refused)?);
            }
        }
        let has_barrier = matches!(transport, Transport::Barrier(_));
        let description = Description {
            channel: config.channel.clone(),
            axes: axis_descriptions(config, &counts),
            reads: config.reads.clone(),
            heartbeat,
            barrier: has_barrier,
            tells_applied: has_barrier || !applied.is_empty(),
            shown: ShownStates {
                referenced: states[0].is_some(),
                alarm: states[1].is_some(),
                emergency_stop: states[2].is_some(),
            },
            // A barrier accepts frames of one sender only, and reports its number.
            sees_other_gateways: has_barrier,
            shortest_cycle: Duration::from_millis(1),
            device: device.clone(),
        };
        description.check().map_err(|e| refused(e.to_string()))?;
        Ok(Self {
            receiver: Receiver::new(port, messages),
            description,
            positions,
            applied,
            states,
            transport,
        })
    }

    /// Numbers of bus errors so far.
    pub fn health(&self) -> Health {
        self.receiver.health
    }

    /// Number of corrections that exceeded the range of their signal.
    pub fn saturated(&self) -> u64 {
        match &self.transport {
            Transport::Barrier(_) | Transport::ReadOnly => 0,
            Transport::Plain(plain) => plain.saturated(),
        }
    }

    fn listen(&mut self, deadline: Instant, wait: bool) -> Result<bool, Fault> {
        let transport = &mut self.transport;
        self.receiver.listen(deadline, wait, |messages, index| {
            if let Transport::Barrier(barrier) = transport {
                barrier.process(messages, index);
            }
        })
    }

    fn value(&self, place: &ReceivedSignal) -> f64 {
        let message = self.receiver.message(place);
        place.signal.value(message.data()) * place.to_internal
    }

    /// Whether a state of the control is on. Returns `forbids`, the value that forbids correction, if the message of
    /// the state was never received.
    fn state(&self, place: &ReceivedSignal, forbids: bool) -> bool {
        if self.receiver.message(place).taken.is_some() {
            self.value(place) != 0.0
        } else {
            forbids
        }
    }

    /// Arrival times of the oldest and of the newest of these signals; `None` if one of the signals was never received.
    fn arrivals(&self, places: &[ReceivedSignal]) -> Option<[Instant; 2]> {
        let mut places = places.iter();
        let first = self.receiver.message(places.next()?).taken?;
        places.try_fold([first; 2], |[a, b], place| {
            let taken = self.receiver.message(place).taken?;
            Some([a.min(taken), b.max(taken)])
        })
    }
}

impl<P: CanPort> Controller for CanController<P> {
    fn description(&self) -> &Description {
        &self.description
    }

    /// Returns the last received positions, states and applied correction or report, regardless of their age. Waits
    /// only until every position was received once. `taken` is the arrival of the oldest position, and `uncertainty`
    /// the time from the oldest to the newest position.
    fn read(&mut self, deadline: Instant) -> Result<Snapshot, Fault> {
        self.listen(deadline, false)?;
        let [taken, newest] = loop {
            if self.receiver.health.bus_off {
                return Err(Fault::Disconnected);
            }
            if let Some(arrived) = self.arrivals(&self.positions) {
                break arrived;
            }
            if Instant::now() >= deadline || !self.listen(deadline, true)? {
                return Err(Fault::TimedOut);
            }
        };
        let mut positions = PerChannel::ZERO;
        for (position, place) in positions.iter_mut().zip(&self.positions) {
            *position = self.value(place);
        }
        let arrived = self.arrivals(&self.applied);
        let applied = arrived.map(|_| {
            let mut values = PerChannel::ZERO;
            for (value, place) in values.iter_mut().zip(&self.applied) {
                *value = self.value(place);
            }
            values
        });
        let (report, arrived) = match &self.transport {
            Transport::Barrier(barrier) => (
                barrier.report().map(|(words, _)| words),
                barrier.report().map(|(_, arrived)| arrived),
            ),
            Transport::Plain(_) | Transport::ReadOnly => (None, arrived.map(|[oldest, _]| oldest)),
        };
        let [referenced, alarm, emergency_stop] = &self.states;
        let state = |place: &Option<ReceivedSignal>, unseen: bool, forbids: bool| {
            let place = place.as_ref();
            place.map_or(unseen, |place| self.state(place, forbids))
        };
        let states = self.states.iter().flatten();
        let states = states.filter_map(|place| self.receiver.message(place).taken);
        Ok(Snapshot {
            positions,
            taken,
            uncertainty: newest.duration_since(taken),
            // A state without a signal is reported as good. The description names such states, and the configuration
            // has accepted them.
            state: ControllerState {
                referenced: state(referenced, true, false),
                alarm: state(alarm, false, true),
                emergency_stop: state(emergency_stop, false, true),
            },
            state_taken: states.min().unwrap_or(taken),
            applied,
            report,
            correction_taken: arrived.unwrap_or(taken),
        })
    }

    fn post(&mut self, frame: &Words, deadline: Instant) -> Result<(), Fault> {
        match &mut self.transport {
            Transport::Barrier(barrier) => barrier.post(&mut self.receiver.port, frame, deadline),
            Transport::Plain(_) => Err(Fault::Unsupported("frames: the DBC file has no barrier")),
            Transport::ReadOnly => Err(READ_ONLY),
        }
    }

    fn apply(&mut self, corrections: &PerChannel<f64>, deadline: Instant) -> Result<(), Fault> {
        match &mut self.transport {
            Transport::Plain(plain) => plain.apply(&mut self.receiver.port, corrections, deadline),
            Transport::Barrier(_) => {
                Err(Fault::Unsupported("plain values: the control has a barrier"))
            }
            Transport::ReadOnly => Err(READ_ONLY),
        }
    }
}

const READ_ONLY: Fault = Fault::Unsupported("corrections, where positions are only read");

fn axis_descriptions(config: &BridgeConfig, counts: &[Count]) -> Vec<Axis> {
    let both = config.axes.iter().zip(counts);
    both.map(|(name, count)| Axis {
        name: *name,
        includes_correction: config.includes_correction,
        resolution: Displacement::new(name.kind(), count.step),
        largest: Some(Displacement::new(name.kind(), count.largest)),
    })
    .collect()
}
