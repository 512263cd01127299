//! A simulated machine: it moves along a program, has a hidden true error and heats up. It knows no model:
//! the error is a function handed to it.

use std::{
    sync::{
        Arc,
        atomic::{AtomicBool, AtomicU64, Ordering},
    },
    time::{Duration, Instant},
};

use volcomp_vocabulary::PerChannel;

use crate::{
    Axis, Clock, Controller, ControllerState, Description, Fault, Heartbeat, ShownStates, Snapshot,
    Temperature, Thermometer,
};

/// The true error of the tool at a position (mm, rad) and the sensors' temperatures (°C): what the machine
/// misses on each axis, mm and rad.
pub type Truth = Arc<dyn Fn(&PerChannel<f64>, &[f64]) -> PerChannel<f64> + Send + Sync>;

/// One move of a program.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Move {
    /// Where to, mm and rad.
    pub to: PerChannel<f64>,
    /// Feed, mm/s (rad/s where no linear axis moves).
    pub feed_per_s: f64,
    /// How long to stand there.
    pub dwell: Duration,
}

/// A sensor that warms up: T = start + rise·(1 − exp(−t/τ)).
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Warming {
    /// The name of the sensor.
    pub name: String,
    /// At the beginning, °C.
    pub start_degc: f64,
    /// In the end so much more, K.
    pub rise_k: f64,
    /// The time constant τ of the warming, s.
    pub time_constant_s: f64,
}

impl Warming {
    fn at(&self, elapsed: Duration) -> f64 {
        let passed = elapsed.as_secs_f64() / self.time_constant_s;
        self.start_degc - self.rise_k * (-passed).exp_m1()
    }
}

/// The axes, program, sensors and true error of a simulated machine.
#[derive(Clone)]
pub struct Machine {
    /// The axes of the machine in channel order.
    pub axes: Vec<Axis>,
    /// Moves, gone through again and again; where the last one ends the first begins.
    pub program: Vec<Move>,
    /// Acceleration and deceleration of every move, mm/s² or rad/s².
    pub acceleration_per_s2: f64,
    /// The temperature sensors of the machine, each with its own warming.
    pub sensors: Vec<Warming>,
    /// The true error of the machine, which the compensation does not know.
    pub truth: Truth,
    /// The clock by which the machine moves and warms.
    pub clock: Clock,
}

/// Switches by which a test disturbs a machine while it runs.
#[derive(Debug, Default)]
pub struct Controls {
    /// The axes are not referenced.
    pub unreferenced: AtomicBool,
    /// An alarm is on.
    pub alarm: AtomicBool,
    /// The emergency stop is pressed.
    pub emergency_stop: AtomicBool,
    /// Positions stay as they are.
    pub frozen: AtomicBool,
    /// The connection is gone.
    pub disconnected: AtomicBool,
    /// The next call finds the applied correction cleared, as after a reboot; then it is false again.
    pub clear_applied: AtomicBool,
    /// How often a correction was applied.
    pub heartbeat: AtomicU64,
}

/// The controller of a simulated machine.
pub struct SimulatedController {
    description: Description,
    path: Path,
    machine: Machine,
    controls: Arc<Controls>,
    applied: PerChannel<f64>,
    frozen_at: Option<PerChannel<f64>>,
}

/// The thermometer of a simulated machine.
pub struct SimulatedThermometer {
    device: String,
    names: Vec<String>,
    sensors: Vec<Warming>,
    clock: Clock,
    latest: Vec<Temperature>,
}

impl Machine {
    /// Its controller, its thermometer, and what a test may do to it.
    pub fn start(self) -> (SimulatedController, SimulatedThermometer, Arc<Controls>) {
        let controls = Arc::new(Controls::default());
        let thermometer = SimulatedThermometer {
            device: "simulated".to_owned(),
            names: self.sensors.iter().map(|s| s.name.clone()).collect(),
            latest: vec![Temperature::NOT_READ; self.sensors.len()],
            sensors: self.sensors.clone(),
            clock: self.clock.clone(),
        };
        let controller = SimulatedController {
            description: Description {
                device: "simulated".to_owned(),
                channel: "simulated".to_owned(),
                axes: self.axes.clone(),
                heartbeat: Heartbeat::Watched,
                // Nobody else can reach it.
                barrier: false,
                shown: ShownStates::ALL,
                sees_other_gateways: true,
                shortest_cycle: Duration::from_micros(10),
            },
            path: Path::new(&self.program, self.acceleration_per_s2),
            machine: self,
            controls: Arc::clone(&controls),
            applied: PerChannel::ZERO,
            frozen_at: None,
        };
        (controller, thermometer, controls)
    }
}

impl SimulatedController {
    /// Where the program is now, without correction.
    pub fn commanded(&self) -> PerChannel<f64> {
        self.path.at(self.machine.clock.elapsed())
    }

