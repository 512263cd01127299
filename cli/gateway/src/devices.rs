//! The devices of a configuration: what they are, told without opening them, and opened.

use std::{collections::BTreeMap, time::Duration};

use volcomp_can::{
    BridgeConfig, CanController, CanSocket, CanThermometer, SignalTable, temperature_names,
};
use volcomp_devices::{
    Address, Scheme, digital_lines, digital_modules, focas_config, gpio_port, signal_table,
    thermometer, thermometer_names,
};
use volcomp_digital_io::{DigitalAxis, DigitalController, Wiring};
use volcomp_focas::{
    BarrierArea, Block, FocasConfig, FocasController, PmcAddress, ShiftSource, Width, inspect,
};
use volcomp_guard::Limits;
use volcomp_linuxcnc::{LinuxCncConfig, LinuxCncController};
use volcomp_port::{Controller, Description, DeviceError, DigitalIo, Thermometer};
use volcomp_runtime::{BarrierSettings, PathSettings};
use volcomp_sinumerik::SinumerikConfig;
use volcomp_vocabulary::{AxisKind, AxisName, Displacement, Um, Urad};

use crate::config::{ControllerConfig, PmcByte, Referenced, ThermometerConfig};
use crate::documents::{OnlinePlan, PmcPlan};
use crate::linuxcnc;
use crate::online;
use crate::sinumerik;

/// A bridge on CAN, or in LinuxCNC, tells what is applied in messages of its own, which it sends when it likes: so late at the most a
/// correction shows in them. How old such a message may be, or one with positions, flags or temperatures, is for the guard to
/// judge.
const TOLD_WITHIN: Duration = Duration::from_millis(100);

/// One controller as it is configured, not opened.
#[derive(Clone, Debug)]
pub struct ControllerDevice {
    address: Address,
    kind: Kind,
}

#[derive(Clone, Debug)]
enum Kind {
    Focas(Box<FocasConfig>),
    Can(BridgeConfig),
    Lines(Lines),
    Sinumerik(Box<SinumerikConfig>),
    LinuxCnc(LinuxCncConfig),
}

/// One axis on digital lines.
#[derive(Clone, Debug)]
struct Lines {
    channel: String,
    wiring: Wiring,
    coherence: volcomp_digital_io::Coherence,
    axis: DigitalAxis,
}

impl ControllerDevice {
    /// The controller of a `[[controller]]`.
    ///
    /// # Errors
    /// A URL or keys that make no sense, a DBC file that cannot be read.
    pub fn new(config: &ControllerConfig) -> Result<Self, DeviceError> {
        let address = Address::parse(&config.url)?;
        let channel = |default: &str| config.channel.clone().unwrap_or_else(|| default.to_owned());
        let kind = match address.scheme {
            Scheme::Focas => Kind::Focas(Box::new(focas(&address, config)?)),
            Scheme::Can => Kind::Can(can(&address, config, channel("can"))?),
            Scheme::OpcUa => Kind::Sinumerik(Box::new(sinumerik::controller(&address, config)?)),
            Scheme::LinuxCnc => {
                Kind::LinuxCnc(linuxcnc::controller(&address, config, channel("linuxcnc"))?)
            }
            Scheme::Gpio | Scheme::Modbus | Scheme::ModbusRtu => {
                Kind::Lines(lines(config, channel("digital"))?)
            }
        };
        Ok(Self { address, kind })
    }

    /// The description of the controller by its driver, without opening it.
    ///
    /// # Errors
    /// A configuration that the driver refuses.
    pub fn describe(&self) -> Result<Description, DeviceError> {
        match &self.kind {
            Kind::Focas(config) => config.describe().map_err(|error| error.of(config.device())),
            Kind::Can(config) => config.describe(&CanSocket::device_of(&self.address.host)),
            Kind::Lines(lines) => Ok(lines
                .on(digital_lines(&self.address)?)?
                .description()
                .clone()),
            Kind::Sinumerik(config) => config.describe().map_err(|error| error.of(config.device())),
            Kind::LinuxCnc(config) => config.describe(),
        }
    }

