//! Shifts an axis by a few µm, reads the shift back, and removes it.
//!
//!     cargo run -p volcomp-focas --example shift -- 192.0.2.10:8193 X 5
//!
//! Without arguments a simulated control is shifted. On a real control, switch the drives off and first check in its
//! manual from which words the control takes shifts; R100 and the heartbeat at R120 are examples.

use std::{
    error::Error,
    time::{Duration, Instant},
};

use volcomp_focas::{
    FocasConfig, FocasController,
    simulator::{Options, Simulator, World},
};
use volcomp_port::Controller;
use volcomp_vocabulary::{AxisName, Mm, PerChannel, Um};

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let mut simulator = None;
    let (address, axis, shift) = match &arguments[..] {
        [] => {
            let world = World::new(&['X', 'Y', 'Z']);
            let started = Simulator::start("127.0.0.1:0", Options::default(), world)?;
            let address = simulator.insert(started).address().to_string();
            (address, AxisName::X, Um(5.0))
        }
        [address, axis, um] => (address.clone(), axis.parse()?, Um(um.parse()?)),
        _ => return Err("expected HOST:PORT AXIS UM, or nothing".into()),
    };
    if axis.is_rotary() {
        return Err("expected a linear axis: the shift is a length".into());
    }
    let (host, port) = address.rsplit_once(':').ok_or("expected HOST:PORT")?;
    let mut config = FocasConfig::new(host, &[axis]);
    config.port = port.parse()?;

    let mut controller = FocasController::new(config)?;
    controller.wait(Duration::from_secs(5))?;
    // The heartbeat must be read before the first write.
    controller.read(soon())?;
    for shift in [shift, Um(0.0)] {
        // Corrections are in mm and rad, in the order of the configuration's axes.
        controller.apply(&PerChannel::leading([shift.to_mm().0]), soon())?;
        let applied = controller.read(soon())?.applied.unwrap_or_default();
        let found = Mm(applied[0]).to_um();
        println!("{axis} is shifted by {found:.1}");
        // The shift is rounded to counts of 1 µm.
        assert!((found - shift).abs() <= Um(0.5 + 1e-9));
    }
    Ok(())
}

fn soon() -> Instant {
    Instant::now() + Duration::from_millis(100)
}
