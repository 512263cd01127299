//! A simulated machine that runs a part program, has a true error and warms up.
//!
//! Its control may run a program that determines the corrections of the axes. The true error is a given function, and
//! independent of the error model under test.

use std::{
    array,
    sync::{
        Arc, Mutex, MutexGuard, PoisonError,
        atomic::{AtomicBool, AtomicU64, Ordering},
    },
    time::{Duration, Instant},
};

use volcomp_vocabulary::{MAX_AXES, PerChannel};

use crate::{
    Axis, Clock, ControlProgram, Controller, ControllerState, Description, Fault, Heartbeat,
    ShownStates, Snapshot, Temperature, Thermometer, Words,
};

/// Maximum number of controllers that can be connected to one machine if its control runs a program.
pub const MOST_WAYS: usize = 4;

/// Shortest supported cycle time of a simulated control without a program; with a program it is the scan time.
const SHORTEST_CYCLE: Duration = Duration::from_micros(10);

/// Function from a position (mm and rad) and the temperatures of the sensors (°C) to the true error of each axis, mm
/// and rad.
pub type Truth = Arc<dyn Fn(&PerChannel<f64>, &[f64]) -> PerChannel<f64> + Send + Sync>;

/// Simulated machine before its start: axes, part program, sensors and true error.
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
            // The first call adds the time since the start of the clock to the motion time.
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
                // Only this process can access the simulated machine, so another gateway cannot exist.
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

/// The corrections applied to the axes of a simulated machine. There is one record per scan of the control, or per
/// write if the control runs no program. The log can be read from any thread without side effects.
///
/// When the control restarts ([`Controls::clear_applied`]), the changes of its words do
/// not count, because the axes have no power.
#[derive(Debug, Default)]
pub struct AxisLog {
    scans: AtomicU64,
    /// Correction of each axis, as the bits of an `f64`.
    applied: [AtomicU64; MAX_AXES],
    largest_change: [AtomicU64; MAX_AXES],
    furthest: [AtomicU64; MAX_AXES],
    changes_while_held: AtomicU64,
    records: AtomicBool,
    recorded: Mutex<Vec<Given>>,
}

/// The corrections that were applied in one scan.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Given {
    /// Time of the scan on the clock of the machine.
    pub at: Duration,
    /// Applied correction of each axis, mm and rad.
    pub applied: PerChannel<f64>,
    /// Whether the axes were held by an emergency stop, by an alarm, or because an axis was not referenced.
    pub held: bool,
}

fn load(bits: &[AtomicU64; MAX_AXES]) -> PerChannel<f64> {
    PerChannel::from_fn(|axis| f64::from_bits(bits[axis].load(Ordering::Relaxed)))
}

/// Replaces the stored number by `value` if `value` is larger. Negative values are invalid, because their bit patterns
/// are not ordered like the numbers.
fn raise(bits: &AtomicU64, value: f64) {
    bits.fetch_max(value.to_bits(), Ordering::Relaxed);
}

impl AxisLog {
    /// Number of scans since the start, or number of writes if the control runs no program.
    pub fn scans(&self) -> u64 {
        self.scans.load(Ordering::Relaxed)
    }

    /// Correction that is applied to each axis at present, mm and rad.
    pub fn applied(&self) -> PerChannel<f64> {
        load(&self.applied)
    }

    /// Largest change of each axis between consecutive scans since [`forget`](Self::forget), mm and rad.
    pub fn largest_change(&self) -> PerChannel<f64> {
        load(&self.largest_change)
    }

    /// Largest magnitude of the correction of each axis since [`forget`](Self::forget), mm and rad.
    pub fn furthest(&self) -> PerChannel<f64> {
        load(&self.furthest)
    }

    /// Number of scans since [`forget`](Self::forget) that changed a correction during an emergency stop or alarm, or
    /// while an axis was not referenced.
    pub fn changes_while_held(&self) -> u64 {
        self.changes_while_held.load(Ordering::Relaxed)
    }

    /// Resets the largest changes, the largest corrections, the changes while held, and the recorded scans.
    pub fn forget(&self) {
        for bits in self.largest_change.iter().chain(&self.furthest) {
            bits.store(0, Ordering::Relaxed);
        }
        self.changes_while_held.store(0, Ordering::Relaxed);
        self.lock().clear();
    }

    /// Records the next `most` scans, for [`recorded`](Self::recorded). Allocates in this call, so that scans do not
    /// allocate.
    pub fn record(&self, most: usize) {
        *self.lock() = Vec::with_capacity(most);
        self.records.store(most > 0, Ordering::Relaxed);
    }

