//! From a configuration to a cycle: controllers, guards, thermometers, the model.

use std::time::Duration;

use volcomp_can::{BridgeConfig, CanController, CanSocket, CanThermometer};
use volcomp_devices::{
    Address, Scheme, digital_modules, focas_config, gpio_port, signal_table, thermometer,
};
use volcomp_digital_io::{CorrectionWord, DigitalAxis, DigitalController, PositionWord, Wiring};
use volcomp_focas::FocasController;
use volcomp_guard::{AxisLimits, Guard, Limits, Reasons, SensorLimits};
use volcomp_port::{Axis, Controller, Description, DeviceError, DigitalIo, Heartbeat, Thermometer};

use volcomp_vocabulary::{AxisName, Displacement, MAX_AXES, PerAxis, PerChannel};

use crate::{
    config::{AxisGuard, Config, ControllerConfig, GuardConfig, ThermometerConfig},
    cycle::{Cycle, Sensors},
    error::GatewayError,
    model::Model,
    path::ControlPath,
};

/// A shift that a position cannot show proves nothing: this many steps of the position at least.
const SHIFT_STEPS: f64 = 4.0;

/// The controller of a `[[controller]]`.
///
/// # Errors
/// A device that cannot be set up.
pub fn controller(config: &ControllerConfig) -> Result<Box<dyn Controller>, GatewayError> {
    let address = Address::parse(&config.url)?;
    let channel = |default: &str| config.channel.clone().unwrap_or_else(|| default.to_owned());
    match address.scheme {
        Scheme::Focas => {
            let mut focas = focas_config(&address, &config.axes)?;
            focas.channel = channel(&focas.channel.clone());
            if let Some((first, width)) = config.area {
                (focas.shift.first, focas.shift.width) = (first, width);
            }
            if let Some(um) = config.resolution_um {
                focas.shift.count_linear = volcomp_vocabulary::Um(um).to_mm();
            }
            if let Some(urad) = config.resolution_urad {
                focas.shift.count_rotary = volcomp_vocabulary::Urad(urad).to_rad();
            }
            focas.heartbeat = config.heartbeat;
            if let Some(referenced) = config.referenced {
                focas.referenced = referenced;
            }
            focas.includes_correction = config.includes_correction;
            Ok(Box::new(FocasController::new(focas)?))
        }
        Scheme::Can => {
            let bridge = BridgeConfig {
                table: signal_table(&address)?,
                channel: channel("can"),
                axes: config.axes.clone(),
                includes_correction: config.includes_correction,
                stale_after: Duration::from_millis(100),
            };
            Ok(Box::new(CanController::new(
                CanSocket::open(&address.host)?,
                &bridge,
            )?))
        }
        Scheme::Gpio => digital(config, gpio_port(&address)?, &channel("digital")),
        Scheme::Modbus | Scheme::ModbusRtu => {
            digital(config, digital_modules(&address)?, &channel("digital"))
        }
    }
}

fn digital<D: DigitalIo + 'static>(
    config: &ControllerConfig,
    io: D,
    channel: &str,
) -> Result<Box<dyn Controller>, GatewayError> {
    let [name] = config.axes[..] else {
        let what = format!(
            "found {} axes, expected one: these lines carry one position",
            config.axes.len()
        );
        return Err(DeviceError::new(&*config.url, what, "name one axis").into());
    };
    let words = &config.digital;
    let axis = DigitalAxis {
        position: PositionWord {
            bits: words.position_bits,
            code: words.position_code,
            mm_per_count: words.position_mm_per_count,
            zero_mm: words.position_zero_mm,
        },
        correction: CorrectionWord {
            bits: words.correction_bits,
            code: words.correction_code,
            mm_per_count: config.resolution_um.unwrap_or(1.0) * 1e-3,
        },
        includes_correction: config.includes_correction,
        ..DigitalAxis::published(name)
    };
    let wiring = Wiring {
        position: (0..words.position_bits).collect(),
        correction: (0..words.correction_bits).collect(),
        ..Wiring::default()
    };
    Ok(Box::new(DigitalController::new(
        io,
        channel,
        wiring,
        words.coherence,
        vec![axis],
    )?))
}