    /// Opens it. Connections are made in the background; a CAN interface and GPIO lines must be there.
    ///
    /// # Errors
    /// A device that cannot be opened.
    pub fn open(&self) -> Result<Box<dyn Controller>, DeviceError> {
        Ok(match &self.kind {
            Kind::Focas(config) => Box::new(FocasController::new((**config).clone())?),
            Kind::Can(config) => Box::new(CanController::new(
                CanSocket::open(&self.address.host)?,
                config,
            )?),
            Kind::Lines(lines) if self.address.scheme == Scheme::Gpio => {
                Box::new(lines.on(gpio_port(&self.address)?)?)
            }
            Kind::Lines(lines) => Box::new(lines.on(digital_modules(&self.address)?)?),
            Kind::Sinumerik(config) => sinumerik::open(config)?,
            Kind::LinuxCnc(config) => Box::new(LinuxCncController::new(config)?),
        })
    }

    /// Asks a control what it tells about itself, and compares that with the configuration and the limits of its guard
    /// (`None`: it is only read); `None` where its bus has nothing to compare. Nothing is written.
    ///
    /// # Errors
    /// A control that cannot be reached, or that contradicts the configuration.
    pub fn online(
        &self,
        own: &ControllerConfig,
        limits: Option<&Limits>,
    ) -> Result<Option<OnlinePlan>, DeviceError> {
        let config = match &self.kind {
            Kind::Focas(config) => config,
            Kind::Sinumerik(config) => return sinumerik::online(config, limits).map(Some),
            Kind::LinuxCnc(config) => {
                return linuxcnc::online(config, &self.address, own, limits).map(Some);
            }
            Kind::Can(_) | Kind::Lines(_) => return Ok(None),
        };
        let found = inspect(config).map_err(|error| error.of(config.device()))?;
        let barrier = own.barrier.as_ref().zip(limits).map(|(barrier, limits)| {
            online::barrier(&config.device(), barrier, &own.axes, limits, &found.reports)
        });
        let (shift_in_use, shift_words) = match found.shift_source {
            ShiftSource::Told { in_use, first } => (Some(in_use), Some(first)),
            ShiftSource::Untold { .. } => (None, None),
        };
        Ok(Some(OnlinePlan {
            url: self.address.text.clone(),
            axes: found.axes.iter().map(char::to_string).collect(),
            fastest_per_min: None,
            shift_in_use,
            shift_words,
            protocol: None,
            state: None,
            barrier: barrier.transpose()?,
            notes: found.notes,
        }))
    }

    /// Looks through the file of the control that the configuration names (LinuxCNC: its INI file), for the limits of its
    /// guard (`None`: it is only read).
    ///
    /// # Errors
    /// A file that cannot be read, or in which something is wrong or missing.
    pub fn look_through(
        &self,
        own: &ControllerConfig,
        limits: Option<&Limits>,
    ) -> Result<(), DeviceError> {
        match (
            &self.kind,
            own.linuxcnc.as_ref().and_then(|table| table.ini.as_ref()),
        ) {
            (Kind::LinuxCnc(config), Some(file)) => {
                linuxcnc::check(&self.address, own, config, file, limits)
            }
            _ => Ok(()),
        }
    }

    /// The addresses in the PMC that are written and read; `None`: no FANUC control.
    pub fn pmc(&self) -> Option<PmcPlan> {
        let Kind::Focas(config) = &self.kind else {
            return None;
        };
        let plain = config.barrier.is_none() && !config.axes.is_empty();
        let text = |address: PmcAddress| address.to_string();
        Some(PmcPlan {
            shift_words: plain.then(|| text(config.shift.first)),
            shift_bytes: plain.then(|| config.shift.width.bytes()),
            copied: plain && config.copied,
            frame: config.barrier.map(|barrier| text(barrier.frame)),
            report: config.barrier.map(|barrier| text(barrier.report)),
            heartbeat: config.heartbeat.filter(|_| plain).map(text),
            referenced: config.referenced.map(text),
        })
    }