    /// The scans recorded since the last call of [`record`](Self::record) or [`forget`](Self::forget).
    pub fn recorded(&self) -> Vec<Given> {
        self.lock().clone()
    }

    fn lock(&self) -> std::sync::MutexGuard<'_, Vec<Given>> {
        self.recorded.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn push(&self, given: &Given) {
        let before = self.applied();
        let changes: [f64; MAX_AXES] = array::from_fn(|i| (given.applied[i] - before[i]).abs());
        for (axis, change) in changes.iter().enumerate() {
            raise(&self.largest_change[axis], *change);
            raise(&self.furthest[axis], given.applied[axis].abs());
        }
        let changed = given.held && changes.iter().any(|change| *change > 0.0);
        self.changes_while_held.fetch_add(changed.into(), Ordering::Relaxed);
        self.start_at(&given.applied);
        self.scans.fetch_add(1, Ordering::Relaxed);
        if self.records.load(Ordering::Relaxed) {
            let mut recorded = self.lock();
            if recorded.len() < recorded.capacity() {
                recorded.push(*given);
            }
        }
    }

    fn start_at(&self, applied: &PerChannel<f64>) {
        for (bits, value) in self.applied.iter().zip(applied) {
            bits.store(value.to_bits(), Ordering::Relaxed);
        }
    }
}

/// Switches with which a test disturbs a running machine, and the log of its corrections. Every call of the machine
/// reads the switches, and treats them as set since the previous call.
#[derive(Debug, Default)]
pub struct Controls {
    /// An axis is not referenced, and the machine stops.
    pub unreferenced: AtomicBool,
    /// An alarm is active, and the machine stops.
    pub alarm: AtomicBool,
    /// The emergency stop is pressed, and the machine stops.
    pub emergency_stop: AtomicBool,
    /// Feed hold: the machine stops, but its corrections may change.
    pub feed_hold: AtomicBool,
    /// The reported positions do not change, although the axes move.
    pub frozen: AtomicBool,
    pub disconnected: AtomicBool,
    /// At the next call, the machine clears the applied correction, like a reboot without retained data. It also
    /// restarts the control's program at zero, and resets this switch.
    pub clear_applied: AtomicBool,
    /// At the next call, the control restarts with the applied correction still in its axis words, and resets this
    /// switch. Has no effect if the control runs no program.
    pub restart: AtomicBool,
    /// Number of corrections or frames written since the start.
    pub heartbeat: AtomicU64,
    pub axes: AxisLog,
}

impl Controls {
    /// Whether corrections are held by an emergency stop or alarm, or because an axis is not referenced.
    fn holds(&self) -> bool {
        [&self.unreferenced, &self.alarm, &self.emergency_stop]
            .iter()
            .any(|switch| switch.load(Ordering::Relaxed))
    }

    /// Whether the machine stops its motion: by a hold of the corrections, or by feed hold.
    fn stands(&self) -> bool {
        self.holds() || self.feed_hold.load(Ordering::Relaxed)
    }
}

#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Move {
    /// End point, mm and rad.
    pub to: PerChannel<f64>,
    /// Speed along the path, mm/s, or rad/s if no linear axis moves.
    pub feed_per_s: f64,
    /// Time for which the axes stay at the end point.
    pub dwell: Duration,
}

/// Positions along a repeated part program, as a function of time. All moves have the same acceleration and
/// deceleration.
#[derive(Clone, Debug)]
pub struct Path {
    segments: Vec<Segment>,
    /// Start time of each segment, s. The last element is the end of the last dwell.
    starts_s: Vec<f64>,
}

#[derive(Clone, Copy, Debug)]
struct Segment {
    from: PerChannel<f64>,
    to: PerChannel<f64>,
    length: f64,
    /// Duration of the acceleration, and of the equally long deceleration, s.
    accelerating_s: f64,
    coasting_s: f64,
    acceleration: f64,
}

impl Path {
    /// Creates a path that repeats these moves. The acceleration and deceleration is in mm/s², or rad/s² if no linear
    /// axis moves. The path starts at the end point of the last move.
    pub fn new(program: &[Move], acceleration: f64) -> Self {
        let mut from = program.last().map_or(PerChannel::ZERO, |last| last.to);
        let (mut segments, mut starts_s) = (Vec::new(), vec![0.0]);
        for step in program {
            let segment = Segment::new(from, step, acceleration);
            let before = starts_s[starts_s.len() - 1];
            starts_s.push(before + segment.duration_s() + step.dwell.as_secs_f64());
            segments.push(segment);
            from = step.to;
        }
        Self { segments, starts_s }
    }

