//! Thermometers and digital lines on Modbus modules.

use std::{
    path::Path,
    time::{Duration, Instant},
};

use volcomp_modbus::{
    ANSWER_WITHIN, Bus, ByteOrder, DigitalModule, ModbusDigital, Parity, Profile,
    ThermometerConfig, ThermometerUnit, poll_temperatures,
};
use volcomp_port::{
    Backoff, DeviceError, DigitalIo, Fault, Quality, Reason, Temperature, Thermometer,
    UnopenedLines,
};

use crate::{
    address::{Address, hosts},
    driver::{Driver, ThermometerDevice},
    keys::ThermometerConfig as ThermometerTable,
    lines,
    list::serial_ports,
    probe::{Facts, ModuleFacts, Probe},
};

/// Scheme of a serial line.
const RTU: &str = "modbus-rtu";

const PORT: u16 = 502;

pub(crate) const DRIVER: Driver = Driver {
    port: PORT,
    devices: |address| {
        if address.scheme != RTU {
            return hosts(address, PORT);
        }
        let path = std::fs::canonicalize(&address.path);
        let path = path.map_or_else(|_| address.path.clone(), |p| p.display().to_string());
        [format!("serial {path}")].into()
    },
    // A serial line has a single master; TCP modules can be shared.
    is_exclusive: |address| address.scheme == RTU,
    controller: |address, own| lines::controller(address, own, digital_modules, unopened),
    thermometer,
    example: "modbus://192.0.2.40:502?profile=WAGO-750-8DI/8DO",
    // On Modbus two equal readings may be the same process image, so their agreement proves nothing. Gray code limits
    // an error to one step.
    first: |address, machine| lines::first(unopened(address).ok(), "gray", machine),
    probe,
    ..lines::LINES
};

fn thermometer(address: Address, own: &ThermometerTable) -> Result<ThermometerDevice, DeviceError> {
    let config = thermometer_config(&address, &own.names)?;
    Ok(ThermometerDevice {
        address,
        names: config.names()?,
        open: Box::new(move || Ok(Box::new(poll_temperatures(config.clone())?))),
    })
}

/// Profile that a URL names: a file if the name ends in `.toml`, otherwise a shipped profile.
fn profile(address: &Address) -> Result<Profile, DeviceError> {
    let name = address.get("profile").ok_or_else(|| {
        let known: Vec<String> = Profile::shipped().into_iter().map(|p| p.name).collect();
        let expected =
            format!("expected profile=NAME, one of: {}; or profile=FILE.toml", known.join(", "));
        address.wrong("no profile is named", expected)
    })?;
    let is_file = Path::new(name).extension().is_some_and(|e| e == "toml");
    let found = if is_file { Profile::read(Path::new(name)) } else { Profile::named(name) };
    let mut found =
        found.map_err(|e| address.wrong(e.to_string(), "correct the profile").caused_by(e))?;
    if let Some(order) = address.get("byte_order") {
        let named = ByteOrder::NAMES.iter().find(|(name, _)| *name == order);
        let (_, order) = named.ok_or_else(|| {
            let what = format!("found byte_order={order}");
            address.wrong(what, "expected high or low")
        })?;
        match &mut found.channels {
            Some(channels) if channels.number.registers() == 2 => channels.byte_order = *order,
            _ => {
                let what = format!(
                    "found byte_order, and profile {} has no numbers of two registers",
                    found.name
                );
                return Err(address.wrong(what, "leave it out"));
            }
        }
    }
    Ok(found)
}

fn answer_within(address: &Address) -> Result<Duration, DeviceError> {
    let usual = u32::try_from(ANSWER_WITHIN.as_millis()).unwrap_or(u32::MAX);
    let ms = address.number("answer_ms", [10, 10_000], usual)?;
    Ok(Duration::from_millis(ms.into()))
}

fn bus(address: &Address, profile: &Profile) -> Result<Bus, DeviceError> {
    if address.scheme != RTU {
        return Ok(Bus::Tcp { host: address.host.clone(), port: address.port.unwrap_or(PORT) });
    }
    Ok(Bus::Rtu {
        // A serial port of Windows is not a path: `modbus-rtu:///COM3` opens COM3.
        path: (address.path.strip_prefix('/'))
            .filter(|_| cfg!(windows))
            .unwrap_or(&address.path)
            .to_owned(),
        baud: address.number("baud", [300, 4_000_000], profile.baud)?,
        parity: match address.get("parity").unwrap_or("none") {
            "none" => Parity::None,
            "even" => Parity::Even,
            "odd" => Parity::Odd,
            other => {
                let what = format!("found parity={other}");
                return Err(address.wrong(what, "expected none, even or odd"));
            }
        },
        stop_bits: address.number("stop", [1, 2], 1)?,
    })
}

