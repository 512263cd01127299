//! Corrects a control without a bus by the published scheme: its 15 outputs show the position of X, its 8 inputs take the
//! correction. The lines are in memory; on a machine they are a `GpioPort` or a Modbus module.
//!
//!     cargo run -p volcomp-digital-io --example panel

use std::{
    error::Error,
    sync::{Arc, Mutex, PoisonError},
    time::{Duration, Instant},
};

use volcomp_digital_io::{Coherence, DigitalAxis, DigitalController, Wiring};
use volcomp_port::{Controller, DigitalIo, Fault, InputLevels};
use volcomp_vocabulary::{AxisName, PerChannel};

/// The control behind the lines: where X stands (mm), and the levels of its inputs.
#[derive(Clone)]
struct Panel {
    wiring: Wiring,
    axis: DigitalAxis,
    inside: Arc<Mutex<(f64, u64)>>,
}

impl Panel {
    fn moves_to(&self, x_mm: f64) {
        self.inside.lock().unwrap_or_else(PoisonError::into_inner).0 = x_mm;
    }

    /// The correction that the control's inputs show, µm.
    fn taken_um(&self) -> Option<f64> {
        let (_, levels) = *self.inside.lock().unwrap_or_else(PoisonError::into_inner);
        let (word, _) = self.wiring.control_inputs(levels);
        Some(self.axis.correction.decode(word)? * 1e3)
    }
}

impl DigitalIo for Panel {
    fn device(&self) -> &'static str {
        "panel"
    }

    fn inputs(&self) -> u32 {
        15
    }

    fn outputs(&self) -> u32 {
        8
    }

    fn shortest_cycle(&self) -> Duration {
        Duration::from_micros(50)
    }

    fn read(&mut self, _deadline: Instant) -> Result<InputLevels, Fault> {
        let (x_mm, _) = *self.inside.lock().unwrap_or_else(PoisonError::into_inner);
        let word = self.axis.position.encode(x_mm);
        let word = word.ok_or(Fault::Protocol("X is outside the range of its word"))?;
        Ok(InputLevels::now(self.wiring.control_outputs(word, 0, true)))
    }

    fn write(&mut self, levels: u64, _deadline: Instant) -> Result<(), Fault> {
        self.inside.lock().unwrap_or_else(PoisonError::into_inner).1 = levels;
        Ok(())
    }

    fn confirmed(&self) -> Option<u64> {
        Some(self.inside.lock().unwrap_or_else(PoisonError::into_inner).1)
    }
}

fn main() -> Result<(), Box<dyn Error>> {
    let axis = DigitalAxis::published(AxisName::X);
    let panel = Panel {
        wiring: Wiring::published(),
        axis,
        inside: Arc::default(),
    };
    let mut controller = DigitalController::new(
        panel.clone(),
        "lines",
        Wiring::published(),
        // The lines do not switch at the same instant: two readings must agree.
        Coherence::TwoAgree,
        vec![axis],
    )?;
    for x_mm in [0.0, 312.4, 1000.0] {
        panel.moves_to(x_mm);
        let soon = Instant::now() + Duration::from_millis(100);
        let snapshot = controller.read(soon)?;
        let read_mm = snapshot.positions[0];
        // X is 60 µm a metre too long.
        controller.apply(&PerChannel::leading([-6e-5 * read_mm]), soon)?;
        let taken_um = panel.taken_um().ok_or("the word of no correction")?;
        println!("X {x_mm} mm, read as {read_mm:.3} mm: correction {taken_um:.0} µm");
        assert!((taken_um + 0.06 * x_mm).abs() <= 0.51);
    }
    // More than the word can say is held at its end, and counted.
    let soon = Instant::now() + Duration::from_millis(100);
    controller.apply(&PerChannel::leading([0.5]), soon)?;
    println!(
        "asked for 500 µm: {:.0} µm",
        panel.taken_um().unwrap_or(f64::NAN)
    );
    Ok(())
}
