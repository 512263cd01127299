//! The built-in simulation: a gantry that moves and warms up, its true errors, and the model that `volcomp demo`
//! identified for this gantry.

use std::{
    sync::{Arc, Mutex, atomic::Ordering},
    time::Duration,
};

use volcomp_guard::barrier::{Program, Protection, SettingsError};
use volcomp_kinematics::{Form, State, nalgebra::Vector3};
use volcomp_model::{Machine, RigidMotion, RigidSums, Temperatures};
use volcomp_port::{
    Axis, Clock,
    inject::{Injection, Remote},
    simulated::{self, Controls, Move, Plant, SimulatedController, SimulatedThermometer, Warming},
};

use volcomp_runtime::GuardSettings;
use volcomp_vocabulary::{AxisName, Displacement, Mm, PerAxis, PerChannel};

use crate::{
    config::{AuditConfig, Config, GuardTable},
    documents::Disturbance,
    error::GatewayError,
    locked,
};

const MODEL: &str = include_str!("../demo/machine.toml");
const TRUTH: &str = include_str!("../demo/truth.toml");

const RESOLUTION: Mm = Mm(0.001);

/// True errors of the tool position of the simulated machine, including thermal errors.
#[derive(Clone)]
pub struct Truth {
    machine: Arc<Machine>,
    /// Best-fit rigid motion between truth and model at the reference temperature.
    datum: RigidMotion,
    sensors: Arc<[String]>,
    /// The running simulation with its disturbances; `None` until [`of`](Self::of) sets it.
    demo: Option<Arc<Demo>>,
}

/// The simulated machine and its parts.
pub struct Simulation {
    pub controller: SimulatedController,
    pub thermometer: SimulatedThermometer,
    /// Switches with which tests set signals and failures of the running machine.
    pub controls: Arc<Controls>,
    /// The model used for correction.
    pub model: Machine,
    /// True errors of the machine.
    pub truth: Truth,
}

impl Truth {
    /// The truth relative to a model. The best-fit rigid motion at the reference temperature is removed, because the
    /// position of the workpiece is no error of the machine.
    fn against(machine: Machine, model: &Machine, sensors: &[String]) -> Self {
        let none = Temperatures::new();
        let mut sums = RigidSums::default();
        for state in grid(model) {
            let at = |machine: &Machine| machine.error_at(&state, Form::Exact, &none).position_mm;
            let [x, y, z] = [state.q[0], state.q[1], state.q[2]];
            sums.take(&Vector3::new(x, y, z), &(at(&machine) - at(model)));
        }
        Self {
            machine: Arc::new(machine),
            datum: sums.motion(),
            sensors: sensors.into(),
            demo: None,
        }
    }

    pub(crate) fn of(self, demo: Arc<Demo>) -> Self {
        Self { demo: Some(demo), ..self }
    }

    /// The running simulation with its disturbances; `None` if this truth belongs to no simulation.
    pub(crate) fn demo(&self) -> Option<&Demo> {
        self.demo.as_deref()
    }

    /// The true position error (mm, workpiece axes) at axis coordinates (mm) and sensor temperatures (°C).
    pub fn error(&self, positions: &PerAxis<f64>, degc: &[f64]) -> Vector3<f64> {
        let temperatures: Temperatures =
            self.sensors.iter().cloned().zip(degc.iter().copied()).collect();
        let state = State { q: *positions, ..State::default() };
        let place = Vector3::new(positions[0], positions[1], positions[2]);
        let error = self.machine.error_at(&state, Form::Exact, &temperatures);
        self.datum.left_mm(&place, &error.position_mm)
    }

    /// The residual position error (mm, workpiece axes) with corrections (mm) applied.
    pub fn residual(
        &self,
        positions: &PerAxis<f64>,
        correction: &PerAxis<f64>,
        degc: &[f64],
    ) -> Vector3<f64> {
        let moved = PerAxis::from_fn(|i| positions[i] + correction[i]);
        self.error(&moved, degc) + Vector3::new(correction[0], correction[1], correction[2])
    }
}

