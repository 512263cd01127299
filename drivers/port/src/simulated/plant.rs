//! A simulated machine: axes move, the control scans, and controllers connect to it.

use std::{
    sync::{Arc, Mutex, MutexGuard, PoisonError, atomic::Ordering},
    time::{Duration, Instant},
};

use volcomp_vocabulary::PerChannel;

use super::{Controls, Given, Move, Path, SimulatedThermometer, Warming};
use crate::{
    Axis, Clock, ControlProgram, Controller, ControllerState, Description, Fault, Heartbeat,
    ShownStates, Snapshot, Words,
};

/// Maximum number of controllers that can be connected to one machine if its control runs a program.
pub const MOST_WAYS: usize = 4;

/// Shortest supported cycle time of a simulated control without a program; with a program it is the scan time.
const SHORTEST_CYCLE: Duration = Duration::from_micros(10);

/// Function from a position (mm and rad) and the temperatures of the sensors (°C) to the true error of each axis, mm
/// and rad.
pub type Truth = Arc<dyn Fn(&PerChannel<f64>, &[f64]) -> PerChannel<f64> + Send + Sync>;

/// The axes, program, sensors and true error of a simulated machine.
#[derive(Clone)]
pub struct Machine {
    /// Axes of the machine in channel order.
    pub axes: Vec<Axis>,
    /// Moves of the part program, which is repeated.
    pub program: Vec<Move>,
    /// Acceleration and deceleration of every move, mm/s², or rad/s² if no linear axis moves.
    pub acceleration_per_s2: f64,
    pub sensors: Vec<Warming>,
    /// True error of the machine, which the compensation must find.
    pub truth: Truth,
    /// Clock of motion, warming and scans.
    pub clock: Clock,
}

impl Machine {
    /// Starts a machine whose control runs no program. Corrections are written as plain values and reach the axes at
    /// once. Returns the machine's controller, thermometer and test switches.
    pub fn start(self) -> (SimulatedController, SimulatedThermometer, Arc<Controls>) {
        self.started(None)
    }

    /// Starts a machine whose control runs a program once per `scan` (at least 1 µs). Corrections are sent in frames
    /// ([`Controller::post`]), and the axes get the corrections that the program applies. Returns the machine's
    /// controller, thermometer and test switches.
    pub fn start_with(
        self,
        program: Box<dyn ControlProgram>,
        scan: Duration,
    ) -> (SimulatedController, SimulatedThermometer, Arc<Controls>) {
        self.started(Some((program, scan.max(Duration::from_micros(1)))))
    }

    fn started(
        self,
        control: Option<(Box<dyn ControlProgram>, Duration)>,
    ) -> (SimulatedController, SimulatedThermometer, Arc<Controls>) {
        let controls = Arc::new(Controls::default());
        let thermometer = SimulatedThermometer::new(&self.sensors, self.clock.clone());
        let plant = Plant::new(self, control, Arc::clone(&controls));
        (SimulatedController::first(plant), thermometer, controls)
    }
}

/// A simulated machine. It runs even if no controller is connected. Clones are the same machine. Every call first
/// advances the machine to the present time and runs the due scans of its control.
#[derive(Clone)]
pub struct Plant(Arc<Mutex<Inner>>);

struct Inner {
    machine: Machine,
    path: Path,
    controls: Arc<Controls>,
    applied: PerChannel<f64>,
    frozen_at: Option<PerChannel<f64>>,
    /// Time on the clock up to which the machine was simulated.
    until: Duration,
    /// Motion time: the part of the simulated time in which the machine moved along its program.
    moved: Duration,
    control: Option<Control>,
}

struct Control {
    program: Box<dyn ControlProgram>,
    scan: Duration,
    due: Duration,
    report: Option<Words>,
    mailboxes: [Words; MOST_WAYS],
    ways: usize,
}

impl Plant {
    fn new(
        machine: Machine,
        control: Option<(Box<dyn ControlProgram>, Duration)>,
        controls: Arc<Controls>,
    ) -> Self {
        let until = machine.clock.elapsed();
        let control = control.map(|(program, scan)| Control {
            program,
            scan,
            due: until.saturating_add(scan),
            report: None,
            mailboxes: [Words::EMPTY; MOST_WAYS],
            ways: 1,
        });
        Self(Arc::new(Mutex::new(Inner {
            path: Path::new(&machine.program, machine.acceleration_per_s2),
            machine,
            controls,
            applied: PerChannel::ZERO,
            frozen_at: None,
            // The machine does not move before its start.
            until: Duration::ZERO,
            moved: Duration::ZERO,
            control,
        })))
    }

