//! Identifies a machine from a file of observations (default: the file in `examples/identification`), and prints its
//! errors with their uncertainties.

use std::{error::Error, path::PathBuf};

use volcomp_identify::{Observations, identify};

fn main() -> Result<(), Box<dyn Error>> {
    let shipped = || {
        PathBuf::from(env!("CARGO_MANIFEST_DIR"))
            .join("../../examples/identification/observations.toml")
    };
    let path = std::env::args().nth(1).map_or_else(shipped, PathBuf::from);
    let observations = Observations::read(&path)?;
    let found = identify(&observations, |_done, _of| {})?;
    for parameter in found.parameters.iter().filter(|p| p.determined) {
        println!(
            "{} = {:.3} ± {:.3} {}",
            parameter.name,
            parameter.value,
            parameter.uncertainty.unwrap_or_default(),
            parameter.unit
        );
    }
    for warning in &found.warnings {
        println!("note: {warning}");
    }
    println!(
        "left of fitted rows {:.2} µm, of rows left out {:.2} µm, of judged rows {:.2} µm",
        found.residual.rms_um,
        found.left_out.map_or(f64::NAN, |left| left.figures.rms_um),
        found.judged.map_or(f64::NAN, |figures| figures.rms_um)
    );
    println!("{} of {} unknowns are determined", found.rank, found.parameters.len());
    Ok(())
}