/// The disturbances of the built-in machine, which a user starts and ends.
pub struct Demo {
    controls: Arc<Controls>,
    thermometer: Remote,
    plant: Plant,
    active: Mutex<Vec<Disturbance>>,
}

/// Index of the sensor whose heating a user can simulate.
const HEATED: usize = 2;
const HEATED_BY_K: f64 = 15.0;

impl Demo {
    pub(crate) fn new(controls: Arc<Controls>, thermometer: Remote, plant: Plant) -> Self {
        Self { controls, thermometer, plant, active: Mutex::default() }
    }

    /// Begins or ends a disturbance.
    pub fn disturb(&self, what: Disturbance, on: bool) {
        let mut active = locked(&self.active);
        if active.contains(&what) == on {
            return;
        }
        match what {
            Disturbance::Cable => self.controls.disconnected.store(on, Ordering::Relaxed),
            Disturbance::Freeze => self.controls.frozen.store(on, Ordering::Relaxed),
            Disturbance::Heat => {
                let kelvin = if on { HEATED_BY_K } else { 0.0 };
                let jump = Injection::Jump { sensor: HEATED, kelvin };
                if !self.thermometer.inject(jump) {
                    // The queue of injections is full: the thermometer has not been read for 64 requests.
                    return;
                }
            }
        }
        active.retain(|one| *one != what);
        if on {
            active.push(what);
        }
    }

    /// True position errors of the simulated machine with and without the applied correction, mm, whatever the gateway
    /// reads.
    pub(crate) fn residual_and_error(&self) -> [[f64; 3]; 2] {
        let both = self.plant.residual_and_error();
        both.map(|values| [values[0], values[1], values[2]])
    }

    pub fn active(&self) -> Vec<Disturbance> {
        locked(&self.active).clone()
    }
}

fn grid(machine: &Machine) -> impl Iterator<Item = State> + '_ {
    const NODES: usize = 9;
    (0..NODES * NODES * NODES).map(|index| {
        let mut state = State::default();
        let places = [index / NODES / NODES, index / NODES % NODES, index % NODES];
        for ((q, axis), place) in state.q.iter_mut().zip(machine.axes()).zip(places) {
            let [low, high] = axis.travel;
            *q = low + (high - low) * place as f64 / (NODES - 1) as f64;
        }
        state
    })
}

type Started = (SimulatedController, SimulatedThermometer, Arc<Controls>);

/// Settings of the barrier in the built-in machine's control. A scan takes 2 ms; rates and limits match [`guard`].
pub fn protection() -> Protection {
    Protection::default()
}

impl Simulation {
    /// A machine on the clock `clock`. Its control has no barrier and applies corrections as plain values.
    ///
    /// # Errors
    /// Never in practice: the files are built in.
    pub fn new(clock: Clock) -> Result<Self, GatewayError> {
        Self::started(clock, [0.0; 3], |machine| Ok(machine.start()))
    }

    /// A machine on the clock `clock`. Its control runs the reference barrier with the settings of [`protection`].
    ///
    /// # Errors
    /// Never in practice: files and settings are built in.
    pub fn with_barrier(clock: Clock) -> Result<Self, GatewayError> {
        let protection = protection();
        // Only an axis that has moved shows in the test shift what its position contains.
        Self::started(clock, [1000.0; 3], |machine| {
            let program = Program::new(protection.settings(&machine.axes)?)?;
            Ok(machine.start_with(Box::new(program), protection.scan))
        })
    }

