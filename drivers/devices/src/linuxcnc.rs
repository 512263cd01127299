//! LinuxCNC controls, by their bridge.

use std::time::Duration;

use volcomp_linuxcnc::{PORT, look};
use volcomp_port::DeviceError;
use volcomp_vocabulary::Displacement;

use crate::{
    address::Address,
    probed::{Probe, ProbedPosition},
};

/// Whether the URL lets the bridge be on another computer.
///
/// # Errors
/// Another value than `true` or `false`.
pub fn allows_remote_bridge(address: &Address) -> Result<bool, DeviceError> {
    match address.get("remote") {
        None | Some("false") => Ok(false),
        Some("true") => Ok(true),
        Some(other) => {
            Err(address.wrong(format!("found remote={other}"), "expected true or false"))
        }
    }
}

pub(crate) fn probe(address: &Address, at_most: Duration) -> Result<Probe, DeviceError> {
    let port = address.port.unwrap_or(PORT);
    let state = look(&address.host, port, allows_remote_bridge(address)?, at_most)?;
    let mut probe = Probe::of(&address.text);
    let positions = state.axes().map(|axis| ProbedPosition {
        name: axis.name.to_string(),
        at: Displacement::from_coordinate(axis.name.kind(), axis.position),
    });
    probe.positions = positions.collect();
    Ok(probe)
}
