//! A checked configuration: everything that can be determined without opening a device. The gateway opens a plan,
//! `check` prints it, and a reload compares it with the running one.

use std::{sync::Arc, time::Duration};

use volcomp_devices::{ControllerDevice, ThermometerDevice, controller, thermometer};
use volcomp_model::{Machine, ModelError};
use volcomp_port::{
    Clock, Controller, Description, Thermometer,
    inject::{Faults, Faulty},
};
use volcomp_runtime::{
    BarrierSettings, ControlPath, Cycle, GuardSettings, MAX_SENSORS, Model, PathPlan, PathSettings,
    PlanError, PositionReader, ReaderPlan, Sensors,
    guard::{ControlTimeOut, Limits},
    next_owner,
};

use crate::{
    config::{Config, DashboardConfig},
    devices::{needs, online, settings},
    documents::{FleetPlan, PlanDocument},
    error::GatewayError,
    http::{Tls, Tokens, tls},
    interop::quantities::Shape,
    simulate::{self, Demo, Simulation, Truth},
};

mod checks;
mod describe;

/// A checked configuration with everything it refers to. No device has been opened.
pub struct Plan {
    pub config: Config,
    pub model: Model,
    pub tokens: Tokens,
    /// TLS certificate of the dashboard; `None`: without TLS.
    pub tls: Option<Tls>,
    /// Sensor names, in the order of the configuration.
    pub sensors: Vec<String>,
    fleet: Option<Fleet>,
    machine: Machine,
    guard: GuardSettings,
    paths: Vec<PathPlan>,
    readers: Vec<ReaderPlan>,
    devices: Devices,
}

struct Fleet {
    document: FleetPlan,
    damage: Option<String>,
}

#[derive(Default)]
struct Devices {
    controllers: Vec<Box<dyn ControllerDevice>>,
    thermometers: Vec<ThermometerDevice>,
    simulation: Option<Box<Simulation>>,
}

/// A checked plan whose devices are open, ready for the control thread.
pub struct OpenedPlan {
    pub config: Config,
    /// The cycle, before its first run.
    pub cycle: Cycle,
    /// A copy of the cycle's model.
    pub model: Arc<Model>,
    /// Descriptions of the controllers from their drivers, in the order of the configuration.
    pub controllers: Vec<Description>,
    /// Sensor names, in the order of the configuration.
    pub sensors: Vec<String>,
    /// True errors of the machine; `None` if the machine is not simulated.
    pub truth: Option<Truth>,
    /// Disturbances of the built-in simulation; `None` on a configured machine.
    pub demo: Option<Arc<Demo>>,
    pub tokens: Tokens,
    /// TLS certificate of the dashboard; `None`: without TLS.
    pub tls: Option<Tls>,
}

impl Plan {
    /// Checks a configuration and everything it refers to.
    ///
    /// # Errors
    /// The first error found.
    pub fn new(config: Config) -> Result<Self, GatewayError> {
        let guard = config.guard_settings().unwrap_or_else(simulate::guard);
        let (devices, machine) = if config.controllers.is_empty() {
            let simulation = Simulation::with_barrier(Clock::system())?;
            let machine = simulation.model.clone();
            (Devices { simulation: Some(Box::new(simulation)), ..Devices::default() }, machine)
        } else {
            let machine = Machine::read(&config.machine).map_err(|error| match error {
                ModelError::Read(source) => {
                    GatewayError::MachineFile { file: config.file.clone(), source }
                }
                other => other.into(),
            })?;
            (configured(&config)?, machine)
        };
        let model = Model::new(&machine, guard.fading)?;
        let paths = paths(&config, &devices, &model, &guard)?;
        PathPlan::check_together(&paths).map_err(|source| config.plan_error(source))?;
        checks::readers_last(&config)?;
        let readers = readers(&config, &devices, &model)?;
        checks::positions_known(&config, &model, &paths, &readers)?;
        let described = paths.iter().map(|path| &path.description);
        let described = described.chain(readers.iter().map(|reader| &reader.description));
        checks::shown(&config, &model, &devices, described)?;
        let sensors = devices.sensors();
        if sensors.len() > MAX_SENSORS {
            let found = sensors.len();
            return Err(config.plan_error(PlanError::TooManySensors { found }));
        }
        devices.check_files(&config, &paths)?;
        let (tokens, tls) = dashboard(&config.dashboard)?;
        checks::audit_folder(config.audit_dir())?;
        let fleet = checks::fleet(&config)?;
        checks::built(&config)?;
        Ok(Self {
            config,
            model,
            tokens,
            tls,
            sensors,
            fleet,
            machine,
            guard,
            paths,
            readers,
            devices,
        })
    }