    fn now(&self) -> MutexGuard<'_, Inner> {
        let mut inner = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        inner.pass();
        inner
    }

    /// Advances the machine to the time of its clock, running the due scans.
    pub fn pass(&self) {
        drop(self.now());
    }

    /// Present commanded position, without correction, mm and rad.
    pub fn commanded(&self) -> PerChannel<f64> {
        let inner = self.now();
        inner.path.at(inner.moved)
    }

    /// Correction that is applied to the axes at present, mm and rad.
    pub fn applied(&self) -> PerChannel<f64> {
        self.now().applied
    }

    /// Present error of each axis with the applied correction, and present error without correction, mm or rad.
    pub fn residual_and_error(&self) -> [PerChannel<f64>; 2] {
        let inner = self.now();
        let sensors = inner.machine.sensors.iter();
        let degc: Vec<f64> = sensors.map(|sensor| sensor.at(inner.until)).collect();
        let commanded = inner.path.at(inner.moved);
        let moved = PerChannel::from_fn(|i| commanded[i] + inner.applied[i]);
        let error = (inner.machine.truth)(&commanded, &degc);
        let missed = (inner.machine.truth)(&moved, &degc);
        [PerChannel::from_fn(|i| missed[i] + inner.applied[i]), error]
    }

    /// Sets the digital lines to the control: `value` (counts) for the axis with this index, and the level of the latch
    /// line, which toggles after the other lines have settled. The control's program decides whether to accept the
    /// value. Without a program the lines have no effect.
    pub fn set_lines(&self, latch: bool, axis: usize, value: i16) {
        if let Some(control) = &mut self.now().control {
            control.program.lines(latch, axis, value);
        }
    }

    /// Adds a mailbox for a further controller and returns its index; `None` if there are already [`MOST_WAYS`]
    /// mailboxes. Returns 0 if the control runs no program.
    fn another_way(&self) -> Option<usize> {
        let mut inner = self.now();
        let Some(control) = &mut inner.control else {
            return Some(0);
        };
        let way = control.ways;
        (way < MOST_WAYS).then(|| {
            control.ways += 1;
            way
        })
    }

    fn shape(&self) -> (Vec<Axis>, Option<Duration>) {
        let inner = self.now();
        let scan = inner.control.as_ref().map(|control| control.scan);
        (inner.machine.axes.clone(), scan)
    }

    fn is_disconnected(&self) -> bool {
        self.now().controls.disconnected.load(Ordering::Relaxed)
    }

    fn snapshot(&self) -> Snapshot {
        self.now().snapshot()
    }

    /// Applies corrections (mm, rad), rounded to the steps of the axes.
    fn apply(&self, corrections: &PerChannel<f64>) {
        let mut inner = self.now();
        let inner = &mut *inner;
        for ((applied, correction), axis) in
            inner.applied.iter_mut().zip(corrections).zip(&inner.machine.axes)
        {
            *applied = (correction / axis.step()).round() * axis.step();
        }
        inner.log_applied(inner.until);
        inner.controls.heartbeat.fetch_add(1, Ordering::Relaxed);
    }

    /// Stores a frame for the next scan in the mailbox with the index `way`.
    fn post(&self, way: usize, frame: &Words) {
        let mut inner = self.now();
        if let Some(mailbox) = (inner.control.as_mut()).and_then(|c| c.mailboxes.get_mut(way)) {
            *mailbox = *frame;
        }
        inner.controls.heartbeat.fetch_add(1, Ordering::Relaxed);
    }
}

impl Inner {
    fn pass(&mut self) {
        let now = self.machine.clock.elapsed().max(self.until);
        if !self.controls.stands() {
            self.moved += now.saturating_sub(self.until);
        }
        self.until = now;
        if self.controls.clear_applied.swap(false, Ordering::Relaxed) {
            self.applied = PerChannel::ZERO;
            self.controls.axes.start_at(&self.applied);
            self.restart(&PerChannel::default());
        }
        if self.controls.restart.swap(false, Ordering::Relaxed) {
            let applied = self.control.as_ref().map(|c| c.program.applied());
            self.restart(&applied.unwrap_or_default());
        }
        while self.control.as_ref().is_some_and(|c| c.due <= now) {
            self.scan();
        }
    }

    fn restart(&mut self, applied: &PerChannel<i16>) {
        if let Some(control) = &mut self.control {
            control.program.restart(applied);
        }
    }

