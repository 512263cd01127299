//! LinuxCNC controls, by their bridge.

use std::{path::Path, time::Duration};

use volcomp_linuxcnc::{Key, PORT, look};
use volcomp_port::DeviceError;
use volcomp_vocabulary::Displacement;

use crate::{address::Address, probed::Probe};

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

/// The file with the key of the bridge, for programs that have it from the URL alone.
pub fn bridge_key_file(address: &Address) -> Option<&Path> {
    address.get("key_file").map(Path::new)
}

pub(crate) fn probe(address: &Address, at_most: Duration) -> Result<Probe, DeviceError> {
    let port = address.port.unwrap_or(PORT);
    let expected =
        "expected ?key_file=FILE with the key of the bridge, [VOLCOMP]KEY_FILE of its INI file";
    let Some(file) = bridge_key_file(address) else {
        return Err(address.wrong("found no key_file", expected));
    };
    let key = Key::read(file).map_err(|error| {
        address
            .wrong(format!("key_file: {error}"), expected)
            .caused_by(error)
    })?;
    let remote = allows_remote_bridge(address)?;
    let state = look(&address.host, port, remote, &key, at_most)?;
    let mut probe = Probe::of(&address.text);
    for axis in state.axes() {
        let at = Displacement::from_coordinate(axis.name.kind(), axis.position);
        probe.add_position(axis.name.to_string(), at);
    }
    Ok(probe)
}
