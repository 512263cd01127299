//! The plan: a checked configuration, with everything that can be determined without opening a device.
//!
//! The gateway opens a plan, `check` prints it, and a reload compares it with the running one. The checks cover
//! folders, sensor names, overlapping memory blocks, positions and states that no controller reports, and tables that
//! this build does not support.

use std::{io, path::Path, sync::Arc, time::Duration};

use rustix::fs::{Access, FsWord, PROC_SUPER_MAGIC, access, statfs};
use volcomp_devices::{Block, ControllerDevice, ThermometerDevice, controller, thermometer};
use volcomp_model::{Machine, ModelError};
use volcomp_port::{
    Clock, Controller, Description, ShownStates, Thermometer,
    inject::{Faults, Faulty},
};
use volcomp_runtime::{
    BarrierSettings, ControlPath, Cycle, GuardSettings, MAX_SENSORS, Model, PathPlan, PathSettings,
    PlanError, PositionReader, ReaderPlan, Sensors,
    guard::{ControlTimeOut, Limits},
    next_owner,
};
use volcomp_vocabulary::AxisName;

use crate::{
    audit,
    config::{Config, DashboardConfig, is_blank},
    devices::{needs, online, settings},
    documents::{FleetPlan, PlanDocument},
    error::GatewayError,
    http::{Tls, Tokens, tls},
    interop::quantities::Shape,
    simulate::{self, Demo, Simulation, Truth},
};

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
        readers_last(&config)?;
        let readers = readers(&config, &devices, &model)?;
        positions_known(&config, &model, &paths, &readers)?;
        let described = paths.iter().map(|path| &path.description);
        let described = described.chain(readers.iter().map(|reader| &reader.description));
        shown(&config, &model, &devices, described)?;
        let sensors = devices.sensors();
        if sensors.len() > MAX_SENSORS {
            let found = sensors.len();
            return Err(config.plan_error(PlanError::TooManySensors { found }));
        }
        devices.check_files(&config, &paths)?;
        let (tokens, tls) = dashboard(&config.dashboard)?;
        audit_folder(config.audit_dir())?;
        let fleet = fleet(&config)?;
        built(&config)?;
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
            return Err(device_twice(config, "controller", &controller.url));
        }
    }
    let mut controllers: Vec<Box<dyn ControllerDevice>> = Vec::new();
    for own in &config.controllers {
        let device = controller(own).map_err(wrong)?;
        overlap(config, &controllers, &*device)?;
        controllers.push(device);
    }
    let mut thermometers: Vec<ThermometerDevice> = Vec::new();
    for own in &config.thermometers {
        let device = thermometer(own).map_err(wrong)?;
        if thermometers.iter().any(|before| before.is_same(&device)) {
            return Err(device_twice(config, "thermometer", &own.url));
        }
        sensor_names(config, &thermometers, &device, &own.url)?;
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

/// File-system type of `/sys`, as returned by `statfs`.
const SYSFS_MAGIC: FsWord = 0x6265_6572;

/// Rejects an audit-log folder that this user cannot create or write: the path is a file or below one, its name is
/// invalid, or its parent is not writable. Writes nothing.
fn audit_folder(dir: &Path) -> Result<(), GatewayError> {
    let wrong = |found: &Path| {
        let what = if found.starts_with(dir) && found != dir {
            "is a folder, expected a file"
        } else {
            "is no folder"
        };
        Err(GatewayError::invalid(format!(
            "[audit] dir = {}: {} {what}",
            dir.display(),
            found.display()
        )))
    };
    let refused = |found: &Path, source: io::Error| {
        let [dir, found] = [dir, found].map(|path| path.display().to_string());
        GatewayError::invalid(format!("[audit] dir = {dir:?}: {found:?} cannot be used: {source}"))
    };
    for above in dir.ancestors() {
        // The parent of a relative path is the working directory.
        let above = if above == Path::new("") { Path::new(".") } else { above };
        // A dangling link exists but is not a folder.
        match (above.symlink_metadata(), above.metadata()) {
            (_, Ok(found)) if found.is_dir() => {
                can_write_in(above).map_err(|source| refused(above, source))?;
                break;
            }
            (Ok(_), _) => return wrong(above),
            (Err(source), _) if is_missing(&source) => {}
            (Err(source), _) => return Err(refused(above, source)),
        }
    }
    let log = audit::log_file(dir);
    if log.is_dir() {
        return wrong(&log);
    }
    match access(&log, Access::READ_OK | Access::WRITE_OK).map_err(io::Error::from) {
        Err(source) if !is_missing(&source) => Err(refused(&log, source)),
        _ => Ok(()),
    }
}

fn is_missing(error: &io::Error) -> bool {
    matches!(error.kind(), io::ErrorKind::NotFound | io::ErrorKind::NotADirectory)
}

/// Checks that files and folders can be created in a folder. `access` permits everything for root, but the kernel's own
/// file systems reject new files even for root.
fn can_write_in(folder: &Path) -> io::Result<()> {
    access(folder, Access::WRITE_OK | Access::EXEC_OK)?;
    if [PROC_SUPER_MAGIC, SYSFS_MAGIC].contains(&statfs(folder)?.f_type) {
        return Err(io::ErrorKind::PermissionDenied.into());
    }
    Ok(())
}

fn device_twice(config: &Config, table: &str, url: &str) -> GatewayError {
    GatewayError::invalid_in(
        &config.file,
        format_args!("{url} is configured in two [[{table}]], expected one for each device"),
    )
}

/// Rejects a sensor name that is blank or belongs to an earlier thermometer.
fn sensor_names(
    config: &Config,
    before: &[ThermometerDevice],
    device: &ThermometerDevice,
    url: &str,
) -> Result<(), GatewayError> {
    for name in &device.names {
        let expected = if is_blank(name) {
            "expected a name of visible characters for each sensor"
        } else if before.iter().any(|other| other.names.contains(name)) {
            "which is a sensor of another [[thermometer]] already, expected another name for each sensor of the machine"
        } else {
            continue;
        };
        return Err(GatewayError::invalid_in(
            &config.file,
            format_args!("{url}: names: found {name:?}, {expected}"),
        ));
    }
    Ok(())
}

/// Checks that the memory blocks of a controller overlap neither each other nor those of the controllers in `before`,
/// which precede it in the configuration.
fn overlap(
    config: &Config,
    before: &[Box<dyn ControllerDevice>],
    device: &dyn ControllerDevice,
) -> Result<(), GatewayError> {
    let own = before.len();
    if let Some([one, other]) = device.overlap() {
        return Err(overlapping(config, (own, one), (own, other)));
    }
    for (index, before) in before.iter().enumerate() {
        if let Some([one, other]) = device.overlap_with(&**before) {
            return Err(overlapping(config, (own, one), (index, other)));
        }
    }
    Ok(())
}

/// The error for two overlapping blocks. Its position is the key of `one`, or the key of `other` if the file states
/// only that key.
fn overlapping(config: &Config, one: (usize, Block), other: (usize, Block)) -> GatewayError {
    let source = &config.source;
    let key = |(index, block): &(usize, Block)| format!("controller[{index}].{}", block.key);
    let url = |(index, _): &(usize, Block)| format!("controller[{index}].url");
    let (at, beside) = if source.states(&key(&one)) || !source.states(&key(&other)) {
        (one, other)
    } else {
        (other, one)
    };
    let where_beside = match (source.line(&key(&beside)), source.line(&url(&beside))) {
        (Some(line), _) => format!("{} in line {line}", key(&beside)),
        (None, Some(line)) => format!("the driver's own place, {} in line {line}", url(&beside)),
        (None, None) => "the driver's own place".to_owned(),
    };
    let verb = if at.1.is_byte { "lies within" } else { "overlap" };
    let message = format!(
        "{} {verb} {} ({where_beside}): expected bytes of their own for each",
        at.1.text, beside.1.text
    );
    let place = if source.states(&key(&at)) { key(&at) } else { url(&at) };
    GatewayError::Place(source.error(&config.file, &place, message))
}

/// Rejects a read-only controller that precedes a writing one, or is the only controller. Read-only controllers have no
/// rank in the order of preference.
fn readers_last(config: &Config) -> Result<(), GatewayError> {
    let controllers = &config.controllers;
    let misplaced = controllers.iter().enumerate().find(|(index, own)| {
        let later = &controllers[index + 1..];
        own.axes.is_empty() && (*index == 0 || later.iter().any(|later| !later.axes.is_empty()))
    });
    let Some((_, own)) = misplaced else {
        return Ok(());
    };
    Err(GatewayError::invalid_in(
        &config.file,
        format_args!(
            "{}: found axes = [], a controller that is only read, expected it after a [[controller]] that writes and after all of those",
            own.url
        ),
    ))
}

/// Rejects a controller whose correction depends on an unknown position. A writing controller needs the position of
/// every axis of the machine: from its own readings, from another controller, or from `fixed`.
fn positions_known(
    config: &Config,
    model: &Model,
    paths: &[PathPlan],
    readers: &[ReaderPlan],
) -> Result<(), GatewayError> {
    let of_paths = paths.iter().map(|path| &path.description);
    let of_readers = readers.iter().map(|reader| &reader.description);
    let shown: Vec<&Description> = of_paths.chain(of_readers).collect();
    for path in paths {
        let axes = model.axes.iter().zip(path.fixed);
        let unknown = axes.filter(|(axis, fixed)| {
            fixed.is_none() && !shown.iter().any(|description| description.shows(**axis))
        });
        let unknown: Vec<AxisName> = unknown.map(|(axis, _)| *axis).collect();
        if !unknown.is_empty() {
            let what = unknown_positions(&unknown, &config.machine);
            return Err(GatewayError::invalid_in(
                &config.file,
                format_args!("{}: {what}", path.description.device),
            ));
        }
    }
    Ok(())
}

/// The message about axes with unknown positions, with the keys to set for each kind of axis.
fn unknown_positions(axes: &[AxisName], machine: &Path) -> String {
    let list = |with: &str| {
        let words = axes.iter().map(|axis| format!("{with}{axis}{with}"));
        words.collect::<Vec<_>>().join(", ")
    };
    let linear = axes.iter().filter(|axis| !axis.is_rotary());
    let linear: Vec<String> = linear.map(|axis| format!("{axis} = …")).collect();
    let (axis, they, them, they_are) = match axes {
        [_] => ("axis", "it stands", "it", "it is"),
        _ => ("axes", "they stand", "them", "they are"),
    };
    let or_fixed = if linear.is_empty() {
        String::new()
    } else {
        format!(", or state fixed = {{ {} }}", linear.join(", "))
    };
    let not_fixed = if linear.len() == axes.len() { " and `fixed` does not state it" } else { "" };
    let letters = list("");
    format!(
        "{axis} {letters} of {}: the correction depends on where {they}, but no [[controller]] shows {them}{not_fixed}: name {letters} in axes where {they_are} corrected, in reads = [{}] where {they_are} not{or_fixed}",
        machine.display(),
        list("\""),
    )
}

fn by_name(states: ShownStates) -> [(&'static str, bool); 3] {
    [
        ("referenced", states.referenced),
        ("alarm", states.alarm),
        ("emergency_stop", states.emergency_stop),
    ]
}

/// Checks the states and travels of a controller. Errors: a state is neither reported nor listed in
/// `unseen`, `unseen` lists a reported state, or a travel exceeds the range of the position word.
fn shown<'a>(
    config: &Config,
    model: &Model,
    devices: &Devices,
    described: impl Iterator<Item = &'a Description>,
) -> Result<(), GatewayError> {
    let travel = |name: AxisName| {
        let index = model.axes.iter().position(|axis| *axis == name)?;
        model.travel.get(index).copied()
    };
    let controllers = config.controllers.iter().zip(&devices.controllers);
    for ((own, device), description) in controllers.zip(described) {
        let shown = by_name(description.shown).into_iter();
        for ((state, is_shown), (_, is_accepted)) in shown.zip(by_name(own.unseen())) {
            let what = match (is_shown, is_accepted) {
                (false, false) => format!(
                    "this device does not show {state}, so nothing holds the correction by it: let the control show it, or accept that with {state:?} in unseen"
                ),
                (true, true) => format!(
                    "unseen: found {state:?}, expected only states that this device does not show"
                ),
                _ => continue,
            };
            let what = format!("{}: {what}", own.url);
            return Err(GatewayError::invalid_in(&config.file, what));
        }
        let checked = device.check_travel(&travel);
        checked.map_err(|source| config.device_error(source))?;
    }
    Ok(())
}

fn built(config: &Config) -> Result<(), GatewayError> {
    for (is_configured, is_built, table, feature) in [
        (config.shdr.is_some(), cfg!(feature = "shdr"), "shdr", "shdr"),
        (config.opc_ua.is_some(), cfg!(feature = "opc-ua-server"), "opc_ua", "opc-ua-server"),
    ] {
        if is_configured && !is_built {
            return Err(GatewayError::invalid_in(
                &config.file,
                format_args!(
                    "[{table}]: not included in this program: build it with the feature {feature}"
                ),
            ));
        }
    }
    Ok(())
}

/// Checks the files named in `[fleet]` and reads the last activation of the centre.
#[cfg(feature = "fleet")]
fn fleet(config: &Config) -> Result<Option<Fleet>, GatewayError> {
    use tokio_rustls::rustls::pki_types::{CertificateDer, pem::PemObject};
    let Some(fleet) = &config.fleet else {
        return Ok(None);
    };
    let settings = crate::fleet::settings(fleet)?;
    if let Some(ca) = &fleet.ca {
        let mut found = CertificateDer::pem_file_iter(ca).into_iter().flatten();
        if !matches!(found.next(), Some(Ok(_))) {
            let expected = "expected certificates as PEM";
            return Err(GatewayError::invalid_in(ca.display(), expected));
        }
    }
    let kept = crate::fleet::stored(fleet);
    let document = crate::documents::FleetPlan {
        // Reading the settings has already rejected a seed without a public key.
        nkey: settings.public_key().unwrap_or_default(),
        version: kept.standing.active.unwrap_or(0),
        accepted: kept.standing.highest,
        enabled: !kept.standing.disabled,
    };
    Ok(Some(Fleet { document, damage: kept.damage }))
}

/// Rejects `[fleet]`, which this build does not support.
#[cfg(not(feature = "fleet"))]
fn fleet(config: &Config) -> Result<Option<Fleet>, GatewayError> {
    match &config.fleet {
        None => Ok(None),
        Some(_) => Err(GatewayError::invalid_in(
            &config.file,
            "[fleet]: this build of volcomp-gateway has no fleet, expected one that was built with the feature `fleet` (cargo build -p volcomp-gateway --features fleet), or a configuration without this table",
        )),
    }
}
