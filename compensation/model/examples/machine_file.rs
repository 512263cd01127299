//! Reads a machine file. Prints the error of the tool tip at a position and the correction of this error: with all
//! axes, and with the axes that a controller writes.
//!
//! `cargo run -p volcomp-model --example machine_file -- examples/trunnion.toml`

use std::{env, path::PathBuf, process::ExitCode};

use volcomp_model::{
    Machine, ModelError, Temperatures, Tolerance,
    kinematics::{CorrectionOptions, Form},
    vocabulary::{AxisKind, AxisName, Displacement},
};

fn main() -> ExitCode {
    let shipped = concat!(env!("CARGO_MANIFEST_DIR"), "/../../examples/trunnion.toml");
    let file = env::args_os().nth(1).map_or(shipped.into(), PathBuf::from);
    match Machine::read(&file).and_then(|machine| answer(&machine)) {
        Ok(()) => ExitCode::SUCCESS,
        // The message has file, line, key, and found and expected value.
        Err(error) => {
            eprintln!("error: {error}");
            ExitCode::from(2)
        }
    }
}

fn answer(machine: &Machine) -> Result<(), ModelError> {
    println!("{} ({})", machine.name, machine.chain().structure());

    // A command at a quarter of every travel: coordinates in mm and deg, as a control displays them.
    let quarter = |[low, high]: [f64; 2]| low + 0.25 * (high - low);
    let axes = machine.axes().iter();
    let command: Vec<(AxisName, f64)> = axes.map(|a| (a.name, quarter(a.travel))).collect();
    let state = machine.state(&command)?;
    for (axis, coordinate) in &command {
        print!("  {axis} {coordinate}");
    }
    println!();

    // The error is actual minus ideal, in workpiece axes. In memory lengths are in mm and angles in rad.
    let steady = Temperatures::new();
    let error = machine.error_at(&state, Form::Exact, &steady);
    let [x, y, z] = (error.position_mm * 1e3).into();
    println!("error of the tip: {x:.2} {y:.2} {z:.2} µm");
    for name in machine.outside_range(&state) {
        println!("  {name} is evaluated outside its measured range");
    }

    // The correction is added to the command: on the axes of the machine file's key `correct` (default: all), and on the linear axes
    // alone. Errors that the axes cannot correct are residual.
    let linear = command.iter().map(|(axis, _)| *axis);
    let linear = linear.filter(|axis| axis.kind() == AxisKind::Linear);
    let linear_only = CorrectionOptions::of(&linear.collect::<Vec<_>>());
    for (text, options) in [
        ("as the machine file says", machine.correction_options()),
        ("linear axes alone", linear_only),
    ] {
        let found = machine.correction_at(&state, &steady, &options);
        print!("correction, {text}:");
        for (joint, delta) in machine.chain().joints().iter().zip(&found.delta) {
            print!("  {} {:.2}", joint.name, Displacement::new(joint.kind, *delta));
        }
        println!(
            "; left: {:.3} µm, tool axis {:.1} µrad",
            found.residual_mm.norm() * 1e3,
            found.residual_axis.norm() * 1e6
        );
    }

    // A controller evaluates the compiled form, which needs neither allocation nor the machine file.
    let compiled = machine.compile(Tolerance::default())?;
    println!(
        "compiled: {} pieces of cubics, {} bytes, within {} nm of the curves",
        compiled.pieces(),
        compiled.bytes(),
        compiled.tolerance().linear_mm * 1e6
    );
    Ok(())
}
