//! LinuxCNC controls, connected through their bridge.

use std::{
    path::{Path, PathBuf},
    time::{Duration, Instant},
};

use volcomp_linuxcnc::{
    Expected, GuardMinimum, Ini, Key, LinuxCncConfig, LinuxCncController, PORT, VERSION, read_state,
};
use volcomp_port::{Controller, Description, DeviceError};
use volcomp_vocabulary::{AxisKind, Displacement};

use crate::{
    address::{Address, hosts},
    driver::{
        ControllerDevice, Driver, GuardRequirements, Inspected, REPORTED_WITHIN, Settings, USUAL,
    },
    first_config::{FirstConfig, Setting, barrier},
    keys::{BarrierConfig, ControllerConfig, join},
    probe::Probe,
};

const ANSWERS_WITHIN: Duration = Duration::from_secs(2);

/// Time between the two reports from which the scan period of a bridge is determined.
const COUNTED_FOR: Duration = Duration::from_millis(500);

const KEY_FILE: &str = "volcomp.key";

pub(crate) const DRIVER: Driver = Driver {
    name: "a LinuxCNC control (linuxcnc://)",
    keys: &["linuxcnc"],
    writer_keys: &["resolution_um", "resolution_urad", "barrier"],
    port: PORT,
    devices: |address| hosts(address, PORT),
    complete: |own, folder| {
        let tables = own.linuxcnc.iter_mut();
        let files = tables.flat_map(|table| [&mut table.key_file, &mut table.ini]);
        join(folder, files.flatten());
    },
    controller: |address, own| Ok(Box::new(control(&address, own)?)),
    example: "linuxcnc://127.0.0.1:47001",
    first: |_, _| first(),
    probe,
    ..USUAL
};

fn first() -> FirstConfig {
    let mut settings = barrier(1.0).to_vec();
    settings.extend([
        Setting::text(
            "linuxcnc.key_file",
            KEY_FILE,
            "File with the key of the bridge, mode 0600: a copy of [VOLCOMP]KEY_FILE of the INI file",
        ),
        Setting::text(
            "linuxcnc.ini",
            "mill.ini",
            "INI file of the control, which `check` compares",
        )
        .example(),
    ]);
    FirstConfig { cycle_ms: 1.0, settings, key_file: Some(KEY_FILE), ..FirstConfig::default() }
}

struct Control {
    url: String,
    config: LinuxCncConfig,
    barrier: Option<BarrierConfig>,
    ini: Option<PathBuf>,
}

impl ControllerDevice for Control {
    fn describe(&self) -> Result<Description, DeviceError> {
        self.config.describe()
    }

    fn open(&self) -> Result<Box<dyn Controller>, DeviceError> {
        Ok(Box::new(LinuxCncController::new(&self.config)?))
    }

    fn settings(&self) -> Settings {
        Settings {
            shown_within: Some(REPORTED_WITHIN),
            // Commanded positions are floating-point numbers without steps.
            ..Settings::default()
        }
    }

    /// Reads the present state of the bridge. To check its barrier, reads two reports some scans apart.
    fn inspect(&self, needs: Option<&GuardRequirements>) -> Result<Option<Inspected>, DeviceError> {
        let config = &self.config;
        let state =
            read_state(&config.host, config.port, config.remote, &config.key, ANSWERS_WITHIN)?;
        let mut reports = Vec::new();
        if self.barrier.is_some() && needs.is_some() {
            let mut control = LinuxCncController::new(config)?;
            for pause in [Duration::ZERO, COUNTED_FOR] {
                std::thread::sleep(pause);
                let read = control.read(Instant::now() + ANSWERS_WITHIN);
                let read = read.map_err(|fault| {
                    let expected = "compare [VOLCOMP] of the INI file with the configuration";
                    DeviceError::of_fault(config.device(), fault, expected)
                })?;
                reports.extend(read.report.map(|report| (read.correction_taken, report)));
            }
        }
        Ok(Some(Inspected {
            axes: state.axes().map(|axis| axis.name.to_string()).collect(),
            // States of other versions cannot be decoded, so a decoded state has this version.
            protocol: Some(VERSION),
            state: Some(state.flags.to_string()),
            reports,
            ..Inspected::default()
        }))
    }

