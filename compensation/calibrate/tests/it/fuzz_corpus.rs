//! Replays the stored fuzz inputs: a file named `valid-…` must parse, a file named `broken-…` must be rejected.

use std::fs;

use volcomp_calibrate::{CalibrationFile, calibrate};
use volcomp_test_support::root;

/// The machine of `tests/fuzz/fuzz_targets/calibration.rs`.
const MACHINE: &str = "structure = \"w b X Y C t\"
axes.X.travel = [0.0, 500.0]
axes.Y.travel = [0.0, 400.0]
axes.C.travel = [-180.0, 180.0]
";

#[test]
fn calibration_files() {
    let folder = tempfile::tempdir().expect("a folder");
    let write = |name: &str, text: &str| {
        fs::write(folder.path().join(name), text).expect("written");
    };
    write("machine.toml", MACHINE);
    let mut count = 0;
    for entry in fs::read_dir(root().join("tests/fuzz/corpus/calibration")).expect("a folder") {
        let path = entry.expect("an entry").path();
        let name = path.file_name().expect("a name").display().to_string();
        let text = String::from_utf8_lossy(&fs::read(&path).expect("read")).into_owned();
        let (keys, rows) = text.split_once("\n===\n").unwrap_or((&text, ""));
        write("c.toml", keys);
        write("m.csv", rows);
        let found = CalibrationFile::read(&folder.path().join("c.toml"));
        assert!(found.is_ok() || !name.starts_with("valid-"), "{name}: {found:?}");
        assert!(found.is_err() || !name.starts_with("broken-"), "{name} was read");
        if let Ok(file) = found {
            let _ = calibrate(&file, |_, _| {});
        }
        count += 1;
    }
    assert!(count >= 3, "{count} files");
}
