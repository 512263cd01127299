//! Controls and thermometers on CAN interfaces of Linux.

use std::{
    collections::BTreeMap,
    path::Path,
    time::{Duration, Instant},
};

use rustix::net::{AddressFamily, SocketType, netdevice::name_to_index, socket};
use volcomp_can::{
    BridgeConfig, CanController, CanPort, CanSocket, CanThermometer, Frame, Received, SHIPPED_DBC,
    SignalTable, temperature_names,
};
use volcomp_document::read_text;
use volcomp_port::{Controller, Description, DeviceError, Temperature};

use crate::{
    address::Address,
    driver::{ControllerDevice, Driver, REPORTED_WITHIN, Settings, ThermometerDevice, USUAL},
    first_config::{FirstConfig, FirstMachine, barrier, includes_correction},
    keys::{ControllerConfig, ThermometerConfig},
    probe::{BusFacts, Facts, Probe, SeenFrames},
};

pub(crate) const DRIVER: Driver = Driver {
    name: "a bridge on CAN (can://)",
    writer_keys: &["includes_correction", "unwatched", "barrier"],
    devices: |address| [interface(&address.host)].into(),
    controller: |address, own| Ok(Box::new(bridge(&address, own)?)),
    thermometer,
    example: "can://can0",
    first,
    probe,
    ..USUAL
};

fn first(address: &Address, machine: &FirstMachine<'_>) -> FirstConfig {
    let mut settings = vec![includes_correction(false)];
    // An invalid DBC file is reported elsewhere, when the configuration is checked.
    let has_barrier = signal_table(address).is_ok_and(|table| {
        let config = BridgeConfig {
            table,
            channel: String::new(),
            axes: machine.axes.to_vec(),
            reads: Vec::new(),
            includes_correction: false,
        };
        config.describe(&address.text).is_ok_and(|own| own.barrier)
    });
    if has_barrier {
        settings.extend(barrier(1.0));
    }
    FirstConfig { cycle_ms: 4.0, settings, ..FirstConfig::default() }
}

fn thermometer(
    address: Address,
    own: &ThermometerConfig,
) -> Result<ThermometerDevice, DeviceError> {
    let table = signal_table(&address)?;
    let known = temperature_names(&table, &own.url)?;
    if let Some(name) = own.names.iter().find(|name| !known.contains(name)) {
        let expected = format!("expected some of {known:?}, the sensors of this device");
        return Err(address.wrong(format!("names: found {name:?}"), expected));
    }
    let names = match &own.names[..] {
        [] => known,
        names => names.to_vec(),
    };
    let (interface, selected) = (address.host.clone(), names.clone());
    Ok(ThermometerDevice {
        address,
        names,
        open: Box::new(move || {
            let socket = CanSocket::open(&interface)?;
            Ok(Box::new(CanThermometer::new(socket, &table, &selected)?))
        }),
    })
}

struct Bridge {
    interface: String,
    config: BridgeConfig,
}

fn bridge(address: &Address, config: &ControllerConfig) -> Result<Bridge, DeviceError> {
    let bridge = Bridge {
        interface: address.host.clone(),
        config: BridgeConfig {
            table: signal_table(address)?,
            channel: config.channel_or("can"),
            axes: config.axes.clone(),
            reads: config.reads.clone(),
            includes_correction: config.includes_correction,
        },
    };
    let has_barrier = bridge.describe()?.barrier;
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

impl ControllerDevice for Bridge {
    fn describe(&self) -> Result<Description, DeviceError> {
        self.config.describe(&CanSocket::device_of(&self.interface))
    }

    fn open(&self) -> Result<Box<dyn Controller>, DeviceError> {
        let socket = CanSocket::open(&self.interface)?;
        Ok(Box::new(CanController::new(socket, &self.config)?))
    }

    fn settings(&self) -> Settings {
        Settings {
            shown_within: Some(REPORTED_WITHIN),
            position_steps: self.config.position_steps(),
            ..Settings::default()
        }
    }
}

/// Name of a network interface by its kernel index, because one interface may have several names. An unknown interface
/// keeps its name.
fn interface(name: &str) -> String {
    let number = socket(AddressFamily::INET, SocketType::DGRAM, None)
        .and_then(|socket| name_to_index(socket, name));
    number
        .map_or_else(|_| format!("interface {name}"), |number| format!("interface number {number}"))
}

/// Signal table of the DBC file that a URL names. Without the key `dbc`, the shipped file is used. Errors: the file
/// cannot be read or is not a DBC file.
fn signal_table(address: &Address) -> Result<SignalTable, DeviceError> {
    let text = match address.get("dbc") {
        None => SHIPPED_DBC.to_owned(),
        Some(path) => read_text(Path::new(path)).map_err(|e| {
            address.wrong(e.to_string(), "check the path of the DBC file").caused_by(e)
        })?,
    };
    let file = address.get("dbc").unwrap_or("the shipped volcomp.dbc");
    SignalTable::parse_file(file, &text)
        .map_err(|e| address.wrong(e.to_string(), "correct the DBC file").caused_by(e))
}

fn probe(address: &Address, at_most: Duration) -> Result<Probe, DeviceError> {
    let table = signal_table(address)?;
    let mut socket = CanSocket::open(&address.host)?;
    let deadline = Instant::now() + at_most;
    let mut frames: BTreeMap<(bool, u32), (Frame, u64)> = BTreeMap::new();
    let mut errors = 0_u64;
    loop {
        match socket.receive(deadline) {
            Ok(Some(Received::Frame(frame, _))) => {
                let count = frames.entry((frame.extended, frame.id)).or_insert((frame, 0));
                *count = (frame, count.1 + 1);
            }
            Ok(Some(_)) => errors += 1,
            Ok(None) => break,
            Err(fault) => {
                return Err(address.failed(fault, "bring the interface up: ip link set … up"));
            }
        }
    }
    if frames.is_empty() {
        let what = format!("no frame came within {} ms", at_most.as_millis());
        return Err(address.no_answer(what, "check the wire, the bit rate and the other side"));
    }
    let mut probe = Probe::of(&address.text);
    for (frame, _) in frames.values() {
        let Some(message) = table.message_of(frame).map(|index| &table.messages[index]) else {
            continue;
        };
        if !message.is_whole(frame.data()) {
            errors += 1;
            continue;
        }
        for signal in &message.signals {
            if let Some((name, at)) = signal.position(frame.data()) {
                probe.add_position(name.to_string(), at);
            } else if let Some((name, degc)) = signal.temperature(frame.data()) {
                probe.add_temperature(name, Temperature::good(degc, Instant::now()));
            }
        }
    }
    let count =
        frames.iter().map(|(&(extended, id), &(_, count))| SeenFrames { id, extended, count });
    probe.facts = Some(Facts::Bus(BusFacts { frames: count.collect(), errors }));
    Ok(probe)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_dbc_file_of_a_terabyte_is_not_read_to_its_end() {
        let folder = tempfile::tempdir().expect("writable");
        let path = folder.path().join("long.dbc");
        let file = std::fs::File::create(&path).expect("writable");
        file.set_len(1 << 40).expect("a sparse file");
        let address = Address::parse(&format!("can://can0?dbc={}", path.display()));
        let error = signal_table(&address.expect("a URL")).expect_err("too long").to_string();
        assert!(error.contains("long.dbc: found more than 256 MiB"), "{error}");
    }
}