    /// The error of the tool now with the applied correction, and without: mm and rad for each axis.
    pub fn residual_and_error(&self) -> [PerChannel<f64>; 2] {
        let elapsed = self.machine.clock.elapsed();
        let sensors = self.machine.sensors.iter();
        let degc: Vec<f64> = sensors.map(|sensor| sensor.at(elapsed)).collect();
        let commanded = self.commanded();
        let moved = PerChannel::from_fn(|i| commanded[i] + self.applied[i]);
        let error = (self.machine.truth)(&commanded, &degc);
        let missed = (self.machine.truth)(&moved, &degc);
        [PerChannel::from_fn(|i| missed[i] + self.applied[i]), error]
    }
}

impl Controller for SimulatedController {
    fn description(&self) -> &Description {
        &self.description
    }

    fn read(&mut self, _deadline: Instant) -> Result<Snapshot, Fault> {
        if self.controls.disconnected.load(Ordering::Relaxed) {
            return Err(Fault::NotConnected);
        }
        if self.controls.clear_applied.swap(false, Ordering::Relaxed) {
            self.applied = PerChannel::ZERO;
        }
        let mut positions = self.commanded();
        for ((position, axis), applied) in positions
            .iter_mut()
            .zip(&self.description.axes)
            .zip(&self.applied)
        {
            if axis.includes_correction {
                *position += applied;
            }
        }
        if self.controls.frozen.load(Ordering::Relaxed) {
            positions = *self.frozen_at.get_or_insert(positions);
        } else {
            self.frozen_at = None;
        }
        Ok(Snapshot {
            positions,
            taken: self.machine.clock.now(),
            uncertainty: Duration::ZERO,
            state: ControllerState {
                referenced: !self.controls.unreferenced.load(Ordering::Relaxed),
                alarm: self.controls.alarm.load(Ordering::Relaxed),
                emergency_stop: self.controls.emergency_stop.load(Ordering::Relaxed),
            },
            applied: Some(self.applied),
            report: None,
        })
    }

    fn apply(&mut self, corrections: &PerChannel<f64>, _deadline: Instant) -> Result<(), Fault> {
        if self.controls.disconnected.load(Ordering::Relaxed) {
            return Err(Fault::NotConnected);
        }
        for ((applied, wanted), axis) in self
            .applied
            .iter_mut()
            .zip(corrections)
            .zip(&self.description.axes)
        {
            *applied = (wanted / axis.step()).round() * axis.step();
        }
        self.controls.heartbeat.fetch_add(1, Ordering::Relaxed);
        Ok(())
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

/// A program as places over time: every move with the same acceleration and deceleration, the first one from where the
/// last one ends.
#[derive(Clone, Debug)]
pub struct Path {
    segments: Vec<Segment>,
    /// When each segment begins, s; then when the last one ends.
    starts_s: Vec<f64>,
}

#[derive(Clone, Copy, Debug)]
struct Segment {
    from: PerChannel<f64>,
    to: PerChannel<f64>,
    length: f64,
    /// Accelerating, then coasting, then decelerating as long as accelerating, s.
    accelerating_s: f64,
    coasting_s: f64,
    acceleration: f64,
}

impl Path {
    /// The moves of a program, gone through again and again, with this acceleration (mm/s², or rad/s² where no linear
    /// axis moves).
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

    /// Where the axes are at a time since the start, mm and rad.
    pub fn at(&self, elapsed: Duration) -> PerChannel<f64> {
        let period = self.starts_s[self.starts_s.len() - 1];
        let time = if period > 0.0 {
            elapsed.as_secs_f64() % period
        } else {
            0.0
        };
        let index = self.starts_s.partition_point(|start| *start <= time);
        let place = index
            .saturating_sub(1)
            .min(self.segments.len().saturating_sub(1));
        let segment = self.segments.get(place);
        segment.map_or(PerChannel::ZERO, |s| s.at(time - self.starts_s[place]))
    }
}

impl Segment {
    fn new(from: PerChannel<f64>, step: &Move, acceleration: f64) -> Self {
        let squares = from.iter().zip(&step.to).map(|(a, b)| (b - a) * (b - a));
        let length = squares.sum::<f64>().sqrt();
        // A short move never reaches its feed.
        let feed = step.feed_per_s.min((length * acceleration).sqrt());
        let (accelerating_s, coasting_s) = if length > 0.0 && feed > 0.0 {
            let accelerating_s = feed / acceleration;
            (accelerating_s, length / feed - accelerating_s)
        } else {
            (0.0, 0.0)
        };
        Self {
            from,
            to: step.to,
            length,
            accelerating_s,
            coasting_s,
            acceleration,
        }
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
