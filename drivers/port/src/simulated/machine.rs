//! The data of a simulated machine.

use std::{sync::Arc, time::Duration};

use volcomp_vocabulary::PerChannel;

use super::{Controls, Move, Plant, SimulatedController, SimulatedThermometer, Warming};
use crate::{Axis, Clock, ControlProgram};

/// The true error of the tool at a position (mm, rad) and the sensors' temperatures (°C): what the machine
/// misses on each axis, mm and rad.
pub type Truth = Arc<dyn Fn(&PerChannel<f64>, &[f64]) -> PerChannel<f64> + Send + Sync>;

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
    /// The clock by which the machine moves and warms, and its control scans.
    pub clock: Clock,
}

impl Machine {
    /// Its controller, its thermometer, and what a test may do to it. Corrections are written as plain values, which the
    /// axes get at once: nothing on the control's side protects them.
    pub fn start(self) -> (SimulatedController, SimulatedThermometer, Arc<Controls>) {
        self.started(None)
    }

    /// The same with a program in the control, run once in each `scan` (at least 1 µs): corrections go to it in frames
    /// ([`Controller::post`](crate::Controller::post)), and the axes get what it applies.
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
