//! Corrects a simulated machine in the same program, and prints its error without and with correction.

use std::{error::Error, sync::Arc, time::Duration};

use runtime::machine::Machine;
use runtime::port::{Axis, Clock, Controller, simulated};
use runtime::vocabulary::{AxisName, Displacement, Mm, PerChannel, Um};
use volcomp_runtime as runtime;

const MACHINE: &str = "structure = \"w X' Y' b Z t\"
axes = { X.travel = [0, 800], Y.travel = [0, 500], Z.travel = [0, 400] }
errors = { EXX = { poly = [0, 0.02] }, EYX = 12.0, EZY = { poly = [0, 0, 1e-4] } }";
const PERIOD: Duration = Duration::from_millis(4);

/// A control with three axes at one position.
fn control(clock: &Clock) -> impl Controller + 'static {
    let axis = |name| Axis {
        name,
        includes_correction: false,
        resolution: Displacement::Length(Mm(0.001)),
        largest: None,
    };
    let there = simulated::Move {
        to: PerChannel([600.0, 400.0, 100.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]),
        feed_per_s: 200.0,
        dwell: Duration::from_secs(60),
    };
    let machine = simulated::Machine {
        axes: [AxisName::X, AxisName::Y, AxisName::Z].map(axis).to_vec(),
        program: vec![there],
        acceleration_per_s2: 1000.0,
        sensors: Vec::new(),
        truth: Arc::new(|_, _| PerChannel::ZERO),
        clock: clock.clone(),
    };
    machine.start().0
}

pub(crate) fn main() -> Result<(), Box<dyn Error>> {
    let (clock, settings) = (Clock::manual(), runtime::PathSettings::default());
    let guard = runtime::GuardSettings::new(runtime::AxisSettings::new(Um(100.0), Um(500.0)));
    let model = runtime::Model::new(&Machine::parse(MACHINE, "example")?, guard.fading)?;
    let control = control(&clock);
    let described = control.description().clone();
    let plan = runtime::PathPlan::new(described, &model, &guard, &settings, PERIOD)?;
    let paths = vec![runtime::ControlPath::new(Box::new(control), &plan)?];
    let sensors = runtime::Sensors::new(Vec::new(), guard.temperatures);
    let cycle = runtime::Cycle::new(Box::new(model), paths, guard.hand_back, sensors, PERIOD);
    let mut cycle = cycle?.with_start(clock.start());
    let mut input = runtime::CycleInput::default();
    for number in 0..2500 {
        clock.advance(PERIOD);
        input.request = (number == 1).then_some(runtime::guard::Request::Arm);
        cycle.run(clock.now(), &input, &mut || Duration::ZERO);
    }
    let um = |error: runtime::ToolError| error.position_mm.map(|mm| (mm * 1e4).round() / 10.0);
    let [without, with] = [cycle.report().error, cycle.report().residual].map(|e| e.map(um));
    println!("without correction {without:?} µm, with correction {with:?} µm");
    Ok(())
}
