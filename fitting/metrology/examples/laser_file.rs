//! Writes a Renishaw `.rtl` file, reads it back and prints its content.

use volcomp_metrology::{
    DeviationUnit, Measurement, MetrologyError, Reading, RenishawKind, parse_renishaw,
    write_renishaw,
};
use volcomp_vocabulary::Direction;

fn main() -> Result<(), MetrologyError> {
    // Two runs in both directions over three targets; in the backward direction with 2 µm of lost motion.
    let mut measurement = Measurement { unit: Some(DeviationUnit::Um), ..Measurement::default() };
    measurement.metadata.machine = Some("mill-1".to_owned());
    measurement.metadata.axis = Some("X".to_owned());
    for run in 1..=2 {
        for direction in Direction::BOTH {
            let mut targets = [0.0, 250.0, 500.0];
            if direction == Direction::Negative {
                targets.reverse();
            }
            let lost_um = if direction == Direction::Negative { -2.0 } else { 0.0 };
            let readings = targets.map(|target| Reading {
                target,
                run,
                direction,
                deviation: 0.01 * target + 0.1 * f64::from(run) + lost_um,
            });
            measurement.readings.extend(readings);
        }
    }
    let text = write_renishaw(&measurement);
    println!("{}", text.lines().take(12).collect::<Vec<_>>().join("\n"));
    println!("…\n");

    // `RenishawKind::Angular` reads `.rta` files, whose deviations are in µrad.
    let read = parse_renishaw(text.as_bytes(), "x-axis.rtl", RenishawKind::Linear)?;
    println!("axis {}", read.metadata.axis.as_deref().unwrap_or("not stated"));
    for target in read.targets() {
        for direction in Direction::BOTH {
            if let Some(mean_um) = read.mean_at(target, direction) {
                println!("at {target} mm {}: mean {mean_um:.2} µm", direction.name());
            }
        }
    }
    // A broken file is rejected; the message names the line.
    let broken = text.replace("500.000000", "5oo.000000");
    match parse_renishaw(broken.as_bytes(), "broken.rtl", RenishawKind::Linear) {
        Err(error) => println!("refused: {error}"),
        Ok(_) => println!("the damaged number was not found"),
    }
    Ok(())
}