    /// The settings of the path besides those of its driver, for cycles of this length.
    pub fn settings(&self, config: &ControllerConfig, period: Duration) -> PathSettings {
        let is_digital = matches!(self.kind, Kind::Lines(_));
        let behind = match self.kind {
            Kind::Can(_) | Kind::LinuxCnc(_) => TOLD_WITHIN.min(longest_read_back(period)),
            Kind::Focas(_) | Kind::Lines(_) => period,
            Kind::Sinumerik(ref config) => config.server.read_back().min(longest_read_back(period)),
        };
        // A frame waits for the control's scan, and is seen in the report after another one.
        let behind = config
            .barrier
            .map_or(behind, |barrier| behind.max(2 * (barrier.scan() + period)));
        let cycles = behind.as_nanos().div_ceil(period.as_nanos().max(1));
        PathSettings {
            fixed: config
                .fixed
                .iter()
                .map(|(name, at)| (*name, Displacement::from_coordinate(name.kind(), *at)))
                .collect(),
            not_driven: config.not_driven(),
            unwatched: config.unwatched,
            only_thermal: config.only_thermal(),
            hold: config.hold(),
            proves: config.test_shift.unwrap_or(!is_digital),
            position_steps: match &self.kind {
                Kind::Lines(lines) => [lines.position_step()].into(),
                Kind::Can(can) => can.position_steps(),
                // A control tells three decimals, or as many as it has for corrections.
                Kind::Focas(focas) => (focas.axes.iter().chain(&focas.reads))
                    .map(|name| (*name, focas.position_step(*name)))
                    .collect(),
                Kind::Sinumerik(config) => (config.axes.iter().chain(&config.reads))
                    .map(|name| (*name, config.position_step(*name)))
                    .collect(),
                // Commanded positions are floating numbers.
                Kind::LinuxCnc(_) => BTreeMap::new(),
            },
            read_back_cycles: usize::try_from(cycles).unwrap_or(usize::MAX).max(1),
            barrier: config.barrier.map(|barrier| BarrierSettings {
                machine: barrier.machine,
                scan: barrier.scan(),
            }),
            ..PathSettings::default()
        }
    }

    /// Checks that every position within the travel of an axis can be shown, where positions come as words of so many
    /// bits. `travel` tells the ends of the travel of a machine axis.
    ///
    /// # Errors
    /// A travel beyond the position word.
    pub fn check_travel(
        &self,
        travel: impl Fn(AxisName) -> Option<[Displacement; 2]>,
    ) -> Result<(), DeviceError> {
        let Kind::Lines(lines) = &self.kind else {
            return Ok(());
        };
        let axis = &lines.axis;
        let Some(travel) = travel(axis.name) else {
            return Ok(());
        };
        let ends = travel.map(Displacement::mm_or_rad);
        axis.position.check_travel(ends).map_err(|beyond| {
            let found = format!("axis {}: {beyond}", axis.name);
            let keys = match axis.name.kind() {
                AxisKind::Linear => "position_mm_per_count or position_zero_mm",
                AxisKind::Rotary => "position_deg_per_count or position_zero_deg",
            };
            let remedy = format!("state other [controller.digital] position_bits, {keys}");
            self.address.wrong(found, remedy).caused_by(beyond)
        })
    }

    /// Two blocks of a control's memory that this controller uses and that share a byte; `None`: there are none.
    pub fn overlap(&self) -> Option<[Block; 2]> {
        match &self.kind {
            Kind::Focas(config) => config.overlap(),
            Kind::Can(_) | Kind::Lines(_) | Kind::Sinumerik(_) | Kind::LinuxCnc(_) => None,
        }
    }

