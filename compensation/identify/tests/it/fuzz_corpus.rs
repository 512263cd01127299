//! Replays the kept inputs of the fuzz target; a file named `valid-…` must be read, one named `broken-…` refused.

use std::path::Path;

use volcomp_identify::{Observations, identify};
use volcomp_test_support::root;

/// The machine of `tests/fuzz/fuzz_targets/observations.rs`.
const MACHINE: &str = "structure = \"w b X Y C t\"
axes.X.travel = [0.0, 500.0]
axes.Y.travel = [0.0, 400.0]
axes.C.travel = [-180.0, 180.0]
";

#[test]
fn observations() {
    let mut count = 0;
    for entry in std::fs::read_dir(root().join("tests/fuzz/corpus/observations")).expect("a folder")
    {
        let path = entry.expect("an entry").path();
        let name = path
            .file_name()
            .expect("a name")
            .to_string_lossy()
            .into_owned();
        let text = String::from_utf8_lossy(&std::fs::read(&path).expect("read")).into_owned();
        let (keys, rows) = text.split_once("\n===\n").unwrap_or((&text, ""));
        let read = |path: &Path| {
            let text = if path.ends_with("machine.toml") {
                MACHINE
            } else {
                rows
            };
            Ok(text.to_owned())
        };
        let found = Observations::parse(keys, Path::new("observations.toml"), &read);
        assert!(
            found.is_ok() || !name.starts_with("valid-"),
            "{name} was refused: {found:?}"
        );
        assert!(
            found.is_err() || !name.starts_with("broken-"),
            "{name} was read"
        );
        if let Ok(found) = found {
            let _ = identify(&found, |_, _| {});
        }
        count += 1;
    }
    assert!(count >= 5, "{count} files");
}