    /// Limits enforced by the guard of each writing controller (mm, rad), in order of preference.
    pub fn limits(&self) -> Vec<Limits> {
        self.paths.iter().map(|path| path.limits).collect()
    }

    /// Plans of the writing controllers, in order of preference.
    pub(crate) fn paths(&self) -> &[PathPlan] {
        &self.paths
    }

    /// Controller descriptions from the drivers: writing ones first, then read-only ones.
    pub(crate) fn descriptions(&self) -> impl Iterator<Item = &Description> {
        let readers = self.readers.iter().map(|reader| &reader.description);
        let paths = self.paths.iter().map(|path| &path.description);
        paths.chain(readers)
    }

    pub(crate) fn guard(&self) -> &GuardSettings {
        &self.guard
    }

    /// The parts that determine the quantities reported to other systems.
    pub fn shape(&self) -> Shape {
        let mut axes = self.model.axes.clone();
        axes.sort_unstable();
        Shape {
            machine: self.model.name.clone(),
            axes,
            sensors: self.sensors.clone(),
            controllers: self.paths.len() + self.readers.len(),
        }
    }

    /// Device name shown by an MTConnect agent.
    pub fn shdr_device(&self) -> &str {
        let shdr = self.config.shdr.as_ref();
        let stated = shdr.and_then(|shdr| shdr.device.as_deref());
        stated.unwrap_or(&self.model.name)
    }

    /// Opens the devices and builds the cycle.
    ///
    /// # Errors
    /// A device cannot be opened.
    pub fn open(mut self) -> Result<OpenedPlan, GatewayError> {
        let devices = std::mem::take(&mut self.devices);
        let plan = |source| self.config.plan_error(source);
        let (controllers, thermometers, simulated) =
            devices.open().map_err(GatewayError::Device)?;
        // Every start of a machine gets a unique owner number.
        let owner = next_owner();
        let mut controllers = controllers.into_iter();
        let paths = controllers
            .by_ref()
            .take(self.paths.len())
            .zip(&self.paths)
            .map(|(controller, path)| ControlPath::new(controller, path)?.with_owner(path, owner))
            .collect::<Result<Vec<_>, _>>()
            .map_err(plan)?;
        let readers = controllers
            .zip(&self.readers)
            .map(|(controller, reader)| PositionReader::new(controller, reader))
            .collect();
        let cycle = Cycle::new(
            Box::new(self.model.clone()),
            paths,
            self.guard.hand_back,
            Sensors::new(thermometers, self.guard.temperatures),
            self.config.cycle(),
        )
        .and_then(|cycle| cycle.with_readers(readers))
        .map_err(plan)?
        .with_rapid(self.guard.rapid);
        let opened = self.opened(cycle);
        let (truth, demo) = simulated.unzip();
        Ok(OpenedPlan { truth, demo, ..opened })
    }

    pub(crate) fn opened(self, cycle: Cycle) -> OpenedPlan {
        OpenedPlan {
            controllers: self.descriptions().cloned().collect(),
            config: self.config,
            cycle,
            model: Arc::new(self.model),
            sensors: self.sensors,
            truth: None,
            demo: None,
            tokens: self.tokens,
            tls: self.tls,
        }
    }