/// The thermometer of a `[[thermometer]]`.
///
/// # Errors
/// A device that cannot be set up.
pub fn open_thermometer(config: &ThermometerConfig) -> Result<Box<dyn Thermometer>, GatewayError> {
    let address = Address::parse(&config.url)?;
    match address.scheme {
        Scheme::Modbus | Scheme::ModbusRtu => Ok(Box::new(thermometer(&address, &config.names)?)),
        Scheme::Can => {
            let table = signal_table(&address)?;
            Ok(Box::new(CanThermometer::new(
                CanSocket::open(&address.host)?,
                &table,
                Duration::from_secs(10),
            )?))
        }
        Scheme::Focas | Scheme::Gpio => Err(address
            .wrong(
                "this device has no temperatures",
                "expected modbus://, modbus-rtu:// or can://",
            )
            .into()),
    }
}

/// The limits of a controller's guard.
///
/// # Errors
/// Rotary axes without limits, or limits that make no sense.
pub fn limits(
    description: &Description,
    guard: &GuardConfig,
    config: &PathConfig,
    period: Duration,
) -> Result<Limits, GatewayError> {
    let mut axes = [AxisLimits::NONE; MAX_AXES];
    let mut test_shift = PerChannel::ZERO;
    for ((into, shift), axis) in axes.iter_mut().zip(&mut test_shift).zip(&description.axes) {
        let (of_kind, to_internal) = if axis.name.is_rotary() {
            let rotary = guard.rotary.as_ref().ok_or_else(|| {
                GatewayError::Unfit(format!(
                    "[guard]: axis {} is rotary: limit_urad and slew_urad_per_s are missing",
                    axis.name
                ))
            })?;
            (rotary, 1e-6)
        } else {
            (&guard.linear, 1e-3)
        };
        *into = axis_limits(axis, of_kind, to_internal);
        let wanted = (of_kind.test_shift * to_internal)
            .max(SHIFT_STEPS * axis.step().max(config.position_step));
        if config.proves && of_kind.test_shift > 0.0 && wanted <= into.limit {
            *shift = wanted;
        }
    }
    let limits = Limits {
        axes,
        count: description.axes.len().min(MAX_AXES),
        period,
        hold: guard.hold,
        zero_after: guard.zero_after,
        ramp: guard.ramp,
        test_shift,
        read_back_cycles: config.read_back_cycles,
    };
    let named = |e: volcomp_guard::LimitsError| {
        let axis = e
            .axis
            .and_then(|axis| description.axes.get(axis))
            .map_or(String::new(), |axis| format!(" of {}", axis.name));
        GatewayError::Unfit(format!(
            "[guard]: {}{axis}: found {}, expected {} (mm, rad)",
            e.what, e.found, e.expected
        ))
    };
    limits.check().map_err(named)?;
    Ok(limits)
}

fn axis_limits(axis: &Axis, guard: &AxisGuard, to_internal: f64) -> AxisLimits {
    AxisLimits {
        limit: guard.limit * to_internal,
        warn: guard.warn * to_internal,
        slew_per_s: guard.slew_per_s * to_internal,
        accel_per_s2: guard.accel_per_s2 * to_internal,
        resolution: axis.step(),
        includes_correction: axis.includes_correction,
    }
}

/// What a path has besides its controller.
#[derive(Clone, Debug)]
pub struct PathConfig {
    /// Machine axes that stand where they are told: mm, deg.
    pub fixed: Vec<(AxisName, f64)>,
    /// Nobody watches it, and that is known.
    pub unwatched: bool,
    /// Whether the test shift is made.
    pub proves: bool,
    /// Smallest step that its positions show, mm.
    pub position_step: f64,
    /// How many writes its read-back may be behind.
    pub read_back_cycles: usize,
}

impl PathConfig {
    fn of(config: &ControllerConfig, period: Duration) -> Self {
        let scheme = Address::parse(&config.url)
            .ok()
            .map(|address| address.scheme);
        let is_digital = matches!(
            scheme,
            Some(Scheme::Gpio | Scheme::Modbus | Scheme::ModbusRtu)
        );
        // A bridge on CAN tells what is applied in messages of its own.
        let behind = if scheme == Some(Scheme::Can) {
            Duration::from_millis(60)
        } else {
            period
        };
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "1 to 32"
        )]
        let read_back_cycles = (behind.as_secs_f64() / period.as_secs_f64())
            .ceil()
            .clamp(1.0, 32.0) as usize;
        Self {
            fixed: config.fixed.iter().map(|(name, at)| (*name, *at)).collect(),
            unwatched: config.unwatched,
            proves: config.proves.unwrap_or(!is_digital),
            position_step: if is_digital {
                config.digital.position_mm_per_count
            } else {
                0.0
            },
            read_back_cycles,
        }
    }
}

