//! Measures a known machine with a noisy laser in the virtual shop, calibrates it, and compares the result with the truth.

use std::{error::Error, fs, path::Path};

use volcomp_calibrate::{CalibrationFile, calibrate};
use volcomp_kinematics::Form;
use volcomp_model::{Machine, Temperatures};
use volcomp_shop::Shop;
use volcomp_vocabulary::AxisName;

fn main() -> Result<(), Box<dyn Error>> {
    // Truth machine, instrument and lines of the repository's example.
    let examples = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../examples/calibration");
    let shop = Shop::read(&examples.join("shop.toml"))?;

    // The files of the laser, in a separate folder.
    let folder = std::env::temp_dir().join(format!("volcomp-shop-{}", std::process::id()));
    fs::create_dir_all(&folder)?;
    for (name, text) in shop.files(|_done, _of| {})? {
        fs::write(folder.join(name), text)?;
    }

    // The calibration reads only these files, not the truth.
    let found = calibrate(&CalibrationFile::read(&folder.join("calibration.toml"))?, |_, _| {})?;
    fs::remove_dir_all(&folder)?;

    // Noise, drift, and the position of the workpiece remain, which a calibration cannot determine.
    let none = Temperatures::new();
    let error_um = |machine: &Machine, at: &[(AxisName, f64)]| {
        let state = machine.state(at)?;
        let error = machine.error_at(&state, Form::Exact, &none).position_mm * 1e3;
        Ok::<_, volcomp_model::ModelError>(error)
    };
    for x in [0.0, 200.0, 400.0, 600.0] {
        let at = [(AxisName::X, x), (AxisName::Y, 200.0), (AxisName::Z, -200.0)];
        let (truth, model) = (error_um(&shop.truth, &at)?, error_um(&found.machine, &at)?);
        println!("X {x:5} mm: error {:6.2} µm along X, the model says {:6.2} µm", truth.x, model.x);
    }
    Ok(())
}
