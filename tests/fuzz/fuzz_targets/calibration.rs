#![no_main]
//! Calibration files with their measurement file: no panic on any text, also when an accepted one is calibrated.

use libfuzzer_sys::fuzz_target;
use volcomp_calibrate::{CalibrationFile, calibrate};

const MACHINE: &str = "structure = \"w b X Y C t\"
axes.X.travel = [0.0, 500.0]
axes.Y.travel = [0.0, 400.0]
axes.C.travel = [-180.0, 180.0]
";

// The input is the calibration file and, after a line `===`, the table `m.csv`.
fuzz_target!(|text: &str| {
    let (keys, rows) = text.split_once("\n===\n").unwrap_or((text, ""));
    let folder = std::env::temp_dir().join(format!("volcomp-fuzz-{}", std::process::id()));
    let write = |name: &str, text: &str| std::fs::write(folder.join(name), text);
    if std::fs::create_dir_all(&folder).is_err()
        || write("machine.toml", MACHINE).is_err()
        || write("m.csv", rows).is_err()
        || write("c.toml", keys).is_err()
    {
        return;
    }
    if let Ok(mut file) = CalibrationFile::read(&folder.join("c.toml")) {
        if let Some(observations) = &mut file.observations {
            observations.folds = 0;
        }
        let _ = calibrate(&file, |_, _| {});
    }
});
