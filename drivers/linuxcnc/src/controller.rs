//! Controls LinuxCNC through its bridge: receives states and sends frames for the barrier.

use std::{
    io::ErrorKind,
    net::UdpSocket,
    time::{Duration, Instant},
};

use rustix::{
    event::{PollFd, PollFlags, Timespec, poll},
    io::Errno,
};
use volcomp_port::{
    Axis, Controller, ControllerState, Description, DeviceError, Fault, Heartbeat, ShownStates,
    Snapshot, Words,
};
use volcomp_vocabulary::{AxisKind, AxisName, Deg, Displacement, Mm, PerChannel};

use crate::{
    COMMAND_BYTES, Command, Content, Flags, Key, STATE_BYTES, State,
    age::Clocks,
    offset_monitor::OffsetMonitor,
    socket::{device, open},
    state::AxisState,
};

/// Interval of listen commands while no frames are sent. It is shorter than the second after which the bridge stops
/// sending states.
const LISTEN_INTERVAL: Duration = Duration::from_millis(200);

/// Time without states of the current run after which a state of another run counts as a restart of the bridge.
const RUN_TIMEOUT: Duration = Duration::from_secs(1);

const MAX_DATAGRAMS_PER_READ: usize = 256;

/// Configuration of a LinuxCNC control and its bridge.
#[derive(Clone, Debug, PartialEq)]
pub struct LinuxCncConfig {
    pub host: String,
    pub port: u16,
    pub key: Key,
    /// Whether the bridge may run on another computer. Datagrams are not encrypted, so anyone on that network can read
    /// them.
    pub remote: bool,
    /// Name of the channel through which corrections reach the axes. Controllers with the same channel are
    /// alternatives.
    pub channel: String,
    /// Machine number, as set in the bridge. It is unused if positions are only read.
    pub machine: u16,
    /// Corrected axes in channel order, as set in the bridge; empty if positions are only read.
    pub axes: Vec<AxisName>,
    pub reads: Vec<AxisName>,
    /// Length of one count of a linear axis.
    pub step_linear: Displacement,
    /// Angle of one count of a rotary axis.
    pub step_rotary: Displacement,
}

impl LinuxCncConfig {
    /// Default size of a count of linear axes: 1 nm.
    pub const STEP_LINEAR: Displacement = Displacement::Length(Mm(1e-6));

    /// Default size of a count of rotary axes: a millionth of a degree.
    pub fn step_rotary() -> Displacement {
        Displacement::Angle(Deg(1e-6).to_rad())
    }

    /// Name of the device in messages.
    pub fn device(&self) -> String {
        device(&self.host, self.port)
    }

    fn step(&self, kind: AxisKind) -> Displacement {
        match kind {
            AxisKind::Linear => self.step_linear,
            AxisKind::Rotary => self.step_rotary,
        }
    }

    /// Size of one count in the unit of the protocol: nm, or millionths of a degree.
    pub(crate) fn step_nano(&self, kind: AxisKind) -> f64 {
        nano(kind, self.step(kind).mm_or_rad()).round()
    }

    /// Describes the controller without opening it.
    ///
    /// # Errors
    /// Invalid axes or steps.
    pub fn describe(&self) -> Result<Description, DeviceError> {
        let axis = |name: &AxisName| {
            let step = self.step(name.kind());
            let largest = f64::from(i16::MAX) * step.mm_or_rad();
            Axis {
                name: *name,
                // `pos-cmd` never contains the offset by which the correction is applied.
                includes_correction: false,
                resolution: step,
                largest: Some(Displacement::new(name.kind(), largest)),
            }
        };
        let description = Description {
            device: self.device(),
            channel: self.channel.clone(),
            axes: self.axes.iter().map(axis).collect(),
            reads: self.reads.clone(),
            heartbeat: if self.axes.is_empty() { Heartbeat::Unwatched } else { Heartbeat::Watched },
            barrier: !self.axes.is_empty(),
            tells_applied: !self.axes.is_empty(),
            shown: ShownStates::ALL,
            sees_other_gateways: !self.axes.is_empty(),
            shortest_cycle: Duration::from_micros(250),
        };
        let unfit = |error: volcomp_port::UnfitAxes| {
            DeviceError::option(self.device(), error.to_string(), "correct the axes")
        };
        description.check().map_err(unfit)?;
        for axis in &description.axes {
            let counts = nano(axis.name.kind(), axis.step());
            let near = (counts - counts.round()).abs() < 1e-6 * counts;
            if !near || !(1.0..=1e6).contains(&counts.round()) {
                let found = format!("axis {}: found a step of {}", axis.name, axis.resolution);
                let expected = match axis.kind() {
                    AxisKind::Linear => "expected whole nanometres, 0.001 um or more",
                    AxisKind::Rotary => "expected whole millionths of a degree",
                };
                return Err(DeviceError::option(self.device(), found, expected));
            }
        }
        Ok(description)
    }
}

