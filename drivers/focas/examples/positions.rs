//! Reads type, axes, positions and state of a control.
//!
//!     cargo run -p volcomp-focas --example positions -- 192.0.2.10:8193
//!
//! Without an address the example uses a simulated control.

use std::{error::Error, time::Duration};

use volcomp_focas::{
    Client, PositionKind,
    simulator::{Options, Simulator, World},
};

fn main() -> Result<(), Box<dyn Error>> {
    let mut simulator = None;
    let address = if let Some(address) = std::env::args().nth(1) {
        address
    } else {
        let world = World::new(&['X', 'Y', 'Z', 'C']);
        let started = Simulator::start("127.0.0.1:0", Options::default(), world)?;
        simulator.insert(started).address().to_string()
    };
    let (host, port) =
        address.rsplit_once(':').ok_or("expected HOST:PORT, such as 192.0.2.10:8193")?;
    let mut client = Client::open(host, port.parse()?, Duration::from_secs(2))?;
    let system = client.system_info()?;
    println!("control {}, series {}", system.cnc_type, system.series);
    let names = client.axis_names()?;
    let positions = client.positions(PositionKind::Machine, names.len())?;
    assert_eq!(names.len(), positions.len());
    for (name, position) in names.iter().zip(positions) {
        // The position is in mm or deg: the control does not report whether an axis is rotary.
        println!("{name} {position:.3}");
    }
    let status = client.status()?;
    println!("emergency stop {}, alarm {}", status.emergency != 0, status.alarm != 0);
    Ok(())
}