    fn started(
        clock: Clock,
        first: [f64; 3],
        start: impl FnOnce(simulated::Machine) -> Result<Started, SettingsError>,
    ) -> Result<Self, GatewayError> {
        let model = Machine::parse(MODEL, "built-in machine.toml")?;
        let truth_machine = Machine::parse(TRUTH, "built-in truth.toml")?;
        let sensors = warming();
        let names: Vec<String> = sensors.iter().map(|sensor| sensor.name.clone()).collect();
        let truth = Truth::against(truth_machine, &model, &names);
        let function = truth.clone();
        let axis = |name| Axis {
            name,
            includes_correction: false,
            resolution: Displacement::Length(RESOLUTION),
            largest: None,
        };
        let machine = simulated::Machine {
            axes: [AxisName::X, AxisName::Y, AxisName::Z].map(axis).to_vec(),
            program: program(first),
            acceleration_per_s2: 1000.0,
            sensors,
            truth: Arc::new(move |q: &PerChannel<f64>, degc: &[f64]| {
                // The channels and the chain both begin with X, Y, Z.
                let missed = function.error(&PerAxis(q.0), degc);
                let mut values = PerChannel::ZERO;
                values[..3].copy_from_slice(missed.as_slice());
                values
            }),
            clock,
        };
        let (controller, thermometer, controls) = start(machine).map_err(|source| {
            GatewayError::Barrier { device: "built-in barrier".to_owned(), source }
        })?;
        Ok(Self { controller, thermometer, controls, model, truth })
    }
}

fn warming() -> Vec<Warming> {
    let sensor = |name: &str, start_degc: f64, rise_k: f64, time_constant_s: f64| Warming {
        name: name.to_owned(),
        start_degc,
        rise_k,
        time_constant_s,
    };
    vec![
        sensor("bed", 20.1, 1.0, 3600.0),
        sensor("column", 20.3, 3.0, 1800.0),
        sensor("spindle", 20.5, 9.0, 600.0),
        sensor("scale_x", 20.2, 4.0, 1200.0),
        sensor("scale_y", 20.2, 4.0, 1200.0),
    ]
}

/// Moves from `first` through the whole volume, along edges and diagonals, with a stop at each end.
fn program(first: [f64; 3]) -> Vec<Move> {
    let corners = [
        first,
        [8000.0, 4000.0, 2500.0],
        [0.0, 4000.0, 2500.0],
        [8000.0, 0.0, 0.0],
        [8000.0, 4000.0, 0.0],
        [0.0, 0.0, 2500.0],
        [4000.0, 2000.0, 1250.0],
        [8000.0, 0.0, 2500.0],
        [0.0, 4000.0, 0.0],
        [0.0, 0.0, 0.0],
    ];
    let to = |(index, corner): (usize, [f64; 3])| {
        let mut to = PerChannel::ZERO;
        to[..3].copy_from_slice(&corner);
        Move {
            to,
            feed_per_s: 1000.0,
            // Arming with the test shift fits into the first stop.
            dwell: Duration::from_millis(if index == 0 { 4500 } else { 1500 }),
        }
    };
    corners.into_iter().enumerate().map(to).collect()
}

/// The built-in configuration, limits included.
pub fn config() -> Config {
    Config {
        file: "built-in configuration".to_owned(),
        machine: "built-in".into(),
        configured_machine: "built-in".into(),
        auto_arm: true,
        guard: Some(limits()),
        audit: AuditConfig {
            dir: std::env::temp_dir().join(format!("volcomp-gateway-{}", std::process::id())),
        },
        ..Config::default()
    }
}

/// The built-in limits. A gateway without configured limits uses them as well, but cannot arm.
pub fn guard() -> GuardSettings {
    limits().settings()
}

fn limits() -> GuardTable {
    let mut limits = GuardTable {
        limit_um: 250.0,
        warn_um: Some(200.0),
        slew_um_per_s: 500.0,
        accel_um_per_s2: Some(20_000.0),
        confirm_um: Some(50.0),
        limit_urad: Some(250.0),
        warn_urad: Some(200.0),
        slew_urad_per_s: Some(500.0),
        accel_urad_per_s2: Some(20_000.0),
        confirm_urad: Some(50.0),
        limit_without_barrier_um: 250.0,
        limit_without_barrier_urad: 250.0,
        ..GuardTable::default()
    };
    limits.complete();
    limits
}