/// Converts a length in mm to nm, or an angle in rad to millionths of a degree.
fn nano(kind: AxisKind, mm_or_rad: f64) -> f64 {
    match kind {
        AxisKind::Linear => mm_or_rad * 1e6,
        AxisKind::Rotary => mm_or_rad.to_degrees() * 1e6,
    }
}

/// Counters of irregular datagrams from the bridge.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Health {
    /// Number of datagrams that are not states of this protocol version and key.
    pub broken: u64,
    /// Number of states from another machine, or with other axes or steps than configured.
    pub foreign: u64,
    /// Number of states that arrived twice or out of order, and of states of another run that arrived although states
    /// of the current run still arrived.
    pub late: u64,
    /// Number of lost states, from gaps in the sequence numbers.
    pub lost: u64,
    /// Number of restarts of the bridge.
    pub restarts: u64,
}

/// Reads and corrects a LinuxCNC control through its bridge.
pub struct LinuxCncController {
    socket: UdpSocket,
    description: Description,
    machine: u16,
    key: Key,
    /// Time at which the last command was sent, and run of the state that the command answered.
    last_sent: Option<(Instant, u32)>,
    last: Option<(State, Instant)>,
    last_received: Option<Instant>,
    mismatch: Option<&'static str>,
    clocks: Clocks,
    offset_monitor: OffsetMonitor,
    health: Health,
}

impl LinuxCncController {
    /// Opens the socket to a bridge. The bridge need not be running.
    ///
    /// # Errors
    /// Invalid axes or steps; a host that cannot be resolved, or is another computer although `remote` is `false`; no
    /// socket.
    pub fn new(config: &LinuxCncConfig) -> Result<Self, DeviceError> {
        let description = config.describe()?;
        let socket = open(&config.host, config.port, config.remote)?;
        Ok(Self {
            socket,
            description,
            machine: config.machine,
            key: config.key,
            last_sent: None,
            last: None,
            last_received: None,
            mismatch: None,
            clocks: Clocks::default(),
            offset_monitor: OffsetMonitor::default(),
            health: Health::default(),
        })
    }

    pub fn health(&self) -> Health {
        self.health
    }

    /// Last state received from the bridge, regardless of its age; `None` before the first state.
    pub fn state(&self) -> Option<&State> {
        self.last.as_ref().map(|(state, _)| state)
    }

    fn send(&mut self, content: Content) -> Result<(), Fault> {
        let answers = self.state().map_or([0; 2], |state| [state.run, state.sequence]);
        self.last_sent = Some((Instant::now(), answers[0]));
        let command = Command { machine: self.machine, answers, content };
        let mut bytes = [0; COMMAND_BYTES];
        let length = command.encode(&self.key, &mut bytes);
        // The error "connection refused" is about the previous datagram, so this datagram is sent again.
        for _ in 0..2 {
            match self.socket.send(&bytes[..length]) {
                Ok(_) => return Ok(()),
                Err(e) if e.kind() == ErrorKind::ConnectionRefused => {}
                Err(e) if e.kind() == ErrorKind::Interrupted => {}
                // The send queue is full. The datagram is lost, as it could be on the network.
                Err(e) if e.kind() == ErrorKind::WouldBlock => return Err(Fault::TimedOut),
                Err(_) => return Err(Fault::Disconnected),
            }
        }
        Err(Fault::Disconnected)
    }

    /// Whether a listen command is due, because no command was sent for `LISTEN_INTERVAL` or since the bridge
    /// restarted.
    fn listen_is_due(&self) -> bool {
        let run = self.state().map_or(0, |state| state.run);
        self.last_sent
            .is_none_or(|(at, answered)| answered != run || at.elapsed() >= LISTEN_INTERVAL)
    }

    fn drain(&mut self) {
        let mut bytes = [0; STATE_BYTES + 1];
        for _ in 0..MAX_DATAGRAMS_PER_READ {
            match self.socket.recv(&mut bytes) {
                Ok(length) => self.take(&bytes[..length], Instant::now()),
                Err(e) if e.kind() == ErrorKind::Interrupted => {}
                // No process listens at that port. The growing age of the last state shows this.
                Err(e) if e.kind() == ErrorKind::ConnectionRefused => {}
                Err(_) => return,
            }
        }
    }

