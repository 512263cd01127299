#![no_main]
//! Observation files with their row files: no panic on any text, also when an accepted one is identified.

use libfuzzer_sys::fuzz_target;
use volcomp_identify::{Observations, identify};

const MACHINE: &str = "structure = \"w b X Y C t\"
axes.X.travel = [0.0, 500.0]
axes.Y.travel = [0.0, 400.0]
axes.C.travel = [-180.0, 180.0]
";

// The input is the observation file and, after a line `===`, the table that serves as every row file.
fuzz_target!(|text: &str| {
    let (keys, rows) = text.split_once("\n===\n").unwrap_or((text, ""));
    let read = |path: &std::path::Path| {
        let is_machine = path.ends_with("machine.toml");
        Ok(if is_machine { MACHINE } else { rows }.to_owned())
    };
    if let Ok(mut observations) = Observations::parse(keys, "observations.toml".as_ref(), &read) {
        observations.folds = 0;
        let _ = identify(&observations, |_, _| {});
    }
});
