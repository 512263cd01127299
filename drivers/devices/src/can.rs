//! Machine controllers and thermometers on CAN interfaces of Linux.

use std::{
    collections::BTreeMap,
    time::{Duration, Instant},
};

use volcomp_can::{CanPort, CanSocket, Frame, Received, SHIPPED_DBC, SignalTable};
use volcomp_port::{DeviceError, Temperature};

use crate::{
    address::Address,
    facts::{BusFacts, Facts, SeenFrames},
    probed::Probe,
};

/// The signals of a URL: the DBC file it names, else the shipped one.
///
/// # Errors
/// A file that cannot be read or is no DBC.
pub fn signal_table(address: &Address) -> Result<SignalTable, DeviceError> {
    let text = match address.get("dbc") {
        None => SHIPPED_DBC.to_owned(),
        Some(path) => std::fs::read_to_string(path).map_err(|e| {
            let found = format!("{path}: {e}");
            address
                .wrong(found, "check the path of the DBC file")
                .caused_by(e)
        })?,
    };
    let file = address.get("dbc").unwrap_or("the shipped volcomp.dbc");
    SignalTable::parse_file(file, &text).map_err(|e| {
        address
            .wrong(e.to_string(), "correct the DBC file")
            .caused_by(e)
    })
}

pub(crate) fn probe(address: &Address, at_most: Duration) -> Result<Probe, DeviceError> {
    let table = signal_table(address)?;
    let mut socket = CanSocket::open(&address.host)?;
    let deadline = Instant::now() + at_most;
    let mut frames: BTreeMap<(bool, u32), (Frame, u64)> = BTreeMap::new();
    let mut errors = 0_u64;
    loop {
        match socket.receive(deadline) {
            Ok(Some(Received::Frame(frame, _))) => {
                let seen = frames
                    .entry((frame.extended, frame.id))
                    .or_insert((frame, 0));
                *seen = (frame, seen.1 + 1);
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
    let seen = frames
        .iter()
        .map(|(&(extended, id), &(_, count))| SeenFrames {
            id,
            extended,
            count,
        });
    probe.facts = Some(Facts::Bus(BusFacts {
        frames: seen.collect(),
        errors,
    }));
    Ok(probe)
}
