//! The correction of a five-axis machine with both rotary axes on the table: the displacements to be added to a
//! command, so that the tool has its commanded position and direction.
//!
//! ```text
//! cargo run -p volcomp-kinematics --example five_axis
//! ```

use volcomp_kinematics::{
    Chain, CorrectionOptions, Form, GivenErrors, State, Structure, correct, volumetric_error,
};
use volcomp_vocabulary::AxisName;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    // A trunnion table: A carries C, and C carries the workpiece. X, Y and Z carry the tool.
    let structure: Structure = "w C' A' b X Y Z t".parse()?;
    let mut chain = Chain::new(structure);
    chain.set_point(AxisName::A, [0.0, 0.0, 50.0])?;
    chain.set_tool([0.0, 0.0, 100.0], [0.0, 0.0, 1.0])?;

    // The line of C is displaced by 15 µm in X and tilted by 30 µrad about Y; Y is 20 µrad out of square.
    let mut errors = GivenErrors::default();
    for (name, value) in [("EX0C", 15.0), ("EB0C", 30.0), ("EC0Y", 20.0)] {
        errors.set(&chain, name.parse()?, value)?;
    }

    let state = State::new(
        &chain,
        [
            (AxisName::X, 100.0),
            (AxisName::Y, 50.0),
            (AxisName::Z, -20.0),
            (AxisName::A, -40_f64.to_radians()),
            (AxisName::C, 30_f64.to_radians()),
        ],
    )?;
    let error = volumetric_error(&chain, &errors, &state, Form::Exact);
    let [x, y, z]: [f64; 3] = (error.position_mm * 1e3).into();
    println!("position error: {x:.2} {y:.2} {z:.2} µm in workpiece axes");

    let correction = correct(&chain, &errors, &state, &CorrectionOptions::default());
    for (joint, delta) in chain.joints().iter().zip(&correction.delta) {
        let unit = if joint.name.is_rotary() { "µrad" } else { "µm" };
        let micro = if joint.name.is_rotary() { delta * 1e6 } else { delta * 1e3 };
        println!("add to {}: {micro:8.2} {unit}", joint.name);
    }
    println!("left over, µm: {:.6}", correction.residual_mm.norm() * 1e3);
    Ok(())
}