    /// Time from the start to the arrival at the end point of the move with this index from 0; `None` if there is no
    /// such move.
    pub fn arrival(&self, index: usize) -> Option<Duration> {
        let (segment, start_s) = (self.segments.get(index)?, self.starts_s.get(index)?);
        Duration::try_from_secs_f64(start_s + segment.duration_s()).ok()
    }

    /// Positions of the axes, mm and rad. `elapsed` is the time since the start.
    pub fn at(&self, elapsed: Duration) -> PerChannel<f64> {
        let period = self.starts_s[self.starts_s.len() - 1];
        let time = if period > 0.0 { elapsed.as_secs_f64() % period } else { 0.0 };
        let index = self.starts_s.partition_point(|start| *start <= time);
        let place = index.saturating_sub(1).min(self.segments.len().saturating_sub(1));
        let segment = self.segments.get(place);
        segment.map_or(PerChannel::ZERO, |s| s.at(time - self.starts_s[place]))
    }
}

impl Segment {
    fn new(from: PerChannel<f64>, step: &Move, acceleration: f64) -> Self {
        let squares = from.iter().zip(&step.to).map(|(a, b)| (b - a) * (b - a));
        let length = squares.sum::<f64>().sqrt();
        // A short move does not reach its feed.
        let feed = step.feed_per_s.min((length * acceleration).sqrt());
        let (accelerating_s, coasting_s) = if length > 0.0 && feed > 0.0 {
            let accelerating_s = feed / acceleration;
            (accelerating_s, length / feed - accelerating_s)
        } else {
            (0.0, 0.0)
        };
        Self { from, to: step.to, length, accelerating_s, coasting_s, acceleration }
    }

    fn duration_s(&self) -> f64 {
        2.0 * self.accelerating_s + self.coasting_s
    }

    fn at(&self, time_s: f64) -> PerChannel<f64> {
        let left_s = self.duration_s() - time_s;
        let passed = if self.length == 0.0 || left_s <= 0.0 {
            return self.to;
        } else if time_s < self.accelerating_s {
            0.5 * self.acceleration * time_s * time_s
        } else if left_s < self.accelerating_s {
            self.length - 0.5 * self.acceleration * left_s * left_s
        } else {
            let feed = self.acceleration * self.accelerating_s;
            feed * (time_s - 0.5 * self.accelerating_s)
        };
        let share = passed / self.length;
        PerChannel::from_fn(|i| self.from[i] + share * (self.to[i] - self.from[i]))
    }
}

/// A sensor that warms up by T = start + rise·(1 − exp(−t/τ)).
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Warming {
    pub name: String,
    /// Temperature at the start, °C.
    pub start_degc: f64,
    /// Final rise above `start_degc`, K.
    pub rise_k: f64,
    /// Time constant τ of the warming, s.
    pub time_constant_s: f64,
}

impl Warming {
    fn at(&self, elapsed: Duration) -> f64 {
        let passed = elapsed.as_secs_f64() / self.time_constant_s;
        self.start_degc - self.rise_k * (-passed).exp_m1()
    }
}

/// The thermometer of a simulated machine. Its sensors warm up by the formula of [`Warming`].
pub struct SimulatedThermometer {
    device: String,
    names: Vec<String>,
    sensors: Vec<Warming>,
    clock: Clock,
    latest: Vec<Temperature>,
}

impl SimulatedThermometer {
    fn new(sensors: &[Warming], clock: Clock) -> Self {
        Self {
            device: "simulated".to_owned(),
            names: sensors.iter().map(|s| s.name.clone()).collect(),
            latest: vec![Temperature::NOT_READ; sensors.len()],
            sensors: sensors.to_vec(),
            clock,
        }
    }
}

impl Thermometer for SimulatedThermometer {
    fn device(&self) -> &str {
        &self.device
    }

    fn names(&self) -> &[String] {
        &self.names
    }

    fn latest(&mut self) -> &[Temperature] {
        let (elapsed, now) = (self.clock.elapsed(), self.clock.now());
        for (latest, sensor) in self.latest.iter_mut().zip(&self.sensors) {
            *latest = Temperature::good(sensor.at(elapsed), now);
        }
        &self.latest
    }
}
