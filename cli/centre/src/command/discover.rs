//! The search of the network from the command line.

use std::io::{IsTerminal, Write};

use clap::Args;

use super::{CommandError, print, print_json};
use crate::discover::{FASTEST_PER_SECOND, Kind, PER_SECOND, Search, Subnet, table};

/// What is searched, and how.
#[derive(Args)]
pub(super) struct DiscoverArguments {
    /// Subnets or addresses, such as 192.0.2.0/24
    #[arg(required = true)]
    subnets: Vec<Subnet>,
    /// Search ranges that are not private, too: they belong to you
    #[arg(long)]
    yes_these_are_mine: bool,
    /// New connections a second over all addresses, 1 to 1000
    #[arg(long, default_value_t = PER_SECOND, value_parser = rate)]
    rate: f64,
    /// Try this port for FOCAS instead of 8193; may be given several times
    #[arg(long, value_name = "PORT")]
    focas_port: Vec<u16>,
    /// Try this port for OPC UA instead of 4840
    #[arg(long, value_name = "PORT")]
    opc_ua_port: Vec<u16>,
    /// Try this port for Modbus TCP instead of 502
    #[arg(long, value_name = "PORT")]
    modbus_port: Vec<u16>,
    /// Try this port for gateways instead of 8080 and 8443
    #[arg(long, value_name = "PORT")]
    gateway_port: Vec<u16>,
    /// Print one JSON document
    #[arg(long)]
    json: bool,
}

fn rate(text: &str) -> Result<f64, String> {
    let found: f64 = text.parse().map_err(|_| "expected a number".to_owned())?;
    if (1.0..=FASTEST_PER_SECOND).contains(&found) {
        Ok(found)
    } else {
        Err(format!("expected 1 to {FASTEST_PER_SECOND}"))
    }
}

pub(super) fn act(arguments: &DiscoverArguments) -> Result<(), CommandError> {
    for subnet in &arguments.subnets {
        let checked = subnet.check(arguments.yes_these_are_mine);
        checked.map_err(|e| CommandError::Wrong(e.to_string()))?;
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
    let runtime = tokio::runtime::Builder::new_multi_thread()
        .worker_threads(1)
        .enable_all()
        .build()?;
    let devices = runtime.block_on(search.run(|done| {
        if shows {
            // Nobody may be reading.
            let _ = write!(std::io::stderr(), "\r{done} of {of} ");
        }
    }));
    if shows {
        eprintln!();
    }
    if arguments.json {
        print_json(&devices)
    } else {
        print(&table(&devices))
    }
}