/// One path, checked against the machine.
///
/// # Errors
/// Axes that the machine does not have, a controller that nobody watches unless that is known.
pub fn path(
    controller: Box<dyn Controller>,
    model: &Model,
    guard: &GuardConfig,
    config: &PathConfig,
    period: Duration,
    channels: &mut Vec<String>,
) -> Result<ControlPath, GatewayError> {
    let description = controller.description().clone();
    let device = &description.device;
    let unfit = |what: String| Err(GatewayError::Unfit(format!("{device}: {what}")));
    let mut machine_axis = PerChannel([0; MAX_AXES]);
    for (place, axis) in machine_axis.iter_mut().zip(&description.axes) {
        let letters: String = model.axes.iter().map(|name| name.letter()).collect();
        let Some(index) = model.index_of(axis.name) else {
            return unfit(format!(
                "axis {}: the machine {} has the axes {letters}",
                axis.name, model.name
            ));
        };
        *place = index;
    }
    let mut fixed = PerAxis([None; MAX_AXES]);
    for (name, at) in &config.fixed {
        match model.index_of(*name) {
            Some(index) => {
                fixed[index] = Some(Displacement::from_coordinate(name.kind(), *at).mm_or_rad());
            }
            None => {
                return unfit(format!(
                    "fixed: the machine {} has no axis {name}",
                    model.name
                ));
            }
        }
    }
    let mut notes = Reasons::CANNOT_SEE_OTHERS.when(!description.sees_other_gateways);
    match (description.heartbeat, config.unwatched) {
        (Heartbeat::Unwatched, false) => return unfit("nobody ramps the correction out when the gateway stops: name a heartbeat that the control watches, or say unwatched = true".to_owned()),
        (Heartbeat::Unwatched, true) => notes |= Reasons::UNWATCHED,
        (Heartbeat::Watched, _) => {}
    }
    if description.shortest_cycle > period {
        return unfit(format!(
            "a cycle takes {:.1} ms at least, found cycle_ms = {}",
            description.shortest_cycle.as_secs_f64() * 1e3,
            period.as_secs_f64() * 1e3
        ));
    }
    let limits = limits(&description, guard, config, period)?;
    let guard = Guard::new(limits).map_err(|e| GatewayError::Unfit(e.to_string()))?;
    let channel = channels
        .iter()
        .position(|known| *known == description.channel)
        .unwrap_or_else(|| {
            channels.push(description.channel.clone());
            channels.len() - 1
        });
    Ok(ControlPath::new(
        controller,
        guard,
        machine_axis,
        fixed,
        u32::try_from(channel).unwrap_or(u32::MAX),
        notes,
    ))
}

/// A cycle from a configuration.
///
/// # Errors
/// What does not fit together, or cannot be opened.
pub fn cycle(
    config: &Config,
    guard: &GuardConfig,
    model: Box<Model>,
) -> Result<Cycle, GatewayError> {
    let mut channels = Vec::new();
    let mut paths = Vec::new();
    for controller_config in &config.controllers {
        let opened = controller(controller_config)?;
        let path_config = PathConfig::of(controller_config, config.cycle);
        paths.push(path(
            opened,
            &model,
            guard,
            &path_config,
            config.cycle,
            &mut channels,
        )?);
    }
    let thermometers = config
        .thermometers
        .iter()
        .map(open_thermometer)
        .collect::<Result<_, _>>()?;
    let sensors = Sensors {
        thermometers,
        limits: sensor_limits(guard),
    };
    Ok(Cycle::new(
        model,
        paths,
        guard.hand_back,
        sensors,
        config.cycle,
    ))
}

/// What temperatures may be.
pub fn sensor_limits(guard: &GuardConfig) -> SensorLimits {
    SensorLimits {
        range_degc: guard.range_degc,
        max_degc_per_min: guard.max_degc_per_min,
        stale: guard.temperature_stale,
    }
}

/// New limits for every path after a reload, in the order of the controllers.
///
/// # Errors
/// Limits that make no sense.
pub fn reloaded_limits(
    config: &Config,
    guard: &GuardConfig,
    descriptions: &[Description],
) -> Result<Vec<Limits>, GatewayError> {
    let pairs = config.controllers.iter().zip(descriptions);
    pairs
        .map(|(controller, description)| {
            limits(
                description,
                guard,
                &PathConfig::of(controller, config.cycle),
                config.cycle,
            )
        })
        .collect()
}