    fn scan(&mut self) {
        let holds = self.controls.holds();
        let Some(control) = &mut self.control else {
            return;
        };
        let mailboxes = control.mailboxes.each_ref().map(Words::as_slice);
        let ways = &mailboxes[..control.ways.min(MOST_WAYS)];
        control.report = Some(control.program.scan(ways, holds));
        let at = control.due;
        control.due = at.saturating_add(control.scan);
        let counts = control.program.applied();
        let axes = self.applied.iter_mut().zip(&counts);
        for ((applied, count), axis) in axes.zip(&self.machine.axes) {
            *applied = f64::from(*count) * axis.step();
        }
        self.log_applied(at);
    }

    fn log_applied(&self, at: Duration) {
        self.controls.axes.push(&Given { at, applied: self.applied, held: self.controls.holds() });
    }

    fn snapshot(&mut self) -> Snapshot {
        let mut positions = self.path.at(self.moved);
        let axes = positions.iter_mut().zip(&self.machine.axes);
        for ((position, axis), applied) in axes.zip(&self.applied) {
            if axis.includes_correction {
                *position += applied;
            }
        }
        if self.controls.frozen.load(Ordering::Relaxed) {
            positions = *self.frozen_at.get_or_insert(positions);
        } else {
            self.frozen_at = None;
        }
        let taken: Instant = self.machine.clock.start() + self.until;
        Snapshot {
            positions,
            taken,
            uncertainty: Duration::ZERO,
            state: ControllerState {
                referenced: !self.controls.unreferenced.load(Ordering::Relaxed),
                alarm: self.controls.alarm.load(Ordering::Relaxed),
                emergency_stop: self.controls.emergency_stop.load(Ordering::Relaxed),
            },
            applied: self.control.is_none().then_some(self.applied),
            report: self.control.as_ref().and_then(|c| c.report),
            state_taken: taken,
            correction_taken: taken,
        }
    }
}

/// The controller of a simulated machine. When the controller is dropped, the machine continues to run.
pub struct SimulatedController {
    description: Description,
    plant: Plant,
    way: usize,
    barrier: bool,
}

impl SimulatedController {
    fn first(plant: Plant) -> Self {
        Self::on(plant, 0)
    }

    fn on(plant: Plant, way: usize) -> Self {
        let (axes, scan) = plant.shape();
        Self {
            description: Description {
                device: "simulated".to_owned(),
                channel: "simulated".to_owned(),
                axes,
                reads: Vec::new(),
                heartbeat: Heartbeat::Watched,
                barrier: scan.is_some(),
                tells_applied: true,
                shown: ShownStates::ALL,
                // No other process can access the simulated machine.
                sees_other_gateways: true,
                shortest_cycle: scan.unwrap_or(SHORTEST_CYCLE),
            },
            plant,
            way,
            barrier: scan.is_some(),
        }
    }

    /// Connects another controller to the same machine, like a second gateway or bus. If the control runs a program,
    /// each controller has its own mailbox. `None` if the control runs a program and there are already [`MOST_WAYS`]
    /// controllers.
    pub fn another(&self) -> Option<Self> {
        let way = self.plant.another_way()?;
        Some(Self::on(self.plant.clone(), way))
    }

    /// Returns the machine, for access while the controller has another owner.
    pub fn plant(&self) -> Plant {
        self.plant.clone()
    }

    /// Present commanded position, without correction, mm and rad.
    pub fn commanded(&self) -> PerChannel<f64> {
        self.plant.commanded()
    }

    /// Present error of each axis with the applied correction, and present error without correction, mm or rad.
    pub fn residual_and_error(&self) -> [PerChannel<f64>; 2] {
        self.plant.residual_and_error()
    }

    fn connected(&self) -> Result<&Plant, Fault> {
        if self.plant.is_disconnected() {
            return Err(Fault::NotConnected);
        }
        Ok(&self.plant)
    }
}

impl Controller for SimulatedController {
    fn description(&self) -> &Description {
        &self.description
    }

    fn read(&mut self, _deadline: Instant) -> Result<Snapshot, Fault> {
        Ok(self.connected()?.snapshot())
    }

    fn post(&mut self, frame: &Words, _deadline: Instant) -> Result<(), Fault> {
        if !self.barrier {
            return Err(Fault::Unsupported("frames, since the control has no barrier"));
        }
        self.connected()?.post(self.way, frame);
        Ok(())
    }

    fn apply(&mut self, corrections: &PerChannel<f64>, _deadline: Instant) -> Result<(), Fault> {
        if self.barrier {
            return Err(Fault::Unsupported("plain values, since the control has a barrier"));
        }
        self.connected()?.apply(corrections);
        Ok(())
    }
}