    /// A block that this controller uses and one of another controller of the same control that share a byte which one of
    /// them writes; `None`: there are none.
    pub fn overlap_with(&self, other: &Self) -> Option<[Block; 2]> {
        match (&self.kind, &other.kind) {
            (Kind::Focas(own), Kind::Focas(others)) => own.overlap_with(others),
            _ => None,
        }
    }
}

fn can(
    address: &Address,
    config: &ControllerConfig,
    channel: String,
) -> Result<BridgeConfig, DeviceError> {
    let bridge = BridgeConfig {
        table: signal_table(address)?,
        channel,
        axes: config.axes.clone(),
        reads: config.reads.clone(),
        includes_correction: config.includes_correction,
    };
    let has_barrier = bridge
        .describe(&CanSocket::device_of(&address.host))?
        .barrier;
    let wrong = |found: &str, remedy: &str| Err(address.wrong(found, remedy));
    match (has_barrier, config.barrier.is_some()) {
        (true, false) => wrong(
            "the DBC file has the words of a barrier, and there is no table [controller.barrier]",
            "state the table with the number of the machine and the scan of the control",
        ),
        (false, true) => wrong(
            "the DBC file has no words of a barrier, FRAME_0 and so on, and there is a table [controller.barrier]",
            "name another DBC file, or leave the table out",
        ),
        _ => Ok(bridge),
    }
}

fn focas(address: &Address, config: &ControllerConfig) -> Result<FocasConfig, DeviceError> {
    let mut focas = focas_config(address, &config.axes)?;
    if let Some(channel) = &config.channel
        && *channel != focas.channel
    {
        let found = format!("channel: found {channel:?}");
        let expected = format!(
            "expected {:?}, the only channel of a FANUC control",
            focas.channel
        );
        return Err(address.wrong(found, expected));
    }
    if let Some(area) = config.area {
        focas.shift.first = PmcByte {
            pmc: area.pmc,
            at: area.first,
        }
        .into();
        focas.shift.width = match area.width {
            1 => Width::Byte,
            4 => Width::Long,
            _ => Width::Word,
        };
        focas.copied = area.copied;
    }
    if let Some(um) = config.resolution_um {
        focas.shift.count_linear = Um(um).to_mm();
    }
    if let Some(urad) = config.resolution_urad {
        focas.shift.count_rotary = Urad(urad).to_rad();
    }
    focas.reads.clone_from(&config.reads);
    focas.heartbeat = config.heartbeat.map(Into::into);
    focas.barrier = config.barrier.and_then(|barrier| {
        let (frame, report) = (barrier.frame?, barrier.report?);
        Some(BarrierArea {
            frame: frame.into(),
            report: report.into(),
        })
    });
    match config.referenced {
        None => {}
        Some(Referenced::Not(_)) => focas.referenced = None,
        Some(Referenced::Byte(byte)) => focas.referenced = Some(byte.into()),
    }
    focas.includes_correction = config.includes_correction;
    Ok(focas)
}

fn lines(config: &ControllerConfig, channel: String) -> Result<Lines, DeviceError> {
    let mut names = config.axes.iter().chain(&config.reads);
    let (Some(&name), None) = (names.next(), names.next()) else {
        let what = format!(
            "axes: found {} axes, expected one: these lines carry one position",
            config.axes.len() + config.reads.len()
        );
        return Err(DeviceError::option(&*config.url, what, "name one axis"));
    };
    let words = config.digital.unwrap_or_default();
    let axis = config.digital_axis(name).map_err(|missing| {
        let found = missing.to_string();
        DeviceError::option(&*config.url, found, "state it").caused_by(missing)
    })?;
    Ok(Lines {
        channel,
        wiring: Wiring {
            position: (0..words.position_bits).collect(),
            correction: (0..words.correction_bits).collect(),
            latch: words.latch,
            ..Wiring::default()
        },
        coherence: words.coherence,
        axis,
    })
}

impl Lines {
    fn on<D: DigitalIo>(&self, io: D) -> Result<DigitalController<D>, DeviceError> {
        DigitalController::new(
            io,
            self.channel.clone(),
            self.wiring.clone(),
            self.coherence,
            vec![self.axis],
        )
    }