    fn check_file(&self, needs: Option<&GuardRequirements>) -> Result<(), DeviceError> {
        let Some(file) = &self.ini else { return Ok(()) };
        let shown = file.display();
        let ini = Ini::read(file).map_err(|e| {
            let found = format!("{shown}: {e}");
            DeviceError::option(&*self.url, found, "check linuxcnc.ini").caused_by(e)
        })?;
        let problems = ini.problems(&Expected {
            control: &self.config,
            scan_ms: self.barrier.map_or(1.0, |barrier| barrier.scan_ms),
            least: needs.map(least),
        });
        if problems.is_empty() {
            return Ok(());
        }
        let problems: Vec<String> = problems.iter().map(ToString::to_string).collect();
        Err(DeviceError::option(
            &*self.url,
            format!("{shown}: {}", problems.join("; ")),
            "correct the INI file, and start LinuxCNC anew",
        ))
    }
}

/// Requirements of the guard in the units of the INI file.
fn least(needs: &GuardRequirements) -> GuardMinimum {
    let milli = |[linear, rotary]: [f64; 2]| [linear * 1e3, rotary.to_degrees() * 1e3];
    GuardMinimum {
        limit: milli(needs.limit),
        rate: milli(needs.rate_per_s),
        zero_after_ms: needs.zero_after.as_secs_f64() * 1e3,
    }
}

/// Settings of the control in a `[[controller]]`. Errors: no table `barrier` although axes are corrected, steps that
/// are not whole numbers, no key.
fn control(address: &Address, config: &ControllerConfig) -> Result<Control, DeviceError> {
    let machine = match &config.barrier {
        Some(barrier) => barrier.machine,
        None if config.axes.is_empty() => 0,
        None => {
            return Err(address.wrong(
                "found no table [controller.barrier]",
                "state it with the number of the machine, [VOLCOMP]MACHINE of the INI file, and the period of its servo thread as scan_ms",
            ));
        }
    };
    let step = |kind, default| config.resolution(kind).unwrap_or(default);
    let control = LinuxCncConfig {
        host: address.host.clone(),
        port: address.port.unwrap_or(PORT),
        key: key(address, config)?,
        remote: allows_remote_bridge(address)?,
        channel: config.channel_or("linuxcnc"),
        machine,
        axes: config.axes.clone(),
        reads: config.reads.clone(),
        step_linear: step(AxisKind::Linear, LinuxCncConfig::STEP_LINEAR),
        step_rotary: step(AxisKind::Rotary, LinuxCncConfig::step_rotary()),
    };
    control.describe()?;
    Ok(Control {
        url: address.text.clone(),
        config: control,
        barrier: config.barrier,
        ini: config.linuxcnc.as_ref().and_then(|table| table.ini.clone()),
    })
}

fn key(address: &Address, config: &ControllerConfig) -> Result<Key, DeviceError> {
    if address.get("key_file").is_some() {
        return Err(address.wrong("found key_file in the URL", "state it as linuxcnc.key_file"));
    }
    let makes = "(umask 077; openssl rand -hex 16 > volcomp.key) makes a file with a key";
    let table = config.linuxcnc.as_ref();
    let Some(file) = table.and_then(|table| table.key_file.as_ref()) else {
        let expected = format!("expected the file with the key of the bridge: {makes}");
        return Err(address.wrong("found no linuxcnc.key_file", expected));
    };
    Key::read(file).map_err(|error| {
        address.wrong(format!("linuxcnc.key_file: {error}"), makes).caused_by(error)
    })
}

/// Whether the URL allows a bridge on another computer. Errors: a value other than `true` or `false`.
fn allows_remote_bridge(address: &Address) -> Result<bool, DeviceError> {
    match address.get("remote") {
        None | Some("false") => Ok(false),
        Some("true") => Ok(true),
        Some(other) => {
            Err(address.wrong(format!("found remote={other}"), "expected true or false"))
        }
    }
}

fn probe(address: &Address, at_most: Duration) -> Result<Probe, DeviceError> {
    let port = address.port.unwrap_or(PORT);
    let expected =
        "expected ?key_file=FILE with the key of the bridge, [VOLCOMP]KEY_FILE of its INI file";
    let Some(file) = address.get("key_file") else {
        return Err(address.wrong("found no key_file", expected));
    };
    let key = Key::read(Path::new(file)).map_err(|error| {
        let compare = "compare it with [VOLCOMP]KEY_FILE of the INI file";
        address.wrong(format!("key_file: {error}"), compare).caused_by(error)
    })?;
    let remote = allows_remote_bridge(address)?;
    let state = read_state(&address.host, port, remote, &key, at_most)?;
    let mut probe = Probe::of(&address.text);
    for axis in state.axes() {
        let at = Displacement::from_coordinate(axis.name.kind(), axis.position);
        probe.add_position(axis.name.to_string(), at);
    }
    Ok(probe)
}