    fn take(&mut self, bytes: &[u8], arrived: Instant) {
        let Ok(state) = State::decode(bytes, &self.key) else {
            self.health.broken += 1;
            return;
        };
        if let Some(mismatch) = self.mismatch_of(&state) {
            self.health.foreign += 1;
            self.mismatch = Some(mismatch);
            return;
        }
        if let Some((last, _)) = &self.last {
            if last.run == state.run {
                // The sequence number wraps. A number is later if it is ahead by less than half of the range.
                let ahead = state.sequence.wrapping_sub(last.sequence);
                if ahead == 0 || ahead >= 1 << 31 {
                    self.health.late += 1;
                    return;
                }
                self.health.lost += u64::from(ahead - 1);
            } else {
                let silent = self.last_received.is_none_or(|last_received| {
                    arrived.saturating_duration_since(last_received) > RUN_TIMEOUT
                });
                // While states of the current run arrive, a state of another run is a replay, and its time is
                // meaningless.
                if !silent {
                    self.health.late += 1;
                    return;
                }
                self.clocks.reset();
                self.offset_monitor = OffsetMonitor::default();
                self.health.restarts += 1;
            }
        }
        self.mismatch = None;
        self.last_received = Some(arrived);
        let local_time = self.clocks.local_time(state.time, arrived);
        self.offset_monitor.process(&state, self.description.axes.len());
        self.last = Some((state, local_time));
    }

    /// Reason why a state does not match the configuration; `None` if the state matches.
    fn mismatch_of(&self, state: &State) -> Option<&'static str> {
        // A configuration that only reads positions has no machine number.
        if self.description.barrier && state.machine != self.machine {
            return Some("the bridge has another machine number");
        }
        let expected = &self.description.axes;
        let names = || state.axes().map(|axis| axis.name);
        if !names().take(expected.len()).eq(expected.iter().map(|axis| axis.name)) {
            return Some("the bridge has other axes, or another order of axes");
        }
        let mut reads = self.description.reads.iter();
        if !reads.all(|name| names().any(|found| found == *name)) {
            return Some("the bridge does not report the position of an axis that is read");
        }
        let same = |(own, found): (&Axis, &AxisState)| {
            let own = nano(own.name.kind(), own.step());
            (own - f64::from(found.step)).abs() < 0.5
        };
        if !expected.iter().zip(state.axes()).all(same) {
            return Some("the bridge and the configuration have different count sizes");
        }
        None
    }

    /// Waits for a datagram until the deadline, at most `LISTEN_INTERVAL`. Returns whether a datagram arrived.
    fn wait(&self, deadline: Instant) -> bool {
        let left = deadline.saturating_duration_since(Instant::now());
        let left = Timespec::try_from(left.min(LISTEN_INTERVAL)).unwrap_or_default();
        match poll(&mut [PollFd::new(&self.socket, PollFlags::IN)], Some(&left)) {
            Ok(ready) => ready > 0,
            Err(error) => error == Errno::INTR,
        }
    }
}

impl Controller for LinuxCncController {
    fn description(&self) -> &Description {
        &self.description
    }

    /// Returns the last state of the bridge, regardless of its age. Waits only before the first state.
    fn read(&mut self, deadline: Instant) -> Result<Snapshot, Fault> {
        let (state, taken) = loop {
            self.drain();
            if self.listen_is_due() {
                self.send(Content::Listen)?;
            }
            if let Some(mismatch) = self.mismatch {
                return Err(Fault::Protocol(mismatch));
            }
            if let Some(last) = &self.last {
                break last;
            }
            if Instant::now() >= deadline {
                return Err(Fault::TimedOut);
            }
            self.wait(deadline);
        };
        let mut positions = PerChannel::ZERO;
        for (position, name) in positions.iter_mut().zip(self.description.shown_axes()) {
            // The state contains each of these axes, or `mismatch_of` would have rejected the state.
            let Some(axis) = state.axes().find(|axis| axis.name == name) else {
                return Err(Fault::Protocol("an axis is missing"));
            };
            *position = match name.kind() {
                AxisKind::Linear => axis.position,
                AxisKind::Rotary => axis.position.to_radians(),
            };
        }
        let flags = state.flags;
        Ok(Snapshot {
            positions,
            taken: *taken,
            uncertainty: state.scan,
            state: ControllerState {
                referenced: flags.has(Flags::HOMED),
                alarm: !flags.has(Flags::ENABLED)
                    || flags.has(Flags::LIMITED)
                    || flags.has(Flags::LOST)
                    || self.offset_monitor.is_lost(),
                emergency_stop: flags.has(Flags::EMERGENCY_STOP),
            },
            state_taken: *taken,
            applied: None,
            report: (self.description.barrier && !state.report.as_slice().is_empty())
                .then_some(state.report),
            correction_taken: *taken,
        })
    }

    fn post(&mut self, frame: &Words, deadline: Instant) -> Result<(), Fault> {
        if !self.description.barrier {
            return Err(Fault::Unsupported("corrections, where positions are only read"));
        }
        if Instant::now() >= deadline {
            return Err(Fault::TimedOut);
        }
        self.send(Content::Frame(*frame))
    }

    fn apply(&mut self, _: &PerChannel<f64>, _: Instant) -> Result<(), Fault> {
        Err(Fault::Unsupported("plain values: the bridge has a barrier"))
    }
}