    /// The plan as printed by `check --json`.
    ///
    /// # Errors
    /// The required correction per kelvin cannot be computed.
    pub fn document(&self) -> Result<PlanDocument, GatewayError> {
        Ok(describe::document(self)?)
    }

    /// Notes on sensors that no thermometer has or no thermal term uses.
    pub(crate) fn sensor_notes(&self) -> Vec<String> {
        describe::of_sensors(self, &describe::sensors(self))
    }

    /// The plan with the settings that the controls report. Nothing is written to the controls.
    ///
    /// # Errors
    /// A control cannot be reached, or contradicts the configuration.
    pub fn online(&self) -> Result<PlanDocument, GatewayError> {
        let controllers = self.devices.controllers.iter();
        let limits = self.paths.iter().map(|path| Some(&path.limits));
        let limits = limits.chain(std::iter::repeat(None));
        let configured = controllers.zip(&self.config.controllers).zip(limits);
        let online_plans =
            configured.map(|((device, config), limits)| online(&**device, config, limits));
        let online_plans = online_plans.collect::<Result<Vec<_>, _>>();
        let online_plans = online_plans.map_err(GatewayError::Device)?;
        Ok(PlanDocument {
            online: Some(online_plans.into_iter().flatten().collect()),
            ..self.document()?
        })
    }
}

impl Devices {
    fn sensors(&self) -> Vec<String> {
        if let Some(simulation) = &self.simulation {
            return simulation.thermometer.names().to_vec();
        }
        let names = self.thermometers.iter().flat_map(|device| &device.names);
        names.cloned().collect()
    }

    fn check_files(&self, config: &Config, paths: &[PathPlan]) -> Result<(), GatewayError> {
        let needs = paths.iter().map(|path| Some(needs(&path.limits)));
        let needs = needs.chain(std::iter::repeat_with(|| None));
        for (device, needs) in self.controllers.iter().zip(needs) {
            let checked = device.check_file(needs.as_ref());
            checked.map_err(|source| config.device_error(source))?;
        }
        Ok(())
    }

    #[expect(clippy::type_complexity, reason = "three parts of one answer")]
    fn open(
        self,
    ) -> Result<
        (Vec<Box<dyn Controller>>, Vec<Box<dyn Thermometer>>, Option<(Truth, Arc<Demo>)>),
        volcomp_port::DeviceError,
    > {
        if let Some(simulation) = self.simulation {
            let thermometer = Faulty::new(simulation.thermometer, Faults::default(), 0);
            let plant = simulation.controller.plant();
            let demo = Arc::new(Demo::new(simulation.controls, thermometer.remote(), plant));
            return Ok((
                vec![Box::new(simulation.controller)],
                vec![Box::new(thermometer)],
                Some((simulation.truth.of(Arc::clone(&demo)), demo)),
            ));
        }
        let controllers = self.controllers.iter().map(|device| device.open());
        let thermometers = self.thermometers.iter().map(ThermometerDevice::open);
        Ok((controllers.collect::<Result<_, _>>()?, thermometers.collect::<Result<_, _>>()?, None))
    }
}

fn configured(config: &Config) -> Result<Devices, GatewayError> {
    let wrong = |source| config.device_error(source);
    for (index, controller) in config.controllers.iter().enumerate() {
        let before = &config.controllers[..index];
        if before.iter().any(|other| other.url == controller.url) {
            return Err(checks::device_twice(config, "controller", &controller.url));
        }
    }
    let mut controllers: Vec<Box<dyn ControllerDevice>> = Vec::new();
    for own in &config.controllers {
        let device = controller(own).map_err(wrong)?;
        checks::overlap(config, &controllers, &*device)?;
        controllers.push(device);
    }
    let mut thermometers: Vec<ThermometerDevice> = Vec::new();
    for own in &config.thermometers {
        let device = thermometer(own).map_err(wrong)?;
        if thermometers.iter().any(|before| before.is_same(&device)) {
            return Err(checks::device_twice(config, "thermometer", &own.url));
        }
        checks::sensor_names(config, &thermometers, &device, &own.url)?;
        thermometers.push(device);
    }
    Ok(Devices { controllers, thermometers, simulation: None })
}