    fn position_step(&self) -> (AxisName, Displacement) {
        (self.axis.name, self.axis.position.step)
    }
}

/// One thermometer as it is configured, not opened.
#[derive(Clone, Debug)]
pub struct ThermometerDevice {
    address: Address,
    /// The table of signals, on CAN.
    table: Option<SignalTable>,
    /// How the server of a SINUMERIK control is reached, and the nodes of the sensors.
    sinumerik: Option<sinumerik::Temperatures>,
    names: Vec<String>,
    /// The name of the configuration that the device does not have, and those that it has.
    strange: Option<(String, Vec<String>)>,
}

/// The longest time for which a guard remembers its writes.
fn longest_read_back(period: Duration) -> Duration {
    let cycles = u32::try_from(volcomp_runtime::guard::MOST_READ_BACK_CYCLES).unwrap_or(u32::MAX);
    period.saturating_mul(cycles)
}

impl ThermometerDevice {
    /// The thermometer of a `[[thermometer]]`.
    ///
    /// # Errors
    /// A URL or names that make no sense, a device without temperatures.
    pub fn new(config: &ThermometerConfig) -> Result<Self, DeviceError> {
        let address = Address::parse(&config.url)?;
        let (mut strange, mut server) = (None, None);
        let (table, names) = match address.scheme {
            Scheme::Modbus | Scheme::ModbusRtu => {
                (None, thermometer_names(&address, &config.names)?)
            }
            Scheme::Can => {
                let table = signal_table(&address)?;
                let known = temperature_names(&table, &config.url)?;
                let unknown = config.names.iter().find(|name| !known.contains(name));
                strange = unknown.map(|name| (name.clone(), known.clone()));
                let names = match &config.names[..] {
                    [] => known,
                    names => names.to_vec(),
                };
                (Some(table), names)
            }
            Scheme::OpcUa => {
                server = Some(sinumerik::Temperatures::new(&address, config)?);
                (None, config.names.clone())
            }
            Scheme::Focas | Scheme::Gpio | Scheme::LinuxCnc => {
                return Err(address.unsupported(
                    "this device has no temperatures",
                    "expected modbus://, modbus-rtu://, can:// or opc.tcp://",
                ));
            }
        };
        Ok(Self {
            address,
            table,
            sinumerik: server,
            names,
            strange,
        })
    }

    /// A name of the configuration that the device does not have, and the names that it has.
    pub fn strange_name(&self) -> Option<&(String, Vec<String>)> {
        self.strange.as_ref()
    }

    /// The names of its sensors, in the order in which it tells them.
    pub fn names(&self) -> &[String] {
        &self.names
    }

    /// Whether both are the same module, however their URLs are written: the same unit at the same host or serial
    /// device, or the same signals of the same CAN interface.
    pub fn is_same(&self, other: &Self) -> bool {
        let module = |device: &Self| {
            let address = &device.address;
            let unit = address.number("unit", [1, 247], 1_u8).unwrap_or(1);
            let host = address.host.to_lowercase();
            let dbc = address.get("dbc").map(str::to_owned);
            let port = address.port.unwrap_or(volcomp_devices::MODBUS_PORT);
            (host, port, address.path.clone(), unit, dbc)
        };
        self.address.scheme == other.address.scheme && module(self) == module(other)
    }

    /// Opens it. Connections are made in the background; a CAN interface must be there.
    ///
    /// # Errors
    /// A device that cannot be opened.
    pub fn open(&self) -> Result<Box<dyn Thermometer>, DeviceError> {
        if let Some(sinumerik) = &self.sinumerik {
            return sinumerik.open();
        }
        Ok(match &self.table {
            Some(table) => Box::new(CanThermometer::new(
                CanSocket::open(&self.address.host)?,
                table,
                &self.names,
            )?),
            None => Box::new(thermometer(&self.address, &self.names)?),
        })
    }
}
