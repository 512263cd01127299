//! Corrects a control without a bus by the published wiring: its 15 outputs report the position of X, its 8 inputs
//! receive the correction. Here the lines are in memory; on a machine they are a `GpioPort` or a Modbus module.
//!
//!     cargo run -p volcomp-digital-io --example panel

use std::{
    error::Error,
    time::{Duration, Instant},
};

use volcomp_digital_io::{Coherence, DigitalAxis, DigitalController, Panel, Wiring};
use volcomp_port::Controller;
use volcomp_vocabulary::{AxisName, PerChannel};

fn main() -> Result<(), Box<dyn Error>> {
    let axis = DigitalAxis::published(AxisName::X);
    let panel = Panel::new(Wiring::published(), vec![axis]);
    let mut controller = DigitalController::new(
        panel.clone(),
        "lines",
        Wiring::published(),
        // The lines do not switch at the same instant, so two consecutive readings must agree.
        Coherence::TwoAgree,
        vec![axis],
    )?;
    for x_mm in [0.0, 312.4, 1000.0] {
        panel.shows(0, x_mm);
        let soon = Instant::now() + Duration::from_millis(100);
        let snapshot = controller.read(soon)?;
        let read_mm = snapshot.positions[0];
        // X is 60 µm/m too long.
        controller.apply(&PerChannel::leading([-6e-5 * read_mm]), soon)?;
        let taken_um = panel.correction().ok_or("the word of no correction")? * 1e3;
        println!("X {x_mm} mm, read as {read_mm:.3} mm: correction {taken_um:.0} µm");
        assert!((taken_um + 0.06 * x_mm).abs() <= 0.51);
    }
    // A correction above the range of the word is clamped and counted.
    let soon = Instant::now() + Duration::from_millis(100);
    controller.apply(&PerChannel::leading([0.5]), soon)?;
    println!("requested 500 µm:  {:.0} µm", panel.correction().map_or(f64::NAN, |mm| mm * 1e3));
    Ok(())
}