fn thermometer_config(
    address: &Address,
    names: &[String],
) -> Result<ThermometerConfig, DeviceError> {
    let profile = profile(address)?;
    let bus = bus(address, &profile)?;
    let count = profile.channels.as_ref().map_or(0, |channels| channels.count);
    let mut names = names.to_vec();
    if names.is_empty() {
        names = address.list("names");
    }
    if names.is_empty() {
        names = (1..=count).map(|channel| format!("{channel}")).collect();
    }
    let unit = ThermometerUnit { unit: address.number("unit", [1, 247], 1)?, profile, names };
    Ok(ThermometerConfig {
        answer_within: answer_within(address)?,
        ..ThermometerConfig::new(bus, unit)
    })
}

/// Opens the digital lines of a URL. Errors: invalid keys, a profile without digital lines.
fn digital_modules(address: &Address) -> Result<ModbusDigital, DeviceError> {
    let (bus, module) = module(address)?;
    ModbusDigital::new(bus, &[module], answer_within(address)?, Backoff::default())
}

fn unopened(address: &Address) -> Result<UnopenedLines, DeviceError> {
    let (bus, module) = module(address)?;
    ModbusDigital::describe(&bus, &[module])
}

fn module(address: &Address) -> Result<(Bus, DigitalModule), DeviceError> {
    let profile = profile(address)?;
    let bus = bus(address, &profile)?;
    let module = DigitalModule { unit: address.number("unit", [1, 247], 1)?, profile };
    Ok((bus, module))
}

fn probe(address: &Address, at_most: Duration) -> Result<Probe, DeviceError> {
    let profile = profile(address)?;
    let mut probe = Probe::of(&address.text);
    let mut facts = ModuleFacts {
        profile: profile.name.clone(),
        unproven: profile.unproven.clone(),
        outputs_told: None,
    };
    let deadline = Instant::now() + at_most;
    let no_answer = || {
        let ports: Vec<String> = serial_ports().into_iter().map(|port| port.device).collect();
        let remedy = match (address.scheme, ports.is_empty()) {
            (RTU, true) => {
                "check wire, unit, speed and parity; this machine has no serial port".to_owned()
            }
            (RTU, false) => {
                format!(
                    "check wire, unit, speed and parity; serial ports here: {}",
                    ports.join(", ")
                )
            }
            _ => "check address, unit and supply".to_owned(),
        };
        address.no_answer("the module does not answer", remedy)
    };
    let refused = |what: &str| {
        let remedy = "check function, address and count in the profile, and the unit";
        address.no_answer(what.replace("the device", "the module"), remedy)
    };
    let echo = || {
        let remedy = "the adapter repeats every request (local echo), which is skipped: check the wire, unit, speed and parity behind it";
        address.no_answer("only the echo of the request comes back", remedy)
    };
    if profile.channels.is_some() {
        let mut thermometer = poll_temperatures(thermometer_config(address, &[])?)?;
        let unheard = |t: &Temperature| {
            let Quality::Bad(reason) = t.quality else {
                return false;
            };
            matches!(reason, Reason::NotRead | Reason::NoAnswer | Reason::Echo)
        };
        while thermometer.latest().iter().all(unheard) {
            if Instant::now() >= deadline {
                let is_echo =
                    (thermometer.latest().iter()).any(|t| t.quality == Quality::Bad(Reason::Echo));
                return Err(if is_echo { echo() } else { no_answer() });
            }
            std::thread::sleep(Duration::from_millis(5));
        }
        let latest = thermometer.latest().to_vec();
        if let [Temperature { quality: Quality::Bad(reason @ Reason::Refused { .. }), .. }, ..] =
            latest[..]
        {
            return Err(refused(&reason.to_string()));
        }
        for (name, temperature) in thermometer.names().iter().zip(latest) {
            probe.add_temperature(name.clone(), temperature);
        }
    }
    if let Some(digital) = profile.digital.filter(|digital| digital.inputs > 0) {
        let mut lines = digital_modules(address)?;
        let levels = loop {
            match lines.read(deadline) {
                Ok(found) => break found.levels,
                Err(Fault::Refused { code, .. }) => {
                    let code = u8::try_from(code).unwrap_or(0);
                    return Err(refused(&Reason::Refused { code }.to_string()));
                }
                Err(_) if Instant::now() < deadline => std::thread::sleep(Duration::from_millis(5)),
                Err(_) => return Err(no_answer()),
            }
        };
        probe.inputs = (0..digital.inputs).map(|line| levels >> line & 1 == 1).collect();
        facts.outputs_told = (digital.outputs > 0).then(|| lines.reports_outputs());
    }
    probe.facts = Some(Facts::Module(facts));
    Ok(probe)
}
