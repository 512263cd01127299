//! A LinuxCNC control, reached by its bridge: what the configuration says of it, and what the bridge tells.

use std::{
    path::Path,
    time::{Duration, Instant},
};

use volcomp_devices::{Address, allows_remote_bridge, bridge_key_file};
use volcomp_guard::{AxisLimits, Limits, RATE_OVER_SLEW};
use volcomp_linuxcnc::{Expected, Ini, Key, Least, LinuxCncConfig, PORT, VERSION, look};
use volcomp_port::{Controller as _, DeviceError};
use volcomp_vocabulary::AxisKind;

use crate::{config::ControllerConfig, documents::OnlinePlan, online};

/// How long a bridge may take to answer `check --online`.
const ANSWERS_WITHIN: Duration = Duration::from_secs(2);

/// Between two reports by which the scans of a bridge are counted.
const COUNTED_FOR: Duration = Duration::from_millis(500);

/// The control of a `[[controller]]`.
///
/// # Errors
/// No table of the barrier, steps that are not whole numbers, no key.
pub(crate) fn controller(
    address: &Address,
    config: &ControllerConfig,
    channel: String,
) -> Result<LinuxCncConfig, DeviceError> {
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
        channel,
        machine,
        axes: config.axes.clone(),
        reads: config.reads.clone(),
        step_linear: step(AxisKind::Linear, LinuxCncConfig::STEP_LINEAR),
        step_rotary: step(AxisKind::Rotary, LinuxCncConfig::step_rotary()),
    };
    control.describe()?;
    Ok(control)
}

/// The key that the gateway shares with the bridge.
fn key(address: &Address, config: &ControllerConfig) -> Result<Key, DeviceError> {
    if bridge_key_file(address).is_some() {
        return Err(address.wrong("found key_file in the URL", "state it as linuxcnc.key_file"));
    }
    let expected = "expected a file with the key of the bridge, such as (umask 077; openssl rand -hex 16 > volcomp.key) makes it";
    let table = config.linuxcnc.as_ref();
    let Some(file) = table.and_then(|table| table.key_file.as_ref()) else {
        return Err(address.wrong("found no linuxcnc.key_file", expected));
    };
    Key::read(file).map_err(|error| {
        address
            .wrong(format!("linuxcnc.key_file: {error}"), expected)
            .caused_by(error)
    })
}

/// Looks through the INI file of the control, and names everything that is wrong or missing.
///
/// # Errors
/// A file that cannot be read, or something that is wrong in it.
pub(crate) fn check(
    address: &Address,
    config: &ControllerConfig,
    control: &LinuxCncConfig,
    file: &Path,
    limits: Option<&Limits>,
) -> Result<(), DeviceError> {
    let shown = file.display();
    let ini = Ini::read(file).map_err(|e| {
        let found = format!("{shown}: {e}");
        address.wrong(found, "check linuxcnc.ini").caused_by(e)
    })?;
    let problems = ini.problems(&Expected {
        control,
        scan_ms: config.barrier.map_or(1.0, |barrier| barrier.scan_ms),
        least: limits.map(least),
    });
    if problems.is_empty() {
        return Ok(());
    }
    let problems: Vec<String> = problems.iter().map(ToString::to_string).collect();
    let found = format!("{shown}: {}", problems.join("; "));
    Err(address.wrong(found, "correct the INI file, and start LinuxCNC anew"))
}

/// What the guard needs of the bridge, by the rule by which it arms.
fn least(limits: &Limits) -> Least {
    let of = |kind: AxisKind, value: fn(&AxisLimits) -> f64| {
        let axes = limits.axes.iter().take(limits.count);
        let values = axes.filter(|axis| axis.kind == kind).map(value);
        let largest = values.fold(0.0, f64::max);
        match kind {
            AxisKind::Linear => largest * 1e3,
            AxisKind::Rotary => largest.to_degrees() * 1e3,
        }
    };
    let both = |value| [of(AxisKind::Linear, value), of(AxisKind::Rotary, value)];
    Least {
        limit: both(AxisLimits::reachable),
        rate: both(|axis| RATE_OVER_SLEW * axis.slew_per_s),
        zero_after_ms: limits.zero_after.as_secs_f64() * 1e3,
    }
}

/// What the bridge tells now, held against the configuration.
///
/// # Errors
/// A bridge that does not answer, or contradicts the configuration.
pub(crate) fn online(
    config: &LinuxCncConfig,
    address: &Address,
    own: &ControllerConfig,
    limits: Option<&Limits>,
) -> Result<OnlinePlan, DeviceError> {
    let state = look(
        &config.host,
        config.port,
        config.remote,
        &config.key,
        ANSWERS_WITHIN,
    )?;
    let axes = state.axes().map(|axis| axis.name.to_string()).collect();
    let barrier = match own.barrier.as_ref().zip(limits) {
        None => None,
        Some((barrier, limits)) => {
            let mut reports = Vec::new();
            let mut control = volcomp_linuxcnc::LinuxCncController::new(config)?;
            for pause in [Duration::ZERO, COUNTED_FOR] {
                std::thread::sleep(pause);
                let read = control.read(Instant::now() + ANSWERS_WITHIN);
                let read = read.map_err(|fault| {
                    let expected = "compare [VOLCOMP] of the INI file with the configuration";
                    DeviceError::of_fault(config.device(), fault, expected)
                })?;
                reports.extend(read.report.map(|report| (read.correction_taken, report)));
            }
            let found = online::barrier(&config.device(), barrier, &own.axes, limits, &reports);
            Some(found?)
        }
    };
    Ok(OnlinePlan {
        url: address.text.clone(),
        axes,
        fastest_per_min: None,
        shift_in_use: None,
        shift_words: None,
        // Another one is an error of the answer.
        protocol: Some(VERSION),
        state: Some(state.flags.to_string()),
        barrier,
        notes: Vec::new(),
    })
}
