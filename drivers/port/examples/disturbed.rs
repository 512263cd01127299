//! Corrects a simulated machine over a connection that loses responses and breaks. A correcting program must handle
//! these faults.
//!
//! ```text
//! cargo run -p volcomp-port --example disturbed
//! ```

use std::{
    sync::Arc,
    time::{Duration, Instant},
};

use volcomp_port::{
    Axis, Clock, Controller, Fault, Thermometer,
    inject::{Faults, Faulty},
    simulated::{Machine, Move, Warming},
    vocabulary::{AxisName, Displacement, Mm, PerChannel},
};

fn main() {
    let axis = |name| Axis {
        name,
        includes_correction: false,
        resolution: Displacement::Length(Mm(0.001)),
        largest: None,
    };
    let moves = [PerChannel::leading([500.0, 300.0]), PerChannel::ZERO];
    let clock = Clock::manual();
    let machine = Machine {
        axes: [AxisName::X, AxisName::Y].map(axis).to_vec(),
        program: moves
            .map(|to| Move { to, feed_per_s: 100.0, dwell: Duration::from_secs(1) })
            .to_vec(),
        acceleration_per_s2: 1000.0,
        sensors: vec![Warming {
            name: "bed".to_owned(),
            start_degc: 20.0,
            rise_k: 3.0,
            time_constant_s: 600.0,
        }],
        // X moves 20 µm too far per metre.
        truth: Arc::new(|at, _| PerChannel::leading([2e-5 * at[0]])),
        clock: clock.clone(),
    };
    let (controller, mut thermometer, _) = machine.start();
    let faults = Faults { drop: 0.05, disconnect: 0.01, calls: 20, ..Faults::default() };
    // The same seed gives the same faults.
    let mut controller = Faulty::new(controller, faults, 7);
    let (mut answered, mut missed) = (0_u32, 0_u32);
    let mut worst_um = 0.0_f64;
    for _ in 0..2000 {
        clock.advance(Duration::from_millis(4));
        let soon = Instant::now() + Duration::from_millis(1);
        match correct(&mut controller, soon) {
            Ok(()) => {
                answered += 1;
                let [residual, _] = controller.device.residual_and_error();
                worst_um = worst_um.max(residual[0].abs() * 1e3);
            }
            // No reading: the applied correction stays until the next response.
            Err(fault) => {
                missed += 1;
                assert!(matches!(fault, Fault::TimedOut | Fault::NotConnected));
            }
        }
    }
    println!("{answered} cycles answered, {missed} missed");
    println!("worst residual of X in an answered cycle: {worst_um:.2} µm");
    assert!(answered > 1000 && missed > 20);
    // Half of an output step, plus the change during the travel between read and write.
    assert!(worst_um < 1.0, "{worst_um}");
    let names = thermometer.names().to_vec();
    for (name, found) in names.iter().zip(thermometer.latest()) {
        println!("{name}: {:.2} °C", found.degc.unwrap_or(f64::NAN));
    }
}

/// One cycle: reads the position and applies the correction for it.
fn correct(controller: &mut impl Controller, deadline: Instant) -> Result<(), Fault> {
    let snapshot = controller.read(deadline)?;
    let correction = PerChannel::leading([-2e-5 * snapshot.positions[0]]);
    controller.apply(&correction, deadline)
}
