//! Creates a machine file from a calibration file and the measurement files that it names:
//!
//! ```text
//! cargo run -p volcomp-calibrate --example calibrate -- calibration.toml
//! ```
//!
//! Without an argument it uses the file in the repository's folder `examples/calibration`.

use std::path::{Path, PathBuf};

use volcomp_calibrate::{CalibrateError, CalibrationFile, Quality, calibrate};
use volcomp_vocabulary::Direction;

fn main() -> Result<(), CalibrateError> {
    let shipped =
        Path::new(env!("CARGO_MANIFEST_DIR")).join("../../examples/calibration/calibration.toml");
    let path = std::env::args().nth(1).map_or(shipped, PathBuf::from);

    // Reading reports an error in any of the files, with file, line and key.
    let file = CalibrationFile::read(&path)?;
    let calibration = calibrate(&file, |done, of| eprintln!("{done} of {of} errors fitted"))?;

    for curve in &calibration.curves {
        let direction = curve.direction.map_or("both directions", Direction::name);
        let (error, kind) = (curve.error, curve.kind);
        // Lengths and angles are different types, so µm cannot be mistaken for µrad.
        match &curve.quality {
            Quality::Length(q) => {
                println!("{error} {direction}: {kind}, residual {:.2} rms", q.residual_rms);
            }
            Quality::Angle(q) => {
                println!("{error} {direction}: {kind}, residual {:.2} rms", q.residual_rms);
            }
        }
    }
    for (error, value) in &calibration.squareness {
        println!("{error}: {value:.2}");
    }
    for warning in &calibration.warnings {
        println!("warning: {warning}");
    }
    println!("\n{}", calibration.machine.to_toml());
    Ok(())
}