/// Time that a control needs to ramp from the largest correction to zero at the maximum slew rate of the guard.
fn time_to_zero(guard: &GuardSettings) -> Duration {
    let linear = guard.linear.limit.0 / guard.linear.slew_per_s.0;
    let rotary = guard.rotary.map_or(0.0, |rotary| rotary.limit.0 / rotary.slew_per_s.0);
    Duration::try_from_secs_f64(linear.max(rotary)).unwrap_or(Duration::MAX / 4)
}

fn paths(
    config: &Config,
    devices: &Devices,
    model: &Model,
    guard: &GuardSettings,
) -> Result<Vec<PathPlan>, GatewayError> {
    let period: Duration = config.cycle();
    let path = |description: Description, settings: &PathSettings| {
        let planned = PathPlan::new(description, model, guard, settings, period);
        planned.map_err(|source| config.plan_error(source))
    };
    if let Some(simulation) = &devices.simulation {
        // The simulated control is internal to this process, so no other sender can reach it.
        let settings = PathSettings {
            watch: Duration::ZERO,
            barrier: Some(BarrierSettings {
                machine: simulate::protection().machine,
                scan: simulate::protection().scan,
            }),
            ..PathSettings::default()
        };
        return Ok(vec![path(simulation.controller.description().clone(), &settings)?]);
    }
    let configured = devices.controllers.iter().zip(&config.controllers);
    configured
        .filter(|(_, controller)| !controller.axes.is_empty())
        .map(|(device, controller)| {
            let described = device.describe();
            let description = described.map_err(|source| config.device_error(source))?;
            let settings = PathSettings {
                time_out: device
                    .settings()
                    .time_out
                    .map(|after| ControlTimeOut { after, to_zero: time_to_zero(guard) }),
                ..settings(&**device, controller, period)
            };
            path(description, &settings)
        })
        .collect()
}

/// Plans of the read-only controllers, which follow the writing ones.
fn readers(
    config: &Config,
    devices: &Devices,
    model: &Model,
) -> Result<Vec<ReaderPlan>, GatewayError> {
    let all = devices.controllers.iter().zip(&config.controllers);
    all.filter(|(_, controller)| controller.axes.is_empty())
        .map(|(device, controller)| {
            let described = device.describe();
            let description = described.map_err(|source| config.device_error(source))?;
            let settings = settings(&**device, controller, config.cycle());
            let planned = ReaderPlan::new(description, model, &settings);
            planned.map_err(|source| config.plan_error(source))
        })
        .collect()
}

/// Reads tokens and certificate. A dashboard that other computers can reach needs both.
pub(crate) fn dashboard(
    dashboard: &DashboardConfig,
) -> Result<(Tokens, Option<Tls>), GatewayError> {
    let listen = dashboard.listen;
    let tls = (dashboard.tls_certificate.as_ref())
        .zip(dashboard.tls_key.as_ref())
        .map(|(certificate, key)| tls::acceptor(certificate, key))
        .transpose()?;
    let is_local = !dashboard.reading_needs_token();
    if !is_local && tls.is_none() {
        return Err(GatewayError::invalid(format!(
            "[dashboard] listen = {listen}: others can reach this address, so tls_certificate and tls_key are needed (volcomp-gateway tls-init makes a pair)"
        )));
    }
    let tokens = Tokens::load(dashboard.token_file.as_deref())?;
    if !is_local && tokens.is_empty() {
        return Err(GatewayError::invalid(format!(
            "[dashboard] listen = {listen}: others can reach this address, so reading needs a token: token_file is missing or empty"
        )));
    }
    Ok((tokens, tls))
}
