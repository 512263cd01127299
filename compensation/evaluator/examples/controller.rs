//! The smallest program for the cycle of a controller: a compiled machine from bytes, evaluated without allocation.
//!
//!     cargo run -p volcomp-evaluator --example controller

use volcomp_evaluator::kinematics::{Chain, ErrorMotion, State};
use volcomp_evaluator::vocabulary::{AxisKind, AxisName, Displacement};
use volcomp_evaluator::{AxisParts, CompiledMachine, MachineParts, Tolerance};

/// Offline: compiles a machine with 10 µm positioning deviation and 20 µrad yaw over 1 m of X, and a squareness of Y of 30 µrad.
fn at_a_desk() -> Result<Vec<u8>, Box<dyn std::error::Error>> {
    let chain = Chain::new("w X' b Y Z t".parse()?);
    let travel = [0.0, 1000.0].map(|end| Displacement::from_coordinate(AxisKind::Linear, end));
    let x = AxisParts::new(travel, |q, _| {
        ErrorMotion::from_um_urad([0.01 * q, 0.0, 0.0, 0.0, 0.0, 0.02 * q])
    });
    let parts = MachineParts::new(&chain)
        .axis(AxisName::X, x)?
        .axis(AxisName::Y, AxisParts::without_errors(travel))?
        .axis(AxisName::Z, AxisParts::without_errors(travel))?
        .location("EC0Y".parse()?, Displacement::from_micro(AxisKind::Rotary, 30.0))?;
    Ok(CompiledMachine::new(parts, Tolerance::default())?.to_blob())
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let machine = CompiledMachine::from_blob(&at_a_desk()?)?;
    // In the cycle: positions in mm to corrections in mm.
    for x in [0.0, 250.0, 500.0, 1000.0] {
        let state = State::new(
            machine.chain(),
            [(AxisName::X, x), (AxisName::Y, 400.0), (AxisName::Z, 100.0)],
        )?;
        let correction = machine.first_order(&state).delta;
        let um: Vec<String> = [AxisName::X, AxisName::Y, AxisName::Z]
            .into_iter()
            .filter_map(|axis| machine.chain().of_axis(axis, &correction))
            .map(|mm| format!("{:7.2}", mm * 1e3))
            .collect();
        println!("at X {x:6.1}: add {} µm", um.join(" "));
    }
    Ok(())
}
