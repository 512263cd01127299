use std::io::{IsTerminal, Write};

use super::{arguments::DiscoverArguments, print, print_json};
use crate::{
    Error,
    discover::{Kind, Search, table},
};

pub(super) fn act(arguments: &DiscoverArguments) -> Result<(), Error> {
    for subnet in &arguments.subnets {
        let checked = subnet.check(arguments.yes_these_are_mine);
        checked.map_err(|e| Error::Wrong(e.to_string()))?;
    }
    let mut search = Search::new(arguments.subnets.clone());
    search.per_second = arguments.rate;
    let stated = [
        (Kind::Focas, &arguments.focas_port),
        (Kind::OpcUa, &arguments.opc_ua_port),
        (Kind::Modbus, &arguments.modbus_port),
        (Kind::Gateway, &arguments.gateway_port),
    ];
    for (kind, ports) in stated {
        if !ports.is_empty() {
            search.ports.retain(|(known, _)| *known != kind);
            search.ports.extend(ports.iter().map(|port| (kind, *port)));
        }
    }
    let shows = std::io::stderr().is_terminal();
    let of = search.addresses();
    if shows {
        let seconds = search.connections() as f64 / arguments.rate;
        eprintln!("{of} addresses, about {seconds:.0} s");
    }
    let runtime =
        tokio::runtime::Builder::new_multi_thread().worker_threads(1).enable_all().build()?;
    let devices = runtime.block_on(search.run(|done| {
        if shows {
            // Standard error may be closed.
            let _ = write!(std::io::stderr(), "\r{done} of {of} ");
        }
    }));
    if shows {
        eprintln!();
    }
    if arguments.json { print_json(&devices) } else { print(&table(&devices)) }
}
