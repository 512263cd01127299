//! SINUMERIK controls, reached over OPC UA.

use std::time::Duration;

use volcomp_port::DeviceError;
use volcomp_sinumerik::{Nodes, Server, look};
use volcomp_vocabulary::{AxisKind, AxisName, Displacement};

use crate::{address::Address, probed::Probe};

pub(crate) fn probe(address: &Address, at_most: Duration) -> Result<Probe, DeviceError> {
    let mut server = Server::new(&*address.text);
    server.time_out = at_most;
    let found = look(&server, &Nodes::default()).map_err(|error| error.of(&*address.text))?;
    let mut probe = Probe::of(&address.text);
    for (name, at) in found {
        // The letter with which a name begins says whether the axis turns, as everywhere.
        let known = name.chars().next().and_then(AxisName::from_letter);
        let kind = known.map_or(AxisKind::Linear, AxisName::kind);
        probe.add_position(name, Displacement::from_coordinate(kind, at));
    }
    Ok(probe)
}
